"""Numbers of scenes, settings and techniques: each parameter takes numbers of its range, and refuses all else
by a rule.

A limit that is NaN would limit nothing, and a time of NaN would hide the scene, both without a word.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from math import inf
from typing import Any

import numpy as np
import pytest
from hostile_numbers import list_accepted
from refusals import refused_rule

import renderer.techniques as techniques
import rhi
from renderer.content import ModelLimits, load_scene
from renderer.frame import DepthOfFieldSettings, OcclusionSettings, TemporalSettings
from renderer.frame.effects import BloomSettings
from renderer.frame.scene_images import TextureSettings
from renderer.renderer import Renderer
from renderer.scene import (
    AmbientOcclusion,
    Bloom,
    CameraPath,
    DepthOfField,
    Fog,
    Leap,
    Perspective,
    SkewedProjection,
    Stepwise,
    StereoRig,
    TextureMap,
    make_height_field,
    make_path,
    measure_parallax,
)
from renderer.settings import RenderSettings
from renderer.shadows import ShadowSettings
from renderer.tessellation.settings import TessellationSettings
from renderer.visibility import VisibilitySettings

SETTINGS: tuple[type[Any], ...] = (
    BloomSettings,
    DepthOfFieldSettings,
    OcclusionSettings,
    TemporalSettings,
    ModelLimits,
    RenderSettings,
    ShadowSettings,
    StereoRig,
    techniques.TechniqueSettings,
    TessellationSettings,
    TextureSettings,
    VisibilitySettings,
)
SAMPLED = (
    "Forward",
    "LightIndexed",
    "ForwardPlus",
    "Clustered",
    "DeferredPlus",
    "TiledDeferred",
    "ClusteredDeferred",
)
"""The techniques that take a number of samples."""
ROUTE = np.array([(0.0, 0.0, 0.0), (5.0, 0.0, 0.0), (5.0, 0.0, 5.0)])
HEIGHTS = np.arange(12.0).reshape(3, 4)
Call = tuple[Callable[..., object], dict[str, Any]]


def route(**arguments: Any) -> CameraPath:
    return make_path(projection=Perspective(), **arguments)


def parallax(points: Any) -> object:
    eyes = StereoRig().place_eyes(route(corners=ROUTE, rounding=0.5, ahead=1.0).camera(0))
    return measure_parallax(eyes, points)


def numbers_of(kind: type[Any]) -> dict[str, Any]:
    """Return the numbers of default settings."""
    types: dict[Any, Any] = {"int": int, "float": float}
    return {entry.name: types[entry.type](entry.default) for entry in fields(kind) if entry.type in types}


CALLS: dict[str, Call] = {
    "Fog": (Fog, {"density": 0.1, "color": (0.5, 0.6, 0.7), "falloff": 0.1, "base": 1.0}),
    "AmbientOcclusion": (AmbientOcclusion, {"radius": 1.0}),
    "DepthOfField": (DepthOfField, {"focus_distance": 1.0, "aperture_radius": 0.1}),
    "Bloom": (Bloom, {"strength": 0.1}),
    "SkewedProjection": (lambda skew: SkewedProjection(Perspective(), skew), {"skew": 0.1}),
    "Stepwise": (Stepwise, {"steps_per_frame": 2, "memory": 3}),
    "Leap": (Leap, {"steps_per_frame": 2, "error": 0.1}),
    "TextureMap": (
        TextureMap,
        {"image": 0, "uv_set": 0, "offset": (0.5, 0.0), "rotation": 0.1, "scale": (1.0, 2.0)},
    ),
    "make_path": (route, {"corners": ROUTE, "rounding": 0.5, "ahead": 1.0, "sink": 0.1, "frames": 10}),
    "CameraPath": (
        lambda **points: CameraPath(projection=Perspective(), **points),
        {"positions": ROUTE, "targets": ROUTE + 1.0},
    ),
    "make_height_field": (
        lambda size, limit: make_height_field(HEIGHTS, size, limit=limit),
        {"size": 4.0, "limit": 8},
    ),
    "sides of a height field": (lambda size: make_height_field(HEIGHTS, size), {"size": (4.0, 5.0)}),
    "measure_parallax": (parallax, {"points": ROUTE}),
    "Inferred": (techniques.Inferred, {"scale": 0.5, "light_bits": 32}),
    "LightPrePass": (techniques.LightPrePass, {"specular_channels": 3, "light_bits": 32}),
    "Deferred": (techniques.Deferred, {"light_bits": 32, "normal_bits": 16}),
    **{name: (getattr(techniques, name), {"samples": 1}) for name in SAMPLED},
    **{kind.__name__: (kind, numbers_of(kind)) for kind in SETTINGS},
}


@pytest.mark.parametrize("name", CALLS)
def test_a_parameter_takes_numbers_only(name: str) -> None:
    assert list_accepted(*CALLS[name]) == []


def test_numbers_of_numpy_become_those_of_python() -> None:
    limits = ModelLimits(np.float32(8.0), np.int64(9), 7, np.float64(inf))  # type: ignore[arg-type]
    assert (limits.bytes, limits.pixels, limits.vertices, limits.seconds) == (8.0, 9, 7, inf)
    fog = Fog(np.float32(0.5), np.full(3, 0.25))  # type: ignore[arg-type]
    assert (type(fog.density), fog.color) == (float, (0.25, 0.25, 0.25))
    assert type(techniques.Forward(np.int64(4)).samples) is int  # type: ignore[arg-type]


@pytest.mark.parametrize("field", ["bytes", "pixels", "vertices", "seconds"])
def test_a_limit_below_zero_is_refused(field: str) -> None:
    for limit in (-1.0, -inf):
        limits: dict[str, Any] = {field: limit}
        assert refused_rule(lambda limits=limits: ModelLimits(**limits)) == "scene-bad-limit"


def test_a_route_needs_two_corners_apart() -> None:
    for corners in (ROUTE[:1], ROUTE[[0, 0, 1]]):
        rule = refused_rule(lambda corners=corners: route(corners=corners, rounding=0.5, ahead=1.0))
        assert rule == "camera-bad-route"
    assert len(route(corners=ROUTE[:2], rounding=0.0, ahead=1.0, frames=3)) == 3


def test_the_time_of_a_frame_is_a_number(null: rhi.Device) -> None:
    scene = load_scene("grid:count=4,lights=2")
    camera = next(iter(scene.views.values()))
    with Renderer(null, scene, size=(32, 24), visibility="frustum") as renderer:
        assert list_accepted(lambda seconds: renderer.render(camera, seconds), {"seconds": 0.5}) == []
        renderer.render(camera, np.float32(0.5))  # type: ignore[arg-type]
