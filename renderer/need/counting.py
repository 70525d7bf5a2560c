"""What each rung of the ladder adds to a frame, counted on null devices, and what is left of it once it is removed.

A frame's commands don't depend on the device, so all of this is exact. Python's calls are counted as well: two frames that
make the same calls take the processor the same work.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any, Final

import rhi
from renderer.measure.memory import describe_memory
from renderer.need.ladder import LADDER, build_scene, move_eye
from renderer.renderer import Renderer
from renderer.techniques import Forward
from renderer.visibility import make_visibility
from rhi import Command, Commands, Op
from rhi.testing import frames
from rhi.trace import Differences, diff

__rhi_internal__ = True

SIZE: Final = (320, 180)
"""The size of the ladder's pictures."""

_WARM: Final = 5
"""Frames before the one that is counted: in the first ones resources are made, and states are set back."""

_DRAWS: Final = (Op.DRAW, Op.DRAW_INDIRECT)
_DISPATCHES: Final = (Op.DISPATCH, Op.DISPATCH_INDIRECT)
_BINDS: Final = (Op.BIND_UNIFORM, Op.BIND_STORAGE, Op.BIND_TEXTURE, Op.BIND_IMAGE)
_WRITES: Final = (Op.WRITE_BUFFER, Op.WRITE_TEXTURE)

Calls = Counter[tuple[str, str]]
"""How often each Python function was called: its module, and its name there."""


@dataclass(frozen=True, slots=True)
class FrameCosts:
    """What a scene and a frame of it cost.

    Attributes:
        passes: the names of the frame's events. draws, dispatches: the numbers of calls. programs: that of the programs
            that run. bindings: that of the resources that are bound.
        uploads: bytes written in the frame, in which the eye moves. setup: bytes written before.
        images, buffers: bytes of the textures and of the buffers that are held.
        steps: of simulations. calls: of Python functions.
    """

    passes: tuple[str, ...]
    draws: int
    dispatches: int
    programs: int
    bindings: int
    uploads: int
    setup: int
    images: int
    buffers: int
    steps: int
    calls: int


@dataclass(frozen=True, eq=False, slots=True)
class Counted:
    """A frame, all that was done for it, and its commands.

    Attributes:
        costs: the numbers. called: the Python functions. commands: those of the frame.
        held: the bytes of what is held on the device, by name and shape.
    """

    costs: FrameCosts
    called: Calls
    commands: Commands
    held: dict[tuple[str, str], int]


@dataclass(frozen=True, slots=True)
class Removed:
    """What is left of an effect that was removed, compared with a scene that never had it.

    Attributes:
        differences: of the frame's commands. calls: Python calls that only one of the two frames makes.
        bytes: what the device holds more.
    """

    differences: int
    calls: int
    bytes: int

    @property
    def is_nothing(self) -> bool:
        """Whether nothing is left."""
        return not (self.differences or self.calls or self.bytes)


class Ascent:
    """A renderer of the scene of the first rungs."""

    def __init__(self, device: rhi.Device, count: int, size: tuple[int, int] = SIZE, *, is_complete: bool = True) -> None:
        """Switch on what the first `count` rungs have; without the last one if it isn't to be `complete`."""
        self.scene, self._rows = build_scene(count)
        self._count, self.frame = count, 0
        visibility = make_visibility("frustum", self.scene, device)
        self.renderer = Renderer(device, self.scene, technique=Forward(), visibility=visibility, size=size)
        for number in range(count):
            self.switch(number, is_on=is_complete or number < count - 1)

    def switch(self, number: int, *, is_on: bool) -> None:
        """Switch the effect of a rung on or off, if that can be done at run time."""
        switch = LADDER[number].switch
        if switch is not None:
            switch(self.renderer, self._rows[number], is_on)

    def render(self, count: int = 1) -> None:
        """Render the next frames."""
        for _ in range(count):
            self.renderer.render(move_eye(self.frame), self.frame / 60.0)
            self.frame += 1

    def destroy(self) -> None:
        """Destroy the renderer and its layers."""
        for layer in self.renderer.layers:
            layer.destroy()
        self.renderer.destroy()
        self.renderer.visibility.destroy()


def count_rung(number: int) -> Counted:
    """Count a frame of the scene of a rung."""
    with rhi.create_device("null") as device:
        ascent = Ascent(device, number + 1)
        ascent.render(_WARM)
        counted = count_frame(ascent)
        ascent.destroy()
    return counted


def count_frame(ascent: Ascent) -> Counted:
    """Count the next frame."""
    device = ascent.renderer.device
    steps, called = 0, Counter[tuple[str, str]]()
    with watch_calls(called):
        ascent.render()
    steps = ascent.renderer.simulator.steps
    commands = frames(device)[-1]
    before = device.stream[: commands[0].index]
    held = describe_memory(device.stream, None).rows
    images = sum(row.bytes for row in held if row.shape != "buffer")
    runs = commands.filter((*_DRAWS, *_DISPATCHES))
    costs = FrameCosts(
        passes=tuple(one["text"] for one in commands.filter(Op.PUSH_LABEL)),
        draws=len(commands.filter(_DRAWS)),
        dispatches=len(commands.filter(_DISPATCHES)),
        programs=len({one.program for one in runs}),
        bindings=len(commands.filter(_BINDS)),
        uploads=_count_bytes(commands),
        setup=_count_bytes(before),
        images=images,
        buffers=sum(row.bytes for row in held) - images,
        steps=steps,
        calls=called.total(),
    )
    return Counted(costs, called, commands, {(row.name, row.shape): row.bytes for row in held})


def _count_bytes(commands: Commands) -> int:
    return sum(len(one["data"]) for one in commands.filter(_WRITES))


@contextmanager
def watch_calls(called: Calls) -> Iterator[None]:
    """Count the Python functions that a block calls."""

    def note(frame: FrameType, event: str, _: Any) -> None:
        if event == "call":
            called[frame.f_globals.get("__name__", ""), frame.f_code.co_qualname] += 1

    before = sys.getprofile()
    sys.setprofile(note)
    try:
        yield
    finally:
        sys.setprofile(before)


def remove_rung(number: int) -> tuple[Counted, Counted]:
    """Count a frame of a scene that never had the effect of a rung, and one of a scene from which it was removed.

    What can be switched is switched off in a renderer that has drawn it. What is a part of the scene is left out of
    another scene on the same device, after a renderer of the one with it was destroyed.
    """
    is_switched = LADDER[number].switch is not None
    with rhi.create_device("null") as one, rhi.create_device("null") as other:
        never = Ascent(one, number + 1 if is_switched else number, is_complete=not is_switched)
        never.render(2 * _WARM)
        removed = Ascent(other, number + 1)
        removed.render(_WARM)
        if is_switched:
            removed.switch(number, is_on=False)
        else:
            removed.destroy()
            removed = Ascent(other, number)
            removed.render(_WARM)
        removed.render(_WARM)
        return count_frame(never), count_frame(removed)


def compare(never: Counted, removed: Counted) -> tuple[Removed, Differences]:
    """Return what is left of an effect that was removed, and how the commands of the two frames differ."""
    differences = diff(never.commands, removed.commands)
    calls = (never.called - removed.called).total() + (removed.called - never.called).total()
    left = {key: size - never.held.get(key, 0) for key, size in removed.held.items()}
    missing = {key: size for key, size in never.held.items() if key not in removed.held}
    return Removed(len(differences), calls, sum(left.values()) - sum(missing.values())), differences
