"""Counts, on null devices, what each effect step adds to a frame, and what remains once it is removed.

A frame's commands don't depend on the device, so all of this is exact. Python's calls are counted as well:
two frames that make the same calls cost the processor the same work.
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
from renderer.lab.effect_costs.effect_steps import EFFECT_STEPS, build_scene, move_eye
from renderer.lab.measure.memory import describe_memory
from renderer.renderer import Renderer
from renderer.techniques import Forward
from rhi import Commands, Op
from rhi.testing import assert_free, frames
from rhi.trace import Differences, diff

SIZE: Final = (320, 180)
"""The size of the steps' images in pixels."""

ALLOWED_LEFTOVERS: Final = frozenset(
    (
        "draw arguments",
        "readback",
        "transient constants",
        "PixelRays",
        "Haze",
        "FogConstants",
        "Background",
        "BloomConstants",
        "ContactConstants",
        "OcclusionConstants",
        "ApertureConstants",
        "MotionConstants",
        "BlendConstants",
        "CascadeTable",
    )
)
"""What may remain for later use: rings of the device, and constants of less than a kilobyte."""

_WARM: Final = 3
"""Frames before the counted one: in the first ones resources are created, and states are restored."""

_DRAWS: Final = (Op.DRAW, Op.DRAW_INDIRECT)
_DISPATCHES: Final = (Op.DISPATCH, Op.DISPATCH_INDIRECT)
_BINDS: Final = (Op.BIND_UNIFORM, Op.BIND_STORAGE, Op.BIND_TEXTURE, Op.BIND_IMAGE)
_WRITES: Final = (Op.WRITE_BUFFER, Op.WRITE_TEXTURE)

Calls = Counter[tuple[str, str]]
"""The number of calls of each Python function, by its module and name."""


@dataclass(frozen=True, slots=True)
class FrameCosts:
    """The costs of a scene and of a frame of it.

    Attributes:
        passes: the names of the frame's events.
        draws, dispatches: the numbers of calls.
        programs: that of the programs that run.
        bindings: that of the resources that are bound.
        uploads: bytes written in the frame, in which the eye moves.
        setup: bytes written before.
        images, buffers: bytes of the textures and of the buffers in use.
        steps: of simulations.
        calls: of Python functions.
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
    """A frame with its counts and its commands.

    Attributes:
        costs: the counts.
        call_counts: calls of Python functions.
        commands: the frame's commands.
        allocated_bytes: bytes in use on the device, by name and shape.
    """

    costs: FrameCosts
    call_counts: Calls
    commands: Commands
    allocated_bytes: dict[tuple[str, str], int]


@dataclass(frozen=True, slots=True)
class Leftovers:
    """The traces of an effect that was removed, compared with a scene that never had it.

    Attributes:
        differences: of the frame's commands.
        calls: of the renderer's functions, of which one of the frames makes more.
        device_calls: the same of the device's functions: it counts the draws of each program that there is.
        allocated_bytes: additional bytes in use on the device, by name.
    """

    differences: int
    calls: int
    device_calls: int
    allocated_bytes: dict[str, int]


class StepRenderer:
    """A renderer of the scene of the first effect steps."""

    def __init__(
        self, device: rhi.Device, count: int, size: tuple[int, int] = SIZE, *, without: int | None = None
    ) -> None:
        """Switch on the first `count` steps, except step number `without`."""
        self.scene, self._rows = build_scene(count)
        self._count, self.frame = count, 0
        self.renderer = Renderer(device, self.scene, technique=Forward(), visibility="frustum", size=size)
        for number in range(count):
            self.switch(number, is_on=number != without)

    def switch(self, number: int, *, is_on: bool) -> None:
        """Switch the effect of a step on or off, if that can be done at run time."""
        switch = EFFECT_STEPS[number].switch
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


def count_step(number: int) -> CountedFrame:
    """Count a frame of the scene of a step."""
    with rhi.create_device("null") as device:
        step_renderer = StepRenderer(device, number + 1)
        step_renderer.render(_WARM)
        counted = count_frame(step_renderer)
        step_renderer.destroy()
    return counted


def count_frame(step_renderer: StepRenderer) -> CountedFrame:
    """Count the next frame."""
    device = step_renderer.renderer.device
    steps, call_counts = 0, Counter[tuple[str, str]]()
    with count_python_calls(call_counts):
        step_renderer.render()
    steps = step_renderer.renderer.simulator.steps
    commands = frames(device)[-1]
    before = device.stream[: commands[0].index]
    allocated_bytes = describe_memory(device.stream, None).rows
    images = sum(row.bytes for row in allocated_bytes if row.shape != "buffer")
    runs = commands.filter((*_DRAWS, *_DISPATCHES))
    costs = FrameCosts(
        passes=tuple(command["text"] for command in commands.filter(Op.PUSH_LABEL)),
        draws=len(commands.filter(_DRAWS)),
        dispatches=len(commands.filter(_DISPATCHES)),
        programs=len({command.program for command in runs}),
        bindings=len(commands.filter(_BINDS)),
        uploads=_count_bytes(commands),
        setup=_count_bytes(before),
        images=images,
        buffers=sum(row.bytes for row in allocated_bytes) - images,
        steps=steps,
        calls=call_counts.total(),
    )
    return CountedFrame(
        costs, call_counts, commands, {(row.name, row.shape): row.bytes for row in allocated_bytes}
    )


def count_calls(number: int, counted: CountedFrame) -> int:
    """The number of a frame's calls of functions of a step's own modules."""
    modules = EFFECT_STEPS[number].modules
    return sum(
        count for (module, _), count in counted.call_counts.items() if modules and module.startswith(modules)
    )


def _count_bytes(commands: Commands) -> int:
    return sum(len(command["data"]) for command in commands.filter(_WRITES))


@contextmanager
def count_python_calls(call_counts: Calls) -> Iterator[None]:
    """Count the Python functions that a block calls, except comparisons and hashes of dataclasses: how often
    a dictionary compares depends on the addresses of objects. Garbage collection is off meanwhile, since its
    callbacks would be counted."""

    def note(frame: FrameType, event: str, _: Any) -> None:
        if event == "call" and not frame.f_code.co_qualname.startswith("__create_fn__"):
            call_counts[frame.f_globals.get("__name__", ""), frame.f_code.co_qualname] += 1

    before, collects = sys.getprofile(), gc.isenabled()
    gc.disable()
    sys.setprofile(note)
    try:
        yield
    finally:
        sys.setprofile(before)
        if collects:
            gc.enable()


def open_without_effect(device: rhi.Device, number: int, count: int | None = None) -> StepRenderer:
    """Open a renderer of the scene of a step that never had its effect; if the effect is a part of the scene,
    of the scene before it. With a `count`, the scene has this many steps."""
    if EFFECT_STEPS[number].switch is None:
        return StepRenderer(device, number)
    return StepRenderer(device, count or number + 1, without=number)


def remove_effect(device: rhi.Device, number: int, count: int | None = None) -> StepRenderer:
    """Draw the scene of a step, or of the first `count` steps, and remove the effect.

    What can be switched is switched off in the renderer that has drawn it. What is a part of the scene is
    left out of another one on the same device, after the renderer of the one with it was destroyed.
    """
    step_renderer = StepRenderer(device, count or number + 1)
    step_renderer.render(_WARM)
    if EFFECT_STEPS[number].switch is not None:
        step_renderer.switch(number, is_on=False)
        return step_renderer
    step_renderer.destroy()
    step_renderer = StepRenderer(device, number)
    step_renderer.render(_WARM)
    return step_renderer


def remove_step(number: int, count: int | None = None) -> tuple[CountedFrame, CountedFrame]:
    """Count a frame of a scene that never had the effect of a step, and one of a scene from which it was
    removed. Both have the first `count` steps, by default those up to this one."""
    with rhi.create_device("null") as first_device, rhi.create_device("null") as second_device:
        never = open_without_effect(first_device, number, count)
        never.render(2 * _WARM)
        removed = remove_effect(second_device, number, count)
        removed.render(_WARM)
        return count_frame(never), count_frame(removed)


def compare_frames(never: CountedFrame, removed: CountedFrame) -> tuple[Leftovers, Differences]:
    """The traces of an effect that was removed, and how the commands of the two frames differ."""
    differences = diff(never.commands, removed.commands)
    calls = Counter[bool]()
    for more in (never.call_counts - removed.call_counts, removed.call_counts - never.call_counts):
        for (module, _), count in more.items():
            calls[module.startswith("renderer.")] += count
    allocated_bytes: Counter[str] = Counter()
    for sign, frame in ((1, removed), (-1, never)):
        for (name, _), size in frame.allocated_bytes.items():
            allocated_bytes[name] += sign * size
    leaked_bytes = {name: size for name, size in allocated_bytes.items() if size}
    return Leftovers(len(differences), calls[True], calls[False], leaked_bytes), differences


def list_faults(number: int, never: CountedFrame, removed: CountedFrame, leftovers: Leftovers) -> list[str]:
    """The faults of an effect: costs in a scene that never had it, and unexplained `leftovers` once it is
    removed."""
    step, faults = EFFECT_STEPS[number], []
    if step.markers is not None:
        for frames_of, frame in (
            ("a scene that never had it", never),
            ("a scene from which it was removed", removed),
        ):
            try:
                assert_free(step.markers, frame.commands)
            except AssertionError as error:
                faults.append(f"{frames_of} has commands of it: {str(error).splitlines()[0]}")
    leftover_counts = {
        "commands differ": leftovers.differences,
        "calls differ": leftovers.calls,
        "calls of its modules": count_calls(number, removed),
    }
    faults += [f"once it is removed, {count} {noun}" for noun, count in leftover_counts.items() if count]
    return faults + [
        f"once it is removed, {name} is still held"
        for name in sorted(leftovers.allocated_bytes.keys() - ALLOWED_LEFTOVERS)
    ]
