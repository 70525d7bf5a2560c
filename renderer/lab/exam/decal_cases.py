"""Decals, compared with a projection in float64.

A plane fills the image, with boxes of decals through it: turned, tilted, mirrored, stretched, over each other, facing
away, and too far away. Each texel is wider than a pixel, so that an image is read from its finest level.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from renderer.lab.exam.case import CaseImage, CaseResult, Measures
from renderer.lab.exam.lit_planes import FIELD_OF_VIEW, intersect_plane, measure_views
from renderer.scene import Camera, Perspective, Scene, SceneBuilder, make_geometry
from renderer.scene.arrays import Floats
from renderer.shaders.tone_mapping import tone_map
from rhi import Device, from_srgb, to_srgb
from rhi.math import multiply, rotation, scaling, translation
from rhi.shading import evaluate

_SIZE: Final = (96, 64)
_LIGHT: Final = np.array((0.4, 0.7, 1.2))
_RANGE: Final = 20.0
_EYE: Final = np.array((0.2, -0.8, 2.6))
_TARGET: Final = np.array((0.0, 0.1, 0.0))
_EDGE: Final = 4e-3
"""Of a box: so near its faces, a point may count as inside or outside."""


class BoxProjection(NamedTuple):
    """A decal: its node's transform, and the arguments of `SceneBuilder.add_decal`."""

    local: Floats
    size: tuple[float, float, float] = (1.0, 1.0, 1.0)
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    strength: float = 1.0
    inner_angle: float = 1.0
    outer_angle: float = 1.4
    order: int = 0


def _transform(x: float, y: float, z: float, *turns: Floats) -> Floats:
    matrix = translation((x, y, z))
    for turn in turns:
        matrix = multiply(matrix, turn)
    return matrix


PROJECTIONS: Final = (
    BoxProjection(_transform(-0.7, 0.2, 0.1), (1.1, 0.9, 0.6), order=3),
    BoxProjection(
        _transform(-0.2, 0.5, 0.0, rotation((0, 0, 1), 0.5), rotation((1, 0, 0), 0.6)),
        strength=0.8,
        inner_angle=0.3,
        outer_angle=0.9,
    ),
    BoxProjection(
        _transform(0.7, 0.1, 0.0, rotation((0, 0, 1), -0.3), scaling((-1.4, 0.6, 1.0))),
        color=(1.0, 0.5, 0.2),
        order=-2,
    ),
    BoxProjection(
        _transform(0.5, -0.2, -0.1, scaling((1.0, 1.0, 0.5))), (0.5, 1.4, 1.0), (0.3, 1.0, 0.6), 0.6, order=5
    ),
    BoxProjection(
        _transform(0.0, -0.5, 0.0, rotation((1, 0, 0), np.pi)), (3.0, 3.0, 1.0), order=9
    ),  # faces away
    BoxProjection(_transform(0.0, 0.0, 0.6), (5.0, 5.0, 1.0), order=9),  # ends above the plane
    BoxProjection(_transform(0.0, 0.0, 0.0), (5.0, 5.0, 1.0), strength=0.0, order=9),
)


class DecalView(NamedTuple):
    """The technique that draws a view, the material's base color, the metres of the view's unit, and where it is."""

    technique: str
    base: tuple[float, float, float] = (0.5, 0.45, 0.4)
    unit: float = 1.0
    offset: float = 0.0


_VIEWS: Final = {
    "object by object": DecalView("forward"),
    "on a black surface, by volumes of lights": DecalView("deferred", (0.0, 0.0, 0.0)),
    "on a bright surface, by tiles": DecalView("tiled_deferred", (2.0, 1.5, 0.4)),
    "after geometry, 10⁶ m away": DecalView("deferred_plus", offset=1e6),
    "where terms of light are collected": DecalView("light_pre_pass"),
    "in millimetres, 10⁴ m away": DecalView("clustered_deferred", unit=1e-3, offset=1e4),
}


def make_image() -> CaseImage:
    """Make a smooth image (8, 8, 4) with other colours in each corner, and alpha from 0 to 1."""
    y, x = np.mgrid[:8, :8] / 7.0
    channels = 0.2 + 0.6 * x, 0.8 - 0.5 * y, 0.3 + 0.4 * x * y, np.clip(0.2 + x + y, 0.0, 1.0)
    return np.asarray(np.round(255.0 * np.stack(channels, axis=-1)), np.uint8)


def make_decal_scene(view: DecalView) -> tuple[Scene, Camera]:
    """Make the plane with its decals, a light before it, and a camera that it fills."""
    builder, unit, middle = SceneBuilder("decals"), view.unit, np.full(3, view.offset)
    world = builder.add_node(multiply(translation(middle), scaling((unit, unit, unit))))
    corners = np.array([[-9, -9, 0], [9, -9, 0], [-9, 9, 0], [9, 9, 0]], np.float64)
    plane = make_geometry(corners, np.array([0, 1, 2, 2, 1, 3]), np.tile([0.0, 0.0, 1.0], (4, 1)))
    material = builder.add_material(base_color=view.base, specular_color=(0.0, 0.0, 0.0))
    builder.add_objects(world, builder.add_mesh(plane), material)
    image = builder.add_image(make_image())
    for local, *_ in PROJECTIONS:
        builder.add_node(local, world)
    for node, box in enumerate(PROJECTIONS, world + 1):
        arguments = box._asdict()
        del arguments["local"]
        builder.add_decal(node, image, **arguments)
    builder.lights.sky = builder.lights.ground = builder.background = (0.0, 0.0, 0.0)
    builder.lights.add_point(middle + unit * _LIGHT, _RANGE * unit, intensity=unit**2 * 1.5)
    projection = Perspective(FIELD_OF_VIEW, _SIZE[0] / _SIZE[1], near=0.05 * unit)
    eye, target = middle + unit * _EYE, middle + unit * _TARGET
    return builder.build(), Camera.look_at(eye, target, projection=projection)


def compute_levels(view: DecalView) -> Floats:
    """The levels (h, w, 3) of a view."""
    hit = intersect_plane(_SIZE, _EYE, _TARGET)
    color = np.broadcast_to(np.array(view.base), hit.shape)
    for decal in sorted(PROJECTIONS, key=lambda decal: decal.order):
        inside = locate_inside(decal, hit)
        texels = sample_bilinear(inside[..., 0] + 0.5, 0.5 - inside[..., 1])
        is_inside = np.abs(inside).max(axis=2) < 0.5
        alpha = np.where(is_inside, texels[..., 3] * compute_opacity(decal), 0.0)[..., None]
        color = (1.0 - alpha) * color + alpha * texels[..., :3] * decal.color
    away = _LIGHT - hit
    squared = (away**2).sum(axis=-1)
    irradiance = 1.5 * np.clip(1.0 - (squared / _RANGE**2) ** 2, 0.0, 1.0) ** 2 / squared
    light = color * (irradiance * away[..., 2] / np.sqrt(squared))[..., None]
    return np.asarray(255.0 * to_srgb(np.asarray(evaluate(tone_map, light), np.float64)))


def locate_inside(decal: BoxProjection, hit: Floats) -> Floats:
    """The coordinates (h, w, 3) of points in a decal's box, which is from -1/2 to 1/2."""
    inverse = np.linalg.inv(decal.local)
    return np.asarray((hit @ inverse[:3, :3].T + inverse[:3, 3]) / decal.size)


def compute_opacity(decal: BoxProjection) -> float:
    """The strength of a decal on the plane, by the angle between both."""
    x_axis, y_axis, z_axis = decal.local[:3, :3].T
    across = np.cross(x_axis, y_axis)  # at right angles to the box's front, on the side of +z
    cosine = across[2] * np.sign(across @ z_axis) / np.linalg.norm(across)
    low, high = np.cos(decal.outer_angle), np.cos(decal.inner_angle)
    return float(decal.strength * np.clip((cosine - low) / (high - low), 0.0, 1.0))


def select_edges() -> NDArray[np.bool_]:
    """The pixels (h, w) that are within `_EDGE` of a face of a box that is seen."""
    hit = intersect_plane(_SIZE, _EYE, _TARGET)
    is_edge = np.zeros(hit.shape[:2], bool)
    for decal in PROJECTIONS:
        if compute_opacity(decal) > 0.0:
            is_edge |= np.abs(0.5 - np.abs(locate_inside(decal, hit)).max(axis=2)) < _EDGE
    return is_edge


def sample_bilinear(u: Floats, v: Floats) -> Floats:
    """The image (h, w, 4) at coordinates, linear, with its edges repeated."""
    image = make_image() / 255.0
    image[..., :3] = from_srgb(image[..., :3])
    height, width = image.shape[:2]
    x, y = np.clip(u * width - 0.5, 0.0, width - 1.0), np.clip(v * height - 0.5, 0.0, height - 1.0)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    across, down = (x - left)[..., None], (y - top)[..., None]
    upper = image[top, left] * (1.0 - across) + image[top, right] * across
    lower = image[bottom, left] * (1.0 - across) + image[bottom, right] * across
    return np.asarray(upper * (1.0 - down) + lower * down)


def measure_decals(device: Device) -> CaseResult:
    """Draw the views, and measure by how many levels they are off."""
    return measure_views(device, _SIZE, _VIEWS, make_decal_scene, compute_levels, select_edges())


MEASURES: Final[Measures] = {98: measure_decals}
