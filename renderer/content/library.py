"""Scenes and cameras by name, as users type them.

A scene is a generator with options, or a model file. A camera is a frame of a path, a named view, or
coordinates.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np

from renderer import rules
from renderer.content.bazaar import BAZAAR
from renderer.content.city import CITY
from renderer.content.glass import GLASS
from renderer.content.grid import GRID
from renderer.content.hall import HALL
from renderer.content.import_options import parse_model_options
from renderer.content.models import FORMATS, load_model
from renderer.content.night import NIGHT
from renderer.content.specs import Generator
from renderer.content.terrain import TERRAIN
from renderer.content.yard import YARD
from renderer.scene.paths import FRAMES_PER_SECOND, CameraPath, PathFrame
from renderer.scene.scene import Scene
from rhi.errors import refuse
from rhi.math import Camera

GENERATORS: Final[dict[str, Generator]] = {
    generator.name: generator for generator in (CITY, HALL, GRID, NIGHT, BAZAAR, GLASS, TERRAIN, YARD)
}
"""All scene generators by name."""

_FARTHEST: Final = 1e18  # metres; squares of more aren't float32


def load_scene(text: str) -> Scene:
    """Load the scene that `text` names: `city`, `city:blocks=8,seed=3`, or the path of a model file,
    with `:` and options of `parse_model_options`: `engine.glb:scale=0.01,centre`.

    Unknown names, keys and values are refused, listing what is allowed; files are refused as by `load_model`.
    """
    name, _, options = text.partition(":")
    if name in GENERATORS:
        generator = GENERATORS[name]
        return generator.build(**generator.parse(options))
    if not any(Path(file).suffix.lower() in FORMATS or Path(file).is_file() for file in (text, name)):
        accepted = [*GENERATORS, *(f"a file{end}" for end in FORMATS)]
        rules.refuse_name(rules.UNKNOWN_SCENE, f"load_scene({text!r})", name, accepted)
    if _has_options(text):
        scene = load_model(name, *parse_model_options(f"load_scene({text!r})", options))
    else:
        scene = load_model(text)
    scene.name = text
    return scene


def _has_options(text: str) -> bool:
    """True if a scene's text names a model file with options."""
    name, colon, _ = text.partition(":")
    return bool(colon) and Path(name).suffix.lower() in FORMATS and not Path(text).is_file()


def change_options(scene: str, text: str) -> str:
    """Return `text`, or, if it has options alone (`lights=300`), that of a `scene` with these."""
    is_file = _has_options(f"{scene}:" if ":" not in scene else scene)
    name, _, options = scene.partition(":")
    if not (name in GENERATORS or is_file) or "=" not in text.partition(":")[0]:
        return text
    values = dict(part.partition("=")[::2] for part in f"{options},{text}".split(",") if part)
    return f"{name}:{','.join(f'{key}={value}' if value else key for key, value in values.items())}"


def parse_camera_path(text: str, scene: Scene) -> CameraPath:
    """Return the camera path that `text` names: one of the scene's, or the file of a walk-through
    (`.json`)."""
    if text in scene.paths:
        return scene.paths[text]
    if Path(text).suffix.lower() != ".json":
        rules.refuse_name(rules.UNKNOWN_CAMERA, f"parse_camera_path({text!r})", text, scene.paths)
    return CameraPath.load(Path(text))


def parse_camera(text: str, scene: Scene, frame: int = 0) -> Camera:
    """Return the camera that `text` names in `scene`.

    `text` is the name of a path or the file of a walk-through, whose frame `frame` is used; the name of a
    view, which is that of the frame if it follows a node; a position `x,y,z`, from which the camera looks at the
    scene's centre; or a position and a target `x,y,z,x,y,z`.
    """
    call = f"parse_camera({text!r})"
    if text in scene.paths or Path(text).suffix.lower() == ".json":
        return parse_camera_path(text, scene).camera(frame)
    if text in scene.views:
        return scene.view_at(text, frame / FRAMES_PER_SECOND)
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        rules.refuse_name(rules.UNKNOWN_CAMERA, call, text, [*scene.paths, *scene.views])
    if len(numbers) not in (3, 6) or not (np.abs(numbers) <= _FARTHEST).all():
        refuse(rules.UNKNOWN_CAMERA, call, text, f"3 or 6 finite numbers, none beyond {_FARTHEST:g}")
    lower, upper = scene.bounds
    target = np.array(numbers[3:]) if len(numbers) == 6 else 0.5 * (lower + upper)
    projection = next(iter(scene.views.values())).projection
    return Camera.look_at(numbers[:3], target, projection=projection)


def parse_path_frames(text: str, scene: Scene, frames: range) -> list[PathFrame]:
    """Return frames of the camera that `text` names, as `parse_camera` reads it."""
    return [PathFrame(frame, parse_camera(text, scene, frame)) for frame in frames]
