"""What holds as commands come: the bound program, what is bound to its slots, the open pass, the labels.

OpenCL knows none of these: a kernel has arguments, and labels only serve to say where something failed.
"""

from __future__ import annotations

from typing import TypeAlias

from rhi.contract.descriptors import BindingKind, Id, PassDescriptor

__rhi_internal__ = True


Slots: TypeAlias = dict[tuple[BindingKind, int], tuple[int, ...]]
"""What is bound, by kind and slot: the arguments of the binding command behind the slot."""


class States:
    """Of one device.

    Attributes:
        slots: what is bound.
        labels: the open ones, outermost first.
    """

    __slots__ = ("labels", "program", "render_pass", "slots")

    def __init__(self) -> None:
        self.program: Id = 0
        self.slots: Slots = {}
        self.render_pass = PassDescriptor((0, 0))
        self.labels: list[str] = []

    def place(self, call: str) -> str:
        """A call and the labels it lies in, for a message."""
        return f"{call} in {' / '.join(self.labels)}" if self.labels else call
