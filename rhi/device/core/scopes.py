"""The open scopes of a device or command buffer, in one stack: states, passes, events, conditions and
queries.

Scopes nest, whatever their kinds. The entries of the stack are the `with` blocks themselves, so that a scope
makes no object more than it would alone. Most are left as the innermost one, and then only pop themselves,
without a call. `OpenScopes` handles the two exceptions:

- **A scope is left while scopes inside it are open**: one that a generator holds, for example, which is
  closed inside another scope. This is refused (`scope-order`), unless an exception is on its way that the
  refusal would hide. The scope then ends together with the one inside it. Until then draws have the states
  with which the inner scope was entered, afterwards the states of the scopes that are still open. So backends
  see begins and ends that always nest.
- **A block is left without its end**, since Python can raise `KeyboardInterrupt` at the first step of an
  `__exit__`. Then nothing refers to the block any more, and its scope ends with the next scope around it, or
  before the next pass or `present`. While the interrupt propagates, its traceback still refers to the block.
  So the scopes that the interrupt leaves end everything inside.

A scope that ended before its block leaves quietly.
"""

from __future__ import annotations

from sys import getrefcount, is_finalizing
from typing import Final, NoReturn

from rhi.contract.interrupts import DeferredInterrupts
from rhi.device.core.containers import FixedStack
from rhi.device.core.refusals import NO_LOG, RefusalLog
from rhi.errors.call_sites import CallSite, find_call_site
from rhi.errors.device_objects import DeviceObject
from rhi.errors.rules import CONTAINER_FULL, SCOPE_OPEN, SCOPE_ORDER

STACK_DEPTH: Final = 256
_OWN: Final = 2
"""References to a block that `sys.getrefcount` itself causes: a variable's and an argument's."""


class Scope(DeviceObject):
    """An entry of the stack: a `with` block that was entered."""

    __slots__ = ()

    def get_block(self) -> Scope:
        """Return the block whose end ends this scope: itself, unless the block was entered inside itself."""
        return self

    def describe(self) -> str:
        """Return the scope's text in messages."""
        raise NotImplementedError

    def finish(self, failed: bool) -> None:
        """Pop this scope, the innermost one, and end it; `failed` if an exception leaves its block."""
        raise NotImplementedError

    def cut_off(self) -> None:
        """End this scope, the innermost one, before its block."""
        self.finish(True)


class _OuterEnd(Scope):
    """A scope in the stack whose end also ends the one below it, which was left before."""

    __slots__ = ("scope",)

    def __init__(self, scope: Scope) -> None:
        self.scope = scope

    def get_block(self) -> Scope:
        return self.scope.get_block()

    def describe(self) -> str:
        return self.scope.describe()


class OpenScopes(FixedStack[Scope]):
    """The stack of one encoder's open scopes. Its capacity limits the scopes of states; other scopes have
    extra room.

    Attributes:
        refusals: raises and keeps the errors of refused calls.
        records_lines: whether messages name the lines that entered the scopes.
    """

    __slots__ = ("_closed", "_cut", "_lines", "records_lines", "refusals")

    def __init__(self, refusals: RefusalLog = NO_LOG) -> None:
        super().__init__(STACK_DEPTH)
        self.refusals = refusals
        self.records_lines = False
        self._closed = False
        self._cut: set[Scope] = set()  # blocks whose scopes ended before them
        self._lines: dict[int, CallSite | None] = {}  # by index in the stack

    def push(self, value: Scope) -> None:
        """Enter a scope."""
        index = self._index
        try:
            self._data[index] = value
        except IndexError:
            self._data.append(value)
        self._index = index + 1
        if self.records_lines:
            self.record_line()

    def refuse_full(self) -> NoReturn:
        """Refuse one scope of states too many."""
        given, allowed = f"{self._index} elements", f"at most {self.capacity}"
        self.refusals.refuse(CONTAINER_FULL, "FixedStack.push", given, allowed)

    def record_line(self) -> None:
        """Keep the user's line as the one that entered the innermost scope, if lines are kept."""
        if self.records_lines:
            self._lines[self._index - 1] = find_call_site()

    def leave(self, scope: Scope, error: BaseException | None, *, again: bool = False) -> None:
        """End a scope as its block is left, by an exception or without one.

        Args:
            again: whether a refused call has no effect, since it can be repeated later.

        Raises:
            ValidationError: `scope-order` if scopes inside it are open or it isn't; not while an exception is
                on its way, unless that only closes a generator.
        """
        if self._data[self._index - 1] is scope:
            scope.finish(error is not None)
        elif not self._closed and not is_finalizing():
            with DeferredInterrupts():
                self._leave_around(scope, error, again)

    def _leave_around(self, scope: Scope, error: BaseException | None, again: bool) -> None:
        """End a scope that is not the innermost."""
        index = self._find_index(scope)
        if index < 0:
            if scope in self._cut:
                self._cut.discard(scope)
            else:
                self.refuse_unopened(scope.describe(), error)
            return
        if _comes_of_interrupt(error):
            while self._index > index + 1:
                self._cut.add(self.top.get_block())
                self._end_innermost(cut_off=True)
        else:
            self.end_unreferenced()
        if self._index <= index:
            return  # it ended with what was inside
        if self._index == index + 1:
            self._end_innermost(failed=error is not None)
            return
        inner = self[index + 1]
        if not again and not isinstance(inner, _OuterEnd):
            self._data[index + 1] = _OuterEnd(inner)
        if _may_raise(error):
            given = f"{inner.describe()}, entered inside it, is still open"
            if self.records_lines:
                entry, around = self._lines.get(index + 1), self._lines.get(index)
                given += f"\nentered at {entry}, the one around it at {around}"
            self.refusals.refuse(
                SCOPE_ORDER, f"the end of {scope.describe()}", given, "the innermost open scope"
            )

    def _end_innermost(self, *, failed: bool = True, cut_off: bool = False) -> None:
        """End the innermost scope, and those around it that were left before."""
        entry = self.top
        scope = self._data[self._index - 1] = unwrap(entry)
        try:
            scope.cut_off() if cut_off else scope.finish(failed)
        finally:
            if isinstance(entry, _OuterEnd) and self._index:
                self._cut.add(self.top.get_block())
                self._end_innermost()

    def _find_index(self, scope: Scope) -> int:
        """Find the stack index of a scope, or of the latest scope that was entered through it; -1 if there is
        none."""
        for index in reversed(range(self._index)):
            entry = unwrap(self[index])
            if entry is scope or entry.get_block() is scope:
                return index
        return -1

    def withdraw(self, scope: Scope) -> None:
        """Remove a scope that can't be ended, with all scopes inside it. Leaving their blocks does
        nothing."""
        index = self._find_index(scope)
        if index >= 0:
            self._cut.update(entry.get_block() for entry in self._data[index : self._index] if entry)
            self._data[index : self._index] = [None] * (self._index - index)
            self._index = index

    def end_unreferenced(self) -> None:
        """End the innermost scopes whose blocks are no longer referenced, and forget those blocks."""
        if self._cut:
            self._cut = {block for block in self._cut if getrefcount(block) > 1 + _OWN}
        while self._index and not self._is_referenced():
            self._end_innermost(cut_off=True)

    def _is_referenced(self) -> bool:
        """True if anything but this stack refers to the innermost scope's block."""
        block = self.top.get_block()
        ours = sum(entry.get_block() is block for entry in self) + (block in self._cut)
        return getrefcount(block) > ours + _OWN

    def refuse_unopened(self, scope: str, error: BaseException | None) -> None:
        """Refuse the end of a scope that isn't open, unless that would hide an exception that is on its
        way."""
        if _may_raise(error):
            given = "a scope that isn't open, or was left before"
            self.refusals.refuse(SCOPE_ORDER, f"the end of {scope}", given, "one end for each begin")

    def refuse_open(self, call: str) -> None:
        """Refuse a call that no scope may surround."""
        self.end_unreferenced()
        if self._index:
            given = f"a call inside {self.describe_open()}"
            self.refusals.refuse(SCOPE_OPEN, call, given, "no open scope")

    def describe_open(self) -> str:
        """Return the innermost scope's text, empty if none is open."""
        return self.top.describe() if self._index else ""

    def close(self) -> None:
        """Forget all scopes: their blocks are left quietly from now on."""
        self.clear()
        self._cut.clear()
        self._closed = True


def unwrap(entry: Scope) -> Scope:
    """Return the scope itself, whether or not it also ends the one below it."""
    return entry.scope if isinstance(entry, _OuterEnd) else entry


def _may_raise(error: BaseException | None) -> bool:
    """True if a block's end may raise: no exception is propagating, or only one that closes a generator."""
    return error is None or isinstance(error, GeneratorExit)


def _comes_of_interrupt(error: BaseException | None) -> bool:
    """True if an exception is an interrupt, or was raised while an interrupt propagated."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error is not None
