"""Skins and morph targets, compared with rays in float64.

Each strip hangs on two joints; the lower one is bent. The reference is a still mesh whose vertices follow the
formulas of glTF in float64: positions by the mean of the joints, normals by its cofactors, and offsets of
targets by their sum.
"""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer.content.models import add_model
from renderer.lab.exam.case import CaseImage, CaseResult, Measures
from renderer.lab.exam.ray_traced_cases import TracedImage, draw, trace_image
from renderer.lab.exam.scenes import shows_something
from renderer.scene import Camera, Scene, SceneBuilder
from renderer.scene.arrays import Floats
from renderer.scene.meshes import list_grid_triangles
from rhi import Device

_ROWS: Final = 9
_LENGTH: Final = 4.0
_BEND: Final = np.radians(50.0)
_TARGET_WEIGHTS: Final = (1e9, 1.0, 1e9)


@dataclass(frozen=True, slots=True)
class Strip:
    """A strip of 0.7 m by 4 m.

    Attributes:
        weight: the sum of the joints' weights of a vertex.
        knee: metres from the upper to the lower joint.
        scale: the lower joint's, along each axis.
        unit: the upper joint's scale, which the inverse bind matrices undo.
        target: whether targets move it, two of which cancel each other with huge weights.
    """

    weight: float = 1.0
    knee: float = 2.0
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    unit: float = 1.0
    target: bool = False


_STRIPS: Final = (
    Strip(),
    Strip(weight=0.25),
    Strip(weight=1e20, scale=(1.0, 1.0, 1.0001)),
    Strip(knee=0.0, unit=1e-15),
    Strip(scale=(-1.0, 0.8, 1.0)),
    Strip(scale=(1.0, 1.0, 0.0), unit=1e15),
    Strip(target=True),
)


def _round(values: ArrayLike) -> Floats:
    """Round to what a file can hold."""
    return np.asarray(values, np.float32).astype(np.float64)


def make_rest() -> tuple[Floats, Floats]:
    """The positions and normals (18, 3) of a strip at rest."""
    y, x = np.meshgrid(np.linspace(0.0, _LENGTH, _ROWS), (0.0, 0.7), indexing="ij")
    positions = np.stack([x, y, 0.0 * x], axis=-1).reshape(-1, 3)
    normals = np.tile(_round([0.28, 0.0, 0.96]), (len(positions), 1))
    return _round(positions), normals


def make_offsets() -> Floats:
    """The offsets (3, 18, 3) of three targets at weight 1: the last undoes the first."""
    positions, _ = make_rest()
    bulge = 0.01 * np.sin(positions[:, [1, 1, 1]])
    arch = np.stack([0.0 * positions[:, 0], 0.0 * positions[:, 0], 0.05 * positions[:, 1] ** 2], axis=1)
    return _round([bulge, arch, -bulge])


def make_lower_weights() -> Floats:
    """The lower joint's share (18,) of the weights."""
    return _round(make_rest()[0][:, 1] / _LENGTH)


def make_pose(strip: Strip) -> Floats:
    """The matrices (2, 4, 4) by which the joints move points from rest, in the strip's space."""
    pose = np.tile(np.eye(4), (2, 1, 1))
    sine, cosine = np.sin(_BEND), np.cos(_BEND)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]])
    pose[1, :3, :3] = turn * np.array(strip.scale)
    pose[1, :3, 3] = (0.0, strip.knee, 0.0) - pose[1, :3, :3] @ (0.0, strip.knee, 0.0)
    return pose


def deform(strip: Strip) -> tuple[Floats, Floats]:
    """The positions and normals (18, 3) of a bent strip."""
    positions, normals = make_rest()
    if strip.target:
        positions = positions + np.tensordot(_TARGET_WEIGHTS, make_offsets(), 1)
    lower = make_lower_weights()
    mean = np.einsum("vk,kij->vij", np.stack([1.0 - lower, lower], axis=1), make_pose(strip))
    linear = mean[:, :3, :3]
    cofactors = np.stack(
        [np.cross(linear[:, (row + 1) % 3], linear[:, (row + 2) % 3]) for row in range(3)], axis=1
    )
    sign = np.where(np.linalg.det(linear) < -1e-9, -1.0, 1.0)  # what is flat has no sign
    turned = np.einsum("vij,vj->vi", cofactors, normals) * sign[:, None]
    length = np.linalg.norm(turned, axis=1, keepdims=True)
    turned = np.where(length > 0.0, turned / np.where(length > 0.0, length, 1.0), normals)
    return np.einsum("vij,vj->vi", linear, positions) + mean[:, :3, 3], turned


class _Document:
    """A glTF document under construction, with its data in itself."""

    def __init__(self) -> None:
        self.values: dict[str, list[Any]] = {
            name: []
            for name in ("nodes", "meshes", "skins", "animations", "accessors", "bufferViews", "materials")
        }
        surface = {"baseColorFactor": [0.5, 0.45, 0.4, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.5}
        self.add("materials", pbrMetallicRoughness=surface, doubleSided=True)
        self._data = bytearray()

    def add(self, name: str, **fields: Any) -> int:
        """Append to a list; return the position there."""
        self.values[name].append(fields)
        return len(self.values[name]) - 1

    def store(self, array: NDArray[Any], kind: str) -> int:
        """Add an accessor of an array (n, ...) of float32 or of unsigned integers; return its number."""
        data = array.tobytes()
        view = self.add("bufferViews", buffer=0, byteOffset=len(self._data), byteLength=len(data))
        self._data += data + bytes(-len(data) % 4)
        component = {"f": 5126, "u": 5121 if array.dtype.itemsize == 1 else 5125}[array.dtype.kind]
        return self.add("accessors", bufferView=view, componentType=component, count=len(array), type=kind)

    def store_primitive(self, positions: Floats, normals: Floats, **attributes: int) -> dict[str, Any]:
        """Add the vertices of a strip; return its primitive."""
        attributes["POSITION"] = self.store(positions.astype(np.float32), "VEC3")
        attributes["NORMAL"] = self.store(normals.astype(np.float32), "VEC3")
        triangles = self.store(list_grid_triangles(_ROWS, 2).astype(np.uint32), "SCALAR")
        return {"attributes": attributes, "indices": triangles, "material": 0}

    def write(self, path: Path) -> None:
        """Write the document to a file."""
        uri = "data:application/octet-stream;base64," + b64encode(bytes(self._data)).decode()
        buffers = [{"byteLength": len(self._data), "uri": uri}]
        lists = {name: values for name, values in self.values.items() if values}
        path.write_text(
            json.dumps({"asset": {"version": "2.0"}, "buffers": buffers, **lists}), encoding="utf-8"
        )


def _add_strip(document: _Document, strip: Strip, x: float) -> None:
    """Add a strip to a document: three nodes, a mesh, a skin and an animation that stands still."""
    positions, normals = make_rest()
    lower = make_lower_weights() * strip.weight
    upper = np.float64(strip.weight) - lower
    first = len(document.values["nodes"])
    turn = [float(np.sin(_BEND / 2)), 0.0, 0.0, float(np.cos(_BEND / 2))]
    document.add("nodes", children=[first + 1, first + 3], translation=[x, 0, 0])
    document.add("nodes", children=[first + 2], scale=[strip.unit] * 3)
    document.add(
        "nodes", translation=[0.0, strip.knee / strip.unit, 0.0], rotation=turn, scale=list(strip.scale)
    )
    binds = np.tile(np.eye(4), (2, 1, 1))
    binds[:, :3, :3] /= strip.unit
    binds[0, :3, 3] = 0.0
    binds[1, :3, 3] = (0.0, -strip.knee / strip.unit, 0.0)
    joints = np.tile(np.array([[0, 1, 0, 0]], np.uint8), (len(positions), 1))
    weights = np.stack([upper, lower, 0.0 * lower, 0.0 * lower], axis=1).astype(np.float32)
    primitive = document.store_primitive(
        positions,
        normals,
        JOINTS_0=document.store(joints, "VEC4"),
        WEIGHTS_0=document.store(weights, "VEC4"),
    )
    mesh: dict[str, Any] = {"primitives": [primitive]}
    if strip.target:
        offsets = make_offsets().astype(np.float32)
        primitive["targets"] = [{"POSITION": document.store(offset, "VEC3")} for offset in offsets]
        mesh["weights"] = list(_TARGET_WEIGHTS)
    skin = document.add(
        "skins",
        joints=[first + 1, first + 2],
        inverseBindMatrices=document.store(
            binds.transpose(0, 2, 1).reshape(2, 16).astype(np.float32), "MAT4"
        ),
    )
    document.add("nodes", mesh=document.add("meshes", **mesh), skin=skin)
    sampler = {
        "input": document.store(np.array([0.0, 1.0], np.float32), "SCALAR"),
        "output": document.store(np.array([turn, turn], np.float32), "VEC4"),
    }
    channel = {"sampler": 0, "target": {"node": first + 2, "path": "rotation"}}
    document.add("animations", samplers=[sampler], channels=[channel])


def _add_still(document: _Document, strip: Strip, x: float) -> None:
    """Add a mesh of the bent strip to a document."""
    primitive = document.store_primitive(*deform(strip))
    document.add("nodes", mesh=document.add("meshes", primitives=[primitive]), translation=[x, 0, 0])


def make_scene(add: Callable[[_Document, Strip, float], None]) -> Scene:
    """Make a scene of all strips side by side, of a file to which `add` adds each."""
    document = _Document()
    for column, strip in enumerate(_STRIPS):
        add(document, strip, 1.0 * column)
    builder = SceneBuilder("strips")
    with TemporaryDirectory() as folder:
        path = Path(folder) / "strips.gltf"
        document.write(path)
        add_model(builder, path)
    builder.lights.sky, builder.lights.ground = (0.2, 0.25, 0.3), (0.2, 0.15, 0.1)
    builder.lights.add_directional((0.3, -0.6, -1.0))
    builder.lights.add_point((2.0, 3.0, 3.0), 12.0, intensity=4.0)
    return builder.build()


@cache  # the same for each device
def make_views() -> tuple[Scene, TracedImage]:
    """The scene with skins, and the ray-traced image of the one without."""
    return make_scene(_add_strip), trace_image(make_scene(_add_still), _CAMERA)


def measure_strips(device: Device) -> CaseResult:
    """Draw strips, and measure by how many levels pixels are out of the bounds that rays have there.

    NumPy computes the vertices of the first image, which are uploaded with the scene. Half a second later, in the
    same pose, the device computes them, if it can."""
    scene, traced = make_views()
    images: dict[str, CaseImage] = {}
    error = 0.0
    for title, seconds in (("first", 0.0), ("later", 0.5)):
        image = draw(device, scene, _CAMERA, seconds=seconds)
        levels = image[..., :3].astype(np.float64)
        off = np.maximum(traced.low - levels, levels - traced.high).max(axis=2)
        off = np.where(traced.is_smooth, np.maximum(off, 0.0), 0.0)
        error = max(error, float(off.max()))
        images |= {f"{title}: strips": image, f"{title}: off": off}
    holds = {
        **shows_something([images["first: strips"], images["later: strips"]]),
        "most pixels are compared": bool(traced.is_smooth.mean() > 0.5),
        "every strip is a simulation": len(scene.simulated) > 0 and bool(scene.objects.simulated.all()),
    }
    numbers = {"levels off": round(error, 3), "pixels compared": int(traced.is_smooth.sum())}
    return CaseResult(error, numbers, holds, lambda: images)


_CAMERA: Final = Camera.look_at((3.4, 2.6, 5.2), (3.3, 1.7, 0.6))

MEASURES: Final[Measures] = {82: measure_strips}
