"""Street furniture in metres: street lights, lanterns and cars, in parts of one material each.

Cars look along +x, their wheels stand on y = 0. What shines is a part of its own: its material emits light.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from renderer.content import shapes
from renderer.scene.arrays import Floats
from renderer.scene.meshes import MeshGeometry, join
from rhi.math import multiply, rotation, scaling, translation

STREET_LIGHT_REACH: Final = 1.6
"""The distance of a street light's head from its post, along +x."""

CAR_LENGTH: Final = 4.4

_WIDTH: Final = 1.8  # of a car
_AXLE: Final = 1.35  # distance of an axle from the middle of a car


def make_post(detail: int) -> MeshGeometry:
    """Make a street light without its cover: a post of 6 m, an arm along +x, and a head."""
    post = shapes.lathe([(0.14, 0.0), (0.1, 0.6), (0.06, 6.0), (0.0, 6.0)], max(detail, 4))
    arm = shapes.box().transformed(
        _box_transform((0.5 * STREET_LIGHT_REACH, 5.97, 0.0), (STREET_LIGHT_REACH, 0.07, 0.07))
    )
    head = shapes.box().transformed(_box_transform((STREET_LIGHT_REACH, 5.95, 0.0), (0.7, 0.14, 0.34)))
    return join([post, arm, head])


def make_street_light_cover(detail: int) -> MeshGeometry:
    """Make the cover of a street light, below its head."""
    return shapes.sphere(max(detail, 6)).transformed(
        _box_transform((STREET_LIGHT_REACH, 5.87, 0.0), (0.56, 0.16, 0.26))
    )


def make_lantern_post(detail: int) -> MeshGeometry:
    """Make the post of a lantern in a park, 3 m high."""
    profile = [(0.16, 0.0), (0.12, 0.3), (0.05, 0.4), (0.05, 2.8), (0.14, 2.95), (0.0, 3.0)]
    return shapes.lathe(profile, max(detail, 4))


def make_lantern(detail: int) -> MeshGeometry:
    """Make the globe of a lantern, on top of its post."""
    return shapes.sphere(max(detail, 6)).transformed(_box_transform((0.0, 3.18, 0.0), (0.44, 0.44, 0.44)))


def make_car_body() -> MeshGeometry:
    """Make the painted part of a car: hull and roof."""
    hull = shapes.loft(
        _OUTLINE, [(0.20, 0.95, 0.9), (0.42, 1.0, 1.0), (0.70, 1.0, 0.98), (0.86, 0.93, 0.9)], (1.0, 1.0)
    )
    roof = shapes.loft(_CABIN, [(1.34, 0.72, 0.84), (1.42, 0.66, 0.78)], (1.0, 1.0))
    return join([hull, roof])


def make_car_trim(detail: int) -> MeshGeometry:
    """Make the dark parts of a car: windows, wheels and underside."""
    windows = shapes.loft(_CABIN, [(0.84, 1.0, 1.0), (1.36, 0.7, 0.82)], (1.0, 1.0))
    wheel = shapes.cylinder(max(detail, 8))
    turned = multiply(rotation((1, 0, 0), 0.5 * np.pi), scaling((0.64, 0.22, 0.64)))
    wheels = [
        wheel.transformed(multiply(translation((x, 0.32, z)), turned))
        for x in (-_AXLE, _AXLE)
        for z in (-0.5 * _WIDTH + 0.1, 0.5 * _WIDTH - 0.1)
    ]
    below = shapes.box().transformed(_box_transform((0.0, 0.28, 0.0), (0.8 * CAR_LENGTH, 0.2, 0.8 * _WIDTH)))
    return join([windows, *wheels, below])


def make_headlights() -> MeshGeometry:
    """Make the two headlights of a car."""
    return join([_car_light(HEADLIGHT * (1.0, 1.0, side), (0.1, 0.16, 0.34)) for side in (-1.0, 1.0)])


def make_tail_lights() -> MeshGeometry:
    """Make the two tail lights of a car."""
    return join([_car_light(TAIL_LIGHT * (1.0, 1.0, side), (0.08, 0.13, 0.42)) for side in (-1.0, 1.0)])


HEADLIGHT: Final = np.array([0.5 * CAR_LENGTH - 0.06, 0.62, 0.36 * _WIDTH])
"""The middle of a car's right headlight."""

TAIL_LIGHT: Final = np.array([-0.5 * CAR_LENGTH + 0.03, 0.68, 0.32 * _WIDTH])
"""The middle of a car's right tail light."""

_OUTLINE: Final = (0.5 * CAR_LENGTH, 0.5 * _WIDTH) * np.array(
    [(1.0, 0.5), (1.0, -0.5), (0.86, -1.0), (-0.9, -1.0), (-1.0, -0.7), (-1.0, 0.7), (-0.9, 1.0), (0.86, 1.0)]
)
_CABIN: Final = np.array([(0.85, 0.78), (0.85, -0.78), (-1.55, -0.78), (-1.55, 0.78)])


def _car_light(centre: Floats, size: tuple[float, float, float]) -> MeshGeometry:
    return shapes.box().transformed(_box_transform(centre, size))


def _box_transform(centre: Floats | tuple[float, float, float], size: tuple[float, float, float]) -> Floats:
    return multiply(translation(centre), scaling(size))
