"""A test of the generated programs: some hundreds of them find each kind of deliberate fault in the masks."""

import os
import subprocess
import sys
from dataclasses import replace
from signal import SIGSEGV

import pytest
from hypothesis import given
from test_shading_lane_programs import check_shader, program_settings, programs

from rhi.shading import from_source
from rhi.shading.ir import lanes
from rhi.shading.lowering.context import Lowering
from rhi.shading.numpy import numpy_writer as numpy_code
from rhi.shading.opencl import opencl_writer as opencl


def forget_mask(node):
    return replace(node, mask=None)


def break_assignments(monkeypatch):
    """Assignments under a condition change all lanes."""
    real = opencl.OpenCLWriter.set
    monkeypatch.setattr(opencl.OpenCLWriter, "set", lambda self, node: real(self, forget_mask(node)))


def break_stores(monkeypatch):
    real = opencl.OpenCLWriter.store
    monkeypatch.setattr(opencl.OpenCLWriter, "store", lambda self, node: real(self, forget_mask(node)))


def break_atomics(monkeypatch):
    real = opencl.OpenCLWriter.atomic
    monkeypatch.setattr(opencl.OpenCLWriter, "atomic", lambda self, node: real(self, forget_mask(node)))


def break_exits(monkeypatch):
    """A break or return removes lanes from the innermost mask only."""

    def narrow(self, end):
        self.emit(lanes.Set(self.line, self.scope.mask, lanes.FALSE, None))

    monkeypatch.setattr(Lowering, "narrow", narrow)


def break_nesting(monkeypatch):
    """The mask of a branch ignores the masks outside it."""
    real = Lowering.mask_value

    def mask_value(self):
        return lanes.TRUE if sys._getframe(1).f_code.co_name == "branch" else real(self)

    monkeypatch.setattr(Lowering, "mask_value", mask_value)


def break_else(monkeypatch):
    """`else` is executed where the condition is true."""

    def condition_and_negation(self, condition):
        condition = self.let(condition, "condition")
        return condition, condition

    monkeypatch.setattr(Lowering, "condition_and_negation", condition_and_negation)


def break_nobody_left(monkeypatch):
    """A masked jump is taken as soon as one lane is inactive, not only when all are."""
    real = opencl.OpenCLWriter.jump

    def jump(self, node, text, mask):
        start = len(self.lines.text)
        real(self, node, text, mask)
        self.lines.text[start:] = [line.replace("!rhi_any(", "!rhi_all(") for line in self.lines.text[start:]]

    monkeypatch.setattr(opencl.OpenCLWriter, "jump", jump)


def break_numpy(monkeypatch):
    real = numpy_code._NumpyWriter.statement

    def statement(self, node, depth):
        real(self, forget_mask(node) if isinstance(node, lanes.Set) else node, depth)

    monkeypatch.setattr(numpy_code._NumpyWriter, "statement", statement)


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
def test_a_fault_in_the_masks_is_found(fault, run, monkeypatch, request):
    @program_settings(400)  # up to the first that finds it
    @given(source=programs())
    def all_agree(source):
        try:
            check_shader(from_source(source), source, run)
        except ValueError as error:  # NumPy has no branch for lanes that part
            raise AssertionError("NumPy") from error

    if fault is break_stores and "RHI_ALONE" not in os.environ:  # lanes that are off may end the process
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-n",
            "0",
            "-m",
            "",
            f"{__file__}::{request.node.name}",
        ]
        assert subprocess.run(command, env=os.environ | {"RHI_ALONE": "1"}, check=False).returncode in (
            0,
            -SIGSEGV,
        )
        return
    fault(monkeypatch)
    with pytest.raises(AssertionError, match=r"one lane|16 lanes|NumPy"):
        all_agree()
