"""Properties of a scene that glTF has no words for, kept in `extras` of the file under the key `rhi`.

Other programs ignore it, or carry it along. `save_scene` writes it and the reader reads it; both use the
names here. It never says twice what glTF says, so that a file that another program has changed is read as it
was changed.

- of the scene: background, haze, ambient light, camera paths; which nodes may move or are hidden, the order
  of the objects, which objects cast no shadow.
- of a material of the specular model: its four parameters, and emission as a multiple of the base colour.
  What glTF can say is written beside it as a likeness for other programs.
- of a light map: the color that multiplies it, where that is no grey.
- of an image of high range: its texels, beside a PNG of at most 1.
- of a camera: that its far plane only stands for none.
- of a light: whether it casts a shadow, and the radius and sides of its source. Of a node: that it only holds a light
  or a camera, and is none of the scene's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from renderer.content.gltf.document import LARGEST, JsonObject
from renderer.scene.file_versions import KEY as VERSION_KEY
from renderer.scene.file_versions import FileVersions, rename_fields
from renderer.scene.paths import CameraPath
from renderer.scene.scene import Scene
from rhi.math import Depth, Orthographic, Perspective, Projection

KEY: Final = "rhi"
HOLDER: Final = "holder"
INFINITE: Final = "infinite"
FARTHEST: Final = 2.0**24
"""Of a camera without a far plane: its distance in the file over that of the near plane."""
SPECULAR: Final = ("specular_color", "shininess", "rim_strength", "rim_power")
"""The parameters of the specular model."""

_Color = tuple[float, float, float]


@dataclass(frozen=True, eq=False, slots=True)
class SceneExtras:
    """The properties of a scene besides its parts: `background`, `haze`, the ambient light `sky` and
    `ground`, and `paths`."""

    background: _Color
    haze: float
    sky: _Color
    ground: _Color
    paths: Mapping[str, CameraPath]


def get_extras(fields: JsonObject) -> JsonObject | None:
    """Return the fields that `save_scene` has written to the extras of an object, or None."""
    extras = fields.values.get("extras")
    values = extras.get(KEY) if isinstance(extras, dict) else None
    return (
        JsonObject(fields.file, f"{fields.where}.extras.{KEY}", values) if isinstance(values, dict) else None
    )


def primitive_name(primitive: JsonObject, name: str) -> str:
    """Return the name in a primitive's extras, where exporters write any JSON, or else `name`."""
    extras = primitive.values.get("extras")
    return str(extras.get("name", name)) if isinstance(extras, dict) else name


def is_holder(fields: JsonObject) -> bool:
    """True if `save_scene` has written a node only to hold a light or a camera."""
    extras = get_extras(fields)
    is_used = "children" in fields or "mesh" in fields  # by another program
    return extras is not None and extras.flag(HOLDER) and not is_used


def write_scene_extras(scene: Scene) -> dict[str, Any]:
    """Return scene extras as JSON values, for `read_scene_extras`."""
    return {
        VERSION_KEY: SCENE_VERSIONS.current,
        "background": list(map(float, scene.background)),
        "haze": float(scene.haze),
        "sky": list(map(float, scene.lights.sky)),
        "ground": list(map(float, scene.lights.ground)),
        "paths": [_write_path(name, path) for name, path in scene.paths.items()],
    }


def read_scene_extras(fields: JsonObject) -> SceneExtras:
    """Read the scene extras that a scene was saved with."""
    colors = [tuple(fields.reals(name, 3).tolist()) for name in ("background", "sky", "ground")]
    paths = {path_fields.text("name"): _read_path(path_fields) for path_fields in fields.children("paths")}
    return SceneExtras(colors[0], fields.real("haze", low=0.0), colors[1], colors[2], paths)


def migrate_document(document: Any, call: str) -> None:
    """Bring a document that an older `save_scene` has written to the current version, in place.

    Raises:
        ValidationError: `file-version` if a newer one has written it.
    """
    for scene in _list_objects(document, "scenes"):
        extras = scene.get("extras")
        private = extras.get(KEY) if isinstance(extras, dict) else None
        if isinstance(private, dict):
            SCENE_VERSIONS.migrate({VERSION_KEY: private.pop(VERSION_KEY, 1), "document": document}, call)
            return


def _migrate_1(values: dict[str, Any]) -> dict[str, Any]:
    """Rename the mark of nodes that only hold a light or a camera."""
    for node in _list_objects(values["document"], "nodes"):
        extras = node.get("extras")
        rename_fields(extras.get(KEY) if isinstance(extras, dict) else None, {"placed": HOLDER})
    return values


def _list_objects(document: Any, name: str) -> list[dict[str, Any]]:
    """Return the JSON objects in a list of a document, which may be anything."""
    values = document.get(name) if isinstance(document, dict) else None
    return [value for value in values if isinstance(value, dict)] if isinstance(values, list) else []


SCENE_VERSIONS: Final = FileVersions("scenes", (_migrate_1,))
"""The versions of scenes that `save_scene` writes."""


def _write_path(name: str, path: CameraPath) -> dict[str, Any]:
    projection = path.projection
    assert isinstance(projection, Perspective | Orthographic)
    kind = (
        {"perspective": projection.fov}
        if isinstance(projection, Perspective)
        else {"orthographic": projection.height}
    )
    far = {} if np.isinf(projection.far) else {"far": projection.far}
    rest = {"aspect": projection.aspect, "near": projection.near, **far, "depth": projection.depth.value}
    arrays = {"positions": path.positions, "targets": path.targets, "ups": path.ups}
    return {"name": name, **kind, **rest, **{key: rows.ravel().tolist() for key, rows in arrays.items()}}


def _read_path(fields: JsonObject) -> CameraPath:
    is_parallel = "orthographic" in fields
    near = fields.real("near", low=-LARGEST if is_parallel else 1e-30)
    far = (
        fields.real("far", low=float(np.nextafter(near, np.inf)))
        if is_parallel or "far" in fields
        else np.inf
    )
    aspect, depth = (
        fields.real("aspect", low=1e-9),
        Depth(fields.choice("depth", [is_constant.value for is_constant in Depth])),
    )
    projection: Projection
    if is_parallel:
        projection = Orthographic(fields.real("orthographic", low=1e-12), aspect, near, far, depth)
    else:
        projection = Perspective(fields.real("perspective", low=1e-9, high=3.14159), aspect, near, far, depth)
    size = fields.length("positions")
    count = size - size % 3
    if not count:
        fields.refuse("positions", "no camera", "three numbers for each camera")
    positions, targets = (fields.reals(name, count).reshape(-1, 3) for name in ("positions", "targets"))
    is_constant = fields.length("ups") == 3
    ups = fields.reals("ups", 3) if is_constant else fields.reals("ups", count).reshape(-1, 3)
    return CameraPath(positions, targets, projection, ups)
