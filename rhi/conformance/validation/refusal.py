"""`with refuses(rule, device):` the block breaks exactly this rule, and nothing of it is done."""

from __future__ import annotations

import sys
from types import TracebackType
from typing import Any

from rhi import Device, Encoder, Op, RhiError, Rule, ValidationError

MEMOS = frozenset({Op.CREATE_VERTEX_ARRAY, Op.CREATE_SAMPLER, Op.CREATE_PROGRAM})
"""Made once for a mesh and program, a descriptor or a shader, and kept: which test asks first is anybody's guess."""


class refuses:  # noqa: N801 (reads as a verb, like pytest.raises)
    """Passes if the block raises an error of `rule` that names the call, what was given and the line in the
    test, and if a recording `device` heard of no command meanwhile.

    Attributes:
        error: what was raised, once the block has ended.
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
            done = self._stream[self._before :].filter(frozenset(Op) - MEMOS)
            assert not len(done), f"refused, but done in part:\n{done}"
        self.error = error
        return True


def loose(encoder: Encoder) -> Any:
    """A device or command buffer without its types: for calls that a type checker refuses before they run."""
    return encoder
