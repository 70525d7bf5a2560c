"""Helpers for tests of refused calls.

`with refuses(rule, device):` passes if the block breaks exactly this rule and no command of it reaches the
device.
"""

from __future__ import annotations

import sys
from types import TracebackType
from typing import Any

import numpy as np

from rhi import Device, Encoder, Format, Op, RhiError, Rule, ValidationError
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle

CACHED_CREATIONS = frozenset({Op.CREATE_VERTEX_ARRAY, Op.CREATE_SAMPLER, Op.CREATE_PROGRAM})
"""Created once per mesh and program, descriptor or shader, and then kept: any test may be the first to create
one."""


class refuses:  # noqa: N801 (reads as a verb, like pytest.raises)
    """A context manager that passes if its block raises an error of `rule` which names the call, the given
    value and the line in the test, and if a recording `device` received no command meanwhile.

    Attributes:
        error: the error that was raised, once the block has ended.
    """

    error: RhiError

    def __init__(
        self, rule: Rule, device: Device | None = None, kind: type[RhiError] = ValidationError
    ) -> None:
        self._rule = rule
        self._kind = kind
        self._stream = None if device is None else device.stream
        self._before = 0 if self._stream is None else len(self._stream)
        self._file = ""

    def __enter__(self) -> refuses:
        self._file = sys._getframe(1).f_code.co_filename
        self._before = 0 if self._stream is None else len(self._stream)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool:
        __tracebackhide__ = True
        if error is None:
            raise AssertionError(f"nothing was refused; expected [{self._rule.id}]")
        if not isinstance(error, RhiError):
            return False
        if error.rule is not self._rule:
            raise AssertionError(f"expected [{self._rule.id}], got:\n{error}") from error
        assert isinstance(error, self._kind), f"a {type(error).__name__}, expected a {self._kind.__name__}"
        text = str(error)
        assert text.startswith(f"[{self._rule.id}] {self._rule.sentence}"), text
        assert error.call, f"the message names no call:\n{text}"
        assert error.given, f"the message doesn't say what was given:\n{text}"
        assert error.allowed or error.tip, f"the message doesn't say what is allowed:\n{text}"
        line = 0
        while trace is not None:
            if trace.tb_frame.f_code.co_filename == self._file:
                line = trace.tb_lineno
            trace = trace.tb_next
        assert error.site is not None, f"the message names no line:\n{text}"
        assert (error.site.file, error.site.line) == (self._file, line), text
        if self._stream is not None:
            done = self._stream[self._before :].filter(frozenset(Op) - CACHED_CREATIONS)
            assert not len(done), f"refused, but done in part:\n{done}"
        self.error = error
        return True


def loose(encoder: Encoder) -> Any:
    """Return a device or command buffer without its types, for calls that a type checker would refuse."""
    return encoder


def check_working(device: Device) -> None:
    """Check that a device still writes, renders, draws if it has draws, and reads."""
    with device.buffer(np.arange(4, dtype="u4")) as buffer:
        assert_same(buffer.read(), np.arange(4))
    capabilities = device.capabilities
    with device.texture((2, 2), Format.R8) as image, device.mesh(rectangle()) as mesh:
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            if capabilities.draws:
                device.draw(device.program(Colored), mesh)
        assert_same(image.read(), 255 if capabilities.renders else 0)
