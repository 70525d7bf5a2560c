"""The state while commands are executed: that of a `StreamContext`, and whether conditional rendering drops draws.

The condition is unknown if the samples of its query are. Its draws are then neither executed nor dropped but
*undecided*: they are counted as such, and sample counts that include them become unknown.
"""

from __future__ import annotations

from typing import cast

from rhi.commands.context import StreamContext
from rhi.contract.descriptors import Id, ProgramDescriptor, SamplerDescriptor, VertexArrayDescriptor
from rhi.contract.formats import Choice


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

    def find_program(self, program: Id) -> ProgramDescriptor:
        """Return the descriptor of a program."""
        return cast("ProgramDescriptor", self.resources[program])

    def find_sampler(self, sampler: Id) -> SamplerDescriptor:
        """Return the descriptor of a sampler."""
        return cast("SamplerDescriptor", self.resources[sampler])

    def find_vertex_array(self, vertex_array: Id) -> VertexArrayDescriptor:
        """Return the descriptor of a vertex array."""
        return cast("VertexArrayDescriptor", self.resources[vertex_array])

    def decide(self, samples: int | None, inverted: bool) -> None:
        """Begin conditional rendering on a query that counted `samples`, None if unknown."""
        if samples is None:
            self.outcome = DrawOutcome.UNDECIDED
        else:
            self.outcome = DrawOutcome.DROPPED if (samples == 0) != inverted else DrawOutcome.EXECUTED

    def end_conditional(self) -> None:
        super().end_conditional()
        self.outcome = DrawOutcome.EXECUTED
