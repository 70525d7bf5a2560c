"""What holds while commands are executed: states, program, pass and labels as anywhere (`StreamContext`), and
whether conditional rendering lets draws through.

A condition can't be known when nobody has said what is seen. Its draws are then neither executed nor dropped
but *undecided*: they count as such, and make sample counts that include them unknown.
"""

from __future__ import annotations

import enum

from rhi.commands.context import StreamContext

__rhi_internal__ = True


class DrawOutcome(enum.Enum):
    """What becomes of a draw."""

    EXECUTED = "executed"
    DROPPED = "dropped"
    UNDECIDED = "undecided"

    __hash__ = object.__hash__


class ExecutionState(StreamContext):
    """The context of the command that is being executed."""

    __slots__ = ("outcome",)

    def __init__(self) -> None:
        super().__init__()
        self.outcome = DrawOutcome.EXECUTED

    def begin_conditional(self, samples: int | None, inverted: bool) -> None:
        """`samples` is the query's answer, None if it is not known."""
        if samples is None:
            self.outcome = DrawOutcome.UNDECIDED
        else:
            self.outcome = DrawOutcome.DROPPED if (samples == 0) != inverted else DrawOutcome.EXECUTED

    def end_conditional(self) -> None:
        self.outcome = DrawOutcome.EXECUTED
