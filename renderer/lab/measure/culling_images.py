"""Images of what was culled and why (thesis, Figures 6.1 and 6.3): from the camera, and from above.

Each object's bounding box is coloured by the object's outcome. The image from the camera is the frame that
the algorithm drew, with the edges of the boxes; those of hidden objects are drawn over what hides them. In
the image from above the boxes are solid, and white lines mark the edges of the camera's view.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum
from itertools import product
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.content import BUILT_IN
from renderer.frame.drawing import NEARER
from renderer.renderer import FrameResult, Renderer
from renderer.scene import Camera, Depth, Orthographic, Scene
from renderer.scene.arrays import Indices
from renderer.visibility.boxes.bounds import near_mask, pad_boxes
from renderer.visibility.boxes.volumes import Containment, classify
from rhi import CullMode, DepthTest, DepthWrite, Device, Format, Mesh, Primitive, Program
from rhi.shading import Shader, Storage, Struct, Uniform, dot, instance_index, mat4, vec3, vec4


class CullingOutcome(IntEnum):
    """The outcome of culling for an object."""

    OUTSIDE = 0
    CROSSING = 1
    INSIDE = 2
    OCCLUDED = 3
    NEAR = 4


COLORS: Final = {
    CullingOutcome.OUTSIDE: (0.13, 0.65, 0.20),
    CullingOutcome.CROSSING: (0.95, 0.85, 0.10),
    CullingOutcome.INSIDE: (0.90, 0.12, 0.10),
    CullingOutcome.OCCLUDED: (0.12, 0.25, 0.95),
    CullingOutcome.NEAR: (0.10, 0.90, 0.95),
}
"""Linear colours of the outcomes, as in the thesis."""

MEANINGS: Final = {
    CullingOutcome.OUTSIDE: "outside the frustum",
    CullingOutcome.CROSSING: "across its edge, drawn",
    CullingOutcome.INSIDE: "inside it, drawn",
    CullingOutcome.OCCLUDED: "hidden by others",
    CullingOutcome.NEAR: "too near for a query, drawn",
}

_TRANSLUCENT: Final = (
    CullingOutcome.OCCLUDED,
    CullingOutcome.NEAR,
)  # their edges are drawn without a depth test
_MAX_COVERAGE: Final = 0.05  # fraction of the image from above: larger boxes, such as streets, aren't drawn


class Mark(Struct):
    """A box relative to the eye, and its colour."""

    centre: vec3
    half: vec3
    color: vec3


class MarkCamera(Struct):
    """The matrix from positions relative to the eye to clip space."""

    relative_view_projection: mat4


class MarkCorner(Struct):
    """A vertex of a cube from -1/2 to 1/2."""

    position: vec3
    normal: vec3


class MarkVarying(Struct):
    """The varyings of `MarkShader`."""

    clip: vec4
    color: vec3


class MarkShader(Shader):
    """Draws boxes lit from one side, so that their shape can be seen."""

    camera: Uniform[MarkCamera]
    marks: Storage[Mark]

    def vertex(self, v: MarkCorner) -> MarkVarying:
        mark = self.marks[instance_index()]
        position = mark.centre + 2.0 * mark.half * v.position
        lit = 0.7 + 0.3 * dot(v.normal, vec3(0.36, 0.80, 0.48))
        return MarkVarying(
            clip=self.camera.relative_view_projection @ vec4(position, 1.0), color=mark.color * lit
        )

    def fragment(self, v: MarkVarying) -> vec4:
        return vec4(v.color, 1.0)


def compute_outcomes(scene: Scene, camera: Camera, drawn_objects: Indices) -> NDArray[np.uint8]:
    """The `CullingOutcome` (n,) of all objects, from the indices of the objects that were drawn."""
    everything = np.arange(len(scene.objects))
    lower, upper = scene.objects.lower, scene.objects.upper
    side = classify(camera.frustum.planes, lower, upper)
    near = near_mask(camera, *pad_boxes(camera, lower, upper))
    is_drawn = np.isin(everything, drawn_objects)
    outcome = np.where(side == Containment.INSIDE, CullingOutcome.INSIDE, CullingOutcome.CROSSING)
    outcome = np.where(near, CullingOutcome.NEAR, np.where(is_drawn, outcome, CullingOutcome.OCCLUDED))
    return np.where(side == Containment.OUTSIDE, CullingOutcome.OUTSIDE, outcome).astype(np.uint8)


def render_culling_from_camera(
    renderer: Renderer, camera: Camera, result: FrameResult, outcomes: NDArray[np.uint8]
) -> NDArray[np.uint8]:
    """Draw the edges of all boxes inside the view over the frame as the algorithm drew it: (h, w, 4) sRGB."""
    device, scene = renderer.device, renderer.scene
    camera = camera.with_aspect(renderer.size[0] / renderer.size[1])
    nearer = NEARER[camera.projection.depth]
    with (
        _Marks(device) as marks,
        device.render_pass(result.image, result.depth),
        device.states(CullMode.NONE, DepthWrite.OFF, nearer),
    ):
        for outcome in (
            CullingOutcome.OCCLUDED,
            CullingOutcome.CROSSING,
            CullingOutcome.INSIDE,
            CullingOutcome.NEAR,
        ):
            with device.states(DepthTest.OFF if outcome in _TRANSLUCENT else DepthTest.ON):
                marks.draw_boxes(scene, camera, np.flatnonzero(outcomes == outcome), outcomes, solid=False)
    return np.asarray(result.image.read())


def render_culling_from_above(
    renderer: Renderer, camera: Camera, outcomes: NDArray[np.uint8]
) -> NDArray[np.uint8]:
    """Draw all boxes from above, except those that cover more than a twentieth of the image: (h, w, 4)
    sRGB."""
    device, scene, (width, height) = renderer.device, renderer.scene, renderer.size
    rows, above = make_overhead_camera(scene, width / height)
    with (
        device.texture((width, height), Format.RGBA8_SRGB, label="from above") as color,
        _Marks(device) as marks,
    ):
        with (
            device.render_pass(color, clear=(0.02, 0.02, 0.02, 1.0)),
            device.states(DepthTest.OFF, DepthWrite.OFF),
        ):
            with device.states(CullMode.BACK):
                marks.draw_boxes(scene, above, rows, outcomes, solid=True)
            with device.states(CullMode.NONE):
                marks.draw_lines(above, view_outline(camera.with_aspect(width / height), above))
        return np.asarray(color.read())


def make_overhead_camera(scene: Scene, aspect: float) -> tuple[Indices, Camera]:
    """The objects to show from above, the widest first, and a camera that sees them all.

    With this order no roof hides what is below it.
    """
    lower, upper = scene.objects.lower, scene.objects.upper
    size = upper - lower
    rows = np.arange(len(lower))
    while True:  # without the widest objects the image covers less ground
        low, high = lower[rows].min(axis=0), upper[rows].max(axis=0)
        ground = max(float((high - low)[0] * (high - low)[2]), 1e-12)
        small_rows = rows[size[rows, 0] * size[rows, 2] <= _MAX_COVERAGE * ground]
        if len(small_rows) == len(rows) or not len(small_rows):
            break
        rows = small_rows
    rows = rows[np.argsort(-size[rows, 0] * size[rows, 2], kind="stable")]
    median_of, extent = 0.5 * (low + high), high - low
    tall = 1.04 * max(float(extent[2]), float(extent[0]) / aspect, 1e-3)
    projection = Orthographic(tall, aspect, near=0.0, far=float(extent[1]) + 2.0)
    eye = np.array([median_of[0], high[1] + 1.0, median_of[2]])
    return rows, Camera.look_at(eye, eye - (0.0, 1.0, 0.0), (0.0, 0.0, -1.0), projection)


def view_outline(camera: Camera, above: Camera) -> NDArray[np.float64]:
    """The lines (8, 2, 3) of the near plane's sides, and of the view's edges from there across the image.

    All lie at one height that the camera above sees.
    """
    inverse = np.linalg.inv(camera.projection.matrix)
    near_depth = 1.0 if camera.projection.depth is Depth.REVERSED else 0.0
    corners = np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])

    def unproject(depth: float) -> NDArray[np.float64]:
        clip = np.concatenate([corners, np.full((4, 1), depth), np.ones((4, 1))], axis=1)
        view = clip @ inverse.T
        return np.asarray((view[:, :3] / view[:, 3:]) @ camera.rotation + camera.position)

    near = unproject(near_depth)
    away = unproject(0.5) - near
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    projection = above.projection
    assert isinstance(projection, Orthographic)
    far = near + away * 2.0 * projection.height * max(projection.aspect, 1.0)
    lines = np.concatenate(
        [np.stack([near, far], axis=1), np.stack([near, np.roll(near, 1, axis=0)], axis=1)]
    )
    lines[:, :, 1] = above.position[1] - 0.5 * projection.far
    return lines


class _Marks:
    """Draws boxes and lines in the open pass."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._program: Program[...] = device.program(MarkShader)
        vertices = BUILT_IN["box"]()
        self._solid = device.mesh(
            {name: vertices.vertices[name] for name in ("position", "normal")}, vertices.indices, label="box"
        )
        corners = np.array(list(product((-0.5, 0.5), repeat=3)), np.float32)
        pairs = [(a, b) for a, b in product(range(8), repeat=2) if a < b and (a ^ b).bit_count() == 1]
        self._edges = self._lines_of(corners, np.array(pairs, np.uint16).reshape(-1))

    def _lines_of(self, points: NDArray[np.float32], indices: NDArray[np.uint16] | None = None) -> Mesh:
        up = np.tile(np.array([0.36, 0.80, 0.48], np.float32), (len(points), 1))  # fully lit
        return self._device.mesh(
            {"position": points, "normal": up}, indices, primitive=Primitive.LINES, label="edges"
        )

    def draw_boxes(
        self,
        scene: Scene,
        camera: Camera,
        object_indices: Indices,
        outcomes: NDArray[np.uint8],
        *,
        solid: bool,
    ) -> None:
        """Draw the boxes of the objects `object_indices`."""
        if not len(object_indices):
            return
        lower, upper = scene.objects.lower[object_indices], scene.objects.upper[object_indices]
        table = np.array([COLORS[outcome] for outcome in CullingOutcome])
        with self._bound(
            0.5 * (lower + upper) - camera.position, 0.5 * (upper - lower), table[outcomes[object_indices]]
        ) as marks:
            self._draw(self._solid if solid else self._edges, camera, marks, len(object_indices))

    def draw_lines(self, camera: Camera, lines: NDArray[np.float64]) -> None:
        """Draw white lines (k, 2, 3)."""
        points = (0.5 * (lines.reshape(-1, 3) - camera.position)).astype(np.float32)
        with (
            self._lines_of(points) as mesh,
            self._bound(np.zeros((1, 3)), np.ones((1, 3)), np.ones((1, 3))) as marks,
        ):
            self._draw(mesh, camera, marks, 1)

    @contextmanager
    def _bound(self, centre: Any, half: Any, color: Any) -> Iterator[Any]:
        marks = np.zeros(len(centre), Mark.dtype)
        marks["centre"], marks["half"], marks["color"] = centre, half, color
        with self._device.storage(Mark, marks, label="marks") as buffer:
            yield buffer

    def _draw(self, mesh: Mesh, camera: Camera, marks: Any, count: int) -> None:
        matrix = MarkCamera(relative_view_projection=camera.relative_view_projection)
        with self._device.uniform(matrix) as uniform:
            self._device.draw(self._program, mesh, count, camera=uniform, marks=marks)

    def __enter__(self) -> _Marks:
        return self

    def __exit__(self, *_: object) -> None:
        self._solid.destroy()
        self._edges.destroy()
