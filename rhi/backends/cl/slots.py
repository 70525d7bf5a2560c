"""State that commands set one by one: the bound program, the bound resources, the open pass, the open labels.

OpenCL has none of these. Kernels take arguments, and labels only serve to say in errors where a command failed.
"""

from __future__ import annotations

from typing import TypeAlias

from rhi.contract.descriptors import BindingKind, Id, PassDescriptor

Slots: TypeAlias = dict[tuple[BindingKind, int], tuple[int, ...]]
"""Bound resources by kind and slot: the arguments of the binding command that follow the slot."""


class CommandState:
    """The command state of one device.

    Attributes:
        slots: the bound resources.
        labels: the open labels, outermost first.
    """

    __slots__ = ("labels", "program", "render_pass", "slots")

    def __init__(self) -> None:
        self.program: Id = 0
        self.slots: Slots = {}
        self.render_pass = PassDescriptor((0, 0))
        self.labels: list[str] = []

    def locate(self, call: str) -> str:
        """Return the name of a call with the labels that are open around it, for an error."""
        return f"{call} in {' / '.join(self.labels)}" if self.labels else call
