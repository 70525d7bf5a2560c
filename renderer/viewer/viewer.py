"""The viewer: a session, and its inputs: events, keys, the console, scripts and a socket.

It knows no window: a window passes events to `handle` and calls `draw` for each frame. Whatever can be
switched is a command, a line of words, and keys, console, scripts and socket all run those. An error of one
is said in a line.

An event that is handled before a frame begins affects that frame.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from time import perf_counter
from typing import Final

import numpy as np

from renderer import rules
from renderer.layers.canvas import Font
from renderer.scene import Camera, Scene
from renderer.scene.files import parse_path, read_text
from renderer.viewer import hot_reload
from renderer.viewer.command_server import CommandServer
from renderer.viewer.command_table import CommandTable, Parameter, ViewerCommand
from renderer.viewer.commands import make_commands, parse_pixel, parse_seconds, parse_size, switch
from renderer.viewer.console import Console
from renderer.viewer.display_settings import DisplaySettings
from renderer.viewer.hot_reload import FileReloader
from renderer.viewer.interface import InterfaceLayer, InterfaceState
from renderer.viewer.key_bindings import GAMEPAD_BINDINGS, command_for_key, list_key_bindings
from renderer.viewer.session import ViewerSession
from rhi import Device, RhiError, Texture
from rhi.errors import refuse
from rhi.math import Floats
from rhi_screen.controllers import FAST_FACTOR
from rhi_screen.gamepads import Gamepads
from rhi_screen.gestures import Event, Gestures

_NOTE_SECONDS: Final = 4.0  # seconds that a line is shown without the console
_NOTES: Final = 4  # lines
_QUEUE: Final = 10_000  # lines of scripts
_BATCH: Final = 100  # of them in a frame
_CONSOLE_LINES_SHOWN: Final = 64  # lines of the console, of which as many are drawn as there is room for


class Viewer:
    """Shows a scene on a device, one frame at a time.

    Attributes:
        session: the scene, its camera and what draws it.
        file_reloader: reloads saved files, while it watches.
        commands: the commands of `run`.
        console: see `Console`.
        clock: returns the time in seconds.
        has_keys: whether the keys are listed.
        is_over: whether it has quit.
        gamepads: the game controllers that move the camera; on a screen, those of the screen.
        set_size: draws the next frames in so many physical pixels; on a screen, asks its canvas for them.
    """

    def __init__(
        self,
        device: Device,
        scene: Scene,
        *,
        size: tuple[int, int] = (960, 540),
        display: DisplaySettings | None = None,
        camera: Camera | None = None,
        clock: Callable[[], float] = perf_counter,
        font: Font | None = None,
    ) -> None:
        """`size` is in physical pixels. `camera` is the scene's first view by default."""
        begin = camera or next(iter(scene.views.values()))
        self.clock = clock
        self._interface = InterfaceLayer(device, font)
        self.session = ViewerSession(
            device, scene, size, display or DisplaySettings(), begin, [self._interface], self.show_message
        )
        self.set_size: Callable[[tuple[int, int]], object] = lambda size: self.resize(size, self._ratio)
        self.file_reloader = FileReloader(self.session, self.show_message)
        of_files = hot_reload.make_commands(self.file_reloader, self.session)
        self.commands = CommandTable([*make_commands(self.session), *of_files, *self._list_own()])
        self.console = Console(self.commands, self.run)
        self.has_keys = False
        self.is_over = False
        self.gamepads = Gamepads()
        self._gestures = Gestures()
        self._server: CommandServer | None = None
        self._queue: deque[str] = deque()
        self._resume = clock()
        self._last = clock()
        self._ratio = 1.0
        self._pointer: tuple[int, int] | None = None
        self._typed = ""  # a key that may be a character, until a character event says which one
        self._notes: deque[tuple[float, str, bool]] = deque(maxlen=_NOTES)
        self._progress = ""  # of loading, in the latest frame

    # -- events ----------------------------------------------------------------------------------------------

    @property
    def is_moving(self) -> bool:
        """True if the next frame may differ without an event."""
        return bool(
            self.session.is_moving
            or self._gestures.has_pressed_keys
            or self.gamepads.is_pushed
            or (self._queue and not self.is_loading)
            or self._notes
            or (self._progress and not self.is_loading)  # which the next frame doesn't show any more
        )

    @property
    def is_loading(self) -> bool:
        """True while a scene is being loaded."""
        return self.file_reloader.loading.is_loading

    def handle(self, event: Event) -> None:
        """Handle an event of rendercanvas or of a game controller (`rhi_screen.gamepads`). Events that it doesn't
        know are ignored."""
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
            case "gamepad_button_down":
                line, _ = GAMEPAD_BINDINGS.get(event["button"], ("", ""))
                if line == "pick":
                    width, height = self.session.renderer.size
                    line = f"pick {width // 2},{height // 2}"
                if line:
                    self.run(line)
            case "gamepad_connected":
                self.show_message(f"controller: {event['name']}")

    def _handle_key(self, event: Event) -> None:
        key = str(event["key"])
        if event["event_type"] == "key_up":
            self._gestures.handle_key(event)
            return
        has_chord = not {"Control", "Alt", "Meta"}.isdisjoint(event.get("modifiers") or ())
        line = "" if has_chord else command_for_key(self.session.scene, key)
        if self.console.is_open:
            if line == "console":
                self.run(line)
            elif not self.console.press(key) and len(key) == 1 and not has_chord:
                self._typed = key
        elif self._gestures.handle_key(event):
            self._take_over()
        elif line:
            self.run(line)

    def _insert_typed(self) -> None:
        """Insert a key for which no character event came: not every canvas has those."""
        typed, self._typed = self._typed, ""
        if typed and self.console.is_open:
            self.console.insert(typed)

    def _handle_pointer(self, event: Event) -> None:
        session = self.session
        width, height = session.renderer.size
        x, y = (int(float(event[axis]) * self._ratio) for axis in "xy")
        self._pointer = (x, y) if 0 <= x < width and 0 <= y < height else None
        if event["event_type"] == "pointer_up" and self._gestures.is_click(event):
            self.run("pick")
        if self._gestures.will_move(event):
            self._take_over()
        self._gestures.move(event, session.controller, height / self._ratio)

    def _take_over(self) -> None:
        """End a replay, because the camera is moved: it goes on from there."""
        if self.session.replay is not None:
            self.session.camera = self.session.replay.camera

    # -- commands --------------------------------------------------------------------------------------------

    def run(self, line: str) -> tuple[str, bool]:
        """Run a line, and show its message in the console; return the message and whether it is an error."""
        try:
            message, is_error = self.commands.run(line), False
        except RhiError as error:
            message, is_error = rules.describe(error), True
        except OSError as error:
            message, is_error = str(error), True
        self.console.show_message(f"> {line}")
        self.show_message(message, is_error)
        return message, is_error

    def run_script(self, text: str) -> None:
        """Run the lines of a script during the next frames, before other waiting lines."""
        lines = text.splitlines()
        if len(self._queue) + len(lines) > _QUEUE:
            refuse(
                rules.BAD_ARGUMENT, "script", f"{len(self._queue) + len(lines)} lines", f"at most {_QUEUE}"
            )
        self._queue.extendleft(reversed(lines))

    def listen(self, port: int, folder: Path | None = None) -> int:
        """Run the lines that come over a socket of this computer; return the port. Each connection begins
        with the line `greeting`. From then on commands write only below `folder`, by default the working
        folder.

        Raises:
            DeviceError: `viewer-cannot-listen`.
        """
        server = CommandServer(port, self.run)
        self.session.folder = (folder or Path()).resolve()
        if self._server is not None:
            self._server.close()
        self._server = server
        return server.port

    @property
    def greeting(self) -> str:
        """The first line of a connection to the port of `listen`, "" without one. It has a token that is new
        each time."""
        return "" if self._server is None else self._server.greeting

    def show_message(self, text: str, is_error: bool = False) -> None:
        """Show a message in the console, and for some seconds over the image."""
        self.console.show_message(text, is_error=is_error)
        until = self.clock() + _NOTE_SECONDS
        self._notes.extend((until, line, is_error) for line in text.splitlines()[-_NOTES:])

    def _list_own(self) -> Iterator[ViewerCommand]:
        """The commands that aren't the session's."""

        def describe(name: str | None = None) -> str:
            state = self.commands if name is None else [self.commands[name]]
            return "\n".join(f"{command.usage}: {command.summary}" for command in state)

        names = Parameter(
            "COMMAND", words=lambda: [command.name for command in self.commands], is_optional=True
        )
        yield ViewerCommand("help", "describe a command, or list all commands", describe, (names,))

        def resize(size: tuple[int, int] | None = None) -> str:
            if size is not None:
                self.set_size(size)
            return "{} x {} pixels".format(*(size or self.session.renderer.size))

        sizes = Parameter("WIDTHxHEIGHT", parse_size, is_optional=True)
        yield ViewerCommand("size", "set the size of images in pixels, or print it", resize, (sizes,))

        def pick(pixel: tuple[int, int] | None = None) -> str:
            width, height = self.session.renderer.size
            return self.session.pick(*(pixel or self._pointer or (width // 2, height // 2)))

        parameters = (Parameter("X,Y", parse_pixel, is_optional=True),)
        yield ViewerCommand(
            "pick",
            "describe the object at a pixel or under the pointer, and why it is drawn",
            pick,
            parameters,
        )

        def clear() -> str:
            self.session.clear()
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
        """Run the lines received over the socket, and the lines of scripts until one waits."""
        if self._server is not None and not self._waits:
            self._server.poll()
        for _ in range(_BATCH):
            if not self._queue or now < self._resume or self.is_over or self._waits:
                return
            line = self._queue.popleft()
            if line.strip():
                self.run(line)

    @property
    def _waits(self) -> bool:
        """True if lines of scripts and from the socket must wait: not all of the scene is on the device yet."""
        return self.is_loading or self.session.is_uploading

    # -- frames ----------------------------------------------------------------------------------------------

    def resize(self, size: tuple[int, int], ratio: float = 1.0) -> None:
        """Draw the next frames in `size` physical pixels, `ratio` of them to a logical one."""
        self.session.renderer.size = size
        self._ratio = ratio
        self._interface.scale = max(1, round(ratio))

    def draw(self) -> Texture:
        """Draw a frame for the current time, and return its image."""
        self._insert_typed()
        now = self.clock()
        self._run_waiting(now)
        self.file_reloader.update()
        self.session.move(*self._pushes(), now - self._last)
        self._last = now
        while self._notes and self._notes[0][0] < now:
            self._notes.popleft()
        self._interface.state = self._describe()
        image = self.session.draw(now).image
        self.file_reloader.remember_shaders()
        return image

    def close(self) -> None:
        """Destroy all resources on the device, and close connections. A running recording is written."""
        if self._server is not None:
            self._server.close()
        self.file_reloader.close()
        self.session.close()
        self._interface.destroy()

    def _pushes(self) -> tuple[Floats, Floats]:
        """Push (3,) and turn (3,) of the camera by keys and controllers."""
        push, turn = self._gestures.pushes()
        if not self.gamepads.is_pushed:
            return push, turn
        self._take_over()
        stick_push, stick_turn = self.gamepads.motion()
        limited = np.clip(push + stick_push, -FAST_FACTOR, FAST_FACTOR)
        return limited, np.clip(turn + stick_turn, -1.0, 1.0)

    def _describe_loading(self) -> str:
        uploads = self.session.renderer.uploads
        if self.is_loading:
            return self.file_reloader.loading.describe()
        if uploads is not None and not uploads.is_done:
            return f"uploading {uploads.progress.fraction:.0%}"
        images = self.session.renderer.images
        return "" if images is None or images.stream is None else images.stream.report.describe()

    def _describe(self) -> InterfaceState:
        session = self.session
        words = [session.counter.describe(), session.display.describe()]
        self._progress = self._describe_loading()
        if self._progress:
            words.append(self._progress)
        if session.budget is not None:
            words.append(session.budget.describe())
        if session.is_recording:
            words.append(f"recording {session.recorded:.0f} s")
        if session.replay is not None:
            words.append(session.replay.name)
        state = InterfaceState(corner="   ".join(words))
        faults = self.file_reloader.faults
        notes = [
            (line, is_error) for _, line, is_error in self._notes if line not in (*session.hit_lines, *faults)
        ]
        state.notes = [
            *((line, False) for line in session.hit_lines),
            *((line, True) for line in faults),
            *notes,
        ]
        if self.has_keys:
            state.help = list_key_bindings(session.scene)
        if self.console.is_open:
            state.console = tuple(self.console.lines)[-_CONSOLE_LINES_SHOWN:]
            state.line, state.cursor = self.console.text, self.console.cursor
            state.choices = self.console.choices
        if session.hit is not None:
            state.box, state.triangle = session.picked_box(), session.hit.corners
        return state
