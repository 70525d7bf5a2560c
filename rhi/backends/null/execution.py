"""What holds while commands are executed: states, program, pass and labels as anywhere (`Context`), and
whether conditional rendering lets draws through.

A condition can't be known when nobody has said what is seen. Its draws are then neither executed nor dropped
but *undecided*: they count as such, and make sample counts that include them unknown.
"""

from __future__ import annotations

import enum

from rhi.commands.context import Context

__rhi_internal__ = True


class Fate(enum.Enum):
    """What becomes of a draw."""

    EXECUTED = "executed"
    DROPPED = "dropped"
    UNDECIDED = "undecided"

    __hash__ = object.__hash__


class ExecutionState(Context):
    """The context of the command that is being executed."""

    __slots__ = ("fate",)

    def __init__(self) -> None:
        super().__init__()
        self.fate = Fate.EXECUTED

    def begin_conditional(self, samples: int | None, inverted: bool) -> None:
        """`samples` is the query's answer, None if it is not known."""
        if samples is None:
            self.fate = Fate.UNDECIDED
        else:
            self.fate = Fate.DROPPED if (samples == 0) != inverted else Fate.EXECUTED

    def end_conditional(self) -> None:
        self.fate = Fate.EXECUTED
