"""The viewer: a stage, and what tells it things: events, keys, the console, scripts and a socket.

It knows no window: whoever has one hands events to `handle` and calls `draw` for each frame. Whatever can be switched
is a command, a line of words, and keys, console, scripts and socket all run those. An error of one is said in a line.

An event that is handled before a frame begins is in that frame's picture.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from time import perf_counter
from typing import Final

from renderer import rules
from renderer.layers.canvas import Font
from renderer.scene import Camera, Scene
from renderer.scene.files import parse_path, read_text
from renderer.viewer import hot_reload
from renderer.viewer.command_table import CommandTable, Parameter, ViewerCommand
from renderer.viewer.commands import make_commands, parse_place, parse_seconds, parse_size, switch
from renderer.viewer.console import Console
from renderer.viewer.hot_reload import SavedFiles
from renderer.viewer.interface import InterfaceLayer, Shown
from renderer.viewer.keys import find_line, list_keys
from renderer.viewer.look import Look
from renderer.viewer.server import CommandServer
from renderer.viewer.stage import ViewerStage
from rhi import Device, RhiError, Texture
from rhi.errors import refuse
from rhi_screen.gestures import Event, Gestures

_NOTED: Final = 4.0  # seconds that a line is shown without the console
_NOTES: Final = 4  # lines
_QUEUE: Final = 10_000  # lines of scripts
_BATCH: Final = 100  # of them in a frame
_SHOWN: Final = 64  # lines of the console, of which as many are drawn as there is room for


class Viewer:
    """Shows a scene on a device, one frame at a time.

    Attributes:
        stage: the scene, its camera and what draws it. saved: exchanges what is saved, while it watches.
        commands: what `run` understands. console: see `Console`.
        clock: returns the time in seconds. has_keys: whether the keys are listed. is_over: whether it was told to quit.
        set_size: draws the next frames in so many physical pixels; on a screen, asks its canvas for them.
    """

    def __init__(
        self,
        device: Device,
        scene: Scene,
        *,
        size: tuple[int, int] = (960, 540),
        look: Look | None = None,
        camera: Camera | None = None,
        clock: Callable[[], float] = perf_counter,
        font: Font | None = None,
    ) -> None:
        """`size` is in physical pixels. `camera` is the scene's first view by default."""
        begin = camera or next(iter(scene.views.values()))
        self.clock = clock
        self._interface = InterfaceLayer(device, font)
        self.stage = ViewerStage(device, scene, size, look or Look(), begin, [self._interface], self.say)
        self.set_size: Callable[[tuple[int, int]], object] = lambda size: self.resize(size, self._ratio)
        self.saved = SavedFiles(self.stage, self.say)
        of_files = hot_reload.make_commands(self.saved, self.stage)
        self.commands = CommandTable([*make_commands(self.stage), *of_files, *self._list_own()])
        self.console = Console(self.commands, self.run)
        self.has_keys = False
        self.is_over = False
        self._gestures = Gestures()
        self._server: CommandServer | None = None
        self._queue: deque[str] = deque()
        self._resume = clock()
        self._last = clock()
        self._ratio = 1.0
        self._pointer: tuple[int, int] | None = None
        self._typed = ""  # a key that may be a character, until a character event says which one
        self._notes: deque[tuple[float, str, bool]] = deque(maxlen=_NOTES)

    # -- events ----------------------------------------------------------------------------------------------------

    @property
    def is_moving(self) -> bool:
        """Whether the next frame's picture may be another one without an event."""
        return bool(self.stage.is_moving or self._gestures.is_held or self._queue or self._notes)

    def handle(self, event: Event) -> None:
        """Handle an event of rendercanvas. Events that it doesn't know are ignored."""
        if not self.is_moving:
            self._last = self.clock()  # the time in which nothing was drawn moves nothing
        match event["event_type"]:
            case "char":
                self._typed = ""
                if self.console.is_open:
                    self.console.insert(str(event.get("data") or event.get("char_str") or ""))
            case "key_down" | "key_up":
                self._insert_typed()
                self._handle_key(event)
            case "pointer_down" | "pointer_up" | "pointer_move" | "wheel":
                self._handle_pointer(event)
            case "pointer_leave":
                self._pointer = None

    def _handle_key(self, event: Event) -> None:
        key = str(event["key"])
        if event["event_type"] == "key_up":
            self._gestures.hold(event)
            return
        has_chord = not {"Control", "Alt", "Meta"}.isdisjoint(event.get("modifiers") or ())
        line = "" if has_chord else find_line(self.stage.scene, key)
        if self.console.is_open:
            if line == "console":
                self.run(line)
            elif not self.console.press(key) and len(key) == 1 and not has_chord:
                self._typed = key
        elif self._gestures.hold(event):
            self._take_over()
        elif line:
            self.run(line)

    def _insert_typed(self) -> None:
        """Insert a key for which no character event came: not every canvas has those."""
        typed, self._typed = self._typed, ""
        if typed and self.console.is_open:
            self.console.insert(typed)

    def _handle_pointer(self, event: Event) -> None:
        stage = self.stage
        width, height = stage.renderer.size
        x, y = (int(float(event[axis]) * self._ratio) for axis in "xy")
        self._pointer = (x, y) if 0 <= x < width and 0 <= y < height else None
        if event["event_type"] == "pointer_up" and self._gestures.is_click(event):
            self.run("pick")
        if self._gestures.will_move(event):
            self._take_over()
        self._gestures.move(event, stage.controller, height / self._ratio)

    def _take_over(self) -> None:
        """End a replay, because the camera is moved: it goes on from there."""
        if self.stage.replay is not None:
            self.stage.camera = self.stage.replay.camera

    # -- commands --------------------------------------------------------------------------------------------------

    def run(self, line: str) -> tuple[str, bool]:
        """Run a line; return what there is to say and whether that is an error, and say it in the console, too."""
        try:
            said, is_error = self.commands.run(line), False
        except RhiError as error:
            said, is_error = rules.describe(error), True
        except OSError as error:
            said, is_error = str(error), True
        self.console.say(f"> {line}")
        self.say(said, is_error)
        return said, is_error

    def run_script(self, text: str) -> None:
        """Run the lines of a script with the next frames, before others that wait."""
        lines = text.splitlines()
        if len(self._queue) + len(lines) > _QUEUE:
            refuse(rules.BAD_ARGUMENT, "script", f"{len(self._queue) + len(lines)} lines", f"at most {_QUEUE}")
        self._queue.extendleft(reversed(lines))

    def listen(self, port: int, folder: Path | None = None) -> int:
        """Run the lines that come over a socket of this computer; return the port. Each connection begins with the
        line `greeting`. From then on commands write only below `folder`, by default the working folder.

        Raises:
            DeviceError: `viewer-cannot-listen`.
        """
        made = CommandServer(port, self.run)
        self.stage.folder = (folder or Path()).resolve()
        if self._server is not None:
            self._server.close()
        self._server = made
        return made.port

    @property
    def greeting(self) -> str:
        """The first line of a connection to the port of `listen`, "" if there is none: it has a token that is new each
        time."""
        return "" if self._server is None else self._server.greeting

    def say(self, text: str, is_error: bool = False) -> None:
        """Say something in the console, and for some seconds over the picture."""
        self.console.say(text, is_error=is_error)
        until = self.clock() + _NOTED
        self._notes.extend((until, line, is_error) for line in text.splitlines()[-_NOTES:])

    def _list_own(self) -> Iterator[ViewerCommand]:
        """The commands of what isn't the stage's."""

        def describe(name: str | None = None) -> str:
            shown = self.commands if name is None else [self.commands[name]]
            return "\n".join(f"{one.usage}: {one.summary}" for one in shown)

        names = Parameter("COMMAND", words=lambda: [one.name for one in self.commands], is_optional=True)
        yield ViewerCommand("help", "say what a command does, or all of them", describe, (names,))

        def resize(size: tuple[int, int] | None = None) -> str:
            if size is not None:
                self.set_size(size)
            return "{} x {} pixels".format(*(size or self.stage.renderer.size))

        sizes = Parameter("WIDTHxHEIGHT", parse_size, is_optional=True)
        yield ViewerCommand("size", "draw pictures of this size in pixels, or say what it is", resize, (sizes,))

        def pick(place: tuple[int, int] | None = None) -> str:
            width, height = self.stage.renderer.size
            return self.stage.pick(*(place or self._pointer or (width // 2, height // 2)))

        places = (Parameter("X,Y", parse_place, is_optional=True),)
        yield ViewerCommand("pick", "say what is at a pixel or under the pointer, and why it is drawn", pick, places)

        def clear() -> str:
            self.stage.clear()
            self.has_keys = False
            return ""

        yield ViewerCommand("clear", "forget what was picked, hide the keys", clear)

        def show_keys(on: bool) -> None:
            self.has_keys = on

        yield switch("keys", "show what the keys do", lambda: self.has_keys, show_keys, is_silent=True)

        def toggle_console() -> str:
            self.console.is_open = not self.console.is_open
            self._typed = ""
            self._gestures.release()
            return ""

        yield ViewerCommand("console", "open or close the console", toggle_console)

        def script(path: Path) -> str:
            try:
                self.run_script(read_text(path))
            except UnicodeDecodeError:
                refuse(rules.BAD_ARGUMENT, "script", path.name, "a file of text")
            return ""

        def wait(seconds: float) -> str:
            self._resume = self.clock() + seconds
            return ""

        def leave() -> str:
            self.is_over = True
            return ""

        yield ViewerCommand("script", "run the lines of a file", script, (Parameter("FILE", parse_path),))
        yield ViewerCommand("wait", "let a script wait", wait, (Parameter("SECONDS", parse_seconds),))
        yield ViewerCommand("quit", "end the viewer", leave)

    def _run_waiting(self, now: float) -> None:
        """Run what has come over the socket, and the lines of scripts until one waits."""
        if self._server is not None:
            self._server.poll()
        for _ in range(_BATCH):
            if not self._queue or now < self._resume or self.is_over:
                return
            line = self._queue.popleft()
            if line.strip():
                self.run(line)

    # -- frames ----------------------------------------------------------------------------------------------------

    def resize(self, size: tuple[int, int], ratio: float = 1.0) -> None:
        """Draw the next frames in `size` physical pixels, `ratio` of them to a logical one."""
        self.stage.renderer.size = size
        self._ratio = ratio
        self._interface.scale = max(1, round(ratio))

    def draw(self) -> Texture:
        """Draw a frame as of now, and return its image, which the renderer has shown."""
        self._insert_typed()
        now = self.clock()
        self._run_waiting(now)
        self.saved.update()
        self.stage.move(*self._gestures.pushes(), now - self._last)
        self._last = now
        while self._notes and self._notes[0][0] < now:
            self._notes.popleft()
        self._interface.shown = self._describe()
        image = self.stage.draw(now).image
        self.saved.keep()
        return image

    def close(self) -> None:
        """Destroy all resources on the device, and end connections. A recording that runs is written."""
        if self._server is not None:
            self._server.close()
        self.saved.close()
        self.stage.close()
        self._interface.destroy()

    def _describe(self) -> Shown:
        stage = self.stage
        words = [stage.counter.describe(), stage.look.describe()]
        if stage.budget is not None:
            words.append(stage.budget.describe())
        if stage.is_recording:
            words.append(f"recording {stage.recorded:.0f} s")
        if stage.replay is not None:
            words.append(stage.replay.name)
        shown = Shown(corner="   ".join(words))
        faults = self.saved.faults
        notes = [(line, is_error) for _, line, is_error in self._notes if line not in (*stage.told, *faults)]
        shown.notes = [*((line, False) for line in stage.told), *((line, True) for line in faults), *notes]
        if self.has_keys:
            shown.help = list_keys(stage.scene)
        if self.console.is_open:
            shown.console = tuple(self.console.lines)[-_SHOWN:]
            shown.line, shown.cursor = self.console.text, self.console.cursor
            shown.choices = self.console.choices
        if stage.hit is not None:
            shown.box, shown.triangle = stage.find_box(), stage.hit.corners
        return shown
