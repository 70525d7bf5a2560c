"""Decals, compared with a projection in float64.

A plane fills the image, with boxes of decals through it: turned, tilted, mirrored, stretched, over each other, facing
away, and too far away. Each texel is wider than a pixel, so that an image is read from its finest level.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from renderer.lab.exam.case import CaseImage, CaseResult, Measures, largest_error
from renderer.lab.exam.ray_traced_cases import draw
from renderer.lab.exam.scenes import shows_something
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
    projection = Perspective(0.9, _SIZE[0] / _SIZE[1], near=0.05 * unit)
    eye, target = middle + unit * _EYE, middle + unit * _TARGET
    return builder.build(), Camera.look_at(eye, target, projection=projection)


def compute_levels(view: DecalView) -> tuple[Floats, Floats]:
    """The levels (h, w, 3) of a view, and how far each pixel (h, w) is from a face of a box, in that of the box."""
    width, height = _SIZE
    camera = Camera.look_at(_EYE, _TARGET, projection=Perspective(0.9, width / height))
    x = ((np.arange(width) + 0.5) / width * 2.0 - 1.0) * np.tan(0.45) * width / height
    y = (1.0 - (np.arange(height) + 0.5) / height * 2.0) * np.tan(0.45)
    rays = np.stack(np.broadcast_arrays(x[None, :], y[:, None], -1.0), axis=-1) @ camera.rotation
    hit = _EYE + rays * (-_EYE[2] / rays[..., 2])[..., None]
    color = np.broadcast_to(np.array(view.base), hit.shape)
    nearest = np.full(hit.shape[:2], np.inf)
    for decal in sorted(PROJECTIONS, key=lambda decal: decal.order):
        inverse = np.linalg.inv(decal.local)
        inside = (hit @ inverse[:3, :3].T + inverse[:3, 3]) / decal.size
        x_axis, y_axis, z_axis = decal.local[:3, :3].T
        across = np.cross(x_axis, y_axis)  # at right angles to the box's front, on the side of +z
        cosine = across[2] * np.sign(across @ z_axis) / np.linalg.norm(across)
        low, high = np.cos(decal.outer_angle), np.cos(decal.inner_angle)
        opacity = decal.strength * np.clip((cosine - low) / (high - low), 0.0, 1.0)
        distance = 0.5 - np.abs(inside).max(axis=2)
        if opacity > 0.0:
            nearest = np.minimum(nearest, np.abs(distance))
        texels = sample_bilinear(inside[..., 0] + 0.5, 0.5 - inside[..., 1])
        alpha = np.where(distance > 0.0, texels[..., 3] * opacity, 0.0)[..., None]
        color = (1.0 - alpha) * color + alpha * texels[..., :3] * decal.color
    away = _LIGHT - hit
    squared = (away**2).sum(axis=-1)
    irradiance = 1.5 * np.clip(1.0 - (squared / _RANGE**2) ** 2, 0.0, 1.0) ** 2 / squared
    light = color * (irradiance * away[..., 2] / np.sqrt(squared))[..., None]
    return np.asarray(255.0 * to_srgb(np.asarray(evaluate(tone_map, light), np.float64))), nearest


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
    numbers, holds, images = dict[str, object](), dict[str, bool](), dict[str, CaseImage]()
    error = 0.0
    for title, view in _VIEWS.items():
        scene, camera = make_decal_scene(view)
        image = draw(device, scene, camera, _SIZE, technique=view.technique)
        expected, nearest = compute_levels(view)
        off = np.abs(image[..., :3].astype(np.float64) - expected).max(axis=2)
        off[nearest < _EDGE] = 0.0
        numbers[f"{title}: levels off"] = round(float(off.max()), 3)
        error = largest_error(error, float(off.max()))
        for description, is_true in shows_something([image]).items():
            holds[f"{title}: {description}"] = is_true
        images |= {title: image, f"{title}, off": off}
    return CaseResult(error, numbers, holds, lambda: images)


MEASURES: Final[Measures] = {98: measure_decals}
