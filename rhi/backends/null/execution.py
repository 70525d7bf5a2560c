"""The state while commands are executed: a `StreamContext`, and whether conditional rendering drops draws.

The condition is unknown if the samples of its query are. Its draws are then neither executed nor dropped but
*undecided*: they are counted as such, and sample counts that include them become unknown.
"""

from __future__ import annotations

from typing import TypeVar

from rhi.commands.context import StreamContext
from rhi.contract.descriptors import Id
from rhi.errors.choices import Choice

D = TypeVar("D")


class DrawOutcome(Choice):
    """The outcome of a draw under conditional rendering."""

    EXECUTED = "executed"
    DROPPED = "dropped"
    UNDECIDED = "undecided"


class ExecutionState(StreamContext):
    """The state at the command that is being executed.

    Attributes:
        outcome: the outcome of draws at this point.
    """

    __slots__ = ("outcome",)

    def __init__(self) -> None:
        super().__init__()
        self.outcome = DrawOutcome.EXECUTED

    def get(self, resource: Id, kind: type[D]) -> D:
        """Return the descriptor of a resource of this kind."""
        value = self.resources[resource]
        assert isinstance(value, kind)
        return value

    def decide(self, samples: int | None, inverted: bool) -> None:
        """Begin conditional rendering on a query that counted `samples`, None if unknown."""
        if samples is None:
            self.outcome = DrawOutcome.UNDECIDED
        else:
            self.outcome = DrawOutcome.DROPPED if (samples == 0) != inverted else DrawOutcome.EXECUTED

    def end_conditional(self) -> None:
        super().end_conditional()
        self.outcome = DrawOutcome.EXECUTED
