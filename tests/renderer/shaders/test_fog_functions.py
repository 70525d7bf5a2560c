"""The part of light that passes fog, compared with the density added up along the ray in float64."""

from __future__ import annotations

import numpy as np
import pytest
from fog_reference import integrate_fog
from hypothesis import example, given
from hypothesis import strategies as st

from renderer.scene import Fog
from renderer.shaders import fog as shaders
from renderer.shaders import tone_map
from renderer.shaders.tone_mapping import inverse_tone_map
from rhi.shading import evaluate


def look(fog: Fog, eye: float) -> shaders.FogConstants:
    height = fog.falloff * (eye - fog.base)
    return shaders.FogConstants(color=fog.color, density=fog.density, falloff=fog.falloff, height=height)


VIEWS = {
    "inside": (1.7, (30.0, 2.0, -40.0)),
    "above, downwards": (400.0, (100.0, -400.0, 50.0)),
    "far above, downwards": (3000.0, (1000.0, -2999.0, 50.0)),
    "above, upwards": (400.0, (10.0, 90.0, 50.0)),
    "below the base": (-30.0, (10.0, 20.0, 5.0)),
    "far below the base": (-2e4, (1.0, 1.0, 1.0)),
    "from below to above": (-20.0, (3.0, 200.0, 0.0)),
    "horizontal": (1.7, (60.0, 0.0, -80.0)),
    "almost horizontal": (1.7, (60.0, 1e-6, -80.0)),
    "almost horizontal, downwards": (1.7, (60.0, -1e-4, -80.0)),
    "to the end of the series": (1.7, (5.0, 1.99999, 0.0)),
    "after the end of the series": (1.7, (5.0, 2.00001, 0.0)),
    "10,000 km away": (1.7, (1e7, 5.0, 0.0)),
    "10,000 km up": (1.7, (0.0, 1e7, 0.0)),
    "at the eye": (1.7, (0.0, 0.0, 0.0)),
}


@pytest.mark.parametrize("falloff", [0.0, 1e-4, 0.05, 3.0])
@pytest.mark.parametrize("view", VIEWS)
def test_fog_is_the_integral_of_its_density(view: str, falloff: float) -> None:
    eye, position = VIEWS[view]
    fog = Fog(0.02, (0.5, 0.5, 0.5), falloff)
    passing = evaluate(shaders.fog_transmittance, np.array(position), look(fog, eye), dtype=np.float32)
    assert abs(float(passing) - integrate_fog(fog, eye, np.array(position))) < 2e-5


@given(
    st.floats(1e-5, 10.0), st.sampled_from([0.0, 1e-5, 1e-3, 0.02, 0.4]), st.floats(-300.0, 300.0),
    st.tuples(*3 * [st.floats(-1e3, 1e3)]),
)  # fmt: skip
@example(1.0, 0.4, 300.0, (0.0, -600.0, 0.0))
def test_any_ray_passes_a_part_of_its_light(
    density: float, falloff: float, eye: float, position: tuple[float, float, float]
) -> None:
    fog, point = Fog(density, (0.5, 0.5, 0.5), falloff), np.array(position)
    passing = float(evaluate(shaders.fog_transmittance, point, look(fog, eye), dtype=np.float32))
    assert abs(passing - integrate_fog(fog, eye, point)) < 1e-3  # a quarter of a level


@pytest.mark.parametrize(("eye", "falloff"), [(1.7, 0.05), (80.0, 0.05), (-30.0, 0.05), (1.7, 3.0)])
def test_fog_before_the_sky_equals_fog_along_a_long_ray(eye: float, falloff: float) -> None:
    fog = Fog(0.02, (0.5, 0.5, 0.5), falloff)
    for direction in (0.0, 1.0, 0.0), (1.0, 0.02, 0.0), (1.0, 1e-4, 1.0):
        light = evaluate(
            shaders.apply_fog_to_background, np.ones(3), np.array(direction), look(fog, eye), dtype=np.float32
        )
        ray = 1000.0 / falloff / direction[1] * np.array(direction)  # beyond it, nothing is left
        expected = 0.5 + 0.5 * integrate_fog(fog, eye, ray)
        assert np.abs(light - expected).max() < 2e-5


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (1.0, -1e-6, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 0.0)])
def test_a_ray_that_never_leaves_the_fog_sees_nothing_else(direction: tuple[float, float, float]) -> None:
    fog = look(Fog(1e-5, (0.25, 0.5, 0.75), 0.05), 500.0)
    light = evaluate(shaders.apply_fog_to_background, np.ones(3), np.array(direction), fog, dtype=np.float32)
    assert light.tolist() == [0.25, 0.5, 0.75]
    level = look(Fog(1e-5, (0.25, 0.5, 0.75)), 500.0)
    up = evaluate(
        shaders.apply_fog_to_background, np.ones(3), np.array([0.0, 1.0, 0.0]), level, dtype=np.float32
    )
    assert up.tolist() == [0.25, 0.5, 0.75]


def test_colours_lead_back_to_the_light_that_shows_them() -> None:
    for color in (0.0, 0.0, 0.0), (0.02, 0.5, 0.9), (1.0, 1.0, 1.0), (1e-4, 0.999, 1e-9):
        assert evaluate(tone_map, np.array(inverse_tone_map(color)), dtype=np.float64) == pytest.approx(
            color, abs=1e-6
        )
    assert inverse_tone_map((1.0, 1.0, 1.0))[0] == pytest.approx(12.07, abs=0.01)
