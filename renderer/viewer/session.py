"""The session: a scene, drawn with display settings from a camera that moves, with picking and recording.

It knows no events and no words; `renderer.viewer.commands` has the commands for what it can do.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.frame import Layer, UploadSettings
from renderer.inspection.frame_times import CapturedFrame, capture_frames
from renderer.renderer import FrameResult, Renderer
from renderer.scene import FRAMES_PER_SECOND, Camera, CameraPath, PathFrame, Scene
from renderer.scene.arrays import Floats
from renderer.stereo import eye_image_size
from renderer.viewer.camera_recording import MAX_SECONDS, CameraRecorder, CameraReplay, ViewFollower
from renderer.viewer.display_settings import Configurator, DisplaySettings, OriginalState
from renderer.viewer.frame_budget import FrameBudget
from renderer.viewer.picking import Hit, Ray, find_hit
from renderer.viewer.visibility_reasons import explain_visible
from renderer.visibility.boxes.volumes import select_in_view
from rhi import Device, RhiError
from rhi.errors import refuse
from rhi_screen.controllers import MIN_DISTANCE, Controller, Fly, Orbit
from rhi_screen.statistics import FrameCounter

MAX_STEP: Final = 0.25
"""Seconds by which a frame moves the camera and the scene at most, however long it took."""

_DIVISIONS: Final = 25.0  # of the scene's size, which are flown through in as many seconds


def suitable_speed(scene: Scene) -> float:
    """A flying speed in metres a second that suits a scene: it crosses nine tenths of the objects in 25
    seconds, so that one large plane around them doesn't count."""
    middles = 0.5 * (scene.objects.lower + scene.objects.upper)
    low, high = np.percentile(middles, (5.0, 95.0), axis=0)
    size = float(np.linalg.norm(high - low)) or float(np.linalg.norm(scene.bounds[1] - scene.bounds[0]))
    return max(size / _DIVISIONS, MIN_DISTANCE)


class ViewerSession:
    """Draws a scene frame by frame.

    Attributes:
        scene, renderer: the scene, and its renderer.
        layers: drawn over each frame, but not in screenshots.
        controller: moves the camera while nothing is replayed.
        counter: counts frames.
        seconds: the scene's time.
        is_paused: whether that stands still.
        replay: the walk-through that is replayed, or the moving view that is shown, if any.
        hit, hit_lines: what was picked, and lines about it.
        folder: commands write only below it; None: anywhere.
        budget: selects the settings of frames, if any; changing settings ends it.
        uploads: how many bytes of the next scene each frame uploads; None: all before its first frame.
    """

    def __init__(
        self,
        device: Device,
        scene: Scene,
        size: tuple[int, int],
        display: DisplaySettings,
        camera: Camera,
        layers: Sequence[Layer],
        show_message: Callable[[str, bool], None],
    ) -> None:
        """`show_message` receives unrequested messages, and whether they are errors."""
        self.layers = tuple(layers)
        self.uploads: UploadSettings | None = None
        self._original = OriginalState(device, scene)
        self.renderer, self._configurator = self._open(device, scene, size, display, self._original)
        self._last_working = display
        self.controller: Controller = Fly(camera, suitable_speed(scene))
        self.counter = FrameCounter()
        self.seconds = 0.0
        self.is_paused = False
        self.replay: CameraReplay | ViewFollower | None = None
        self.hit: Hit | None = None
        self.hit_lines: list[str] = []
        self._say = show_message
        self.folder: Path | None = None
        self.budget: FrameBudget | None = None
        self._latest: CameraPath | None = None
        self._recorder: tuple[CameraRecorder, Path] | None = None
        self._result: FrameResult | None = None
        self._last_camera = self._fit(camera)

    @property
    def scene(self) -> Scene:
        """The scene that is shown."""
        return self.renderer.scene

    def exchange(self, scene: Scene) -> None:
        """Show another scene from the same camera. If it can't be drawn with the display settings, the
        current one stays.

        Raises:
            RhiError: what refuses to draw it.
        """
        original = OriginalState(self.renderer.device, scene)
        original.timing, original.is_timed = self._original.timing, self._original.is_timed
        opened = self._open(self.renderer.device, scene, self.renderer.size, self.display, original)
        try:
            self._draw_offscreen(opened[0])
        except BaseException:
            _destroy(*opened)
            raise
        self._take(*opened)
        if isinstance(self.replay, ViewFollower):
            self.camera = self._last_camera
        self._original = original
        self._result = None  # its rows are those of the old scene
        self.clear()

    def restart(self) -> None:
        """Begin at the beginning of the scene's time, and count frames from now on."""
        self.seconds = 0.0
        self.counter = FrameCounter()

    def _open(
        self,
        device: Device,
        scene: Scene,
        size: tuple[int, int],
        display: DisplaySettings,
        original: OriginalState,
    ) -> tuple[Renderer, Configurator]:
        with ExitStack() as stack:
            textures = display.settings.textures
            renderer = Renderer(
                device, scene, visibility="none", size=size, textures=textures, uploads=self.uploads
            )
            stack.callback(renderer.destroy)
            configurator = Configurator(renderer, display, original, self.layers)
            stack.pop_all()
        return renderer, configurator

    def _take(self, renderer: Renderer, configurator: Configurator) -> None:
        """Draw with another renderer from now on."""
        renderer.show = self.renderer.show
        old = self.renderer, self._configurator
        self.renderer, self._configurator = renderer, configurator
        _destroy(*old)

    # -- the camera ------------------------------------------------------------------------------------------

    @property
    def camera(self) -> Camera:
        """The camera as of now. Setting it ends a replay."""
        return self.controller.camera if self.replay is None else self.replay.camera

    @camera.setter
    def camera(self, camera: Camera) -> None:
        self.replay = None
        speed = self.controller.speed
        if isinstance(self.controller, Orbit):
            ahead = camera.position + self.controller.distance * camera.forward
            self.controller = Orbit(camera, ahead, speed)
        else:
            self.controller = Fly(camera, speed)

    def begin_at(self, camera: Camera) -> None:
        """Fly from a camera, at a speed that suits the scene."""
        self.replay = None
        self.controller = Fly(camera, suitable_speed(self.scene))

    def drive(self, name: str) -> None:
        """Fly or orbit from here. An orbit is around what was picked, or what is in the middle of the image,
        or the scene."""
        camera, speed = self.camera, self.controller.speed
        self.replay = None
        if name == Fly.name:
            self.controller = Fly(camera, speed)
        else:
            self.controller = Orbit(camera, self._view_centre(), speed)

    @property
    def is_moving(self) -> bool:
        """True if the next frame may differ."""
        return (
            self.controller.is_moving
            or self.replay is not None
            or self._recorder is not None
            or (len(self.renderer.simulator.simulations) > 0 and not self.is_paused)
            or self.renderer.is_trying
            or self.is_uploading
            or self.display.overlay
        )

    @property
    def is_uploading(self) -> bool:
        """True until all of the scene is on the device, or all levels of images that the last frame reads."""
        uploads, images = self.renderer.uploads, self.renderer.images
        is_streaming = images is not None and images.stream is not None and not images.stream.is_done
        return is_streaming or (uploads is not None and not uploads.is_done)

    # -- display settings ------------------------------------------------------------------------------------

    @property
    def display(self) -> DisplaySettings:
        """The settings that frames are drawn with."""
        return self._configurator.display

    def change(self, **changes: Any) -> None:
        """Change display settings (`DisplaySettings.change`). If the device or a technique refuses, they stay
        as they were.

        Raises:
            ValidationError: what refuses says why.
        """
        self._apply(self.display.change(**changes), self.camera)

    def _apply(self, display: DisplaySettings, camera: Camera) -> None:
        if display.settings.textures == self.display.settings.textures:
            self._configurator.apply(display, camera)
        else:  # which are read when a scene is uploaded
            renderer = self.renderer
            self._take(*self._open(renderer.device, self.scene, renderer.size, display, self._original))

    @property
    def is_timed(self) -> bool:
        """True if times of the device's work are taken, with all display settings. Setting it changes that."""
        return self._original.is_timed

    @is_timed.setter
    def is_timed(self, on: bool) -> None:
        self._original.is_timed = on
        self._configurator.update_timing()

    @property
    def latest_result(self) -> FrameResult | None:
        """The latest frame; None before the first one, and after another scene is shown."""
        return self._result

    def list_show_choices(self) -> list[str]:
        """The names of all images that a frame can show."""
        return self._configurator.list_show_choices(self.camera)

    # -- picking ---------------------------------------------------------------------------------------------

    def pick(self, x: int, y: int) -> str:
        """Pick what the latest frame shows at a pixel, and describe it."""
        self.hit = self._cast(x, y)
        if self.hit is None:
            self.hit_lines = []
            return f"nothing at {x}, {y}"
        row, scene = self.hit.object_index, self.scene
        mesh = int(scene.objects.mesh[row])
        triangles = int(scene.meshes.triangle_counts[mesh])
        name = scene.nodes.names[scene.objects.node[row]] or "object"
        reason = explain_visible(self.renderer.visibility, scene, self._last_camera, row)
        self.hit_lines = [
            f"{name} [{row}], mesh {scene.meshes.names[mesh] or mesh}: {triangles:,} triangles, "
            f"{self.hit.distance:.2f} m away, triangle {self.hit.triangle}",
            f"drawn: {reason}",
        ]
        return "\n".join(self.hit_lines)

    def clear(self) -> None:
        """Forget what was picked."""
        self.hit = None
        self.hit_lines = []

    def picked_box(self) -> Floats | None:
        """The corners (8, 3) of the bounding box of what was picked, numbered by bits; it contains the object
        at all times."""
        if self.hit is None:
            return None
        boxes, row = self.scene.objects.boxes, self.hit.object_index
        ends = boxes.lower[row], boxes.upper[row]
        corners = np.array([[ends[number >> axis & 1][axis] for axis in range(3)] for number in range(8)])
        world = boxes.transforms(self.scene.nodes, np.array([row]))[0]
        return np.asarray(corners @ world[:3, :3].T + world[:3, 3])

    def _cast(self, x: int, y: int) -> Hit | None:
        camera, size, display = self._last_camera, self.renderer.size, self.display
        if display.stereo is not None:
            size = eye_image_size(display.stereo, size)
            x, y = x % size[0], y % size[1]
        rows = select_in_view(self.scene, camera, np.arange(len(self.scene.objects)))
        if self._result is not None:
            rows = np.intersect1d(rows, self._result.visible)
        return find_hit(self.scene, self.renderer.simulator, Ray.through(camera, size, x, y), rows)

    def _view_centre(self) -> Floats:
        width, height = self.renderer.size
        hit = self.hit or self._cast(width // 2, height // 2)
        lower, upper = self.scene.bounds
        return 0.5 * (lower + upper) if hit is None else hit.point

    # -- recording -------------------------------------------------------------------------------------------

    @property
    def is_recording(self) -> bool:
        """True if the cameras of frames are recorded."""
        return self._recorder is not None

    @property
    def recorded(self) -> float:
        """The seconds that were recorded so far."""
        return 0.0 if self._recorder is None else self._recorder[0].seconds

    def resolve_output(self, path: Path) -> Path:
        """The path that a file is written to: below `folder`, if there is one; refused elsewhere."""
        if self.folder is None:
            return path
        resolved = (self.folder / path).resolve()
        if not resolved.is_relative_to(self.folder):
            refuse(rules.BAD_ARGUMENT, "write", str(path), f"a file in {self.folder}")
        return resolved

    def record(self, path: Path) -> None:
        """Start recording the camera of each frame; `end_recording` writes them to `path`."""
        path.parent.mkdir(parents=True, exist_ok=True)
        self._recorder = CameraRecorder(), path

    def end_recording(self) -> str:
        """Write the recording, if there is one, and describe it."""
        if self._recorder is None:
            return ""
        (recorder, path), self._recorder = self._recorder, None
        if not len(recorder):
            return "nothing was recorded"
        self._latest = recorder.make_path()
        self._latest.save(path)
        return f"wrote {path}: {len(self._latest)} frames, {recorder.seconds:.1f} s"

    def follow(self, name: str) -> None:
        """Show a view as its node moves it, until the camera is moved."""
        self.replay = ViewFollower(self.scene, name, self.seconds)

    def play(self, path: CameraPath | None, name: str) -> None:
        """Replay a walk-through, or the latest recording."""
        path = path or self._latest
        if path is None:
            refuse(
                rules.BAD_ARGUMENT,
                "play",
                "no recording",
                "a path of the scene, or a walk-through's .json file",
            )
        self.replay = CameraReplay(path, name)

    # -- frames ----------------------------------------------------------------------------------------------

    def move(self, push: Floats, turn: Floats, seconds: float) -> None:
        """Advance the time of the scene and move the camera, which keys push and turn
        (`Controller.advance`)."""
        step = min(max(seconds, 0.0), MAX_STEP)
        if not self.is_paused:
            self.seconds += step
        if self.replay is None:
            self.controller.advance(push, turn, step)
        elif self.replay.is_over:
            self.camera = self.replay.camera
        else:
            self.replay.advance(step, self.seconds)

    def draw(self, now: float) -> FrameResult:
        """Draw a frame at the clock's time `now`."""
        camera = self.camera
        if self._recorder is not None:
            self._recorder[0].add(now, camera)
            if self.recorded >= MAX_SECONDS:
                self._say(self.end_recording(), False)
        self.counter.add(now, process_time())
        began = perf_counter()
        result = self._render(camera)
        if self.budget is not None:
            self._follow(self.budget, began)
        return result

    def set_budget(self, budget: FrameBudget) -> None:
        """Select the settings of later frames by a time budget.

        Raises:
            ValidationError: what refuses the settings that it begins with.
        """
        self.change(settings=budget.settings)
        self.budget = budget

    def _follow(self, budget: FrameBudget, began: float) -> None:
        """Wait for the frame that was begun at a time of the clock, and change the settings if the budget
        selects others."""
        if self.display.settings != budget.settings:
            self.budget = None
            self._say("the budget was dropped because settings were changed", False)
        elif not self.renderer.is_trying:
            self.renderer.device.finish()
            if budget.note(1e3 * (perf_counter() - began)):
                try:
                    self.change(settings=budget.settings)
                except RhiError as error:
                    self._say(rules.describe(error), True)

    def capture(self, frames: int) -> list[CapturedFrame]:
        """Draw frames from the current camera and time on, and return their times."""
        camera, first = (
            self.display.settings.adapt_camera(self.camera),
            round(self.seconds * FRAMES_PER_SECOND),
        )
        return list(
            capture_frames(self.renderer, [PathFrame(first + number, camera) for number in range(frames)])
        )

    def screenshot(self) -> NDArray[np.uint8]:
        """Draw the latest frame again without the layers, and return its pixels (height, width, 4), sRGB.

        Raises:
            ValidationError: `viewer-no-picture` if the device draws nothing.
        """
        renderer = self.renderer
        if not renderer.device.capabilities.shading:
            refuse(rules.NO_SCREENSHOT, "screenshot", f"the {renderer.device.backend_name} device")
        layers = list(renderer.layers)
        renderer.layers[:] = [layer for layer in layers if layer not in self.layers]
        try:
            pixels: NDArray[np.uint8] = self._draw_offscreen(renderer).image.read()
        finally:
            renderer.layers[:] = layers
        return pixels

    def draw_hidden_frame(self) -> None:
        """Draw a frame that isn't shown, after something has changed.

        Raises:
            Exception: what prevents it.
        """
        self._draw_offscreen(self.renderer)

    def close(self) -> None:
        """Destroy all resources on the device. A running recording is written."""
        self.end_recording()
        _destroy(self.renderer, self._configurator)

    def _draw_offscreen(self, renderer: Renderer) -> FrameResult:
        """Draw a frame of the current time that isn't shown."""
        show, renderer.show = renderer.show, renderer.device.present
        try:
            return renderer.render(self.display.settings.adapt_camera(self.camera), self.seconds)
        finally:
            renderer.show = show

    def _fit(self, camera: Camera) -> Camera:
        width, height = self.renderer.size
        return camera.with_aspect(width / height)

    def _render(self, camera: Camera) -> FrameResult:
        """Draw a frame. If something refuses the display settings, the last ones that were drawn are applied,
        or the plain ones."""
        fallbacks = [DisplaySettings(), self._last_working]
        while True:
            try:
                aimed = self.display.settings.adapt_camera(camera)
                self._result = self.renderer.render(aimed, self.seconds)
            except RhiError as error:
                fallbacks = [fallback for fallback in fallbacks if fallback != self.display]
                if not fallbacks:
                    raise
                self._say(rules.describe(error), True)
                self._apply(fallbacks.pop(), camera)
                continue
            self._last_working = self.display
            self._last_camera = self._fit(aimed)
            return self._result


def _destroy(renderer: Renderer, configurator: Configurator) -> None:
    configurator.destroy()
    renderer.destroy()
