"""The metallic-roughness model, compared with glTF's formulas in float64."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from renderer.light_kinds.incidence import Incidence
from renderer.shaders.metals import (
    MIN_ROUGHNESS,
    ambient_light_metallic,
    metallic_surface,
    metallic_terms,
    reflected_light_metallic,
)
from renderer.shaders.structs import Ambient, SurfacePoint
from renderer.shaders.tone_mapping import tone_map
from rhi.shading import evaluate

Floats = NDArray[np.float64]
COUNT = 20_000


def unit(v: Floats) -> Floats:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def encode(linear: Floats) -> Floats:
    """Encode linear light as sRGB, 0…255."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055) * 255


def gltf_brdf(
    base: Floats, metallic: Floats, roughness: Floats, n: Floats, v: Floats, light: Floats
) -> Floats:
    """glTF 2.0, appendix B.3.5, times π, as it is written there: D, G and F by themselves. (k, 3) of unit
    vectors."""

    def dots(a: Floats, b: Floats) -> Floats:
        return np.asarray((a * b).sum(-1, keepdims=True))

    alpha2 = np.maximum(roughness, MIN_ROUGHNESS)[:, None] ** 4
    h = unit(light + v)
    nl, nv, nh, vh = dots(n, light), np.abs(dots(n, v)), dots(n, h), dots(v, h)
    d = alpha2 * (nh > 0) / (np.pi * (nh**2 * (alpha2 - 1) + 1) ** 2)
    g = 2 * nl / (nl + np.sqrt(alpha2 + (1 - alpha2) * nl**2))
    g = g * 2 * nv / (nv + np.sqrt(alpha2 + (1 - alpha2) * nv**2))
    metal = metallic[:, None]
    diffuse, f0 = base * (1 - metal), 0.04 * (1 - metal) + base * metal
    f = f0 + (1 - f0) * (1 - np.abs(vh)) ** 5
    return np.asarray(((1 - f) * diffuse / np.pi + f * d * g / (4 * nl * nv)) * np.pi)


def surfaces(n: Floats, v: Floats, base: Floats, metallic: Any, roughness: Any) -> Any:
    """Return (k,) of `SurfacePoint` of this model in float32, made by the shader's own function."""
    points: Any = np.zeros(len(n), SurfacePoint.dtype)
    points["normal"], points["to_eye"], points["base_color"] = n, v, base
    points["occlusion"] = 1.0
    return evaluate(
        metallic_surface, points, np.asarray(metallic, np.float32), np.asarray(roughness, np.float32)
    )


def lights(direction: Floats, irradiance: Any = 1.0) -> Any:
    incidences: Any = np.zeros(len(direction), Incidence.dtype)
    incidences["direction"], incidences["irradiance"] = direction, irradiance
    return incidences


def random_views(seed: int, spread: float) -> tuple[Floats, Floats, Floats]:
    """Return normals, directions to eyes and to lights, in float32, on one side. With a small `spread` lights
    are where highlights are, near the mirrored direction."""
    random = np.random.default_rng(seed)
    n = unit(random.normal(size=(COUNT, 3)))
    v, light = (unit(random.normal(size=(COUNT, 3))) for _ in range(2))
    v *= np.sign((v * n).sum(1, keepdims=True))
    mirrored = 2 * (v * n).sum(1, keepdims=True) * n - v
    light = unit(mirrored + spread * random.normal(size=(COUNT, 3)) if spread else light)
    light *= np.sign((light * n).sum(1, keepdims=True))
    n, v, light = (x.astype(np.float32).astype(float) for x in (n, v, light))
    return n, v, light


@pytest.mark.parametrize("spread", [0.0, 0.3, 0.03, 0.003])
def test_reflected_light_is_within_one_level_of_gltfs_formulas_in_float64(spread: float) -> None:
    n, v, light = random_views(1, spread)
    random = np.random.default_rng(2)
    base, metallic, roughness = random.random((COUNT, 3)), random.random(COUNT), random.random(COUNT)
    metallic[::3], roughness[::5] = 1.0, 0.0
    base, metallic, roughness = (x.astype(np.float32).astype(float) for x in (base, metallic, roughness))
    n, v, light = unit(n), unit(v), unit(light)
    seen = ((n * light).sum(1) > 1e-3) & ((n * v).sum(1) > 1e-3)
    exact = gltf_brdf(base, metallic, roughness, n, v, light) * (n * light).sum(1, keepdims=True)
    ours = evaluate(reflected_light_metallic, surfaces(n, v, base, metallic, roughness), lights(light))
    assert np.isfinite(ours).all()
    expected, levels = (
        encode(evaluate(tone_map, x, dtype=np.float64)) for x in (exact, ours.astype(np.float64))
    )
    assert expected[seen].std() > 20.0
    assert np.abs(expected - levels)[seen].max() <= 1.0


def test_smooth_metals_have_a_finite_highlight_everywhere() -> None:
    n = np.tile([0.0, 0.0, 1.0], (COUNT, 1))
    away = np.concatenate([[0.0], np.geomspace(1e-9, np.pi / 2, COUNT - 1)])
    v = np.stack([np.sin(away), 0 * away, np.cos(away)], axis=1)
    for light in (v * (-1, 1, 1), -v, n, v * (1, 1, 0), -n):
        ours = evaluate(
            reflected_light_metallic,
            surfaces(n, v, np.ones((COUNT, 3)), np.ones(COUNT), np.zeros(COUNT)),
            lights(light),
        )
        assert np.isfinite(ours).all()
        assert (ours >= 0.0).all()
    peak = evaluate(
        reflected_light_metallic,
        surfaces(n[:1], n[:1], np.ones((1, 3)), np.ones(1), np.zeros(1)),
        lights(n[:1]),
    )
    np.testing.assert_allclose(peak, 0.25 / MIN_ROUGHNESS**4, rtol=1e-4)


def test_vectors_of_no_length_give_no_nan() -> None:
    zero, up = np.zeros((4, 3)), np.tile([0.0, 0.0, 1.0], (4, 1))
    for n, v, light in ((zero, up, up), (up, zero, up), (up, up, zero), (up, up, -up), (zero, zero, zero)):
        points = surfaces(n, v, np.ones((4, 3)), np.array([0, 0.5, 1, 1]), np.array([0, 0.1, 0.5, 1]))
        for result in (
            evaluate(reflected_light_metallic, points, lights(light)),
            evaluate(metallic_terms, points, light),
            evaluate(ambient_light_metallic, points, Ambient(sky=(1, 1, 1), ground=(0, 0, 0))),
        ):
            assert np.isfinite(result).all()


def test_the_terms_times_their_colours_are_the_reflected_light() -> None:
    n, v, light = random_views(3, 0.2)
    random = np.random.default_rng(4)
    points = surfaces(n, v, random.random((COUNT, 3)), random.random(COUNT), random.random(COUNT))
    terms = evaluate(metallic_terms, points, light)
    facing = np.maximum((n * light).sum(1, keepdims=True), 0.0)
    total = points["base_color"] * terms[:, :1] + points["specular_color"] * terms[:, 1:2] + terms[:, 2:]
    reflected = evaluate(reflected_light_metallic, points, lights(light))
    np.testing.assert_allclose(reflected, total * facing, rtol=2e-5, atol=1e-6)


def test_a_metal_scatters_nothing_and_a_dielectric_mirrors_a_twenty_fifth() -> None:
    n = np.tile([0.0, 0.0, 1.0], (2, 1))
    points = surfaces(n, n, np.full((2, 3), 0.5), np.array([1.0, 0.0]), np.full(2, 0.5))
    np.testing.assert_allclose(points["base_color"], [[0.0] * 3, [0.48] * 3], rtol=1e-6)
    np.testing.assert_allclose(points["specular_color"], [[0.5] * 3, [0.04] * 3], rtol=1e-6)


@pytest.mark.parametrize("roughness", [0.0, 0.3, 1.0])
def test_no_metal_reflects_more_ambient_light_than_there_is(roughness: float) -> None:
    n, v, _ = random_views(5, 0.0)
    points = surfaces(n, v, np.ones((COUNT, 3)), np.ones(COUNT), np.full(COUNT, roughness))
    light = evaluate(ambient_light_metallic, points, Ambient(sky=(1, 1, 1), ground=(1, 1, 1)))
    assert light.max() <= 1.04
    assert light.min() >= 0.3


def test_occlusion_takes_from_ambient_light_alone() -> None:
    n, v, light = random_views(6, 0.5)
    points = surfaces(n, v, np.ones((COUNT, 3)), np.full(COUNT, 0.5), np.full(COUNT, 0.5))
    ambient = Ambient(sky=(1, 1, 1), ground=(0.5, 0.5, 0.5))
    open_light = evaluate(ambient_light_metallic, points, ambient)
    direct = evaluate(reflected_light_metallic, points, lights(light))
    points["occlusion"] = 0.25
    np.testing.assert_allclose(
        evaluate(ambient_light_metallic, points, ambient), open_light * 0.25, rtol=1e-6
    )
    assert np.array_equal(evaluate(reflected_light_metallic, points, lights(light)), direct)
