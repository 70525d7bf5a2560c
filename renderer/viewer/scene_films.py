"""Films of scenes: the frames of a camera path, drawn by any number of workers (`rhi_screen.films`).

A frame is a pure function of the scene, the settings, the camera path and its number. So that no earlier
frame matters:

- Each frame has a new renderer, which costs about a twentieth of a frame: nothing is left of shadow maps that
  were drawn later or for another view, of what was visible, or of triangles that were chosen for other views.
- Simulations are as if they had taken each of their steps since time 0 (`Simulator.takes_all_steps`). A
  worker goes on from its last frame; frames that come later than others of higher numbers begin at time 0.
- What measures times to choose is fixed: `auto` is the technique `forward`, and the visibility algorithm
  `frustum`. Nothing small is animated late (`animation_lag`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, is_dataclass, replace
from hashlib import sha256
from os import environ
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

import rhi
from renderer import rules
from renderer.content import load_scene, parse_camera, parse_camera_path
from renderer.frame import Layer
from renderer.layers.overlay import Overlay
from renderer.layers.particles import Particles
from renderer.scene import Camera, CameraPath, PathFrame, Scene, Simulator
from renderer.scene.attachments import MovingView
from renderer.scene.paths import FRAMES_PER_SECOND
from renderer.settings import RenderSettings, to_json
from renderer.stereo import Stereo, compute_rig
from renderer.techniques import AutoTechnique, Forward
from rhi import refuse
from rhi_screen import FilmResult
from rhi_screen import film as draw_film

FilmCamera = CameraPath | MovingView | Camera
"""What a film is seen from: a path, a view that follows its node, or a camera that stays."""

MakeLayers = Callable[[rhi.Device], Sequence[Layer]]
"""Creates the layers of a device's frames. They must draw the same whatever they drew before."""

_VERSION: Final = 1
"""Part of each film's identity. Raise it if frames become others."""
_AUTO: Final = "auto"
_OVERLAY_HEIGHT: Final = (
    720  # for each further so many rows of pixels, texels of the overlay are a pixel larger
)


@dataclass(frozen=True, slots=True)
class FilmLayers:
    """The layers of the command line: particles, and an overlay of what follows from the frame alone."""

    particles: bool = False
    overlay: bool = False
    height: int = 540

    def __call__(self, device: rhi.Device) -> list[Layer]:
        """Create the layers."""
        layers: list[Layer] = [Particles(device)] if self.particles else []
        if self.overlay:
            scale = max(1, self.height // _OVERLAY_HEIGHT)
            layers.append(Overlay(device, scale=scale, is_timed=False))
        return layers


class SceneFilm:
    """Draws any frame of a film of a scene, on a device of its own. Use it in a `with` block.

    Attributes:
        description: the backend and the device, inside the block.
    """

    def __init__(
        self,
        scene: Scene,
        camera: FilmCamera,
        size: tuple[int, int] = (960, 540),
        *,
        settings: RenderSettings | None = None,
        backend: str | None = None,
        stereo: Stereo | None = None,
        layers: MakeLayers | None = None,
    ) -> None:
        """Arguments are those of `film`. Nothing is created before the block."""
        self.scene, self.camera, self.size = scene, camera, size
        self.settings = make_repeatable(settings or RenderSettings())
        if self.settings.temporal.is_on:
            refuse(rules.TEMPORAL_FILM, "film(settings=...)", "temporal.is_on = True", "False")
        self.backend, self.stereo = backend, stereo
        self.description = ""
        self.make_layers = layers
        self._device: Any = None
        self._layers: Sequence[Layer] = ()
        self._simulator: Simulator | None = None

    def path_frame(self, number: int) -> PathFrame:
        """Return the number and the camera of a frame."""
        if isinstance(self.camera, CameraPath):
            return self.camera.path_frame(number)
        if isinstance(self.camera, MovingView):
            return PathFrame(number, self.scene.view_at(self.camera.name, number / FRAMES_PER_SECOND))
        return PathFrame(number, self.camera)

    def __enter__(self) -> Self:
        self._device = rhi.create_device(self.backend)
        self.description = f"{self._device.backend_name}: {self._device.capabilities.device}"
        try:
            self._layers = [] if self.make_layers is None else self.make_layers(self._device)
        except BaseException:
            self._device.close(quiet=True)
            raise
        return self

    def __exit__(self, *_: object) -> None:
        device, self._device = self._device, None
        if device is None:
            return
        try:
            self._end_simulator(device)
            for layer in self._layers:
                layer.destroy()
            self._layers = ()
        finally:
            device.close()

    def __call__(self, number: int) -> NDArray[np.uint8]:
        """Draw a frame; return its pixels (height, width, 4)."""
        device, settings, scene = self._device, self.settings, self.scene
        path_frame = self.path_frame(number)
        simulator = self._simulator
        if simulator is None:
            simulator = self._simulator = scene.make_simulator()
            simulator.takes_all_steps = True
        try:
            # Hierarchies of boxes are built for this moment.
            simulator.begin_frame(path_frame.seconds)
            scene.refresh()
            with settings.open(device, scene, self.size) as renderer:
                renderer.simulator = simulator
                renderer.stereo = self.stereo
                renderer.layers.extend(self._layers)
                result = settings.render(renderer, path_frame)
                pixels: NDArray[np.uint8] = result.image.read()
                renderer.resources.detach_simulator()
        except BaseException:
            self._simulator = None  # the renderer has destroyed what it has on the device
            raise
        return pixels

    def _end_simulator(self, device: rhi.Device) -> None:
        """Destroy what simulations have on the device."""
        simulator, self._simulator = self._simulator, None
        for simulation in () if simulator is None else simulator.simulations:
            release: Any = getattr(simulation, "release", None)
            if release is not None:
                release(device)

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_device": None, "_layers": (), "_simulator": None, "description": ""}


def make_repeatable(settings: RenderSettings) -> RenderSettings:
    """Return settings whose frames don't depend on times or on earlier frames."""
    changes: dict[str, Any] = {"animation_lag": 0.0}
    if settings.technique.name == AutoTechnique.name:
        changes["technique"] = replace(settings.technique, name=Forward.name)
    if settings.algorithm == _AUTO:
        changes["algorithm"] = "frustum"
    return settings.change_all(changes)


def film(
    scene: Scene | str,
    camera: FilmCamera | str | None = None,
    frames: Iterable[int] | None = None,
    output: str | Path | None = None,
    *,
    size: tuple[int, int] = (960, 540),
    settings: RenderSettings | None = None,
    backend: str | None = None,
    stereo: Stereo | str | None = None,
    layers: MakeLayers | None = None,
    executor: str | Executor = "serial",
    fps: float = float(FRAMES_PER_SECOND),
    progress: bool | None = None,
) -> FilmResult:
    """Draw frames of a scene on the workers of an executor, to a video or to images (`rhi_screen.film`).

    Args:
        scene: a scene, or the text that names one. It travels to each worker once.
        camera: a path, a camera that stays, a view that follows its node, or a text that names one; None: the
            scene's first path or view.
        frames: numbers of frames, which are 60 a second; None: all frames of the path.
        output: the file of a video, or the name of images, such as `city/%05d.png`; None returns the images.
        size: (width, height) of a frame in pixels.
        settings: how frames are drawn (`make_repeatable`).
        backend: None: `RHI_BACKEND`, or the first that works on the worker.
        stereo: two eyes, or the name of an output, whose rig is comfortable for the path's first frame.
        layers: creates the layers over each frame, on a worker.
        executor: one of `rhi_screen.executors.KINDS`, an open executor, or a client of Dask.
        fps: frames a second of the video: 30 for every second frame.
        progress: whether to show a bar with the time left; None: on a terminal.

    Raises:
        ValidationError: `camera-frame-range` for a frame beyond the path, `film-temporal` for temporal anti-aliasing;
            what `rhi_screen.film` refuses.
        DeviceError: see there.
    """
    origin = scene if isinstance(scene, str) else ""
    opened = load_scene(scene) if isinstance(scene, str) else scene
    path = resolve_camera(camera, opened)
    numbers = list_frames(frames, path)
    rig = resolve_stereo(stereo, opened, path, size)
    render = SceneFilm(
        opened, path, size, settings=settings, backend=choose_backend(backend), stereo=rig, layers=layers
    )
    return draw_film(
        render,
        numbers,
        executor,
        output,
        fps=fps,
        identity=identify(render, origin),
        progress=progress,
    )


def resolve_camera(camera: FilmCamera | str | None, scene: Scene) -> FilmCamera:
    """Return the path, the moving view or the camera that `film`'s argument names."""
    if camera is None:
        camera = next(iter(scene.paths or scene.views))
    if not isinstance(camera, str):
        return camera
    if camera not in scene.paths and camera in scene.attachments.views:
        return MovingView(camera)
    if camera in scene.paths or Path(camera).suffix.lower() == ".json":
        return parse_camera_path(camera, scene)
    return parse_camera(camera, scene)


def list_frames(frames: Iterable[int] | None, path: FilmCamera) -> Sequence[int]:
    """Return the numbers of frames; refuse those beyond the path before anything is drawn."""
    if frames is None:
        if not isinstance(path, CameraPath):
            refuse(
                rules.FRAME_RANGE,
                "film(frames=...)",
                "None",
                "numbers of frames, for a camera without a path",
            )
        return range(len(path))
    numbers = frames if isinstance(frames, range) else list(frames)
    if isinstance(path, CameraPath):
        for number in numbers:
            path.path_frame(number)
    return numbers


def resolve_stereo(
    stereo: Stereo | str | None, scene: Scene, path: FilmCamera, size: tuple[int, int]
) -> Stereo | None:
    """Return two eyes; a name of an output gets a comfortable rig."""
    if not isinstance(stereo, str):
        return stereo
    return Stereo(compute_rig(scene, first_camera(scene, path, size)), stereo)


def choose_backend(backend: str | None) -> str | None:
    """Return a backend's name; None leaves it to the workers, whose environment may be another."""
    return backend or environ.get("RHI_BACKEND")


def first_camera(scene: Scene, path: FilmCamera, size: tuple[int, int]) -> Camera:
    """Return the camera of a path's first frame, for frames of this size. Rigs are comfortable for it,
    whichever frames are drawn."""
    if isinstance(path, MovingView):
        camera = scene.view_at(path.name, 0.0)
    else:
        camera = path.camera(0) if isinstance(path, CameraPath) else path
    return camera.with_aspect(size[0] / size[1])


def identify(render: SceneFilm, origin: str = "") -> str:
    """Return a hash of all that frames depend on, but for the device.

    Args:
        origin: the text that the scene was loaded by; a file counts by its contents.
    """
    scene, camera = render.scene, render.camera
    parts: list[object] = [_VERSION, rhi.__version__, scene.name, to_json(render.settings), render.size]
    parts += [render.backend, repr(render.stereo), _describe_layers(render.make_layers)]
    arrays = [scene.meshes.vertices, scene.meshes.indices, scene.objects.mesh, scene.materials]
    arrays += [scene.nodes.parents]
    if isinstance(camera, CameraPath):
        arrays += [camera.positions, camera.targets, camera.ups]
        parts.append(repr(camera.projection))
    elif isinstance(camera, MovingView):
        parts.append(repr(camera))
    else:
        arrays += [camera.position, camera.rotation]
        parts.append(repr(camera.projection))
    file = Path(origin.removesuffix(":unlimited"))
    content = file.read_bytes() if origin and file.is_file() else origin.encode()
    hashed = sha256(repr(parts).encode() + sha256(content).digest())
    for array in arrays:
        hashed.update(np.ascontiguousarray(array).tobytes())
    return hashed.hexdigest()[:24]


def _describe_layers(make_layers: MakeLayers | None) -> str:
    """Return a text that is the same in each process."""
    if is_dataclass(make_layers):
        return repr(make_layers)
    named: Any = make_layers if hasattr(make_layers, "__qualname__") else type(make_layers)
    return f"{named.__module__}.{named.__qualname__}"
