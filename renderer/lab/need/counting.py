"""Counts, on null devices, of what each rung of the ladder adds to a frame, and of what is left once it is removed.

A frame's commands don't depend on the device, so all of this is exact. Python's calls are counted as well: two frames
that make the same calls take the processor the same work.
"""

from __future__ import annotations

import gc
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any, Final

from numpy.typing import NDArray

import rhi
from renderer.lab.measure.memory import describe_memory
from renderer.lab.need.ladder import LADDER, build_scene, move_eye
from renderer.renderer import Renderer
from renderer.techniques import Forward
from rhi import Commands, Op
from rhi.testing import assert_free, frames
from rhi.trace import Differences, diff

SIZE: Final = (320, 180)
"""The size of the ladder's pictures."""

POOLS: Final = frozenset(
    (
        "draw arguments",
        "readback",
        "transient constants",
        "PixelRays",
        "Haze",
        "FogConstants",
        "Background",
        "Share",
        "SunTable",
    )
)
"""What may stay for what comes next: rings of the device, and constants of less than a kilobyte."""

_WARM: Final = 3
"""Frames before the one that is counted: in the first ones resources are made, and states are set back."""

_DRAWS: Final = (Op.DRAW, Op.DRAW_INDIRECT)
_DISPATCHES: Final = (Op.DISPATCH, Op.DISPATCH_INDIRECT)
_BINDS: Final = (Op.BIND_UNIFORM, Op.BIND_STORAGE, Op.BIND_TEXTURE, Op.BIND_IMAGE)
_WRITES: Final = (Op.WRITE_BUFFER, Op.WRITE_TEXTURE)

Calls = Counter[tuple[str, str]]
"""The number of calls of each Python function: its module, and its name there."""


@dataclass(frozen=True, slots=True)
class FrameCosts:
    """The costs of a scene and of a frame of it.

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
class CountedFrame:
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
class Left:
    """The remains of an effect that was removed, compared with a scene that never had it.

    Attributes:
        differences: of the frame's commands. calls: of the renderer's functions, of which one of the frames makes more.
        device_calls: the same of the device's functions: it counts the draws of each program that there is.
        held: the bytes that the device holds more, by name.
    """

    differences: int
    calls: int
    device_calls: int
    held: dict[str, int]


class Ascent:
    """A renderer of the scene of the first rungs."""

    def __init__(
        self, device: rhi.Device, count: int, size: tuple[int, int] = SIZE, *, without: int | None = None
    ) -> None:
        """Switch on what the first `count` rungs have, but for the number of one to be `without`."""
        self.scene, self._rows = build_scene(count)
        self._count, self.frame = count, 0
        self.renderer = Renderer(device, self.scene, technique=Forward(), visibility="frustum", size=size)
        for number in range(count):
            self.switch(number, is_on=number != without)

    def switch(self, number: int, *, is_on: bool) -> None:
        """Switch the effect of a rung on or off, if that can be done at run time."""
        switch = LADDER[number].switch
        if switch is not None:
            switch(self.renderer, self._rows[number], is_on)

    def render(self, count: int = 1) -> None:
        """Render the next frames."""
        for _ in range(count):
            self._image = self.renderer.render(move_eye(self.frame), self.frame / 60.0).image
            self.frame += 1

    def read(self) -> NDArray[Any]:
        """Return the pixels (height, width, 4) of the latest frame."""
        pixels: NDArray[Any] = self._image.read()
        return pixels

    def destroy(self) -> None:
        """Destroy the renderer and its layers."""
        for layer in self.renderer.layers:
            layer.destroy()
        self.renderer.destroy()


def count_rung(number: int) -> CountedFrame:
    """Count a frame of the scene of a rung."""
    with rhi.create_device("null") as device:
        ascent = Ascent(device, number + 1)
        ascent.render(_WARM)
        counted = count_frame(ascent)
        ascent.destroy()
    return counted


def count_frame(ascent: Ascent) -> CountedFrame:
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
    return CountedFrame(costs, called, commands, {(row.name, row.shape): row.bytes for row in held})


def count_calls(number: int, counted: CountedFrame) -> int:
    """Return how many calls of a frame are those of functions of a rung's own modules."""
    modules = LADDER[number].modules
    return sum(count for (module, _), count in counted.called.items() if modules and module.startswith(modules))


def _count_bytes(commands: Commands) -> int:
    return sum(len(one["data"]) for one in commands.filter(_WRITES))


@contextmanager
def watch_calls(called: Calls) -> Iterator[None]:
    """Count the Python functions that a block calls, except for the comparisons and hashes of dataclasses: how often a
    dictionary compares depends on the addresses of objects. No garbage is collected meanwhile, since who asked to be
    told of that would be counted."""

    def note(frame: FrameType, event: str, _: Any) -> None:
        if event == "call" and not frame.f_code.co_qualname.startswith("__create_fn__"):
            called[frame.f_globals.get("__name__", ""), frame.f_code.co_qualname] += 1

    before, collects = sys.getprofile(), gc.isenabled()
    gc.disable()
    sys.setprofile(note)
    try:
        yield
    finally:
        sys.setprofile(before)
        if collects:
            gc.enable()


def open_without(device: rhi.Device, number: int, count: int | None = None) -> Ascent:
    """Open a renderer of the scene of a rung that never had its effect; of the scene before it if that is a part of the
    scene. With a `count`, the scene has this many rungs."""
    if LADDER[number].switch is None:
        return Ascent(device, number)
    return Ascent(device, count or number + 1, without=number)


def remove(device: rhi.Device, number: int, count: int | None = None) -> Ascent:
    """Draw the scene of a rung, or of a `count` of them, and remove the effect.

    What can be switched is switched off in the renderer that has drawn it. What is a part of the scene is left out of
    another one on the same device, after the renderer of the one with it was destroyed.
    """
    ascent = Ascent(device, count or number + 1)
    ascent.render(_WARM)
    if LADDER[number].switch is not None:
        ascent.switch(number, is_on=False)
        return ascent
    ascent.destroy()
    ascent = Ascent(device, number)
    ascent.render(_WARM)
    return ascent


def remove_rung(number: int, count: int | None = None) -> tuple[CountedFrame, CountedFrame]:
    """Count a frame of a scene that never had the effect of a rung, and one of a scene from which it was removed. Both
    have the first `count` rungs, by default those up to this one."""
    with rhi.create_device("null") as one, rhi.create_device("null") as other:
        never = open_without(one, number, count)
        never.render(2 * _WARM)
        removed = remove(other, number, count)
        removed.render(_WARM)
        return count_frame(never), count_frame(removed)


def compare(never: CountedFrame, removed: CountedFrame) -> tuple[Left, Differences]:
    """Return what is left of an effect that was removed, and how the commands of the two frames differ."""
    differences = diff(never.commands, removed.commands)
    calls = Counter[bool]()
    for more in (never.called - removed.called, removed.called - never.called):
        for (module, _), count in more.items():
            calls[module.startswith("renderer.")] += count
    held: Counter[str] = Counter()
    for sign, one in ((1, removed), (-1, never)):
        for (name, _), size in one.held.items():
            held[name] += sign * size
    kept = {name: size for name, size in held.items() if size}
    return Left(len(differences), calls[True], calls[False], kept), differences


def find_faults(number: int, never: CountedFrame, removed: CountedFrame, left: Left) -> list[str]:
    """Say what an effect costs a scene that never had it, and what is `left` of it once it is removed, without a
    cause."""
    rung, faults = LADDER[number], []
    if rung.footprint is not None:
        for frames_of, one in (("a scene that never had it", never), ("a scene from which it was removed", removed)):
            try:
                assert_free(rung.footprint, one.commands)
            except AssertionError as error:
                faults.append(f"{frames_of} has commands of it: {str(error).splitlines()[0]}")
    told = {
        "commands differ": left.differences,
        "calls differ": left.calls,
        "calls of its modules": count_calls(number, removed),
    }
    faults += [f"once it is removed, {count} {what}" for what, count in told.items() if count]
    return faults + [f"once it is removed, {name} is still held" for name in sorted(left.held.keys() - POOLS)]
