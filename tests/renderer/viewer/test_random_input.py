"""Random input: whatever is pressed, typed, dragged and said, frames go on, and nothing grows."""

from __future__ import annotations

import gc
import statistics
import sys
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import rhi
from renderer.content import load_scene
from renderer.frame import COMPONENTS
from renderer.techniques.inspection import INSPECTIONS
from renderer.viewer import Viewer
from renderer.viewer.commands import NEXT
from renderer.viewer.display_settings import LIT_IMAGE, PLAIN
from renderer.viewer.key_bindings import KEY_BINDINGS
from rhi.backends.cl.raster.draw_list_cache import DrawListCache
from rhi_screen.gestures import MOVEMENT_KEYS
from tests.renderer.conftest import open_device

Events = Iterator[dict[str, Any]]
SCENE = "hall:fountains=1,columns=3,detail=4,flags=1"
SIZES = ((64, 36), (40, 50), (65, 37))
CONSOLE = (
    "Enter",
    "Tab",
    "Backspace",
    "Delete",
    "ArrowLeft",
    "ArrowUp",
    "ArrowDown",
    "Home",
    "End",
    "Escape",
)
FILES = ("x.png", "w.json")
WORDS = ("next", "1", "-1", "nan", "32,18", *FILES, "'", "é", "0,2,5,0,1,0", "0.01", "ground", "off", "#")
QUIET = {"quit", "listen", "script"}
SWITCHES = (
    "technique",
    "visibility",
    "shadows",
    "blending",
    "stereo",
    "samples",
    "fxaa",
    "overlay",
    "particles",
    "grid",
)
BLOCKS_A_FRAME = {"null": 0.5, "gl": 1.0, "cl": 2.0}
"""What may stay of a frame in most stretches: new states of known programs stay."""
BLOCKS_OF_EACH = 0.8
"""What each frame may leave: no object."""
RESOURCES_A_FRAME = 0.04
"""What may stay: less than one for each change of the look, of which there is one in eleven frames."""


class RandomUser:
    """Makes events and lines up.

    Attributes:
        names: the commands that it gives.
        obeyed: those of them that did something at least once.
    """

    def __init__(self, seed: int, viewer: Viewer) -> None:
        self._rng = np.random.default_rng(seed)
        self._viewer = viewer
        self.names = [command.name for command in viewer.commands if command.name not in QUIET]
        self.obeyed: set[str] = set()

    def choose(self, *choices: Any) -> Any:
        return choices[int(self._rng.integers(len(choices)))]

    def seconds(self) -> float:
        return float(self._rng.choice([0.0, 0.001, 0.016, 0.016, 0.05, 0.3, 20.0]))

    def act(self) -> None:
        self.choose(self._press, self._press, self._point, self._point, self._wheel, self._say, self._type)()

    def _press(self) -> None:
        key = self.choose(
            *[key for key in KEY_BINDINGS if key != "F12"],
            *MOVEMENT_KEYS,
            *"123456789",
            *CONSOLE,
            "Shift",
            "F7",
            "ß",
        )
        modifiers = self.choose((), (), (), ("Shift",), ("Control",))
        for kind in self.choose(("key_down", "key_up"), ("key_down",), ("key_up",)):
            self._viewer.handle({"event_type": kind, "key": key, "modifiers": modifiers})

    def _point(self) -> None:
        button = int(self._rng.integers(0, 6))
        fingers = int(self._rng.choice([0, 0, 0, 1, 2, 3]))
        for kind in self.choose(
            ("pointer_down", "pointer_move"), ("pointer_move",), ("pointer_up", "pointer_leave")
        ):
            x, y = self._rng.uniform(-20, 90, 2).tolist()
            touches = {
                n: dict(zip("xy", self._rng.uniform(0, 60, 2).tolist(), strict=True)) for n in range(fingers)
            }
            buttons = (button,) if button and kind != "pointer_up" else ()
            self._viewer.handle(
                {
                    "event_type": kind,
                    "x": x,
                    "y": y,
                    "button": button,
                    "buttons": buttons,
                    "modifiers": (),
                    "touches": touches,
                }
            )

    def _wheel(self) -> None:
        dx, dy = (100.0 * self._rng.integers(-3, 4, 2)).tolist()
        self._viewer.handle({"event_type": "wheel", "x": 5, "y": 5, "dx": dx, "dy": dy, "modifiers": ()})

    def _say(self) -> None:
        name = self.choose(*self.names)
        command, line = self._viewer.commands[name], [name]
        for number in range(int(self._rng.integers(0, 3))):
            completions = self._viewer.commands.complete(" ".join([*line, ""]))
            if number < len(command.parameters) and command.parameters[number].name.startswith("FILE"):
                completions = list(FILES)
            line.append(
                self.choose(*(completions or WORDS)) if self._rng.random() < 0.7 else self.choose(*WORDS)
            )
        _, is_error = self._viewer.run(" ".join(line))
        if not is_error:
            self.obeyed.add(name)

    def _type(self) -> None:
        for letter in self.choose("technique deferred", "vis", "'", "pick 3,3", "zz top", "camera "):
            self._viewer.handle({"event_type": self.choose("char", "focus"), "data": letter, "modifiers": ()})


class Coverage:
    """The states of switches that frames were drawn in, and those that there are."""

    def __init__(self, viewer: Viewer) -> None:
        self._viewer = viewer
        self._drawn: set[tuple[str, str]] = set()
        choices = {(name, word) for name in SWITCHES for word in viewer.commands.complete(f"{name} ")}
        self._choices = {choice for choice in choices if choice[1] != NEXT} | {
            ("show", name) for name in (LIT_IMAGE, *COMPONENTS, *INSPECTIONS)
        }

    def note(self) -> None:
        """Note how the latest frame was drawn."""
        display = self._viewer.session.display
        for name in (*SWITCHES, "show"):
            value = getattr(display, name)
            self._drawn.add((name, "on" if value is True else str(value or "off")))

    @property
    def missed(self) -> set[tuple[str, str]]:
        """The states that no frame was drawn in."""
        return self._choices - self._drawn


def play(
    device: rhi.Device, scene: str, frames: int, seed: int, checkpoint: Callable[[], None]
) -> tuple[Viewer, RandomUser, Coverage]:
    """Show frames under random input. Twenty times in between all is put back, and `checkpoint` is called."""
    time = 0.0
    viewer = Viewer(device, load_scene(scene), size=SIZES[0], clock=lambda: time)
    user, coverage = RandomUser(seed, viewer), Coverage(viewer)
    for number in range(frames):
        for _ in range(3):
            user.act()
        if number % 97 == 0:
            viewer.resize(user.choose(*SIZES), user.choose(1.0, 1.5, 2.0))
        time += user.seconds()
        viewer.draw()
        coverage.note()
        if (number + 1) % (frames // 20) == 0:
            settle(viewer)
            for _ in range(8):
                time += 1.0
                viewer.draw()
            checkpoint()
    return viewer, user, coverage


def settle(viewer: Viewer) -> None:
    """Bring a viewer to the state in which it began, as far as it is seen."""
    if viewer.console.is_open:
        viewer.run("console")
    viewer.handle({"event_type": "pointer_leave"})
    viewer.session.end_recording()
    viewer.session.change(
        settings=PLAIN, show="image", stereo=None, overlay=False, particles=False, grid=False, shadows="scene"
    )
    for line in ("reload off", "clear", "camera overview", "drive fly", *["time 0"] * 200):
        viewer.run(line)
    for key in MOVEMENT_KEYS:
        viewer.handle({"event_type": "key_up", "key": key, "modifiers": ()})
    viewer.resize(SIZES[0])


class LiveResources(NamedTuple):
    """The resources that exist between two frames.

    Attributes:
        programs: how many were made.
        blocks: blocks of memory of Python, without what the backend keeps of arrays of draws up to a limit.
        resources: textures, buffers, meshes.
    """

    programs: int
    blocks: int
    resources: int


def count_live_resources(device: rhi.Device) -> LiveResources:
    rasteriser = getattr(device._core.backend, "_rasteriser", None)
    if rasteriser is not None:
        rasteriser.draws._lists = DrawListCache(rasteriser._prepared)
    gc.collect()
    resources = sum(
        isinstance(resource, (rhi.Texture, rhi.Buffer, rhi.Mesh)) for resource in gc.get_objects()
    )
    return LiveResources(len(list(device._programs.items())), sys.getallocatedblocks(), resources)


@pytest.mark.parametrize("seed", [1])
def test_random_input_ends_nothing(seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "renderer.viewer.commands.list_algorithms", lambda device: ["none", "frustum", "auto"]
    )
    with rhi.create_device("null", record=False) as device:
        viewer, *_ = play(device, "grid:count=9,lights=3", 500, seed, lambda: None)
        assert viewer.session.counter.frames == 500 + 20 * 8
        viewer.close()


@pytest.mark.nightly
@pytest.mark.parametrize("backend", ["null", "gl", "cl"])
def test_ten_thousand_frames_of_random_input_keep_no_frame(
    backend: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(
        "RHI_KERNELS", "quick"
    )  # optimising those of all techniques takes longer than the frames
    monkeypatch.setattr(
        sys.modules[__name__], "QUIET", QUIET | {"set", "capture"}
    )  # new programs, and further frames
    seen: list[LiveResources] = []
    with open_device(backend, record=False) as device:
        viewer, user, coverage = play(
            device, SCENE, 10_000, 2, lambda: seen.append(count_live_resources(device))
        )
        viewer.close()
    assert set(user.names) - user.obeyed == ({"screenshot"} if backend == "null" else set())
    assert not coverage.missed
    # A program that is used for the first time stays, with its resources, at some thousand blocks. Where none
    # is new, nothing of the 500 frames between two checkpoints may stay but new states of known programs,
    # which most stretches have. What each frame leaves is in all stretches.
    pairs = [(before, after) for before, after in pairwise(seen) if before.programs == after.programs]
    assert len(pairs) >= 3  # which algorithms are tried, and so when programs are new, follows from time
    blocks = [after.blocks - before.blocks for before, after in pairs]
    assert min(blocks) < 500 * BLOCKS_OF_EACH, blocks
    assert statistics.median(blocks) < 500 * BLOCKS_A_FRAME[backend], blocks
    resources = [after.resources - before.resources for before, after in pairs]
    assert statistics.median(resources) < 500 * RESOURCES_A_FRAME, resources
