"""The commands of a stage: what draws it, where the camera is, and what is written to files."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from math import inf
from pathlib import Path
from statistics import median
from typing import Any, Final

from PIL import Image

from renderer import rules
from renderer.content import find_path, parse_camera
from renderer.frame import Blending
from renderer.lab.measure.capture import write_frames
from renderer.scene.files import parse_path
from renderer.settings import RenderSettings, from_plain, to_plain
from renderer.stereo import OUTPUTS
from renderer.techniques import TECHNIQUES, AutoTechnique
from renderer.viewer.command_table import Parameter, ViewerCommand
from renderer.viewer.look import SHADOWS
from renderer.viewer.stage import ViewerStage
from renderer.visibility import list_algorithms
from rhi.errors import refuse
from rhi_screen.controllers import Fly, Orbit

NEXT: Final = "next"
"""The word for the choice after the present one."""
_SPEED: Final = 1.5  # how many times as fast a step is
_WIDEST: Final = 1 << 20  # pixels
_SMALLEST, _LARGEST = 16, 16384  # pixels of a picture's side
_CAPTURED: Final = 60  # frames, which nothing else is shown meanwhile
_FADE: Final = 0.3  # seconds from one clip to another
_LONGEST: Final = 1e9  # seconds, or metres in one; of more, frames and metres can't be told apart


def make_commands(stage: ViewerStage) -> Iterable[ViewerCommand]:
    """Return the commands of a stage."""
    return [*_looks(stage), *_cameras(stage), *_files(stage)]


def _looks(stage: ViewerStage) -> Iterable[ViewerCommand]:
    """The commands that change what draws the frames."""
    yield _choice(stage, "technique", "draw the scene like this", lambda: [AutoTechnique.name, *TECHNIQUES])
    algorithms = lambda: list_algorithms(stage.renderer.device)  # noqa: E731
    yield _choice(stage, "visibility", "let this decide which objects are drawn", algorithms)
    yield _choice(stage, "show", "show the image, or what the frame is made of", stage.list_contents)
    yield _choice(stage, "shadows", "let the scene decide which lights cast shadows, or all, or none", lambda: SHADOWS)
    blendings = [one.value for one in Blending]
    yield _choice(stage, "blending", "put transparent surfaces together like this", lambda: blendings)
    outputs = {"off": None} | {name: name for name in OUTPUTS}
    yield _choice(stage, "stereo", "draw two eyes and show them like this", lambda: outputs, outputs.__getitem__)
    samples = {str(count): count for count in stage.renderer.device.capabilities.sample_counts}
    yield _choice(stage, "samples", "draw samples in each pixel", lambda: samples, samples.__getitem__)
    yield _entry(stage, "fxaa", "smooth edges")
    yield _entry(stage, "overlay", "draw times, counters and the culling over the picture")
    yield _entry(stage, "particles", "draw the drops of fountains as particles")
    yield _entry(stage, "grid", "draw lines on the ground, a metre apart")

    def assign(path: str, word: str | None = None) -> str:
        settings = stage.look.settings
        if word is not None:
            try:
                value = json.loads(word)
            except (ValueError, RecursionError):  # a word
                value = word
            for name in reversed(path.split(".")):
                value = {name: value}
            try:
                settings = from_plain(RenderSettings, value, f"set {path}", settings)
            except ValueError as error:  # of a choice
                refuse(rules.BAD_ARGUMENT, f"set {path}", word, str(error))
            stage.change(settings=settings)
        return f"{path} {to_plain(settings.get(path))}"

    paths = Parameter("SETTING", words=stage.look.settings.list_paths, is_closed=True)
    yield ViewerCommand("set", "set any setting, or say it", assign, (paths, Parameter("VALUE", is_optional=True)))


def _cameras(stage: ViewerStage) -> Iterable[ViewerCommand]:
    """The commands that move the camera."""

    def places() -> Sequence[str]:
        return [*stage.scene.views, *stage.scene.paths]

    def camera(name: str, frame: int = 0) -> str:
        stage.camera = parse_camera(name, stage.scene, frame)
        return ""

    number = Parameter("FRAME", parse_number, is_optional=True)
    yield ViewerCommand(
        "camera",
        "go to a view, a frame of a path, or x,y,z[,x,y,z]: a place and what to look at",
        camera,
        (Parameter("CAMERA", words=places), number),
    )

    def drive(name: str = NEXT) -> str:
        names = (Fly.name, Orbit.name)
        stage.drive(_after(names, stage.controller.name) if name == NEXT else name)
        return stage.controller.name

    drives = Parameter("HOW", words=lambda: (Fly.name, Orbit.name, NEXT), is_closed=True, is_optional=True)
    yield ViewerCommand("drive", "fly freely, or orbit around what was picked or is in the middle", drive, (drives,))

    def speed(text: str | None = None) -> str:
        factor = {"faster": _SPEED, "slower": 1.0 / _SPEED}.get(text or "")
        if factor is not None:
            stage.controller.speed = min(max(stage.controller.speed * factor, 1e-6), 1e9)
        elif text is not None:
            stage.controller.speed = _parse_speed(text)
        return f"{stage.controller.speed:.3g} m/s"

    speeds = Parameter("M/S", words=lambda: ("faster", "slower"), is_optional=True)
    yield ViewerCommand("speed", "move this fast, or faster, or slower", speed, (speeds,))

    def play(name: str | None = None) -> str:
        stage.play(None if name is None else find_path(name, stage.scene), name or "latest recording")
        return ""

    paths = Parameter("PATH", words=lambda: stage.scene.paths, is_optional=True)
    yield ViewerCommand("play", "show a path, a recording (.json), or the latest recording", play, (paths,))

    def time(seconds: float | None = None) -> str:
        if seconds is not None:
            stage.seconds = seconds
        return f"{stage.seconds:.2f} s"

    yield ViewerCommand("time", "set the scene's time", time, (Parameter("SECONDS", parse_seconds, is_optional=True),))
    yield _pause(stage)

    def clip(name: str | None = None) -> str:
        clips = stage.scene.clips
        if name is not None:
            clips[name].play(stage.seconds, fade=0.0 if stage.is_paused else _FADE, alone=True)
        played = [one.name for one in clips.values() if one.find_weight(stage.seconds + _FADE)]
        return f"plays {', '.join(played) or 'no clip'}"

    names = Parameter("CLIP", words=lambda: stage.scene.clips, is_closed=True, is_optional=True)
    yield ViewerCommand("clip", "play a clip instead of what moves the same, or say what is played", clip, (names,))


def _files(stage: ViewerStage) -> Iterable[ViewerCommand]:
    """The commands that read and write files."""

    def screenshot(path: Path | None = None) -> str:
        path = stage.find_output(path or find_free(stage, ".png"))
        if path.suffix.lower() not in Image.registered_extensions():
            refuse(rules.BAD_ARGUMENT, "screenshot", path.name, "a name that ends with .png")
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(stage.picture()[:, :, :3]).save(path)
        return f"wrote {path}"

    file = Parameter("FILE", parse_path, is_optional=True)
    yield ViewerCommand("screenshot", "write the picture to a file", screenshot, (file,))

    def record(path: Path | None = None) -> str:
        if stage.is_recording:
            return stage.end_recording()
        path = find_file(stage, "record", path, ".json")
        stage.record(path)
        return f"recording to {path}"

    def capture(path: Path | None = None, frames: int = _CAPTURED) -> str:
        path = find_file(stage, "capture", path, ".csv")
        captured = stage.capture(frames)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_frames(path, captured)
        return f"wrote {path}: {median(one.milliseconds for one in captured):.1f} ms a frame"

    number = Parameter("FRAMES", partial(parse_number, least=1, most=_CAPTURED), is_optional=True)
    yield ViewerCommand("capture", "write the times of frames and of their passes to a file", capture, (file, number))
    yield ViewerCommand("record", "begin to record the camera, or end it", record, (file,))
    yield ViewerCommand("status", "say how fast frames are, and what draws them", lambda: describe_status(stage))


def describe_status(stage: ViewerStage) -> str:
    """Return a line with the counter, the look, the camera and the scene's time."""
    eye, ahead = stage.camera.position, stage.camera.position + stage.camera.forward
    place = ",".join(f"{value:.6g}" for value in (*eye, *ahead))
    device, worked = stage.renderer.device.backend_name, f"{1e3 * stage.counter.processor:.1f} ms of processors"
    rate = f"{stage.counter.describe()}, {worked} a frame"
    rate = rate if stage.budget is None else f"{rate}, {stage.budget.describe()}"
    return f"{rate}, {stage.look.describe()} on {device}, camera {place}, {stage.seconds:.2f} s"


def find_file(stage: ViewerStage, call: str, path: Path | None, ending: str) -> Path:
    """Return where a command writes a file, which must have this ending; without a path to a free name."""
    path = stage.find_output(path or find_free(stage, ending))
    if path.suffix.lower() != ending:
        refuse(rules.BAD_ARGUMENT, call, path.name, f"a name that ends with {ending}")
    return path


def find_free(stage: ViewerStage, ending: str) -> Path:
    """Return a file's name that isn't taken: the scene's, with a number."""
    name = Path(stage.scene.name.partition(":")[0]).stem or "scene"
    number = 1
    while (path := (stage.folder or Path()) / f"{name}-{number:03}{ending}").exists():
        number += 1
    return path


def parse_number(text: str, least: int = 0, most: float = inf) -> int:
    """Parse a whole number from `least` to `most`."""
    value = int(text)
    if not least <= value <= most:
        raise ValueError(text)
    return value


def parse_place(text: str) -> tuple[int, int]:
    """Parse `480,270` as a pixel."""
    x, y = (parse_number(number, 0, _WIDEST) for number in text.split(","))
    return x, y


def parse_size(text: str) -> tuple[int, int]:
    """Parse `1280x720` as a width and a height in pixels, 16 to 16,384 each."""
    width, height = (parse_number(number, _SMALLEST, _LARGEST) for number in text.lower().split("x"))
    return width, height


def parse_seconds(text: str) -> float:
    """Parse a number from 0 to `_LONGEST`."""
    value = float(text)
    if not 0.0 <= value <= _LONGEST:
        raise ValueError(text)
    return value


def _parse_speed(text: str) -> float:
    """Parse a number above 0, to `_LONGEST`."""
    try:
        if value := parse_seconds(text):
            return value
    except ValueError:
        pass
    refuse(rules.BAD_ARGUMENT, "speed", text, "a number above 0")


def _after(choices: Iterable[str], present: str) -> str:
    """Return the choice after the present one."""
    known = list(choices)
    return known[(known.index(present) + 1) % len(known)] if present in known else known[0]


def _choice(
    stage: ViewerStage,
    name: str,
    summary: str,
    words: Callable[[], Iterable[str]],
    parse: Callable[[str], Any] = str,
) -> ViewerCommand:
    """Return a command that sets an entry of the look to one of some words, or to the next one."""

    def run(word: str | None = None) -> str:
        present = str(getattr(stage.look, name) or "off")
        if word is None:
            return present
        chosen = _after(words(), present) if word == NEXT else word
        stage.change(**{name: parse(chosen)})
        return f"{name} {chosen}"

    known = Parameter(name.upper(), words=lambda: [*words(), NEXT], is_closed=True, is_optional=True)
    return ViewerCommand(name, summary, run, (known,))


_ON: Final = {"on": True, "off": False}


def switch(
    name: str, summary: str, read: Callable[[], bool], write: Callable[[bool], None], *, is_silent: bool = False
) -> ViewerCommand:
    """Return a command that turns what `read` returns on or off by `write`, or to the other one."""

    def run(word: str | None = None) -> str:
        on = not read() if word is None else _ON[word]
        write(on)
        return "" if is_silent else f"{name} {'on' if on else 'off'}"

    states = Parameter("on|off", words=lambda: _ON, is_closed=True, is_optional=True)
    return ViewerCommand(name, summary, run, (states,))


def _entry(stage: ViewerStage, name: str, summary: str) -> ViewerCommand:
    """Return the switch of an entry of the look."""
    return switch(name, summary, lambda: getattr(stage.look, name), lambda on: stage.change(**{name: on}))


def _pause(stage: ViewerStage) -> ViewerCommand:
    def write(on: bool) -> None:
        stage.is_paused = on

    return switch("pause", "stop the scene's time, or let it go on", lambda: stage.is_paused, write)
