"""The made-up programs would notice a fault in the masks: each kind of it, built in, is found by a hundred of them."""

import sys
from dataclasses import replace

import pytest
from hypothesis import given
from test_shading_lane_programs import check, program_settings, programs

from rhi.shading.ir import lanes
from rhi.shading.lowering.scopes import ScopeLowering
from rhi.shading.numpy import writer as numpy_code
from rhi.shading.opencl import writer as opencl


def forget_mask(node):
    return replace(node, mask=None)


def break_assignments(monkeypatch):
    """Assignments under a condition reach all lanes."""
    real = opencl.Writer.set
    monkeypatch.setattr(opencl.Writer, "set", lambda self, node: real(self, forget_mask(node)))


def break_stores(monkeypatch):
    real = opencl.Writer.store
    monkeypatch.setattr(opencl.Writer, "store", lambda self, node: real(self, forget_mask(node)))


def break_atomics(monkeypatch):
    real = opencl.Writer.atomic
    monkeypatch.setattr(opencl.Writer, "atomic", lambda self, node: real(self, forget_mask(node)))


def break_exits(monkeypatch):
    """A break or return takes lanes out of the innermost mask only."""

    def narrow(self, end):
        self.emit(lanes.Set(self.line, self.scope.mask, lanes.FALSE, None))

    monkeypatch.setattr(ScopeLowering, "narrow", narrow)


def break_nesting(monkeypatch):
    """A branch forgets who takes part outside it."""
    real = ScopeLowering.mask_value

    def mask_value(self):
        return lanes.TRUE if sys._getframe(1).f_code.co_name == "branch" else real(self)

    monkeypatch.setattr(ScopeLowering, "mask_value", mask_value)


def break_else(monkeypatch):
    """`else` is for those that the condition holds for."""

    def two_branches(self, condition):
        condition = self.let(condition, "condition")
        return condition, condition

    monkeypatch.setattr(ScopeLowering, "two_branches", two_branches)


def break_nobody_left(monkeypatch):
    """Code is left as soon as one lane has left it."""
    real = opencl.Writer.jump

    def jump(self, node, text, mask):
        start = len(self.lines.text)
        real(self, node, text, mask)
        self.lines.text[start:] = [line.replace("!rhi_any(", "!rhi_all(") for line in self.lines.text[start:]]

    monkeypatch.setattr(opencl.Writer, "jump", jump)


def break_numpy(monkeypatch):
    real = numpy_code._Writer.statement

    def statement(self, node, depth):
        real(self, forget_mask(node) if isinstance(node, lanes.Set) else node, depth)

    monkeypatch.setattr(numpy_code._Writer, "statement", statement)


FAULTS = [
    break_assignments,
    break_stores,
    break_atomics,
    break_exits,
    break_nesting,
    break_else,
    break_nobody_left,
    break_numpy,
]


@pytest.mark.nightly
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_a_fault_in_the_masks_is_found(fault, tmp_path, run, monkeypatch):
    @program_settings(100)
    @given(source=programs())
    def all_agree(source):
        check(source, tmp_path, run)

    fault(monkeypatch)
    with pytest.raises(AssertionError, match=r"one lane|16 lanes|NumPy"):
        all_agree()
