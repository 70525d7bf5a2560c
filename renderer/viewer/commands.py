"""The commands of a session: display settings, the camera, and files."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from math import inf
from pathlib import Path
from statistics import median
from typing import Any, Final

from renderer import rules
from renderer.content import parse_camera, parse_camera_path
from renderer.frame import Blending
from renderer.inspection.frame_times import write_frames
from renderer.scene.files import parse_path
from renderer.settings import RenderSettings, from_json, to_json
from renderer.stereo import OUTPUTS
from renderer.techniques import TECHNIQUES, AutoTechnique
from renderer.viewer.command_table import Parameter, ViewerCommand
from renderer.viewer.display_settings import SHADOWS
from renderer.viewer.session import ViewerSession
from renderer.visibility import list_algorithms
from rhi.errors import refuse
from rhi_screen.controllers import Fly, Orbit

NEXT: Final = "next"
"""The word for the choice after the current one."""
_SPEED: Final = 1.5  # how many times as fast a step is
_MAX_PIXEL: Final = 1 << 20  # pixels
_MIN_SIZE, _MAX_SIZE = 16, 16384  # pixels of an image's side
_CAPTURE_FRAMES: Final = 60  # frames, during which nothing else is shown
_FADE: Final = 0.3  # seconds from one clip to another
_MAX_SECONDS: Final = 1e9  # seconds, or metres a second; beyond, float precision is lost


def make_commands(session: ViewerSession) -> Iterable[ViewerCommand]:
    """The commands of a session."""
    return [*_display_commands(session), *_cameras(session), *_files(session)]


def _display_commands(session: ViewerSession) -> Iterable[ViewerCommand]:
    """The commands that change what draws the frames."""
    yield _choice(
        session, "technique", "choose the rendering technique", lambda: [AutoTechnique.name, *TECHNIQUES]
    )
    algorithms = lambda: list_algorithms(session.renderer.device)  # noqa: E731
    yield _choice(session, "visibility", "choose the visibility algorithm", algorithms)
    yield _choice(session, "show", "show the image, or what the frame is made of", session.list_show_choices)
    yield _choice(
        session,
        "shadows",
        "choose which lights cast shadows: as the scene says, all, or none",
        lambda: SHADOWS,
    )
    blendings = [member.value for member in Blending]
    yield _choice(session, "blending", "choose how transparent surfaces are composited", lambda: blendings)
    outputs = {"off": None} | {name: name for name in OUTPUTS}
    yield _choice(
        session,
        "stereo",
        "draw two eyes, and choose how they are shown",
        lambda: outputs,
        outputs.__getitem__,
    )
    samples = {str(count): count for count in session.renderer.device.capabilities.sample_counts}
    yield _choice(
        session, "samples", "set the number of samples per pixel", lambda: samples, samples.__getitem__
    )
    yield _display_switch(session, "fxaa", "smooth edges")
    yield _display_switch(session, "temporal", "smooth edges by the samples of many frames")
    yield _display_switch(session, "overlay", "draw times, counters and the culling over the image")
    yield _display_switch(session, "particles", "draw the drops of fountains as particles")
    yield _display_switch(session, "grid", "draw lines on the ground, a metre apart")

    def assign(path: str, word: str | None = None) -> str:
        settings = session.display.settings
        if word is not None:
            try:
                value = json.loads(word)
            except (ValueError, RecursionError):  # a word
                value = word
            for name in reversed(path.split(".")):
                value = {name: value}
            try:
                settings = from_json(RenderSettings, value, f"set {path}", settings)
            except ValueError as error:  # of a choice
                refuse(rules.BAD_ARGUMENT, f"set {path}", word, str(error))
            session.change(settings=settings)
        return f"{path} {to_json(settings.get(path))}"

    paths = Parameter("SETTING", words=session.display.settings.list_paths, is_exhaustive=True)
    yield ViewerCommand(
        "set", "set any setting, or print it", assign, (paths, Parameter("VALUE", is_optional=True))
    )


def _cameras(session: ViewerSession) -> Iterable[ViewerCommand]:
    """The commands that move the camera."""

    def list_cameras() -> Sequence[str]:
        return [*session.scene.views, *session.scene.paths]

    def camera(name: str, frame: int = 0) -> str:
        session.camera = parse_camera(name, session.scene, frame)
        return ""

    number = Parameter("FRAME", parse_number, is_optional=True)
    yield ViewerCommand(
        "camera",
        "go to a view, a frame of a path, or x,y,z[,x,y,z]: a position and a target",
        camera,
        (Parameter("CAMERA", words=list_cameras), number),
    )

    def drive(name: str = NEXT) -> str:
        names = (Fly.name, Orbit.name)
        session.drive(_after(names, session.controller.name) if name == NEXT else name)
        return session.controller.name

    drives = Parameter(
        "HOW", words=lambda: (Fly.name, Orbit.name, NEXT), is_exhaustive=True, is_optional=True
    )
    yield ViewerCommand(
        "drive", "fly freely, or orbit around what was picked or is in the middle", drive, (drives,)
    )

    def speed(text: str | None = None) -> str:
        factor = {"faster": _SPEED, "slower": 1.0 / _SPEED}.get(text or "")
        if factor is not None:
            session.controller.speed = min(max(session.controller.speed * factor, 1e-6), 1e9)
        elif text is not None:
            session.controller.speed = _parse_speed(text)
        return f"{session.controller.speed:.3g} m/s"

    speeds = Parameter("M/S", words=lambda: ("faster", "slower"), is_optional=True)
    yield ViewerCommand("speed", "set the speed of movement, or change it", speed, (speeds,))

    def play(name: str | None = None) -> str:
        scene = session.scene
        if name is not None and name not in scene.paths and name in scene.attachments.views:
            session.follow(name)
        else:
            path = None if name is None else parse_camera_path(name, scene)
            session.play(path, name or "latest recording")
        return ""

    def list_playable() -> Sequence[str]:
        return [*session.scene.paths, *session.scene.attachments.views]

    paths = Parameter("PATH", words=list_playable, is_optional=True)
    yield ViewerCommand(
        "play", "show a path, a view that moves, a recording (.json), or the latest recording", play, (paths,)
    )

    def time(seconds: float | None = None) -> str:
        if seconds is not None:
            session.seconds = seconds
        return f"{session.seconds:.2f} s"

    yield ViewerCommand(
        "time", "set the scene's time", time, (Parameter("SECONDS", parse_seconds, is_optional=True),)
    )
    yield _pause(session)

    def clip(name: str | None = None) -> str:
        clips = session.scene.clips
        if name is not None:
            clips[name].play(session.seconds, fade=0.0 if session.is_paused else _FADE, alone=True)
        played = [item.name for item in clips.values() if item.weight_at(session.seconds + _FADE)]
        return f"plays {', '.join(played) or 'no clip'}"

    names = Parameter("CLIP", words=lambda: session.scene.clips, is_exhaustive=True, is_optional=True)
    yield ViewerCommand(
        "clip",
        "play a clip in place of clips that move the same nodes, or list the clips being played",
        clip,
        (names,),
    )


def _files(session: ViewerSession) -> Iterable[ViewerCommand]:
    """The commands that read and write files."""

    def screenshot(path: Path | None = None) -> str:
        path = session.resolve_output(path or free_path(session, ".png"))
        from PIL import Image  # optional

        if path.suffix.lower() not in Image.registered_extensions():
            refuse(rules.BAD_ARGUMENT, "screenshot", path.name, "a name that ends with .png")
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.fromarray(session.screenshot()[:, :, :3]).save(path)
        return f"wrote {path}"

    file = Parameter("FILE", parse_path, is_optional=True)
    yield ViewerCommand("screenshot", "write the image to a file", screenshot, (file,))

    def record(path: Path | None = None) -> str:
        if session.is_recording:
            return session.end_recording()
        path = output_path(session, "record", path, ".json")
        session.record(path)
        return f"recording to {path}"

    def capture(path: Path | None = None, frames: int = _CAPTURE_FRAMES) -> str:
        path = output_path(session, "capture", path, ".csv")
        captured = session.capture(frames)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_frames(path, captured)
        return f"wrote {path}: {median(one.milliseconds for one in captured):.1f} ms a frame"

    number = Parameter("FRAMES", partial(parse_number, minimum=1, maximum=_CAPTURE_FRAMES), is_optional=True)
    yield ViewerCommand(
        "capture", "write the times of frames and of their passes to a file", capture, (file, number)
    )
    yield ViewerCommand("record", "start or stop recording the camera", record, (file,))
    yield ViewerCommand(
        "status", "say how fast frames are, and what draws them", lambda: describe_status(session)
    )


def describe_status(session: ViewerSession) -> str:
    """A line with the frame counter, the display settings, the camera and the scene's time."""
    eye, ahead = session.camera.position, session.camera.position + session.camera.forward
    camera_text = ",".join(f"{value:.6g}" for value in (*eye, *ahead))
    device, worked = (
        session.renderer.device.backend_name,
        f"{1e3 * session.counter.processor:.1f} ms of processors",
    )
    rate = f"{session.counter.describe()}, {worked} a frame"
    rate = rate if session.budget is None else f"{rate}, {session.budget.describe()}"
    return f"{rate}, {session.display.describe()} on {device}, camera {camera_text}, {session.seconds:.2f} s"


def output_path(session: ViewerSession, call: str, path: Path | None, ending: str) -> Path:
    """The path that a command writes, which must have this ending; by default a free name."""
    path = session.resolve_output(path or free_path(session, ending))
    if path.suffix.lower() != ending:
        refuse(rules.BAD_ARGUMENT, call, path.name, f"a name that ends with {ending}")
    return path


def free_path(session: ViewerSession, ending: str) -> Path:
    """A file name that isn't taken: the scene's name with a number."""
    name = Path(session.scene.name.partition(":")[0]).stem or "scene"
    number = 1
    while (path := (session.folder or Path()) / f"{name}-{number:03}{ending}").exists():
        number += 1
    return path


def parse_number(text: str, minimum: int = 0, maximum: float = inf) -> int:
    """Parse a whole number from `minimum` to `maximum`."""
    value = int(text)
    if not minimum <= value <= maximum:
        raise ValueError(text)
    return value


def parse_pixel(text: str) -> tuple[int, int]:
    """Parse `480,270` as a pixel."""
    x, y = (parse_number(number, 0, _MAX_PIXEL) for number in text.split(","))
    return x, y


def parse_size(text: str) -> tuple[int, int]:
    """Parse `1280x720` as a width and a height in pixels, 16 to 16,384 each."""
    width, height = (parse_number(number, _MIN_SIZE, _MAX_SIZE) for number in text.lower().split("x"))
    return width, height


def parse_seconds(text: str) -> float:
    """Parse a number from 0 to `_MAX_SECONDS`."""
    value = float(text)
    if not 0.0 <= value <= _MAX_SECONDS:
        raise ValueError(text)
    return value


def _parse_speed(text: str) -> float:
    """Parse a number above 0, to `_MAX_SECONDS`."""
    try:
        if value := parse_seconds(text):
            return value
    except ValueError:
        pass
    refuse(rules.BAD_ARGUMENT, "speed", text, "a number above 0")


def _after(choices: Iterable[str], present: str) -> str:
    """The choice after the current one."""
    words = list(choices)
    return words[(words.index(present) + 1) % len(words)] if present in words else words[0]


def _choice(
    session: ViewerSession,
    name: str,
    summary: str,
    words: Callable[[], Iterable[str]],
    parse: Callable[[str], Any] = str,
) -> ViewerCommand:
    """A command that sets one of the display settings to one of some words, or to the next one."""

    def run(word: str | None = None) -> str:
        present = str(getattr(session.display, name) or "off")
        if word is None:
            return present
        selected = _after(words(), present) if word == NEXT else word
        session.change(**{name: parse(selected)})
        return f"{name} {selected}"

    parameter = Parameter(name.upper(), words=lambda: [*words(), NEXT], is_exhaustive=True, is_optional=True)
    return ViewerCommand(name, summary, run, (parameter,))


_ON: Final = {"on": True, "off": False}


def switch(
    name: str,
    summary: str,
    read: Callable[[], bool],
    write: Callable[[bool], None],
    *,
    is_silent: bool = False,
) -> ViewerCommand:
    """A command that turns what `read` returns on or off with `write`, or toggles it."""

    def run(word: str | None = None) -> str:
        on = not read() if word is None else _ON[word]
        write(on)
        return "" if is_silent else f"{name} {'on' if on else 'off'}"

    states = Parameter("on|off", words=lambda: _ON, is_exhaustive=True, is_optional=True)
    return ViewerCommand(name, summary, run, (states,))


def _display_switch(session: ViewerSession, name: str, summary: str) -> ViewerCommand:
    """A command that switches one of the display settings."""
    return switch(
        name, summary, lambda: getattr(session.display, name), lambda on: session.change(**{name: on})
    )


def _pause(session: ViewerSession) -> ViewerCommand:
    def write(on: bool) -> None:
        session.is_paused = on

    return switch("pause", "pause the scene's time, or resume it", lambda: session.is_paused, write)
