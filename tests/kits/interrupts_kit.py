"""Interrupts at chosen steps of a call.

CPython calls a signal's handler at few steps: when a Python function begins, after a call of C, and when a
loop goes back. `Interrupt` counts these steps inside a block, in all functions that the block calls, and
calls the handler of SIGINT at one of them, as the interpreter would: so what holds interrupts back holds
these back, too.
"""

from __future__ import annotations

import dis
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import CodeType, FrameType, TracebackType
from typing import Any, Self

EXEMPT = {__file__}
"""Files whose functions aren't interrupted: those of tests."""
_CALLS = {"CALL", "CALL_FUNCTION_EX"}
_BACK = {"JUMP_BACKWARD", "JUMP_BACKWARD_NO_INTERRUPT"}
# Python prints the exceptions of these and goes on. pytest keeps such an exception until the test's end, and
# with it the frames that the collector has interrupted, with all of their variables.
_DESTRUCTORS = {
    "DrawSlot.__del__",
    "GPUObjectBase.__del__",
    "IndexList.__del__",
    "PollToken.__del__",
    "WeakKeyDictionary.__init__.<locals>.remove",
    "WeakSet.__init__.<locals>._remove",
    "WeakValueDictionary.__init__.<locals>.remove",
    "_CounterPage.__del__",
    "finalize.__call__",
}
_FROM_C = {"__init__", "__new__", "__post_init__", "__call__", "__del__", "__init_subclass__"}


@contextmanager
def use_default_handler() -> Iterator[None]:
    """Make SIGINT raise KeyboardInterrupt inside a block, also where this process was started to ignore it, as
    background jobs of a shell are."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


class Interrupt:
    """A `with` block that is interrupted at its step number `at` (from 1; 0: never).

    Attributes:
        steps: the number of steps so far.
        where: the place of the interrupt, None before.
    """

    def __init__(self, at: int = 0) -> None:
        self._at = at
        self.steps = 0
        self.where: str | None = None
        self._last: dict[int, str] = {}
        self._destructors: set[int] = set()
        self._code: dict[CodeType, bytes] = {}
        # CPython borrows what it calls, and a destructor that is interrupted while it makes a frame may end
        # tracing.
        self._entering, self._going, self._leaving = self._begin, self._go_on, self._leave_destructor

    def __enter__(self) -> Self:
        sys.settrace(self._entering)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        sys.settrace(None)

    def _begin(self, frame: FrameType, event: str, argument: Any) -> Any:
        code = frame.f_code
        if code.co_filename in EXEMPT:
            return None
        caller = frame.f_back
        if code.co_qualname in _DESTRUCTORS or (caller is not None and id(caller) in self._destructors):
            self._destructors.add(id(frame))
            return self._leaving
        if caller is not None and self._last.get(id(caller)) == "CALL" and code.co_name not in _FROM_C:
            self._last[id(caller)] = (
                ""  # the interpreter calls Python functions without a step at their return
            )
        self._last[id(frame)] = ""
        frame.f_trace_opcodes = True
        frame.f_trace_lines = False
        self._step(frame)
        return self._going

    def _leave_destructor(self, frame: FrameType, event: str, argument: Any) -> Any:
        if event == "return":
            self._destructors.discard(id(frame))
        return self._leaving

    def _go_on(self, frame: FrameType, event: str, argument: Any) -> Any:
        if event == "opcode":
            key = id(frame)
            if self._last.get(key):
                self._last[key] = ""
                self._step(frame)
            code = self._code.get(frame.f_code)
            if code is None:
                code = self._code[frame.f_code] = frame.f_code.co_code
            name = dis.opname[code[frame.f_lasti]]
            if name in _CALLS or name in _BACK:
                self._last[key] = name
        elif event == "exception":
            # A call that raises has no step at its end. An interrupt there would be raised before the handler
            # has taken the exception, which CPython then keeps as the thread's current one for ever.
            self._last[id(frame)] = ""
        elif event == "return":
            self._last.pop(id(frame), None)
        return self._going

    def _step(self, frame: FrameType) -> None:
        self.steps += 1
        if self.steps == self._at:
            self.where = f"{frame.f_code.co_filename}:{frame.f_lineno} {frame.f_code.co_qualname}"
            handler = signal.getsignal(signal.SIGINT)
            assert callable(handler)
            handler(signal.SIGINT, frame)
