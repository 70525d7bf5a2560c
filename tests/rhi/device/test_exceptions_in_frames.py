"""Exceptions at any point of a frame: the next frame is drawn right, by the same commands as on a device that
nothing has disturbed.

A frame nests scopes of states, events, passes, queries, conditions, locks and a recording. It is left at each
of its calls by the user's exception or by Ctrl-C, and at each command of the backend by a signal, before or
after the command, or by a driver's error. `DeviceHarness.check` then compares an image, counts and resources.
"""

from __future__ import annotations

import re
import signal
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from harness_kit import DeviceHarness, Tint
from interrupts_kit import EXEMPT, use_default_handler

import rhi
from rhi import BlendFactor, BlendFunction, ColorWrite, CullMode, DepthTest, Scissor, Viewport
from rhi.backends.null import NullBackend
from rhi.contract.backend import Backend

EXEMPT.add(__file__)
BACKENDS = ["null", "gl", "cl", "wgpu"]
SAMPLES = [pytest.param(5, id="sample"), pytest.param(10_000, id="all", marks=pytest.mark.nightly)]
"""How many calls, or commands, of a frame are disturbed on a device that draws."""
_CREATED = re.compile(r"create_\w+\(\w+=(\d+)")
_TURNS = re.compile(r"\b(offset|first)=\d+")
"""Arguments that follow the frames' memory round and round."""


class MineError(Exception):
    """An exception of the user's."""


class Disturbance:
    """Calls `act` at a command of a backend, before or after the command; `at` counts from 1."""

    def __init__(self) -> None:
        self.at = 0
        self.is_after = False
        self.act: Callable[[], object] = int
        self.count = -1
        self.command = ""

    def wrap(self, name: str, command: Callable[..., Any]) -> Callable[..., Any]:
        """Return a method of a backend that counts its calls while a frame is watched."""

        def counted(*arguments: Any, **named: Any) -> Any:
            if self.count < 0:
                return command(*arguments, **named)
            self.count += 1
            is_here = self.count == self.at
            if is_here:
                self.count, self.command = -1, name
                if not self.is_after:
                    self.act()
            result = command(*arguments, **named)
            if is_here and self.is_after:
                self.act()
            return result

        return counted


class Frames(DeviceHarness):
    """A device and a frame with all kinds of scopes inside each other."""

    def __init__(self, backend: str) -> None:
        super().__init__(rhi.create_device(backend, record=backend == "null"), warm_up=False)
        self.queries = self.device.query_set(2)
        self.warm_up()
        for _ in range(3):
            self.draw_frame(int)
            self.settle()
        self.living = self.count_living()
        self.commands_of_a_frame = self.record_frame()
        assert self.record_frame() == self.commands_of_a_frame

    def count_living(self) -> int:
        device = self.device
        if device.backend_name != "null":
            return super().count_living()
        backend: Any = device.backend_as(NullBackend)
        return DeviceHarness.count_living(SimpleNamespace(device=SimpleNamespace(_backend=backend)))  # type: ignore[arg-type]

    def draw_frame(self, step: Callable[[], object]) -> None:
        """Draw a frame, and call `step` before and after each call inside."""
        device, (red, green, _) = self.device, self.tints
        blend = BlendFunction(BlendFactor.SOURCE_ALPHA, BlendFactor.ONE_MINUS_SOURCE_ALPHA)
        step()
        with device.event("frame"), device.states(CullMode.NONE):
            self.out.write(np.ones(16, np.float32))
            step()
            with (
                device.record() as commands,
                commands.states(Scissor(1, 1, 5, 5)),
                commands.event("recorded"),
            ):
                step()
                with commands.render_pass(self.other, clear=(0, 0, 1, 0)):
                    step()
                    with commands.states(ColorWrite(True, False, True, True)):
                        tint = commands.transient.uniform(Tint(color=(1, 1, 0, 1)))
                        commands.draw(self.flat, self.half, tint=tint)
                        step()
                    commands.draw(self.second, self.full, tint=red)
                step()
            device.submit(commands, self.commands)
            step()
            with device.render_pass(self.image, self.depth, clear=(0.5, 0.2, 0.3, 0.4), clear_depth=0.0):
                step()
                device.draw(self.flat, self.half, tint=red)
                with device.states(blend, Scissor(3, 2, 7, 9), DepthTest.OFF), self.query:
                    step()
                    device.draw(self.flat, self.full, tint=green)
                    with device.states(Viewport(0, 0, 4, 8)), device.event("inner"):
                        step()
                        tint = device.transient.uniform(Tint(color=(0, 1, 1, 1)))
                        device.draw(self.second, self.full, tint=tint)
                        step()
                step()
                self._draw_sets(step)
            with self.out.lock(rhi.Access.READ_WRITE) as numbers:
                numbers[:] = 3
                step()
            with self.other.lock(rhi.Access.WRITE) as texels:
                texels[:] = 3
                step()
            device.dispatch(self.count, 1, out=self.out, numbers=self.numbers)
            step()
            with device.render_pass(self.samples, clear=(1, 0, 1, 0), resolve=self.other):
                step()
            self.other.read()
            step()
        device.present(self.image)
        step()

    def _draw_sets(self, step: Callable[[], object]) -> None:
        device, (red, green, blue) = self.device, self.tints
        draws = self.half.draws([0, 0], 3)
        can_skip = device.capabilities.conditional_rendering and device.capabilities.shading
        if can_skip:
            with device.conditional(self.query):
                step()
                with device.states(Scissor(0, 12, 16, 4)), device.event("under a condition"):
                    device.draw(self.second, self.full, tint=red)
                    step()
        with device.immediate(self.second, rhi.Primitive.QUADS, tint=blue) as quads:
            for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)):
                quads.vertex(position=(x, y))
                step()
        device.draw_counted(self.flat, self.half, draws, self.queries, tint=green)
        step()
        if can_skip:
            device.draw_conditional(self.flat, self.half, draws, self.queries, tint=green)
            step()

    def record_frame(self) -> list[str]:
        """Draw a frame after a check, and return its commands; without those of a device that records
        none."""
        self.check()
        if self.device.backend_name != "null":
            return []
        start = len(self.device.stream)
        self.draw_frame(int)
        commands = [str(command).partition("  ")[0] for command in list(self.device.stream)[start:]]
        self.settle()
        return list(unify(commands))

    def count_steps(self) -> int:
        steps: list[int] = []
        self.draw_frame(lambda: steps.append(1))
        self.settle()
        return len(steps)


def unify(commands: list[str]) -> Iterator[str]:
    """Yield commands without what differs from frame to frame: ids of new resources, fence values, and
    offsets in memory that frames share."""
    ids: dict[str, str] = {}
    for command in commands:
        created = _CREATED.match(command)
        if created:
            ids[created[1]] = f"new {len(ids)}"
        if command.startswith(("signal", "completed", "wait", "destroy")):
            yield command.partition("(")[0]
            continue
        named = (
            re.sub(r"(?<==)\d+\b", lambda number: ids.get(number[0], number[0]), command) if ids else command
        )
        yield _TURNS.sub(r"\1=", named)


@pytest.fixture(scope="module", params=BACKENDS)
def frames(request: pytest.FixtureRequest) -> Iterator[tuple[Frames, Disturbance]]:
    disturbance = Disturbance()
    patch = pytest.MonkeyPatch()
    try:
        with rhi.create_device(request.param, record=False) as device:
            backend = type(device._backend)
    except rhi.DeviceError as error:
        pytest.skip(f"{request.param}: {error.given}")
    for name in list_commands(backend):
        patch.setattr(backend, name, disturbance.wrap(name, getattr(backend, name)))
    frames = Frames(request.param)
    yield frames, disturbance
    frames.device.close(quiet=True)
    patch.undo()


def list_commands(backend: type) -> list[str]:
    """Return the names of the contract's methods, but those that make a context current or close it."""
    names = [name for name in vars(Backend) if not name.startswith("_") and callable(getattr(Backend, name))]
    excluded = {"capabilities", "close", "completed", "wait", "create_program", "create_sampler"}
    return [name for name in names if name not in excluded and callable(getattr(backend, name, None))]


def select(count: int, frames: Frames, sample: int, *, is_whole: bool = True) -> list[int]:
    """Return which of `count` steps are disturbed: a sample, on the null device a larger one or all."""
    if frames.device.backend_name == "null":
        sample = count if is_whole else 3 * sample
    return sorted(set(map(int, np.linspace(1, count, min(sample, count)))))


def check_undisturbed(frames: Frames, where: str) -> None:
    try:
        assert frames.record_frame() == frames.commands_of_a_frame
    except BaseException as error:
        error.add_note(where)
        raise


@pytest.mark.parametrize("sample", SAMPLES)
@pytest.mark.parametrize("kind", [MineError, KeyboardInterrupt])
def test_an_exception_at_any_call_of_a_frame_leaves_the_next_frame_unchanged(
    frames: tuple[Frames, Disturbance], kind: type[BaseException], sample: int
) -> None:
    drawn, _ = frames
    for at in select(drawn.count_steps(), drawn, sample):
        left = [at]

        def step(left: list[int] = left) -> None:
            left[0] -= 1
            if not left[0]:
                raise kind

        with pytest.raises(kind):
            drawn.draw_frame(step)
        check_undisturbed(drawn, f"{kind.__name__} at call {at}")


@pytest.fixture(autouse=True)
def default_interrupts() -> Iterator[None]:
    with use_default_handler():
        yield


def fail() -> None:
    raise MineError


def interrupt() -> None:
    signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize("sample", SAMPLES)
@pytest.mark.parametrize(
    ("act", "is_after"),
    [(fail, False), (interrupt, False), (interrupt, True)],
    ids=["error", "before", "after"],
)
def test_a_failure_at_any_command_of_a_frame_leaves_the_next_frame_unchanged(
    frames: tuple[Frames, Disturbance],
    act: Callable[[], object],
    is_after: bool,
    sample: int,
) -> None:
    drawn, disturbance = frames
    disturbance.at, disturbance.count = 0, 0
    drawn.draw_frame(int)
    count, disturbance.count = disturbance.count, -1
    drawn.settle()
    assert count > 10
    disturbance.act, disturbance.is_after = act, is_after
    for at in select(count, drawn, sample, is_whole=act is interrupt and not is_after):
        disturbance.at, disturbance.count = at, 0
        with pytest.raises((MineError, KeyboardInterrupt)):
            drawn.draw_frame(int)
        disturbance.count = -1
        check_undisturbed(drawn, f"{act.__name__} at command {at}, {disturbance.command}, after={is_after}")
