"""Arrays of lights that are written to: a frame refuses what adding lights does, whoever has written it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frames import EYE, make_boxes, max_difference, open_renderer, read_colors

import rhi
from renderer.lab.measure.light_evaluations import count_light_evaluations
from renderer.lights.rectangles import bound_spheres
from renderer.scene import Camera, Lights, Perspective
from renderer.settings import RenderSettings
from renderer.techniques import TECHNIQUES, Forward
from rhi import ValidationError

WRITTEN: dict[str, tuple[str, str, Any]] = {
    "a spot's direction three times as long": ("spot", "direction", (0.0, -3.0, 0.0)),
    "a spot's direction of 0": ("spot", "direction", 0.0),
    "a sun's direction half as long": ("directional", "direction", (0.0, -0.5, 0.0)),
    "a negative range of a point": ("point", "range", -3.0),
    "a negative range of a spot": ("spot", "range", -1e-3),
    "a negative radius": ("point", "source_radius", -0.1),
    "a radius above the range": ("point", "source_radius", 3.001),
    "a height without a width": ("point", "source_up", (0.0, 0.1, 0.0)),
    "a tube that ends beyond the range": ("point", "source_right", (3.001, 0.0, 0.0)),
    "a sun that fills more than a right angle": ("directional", "angular_diameter", 1.58),
    "a sun of a negative size": ("directional", "angular_diameter", -0.1),
    "a negative color": ("point", "color", (1.0, -0.1, 1.0)),
    "a negative intensity": ("directional", "intensity", -1.0),
    "a cone that is wider inside": ("spot", "inner", 0.7),
    "a cone of more than a ball": ("spot", "outer", 3.2),
    "a cone below 0": ("spot", "inner", -0.1),
}
FINE: dict[str, tuple[str, str, Any]] = {
    "a direction that is rounded": ("spot", "direction", (0.0, -0.9995, 0.0)),
    "a range of 0": ("point", "range", 0.0),
    "a sphere of the whole range": ("point", "source_radius", 3.0),
    "a tube of the whole range": ("point", "source_right", (3.0, 0.0, 0.0)),
    "a sun that fills a right angle": ("directional", "angular_diameter", np.pi / 2),
    "no light": ("point", "intensity", 0.0),
    "a ball": ("spot", "outer", np.pi),
    "a sharp cone": ("spot", "inner", 0.6),
}


def add_lights(lights: Lights) -> None:
    lights.add_directional((0, -1, 0))
    lights.add_point((3, 1, 0), 3.0)
    lights.add_spot((0, 3, 0), (0, -1, 0), 8.0, 0.3, 0.6)


def count_draws(kind: str, field: str, value: Any) -> int:
    """Return the draws of a frame after a field of all lights of a kind was written to."""
    builder = make_boxes((0, 0, 0))
    add_lights(builder.lights)
    scene = builder.build()
    with rhi.create_device("null") as device, open_renderer(device, scene, Forward()) as renderer:
        renderer.render(scene.views["eye"])
        before = device.statistics.draws
        getattr(scene.lights, kind)[field] = value
        renderer.render(scene.views["eye"])
        return device.statistics.draws - before


@pytest.mark.parametrize("name", WRITTEN)
def test_a_value_out_of_its_range_is_refused_by_the_frame(name: str) -> None:
    with pytest.raises(ValidationError, match="scene-bad-light") as error:
        count_draws(*WRITTEN[name])
    assert WRITTEN[name][0] in error.value.call
    assert error.value.site is not None
    assert error.value.site.file == __file__


@pytest.mark.parametrize("name", FINE)
def test_a_value_at_the_end_of_its_range_is_drawn(name: str) -> None:
    assert count_draws(*FINE[name]) > 0


def test_a_sphere_without_a_radius_has_a_rectangle_without_an_overflow() -> None:
    camera = Camera.look_at((0, 0, 0), (0, 0, -1), projection=Perspective(aspect=1.0, far=60.0))
    with np.errstate(all="raise"):
        (rectangle,) = bound_spheres(camera, np.array([[0.0, 0.0, -10.0]]), np.zeros(1))
    assert np.abs(rectangle).max() < 1e-5


def test_lights_are_white_and_of_intensity_1_by_default() -> None:
    lights = Lights()
    add_lights(lights)
    lights.add_points([(0, 0, 0)], 1.0)
    lights.add_spots([(0, 0, 0)], (0, 0, -1), 1.0, 0.1, 0.2)
    for array, count in ((lights.directional, 1), (lights.point, 2), (lights.spot, 2)):
        assert array["intensity"].tolist() == [1.0] * count
        assert array["color"].tolist() == [[1.0, 1.0, 1.0]] * count
        assert not array["casts_shadow"].any()


@pytest.mark.parametrize("kind", ["directional", "point", "spot"])
def test_a_written_light_array_gives_a_new_snapshot(kind: str) -> None:
    lights = Lights()
    lights.add_directional((0, -1, 0))
    lights.add_point((0, 1, 0), 5.0)
    lights.add_spot((0, 1, 0), (0, -1, 0), 5.0, 0.1, 0.2)
    lights.refresh()
    before = lights.snapshot
    lights.refresh()
    assert lights.snapshot is before
    getattr(lights, kind)["intensity"] *= 0.5
    lights.refresh()
    assert lights.snapshot is not before


CUTOFF = 0.25


def make_faint() -> Lights:
    """Make point lights of which the last two end before their light is faint: at their range, and at their
    source."""
    lights = Lights()
    lights.add_points([(0, 1.5, 2), (2, 0, 3), (-2, 0, 3)], [9.0, 1.5, 9.0], intensity=[1.0, 4.0, 0.1],
                      color=[(0.5, 1, 0), (1, 1, 1), (1, 1, 1)], source_radius=[0, 0, 1.0])  # fmt: skip
    lights.add_spot((0, 3, 3), (0, -1, -1), 20.0, 0.3, 0.6, intensity=4.0)
    return lights


def test_a_cutoff_shortens_ranges_and_little_light_is_missing() -> None:
    lights = make_faint()
    cut, away = lights.with_cutoff(CUTOFF), np.linspace(0.01, 25.0, 5001)
    assert cut.point["range"].tolist() == [2.0, 1.5, 1.0]
    assert cut.spot["range"].tolist() == [4.0]
    assert lights.point["range"].tolist() == [9.0, 1.5, 9.0]  # the scene's stay as they are
    for before, after in ((lights.point[0], cut.point[0]), (lights.spot[0], cut.spot[0])):
        full, less = (
            array["intensity"] / away**2 * np.clip(1.0 - (away / array["range"]) ** 4, 0.0, 1.0) ** 2
            for array in (before, after)
        )
        assert 0.9 * CUTOFF < (full - less).max() <= 1.1 * CUTOFF


@pytest.mark.parametrize("technique", TECHNIQUES)
def test_a_technique_draws_lights_with_a_cutoff_as_if_their_ranges_were_shorter(
    gl: rhi.Device, technique: str
) -> None:
    settings, images, counts = RenderSettings(algorithm="frustum").change("technique.name", technique), [], []
    for least, is_cut in ((CUTOFF, False), (0.0, True), (0.0, False)):
        builder = make_boxes(*[(2 * x, 2 * y, 0) for x in (-1, 0, 1) for y in (-1, 0, 1)])
        builder.lights = make_faint().with_cutoff(CUTOFF) if is_cut else make_faint()
        builder.lights.cast_shadows()
        with settings.change("light_cutoff", least).open(gl, builder.build(), (48, 32)) as renderer:
            images.append(read_colors(renderer.render(EYE)))
            counts.append(count_light_evaluations(renderer, EYE))
            renderer.light_cutoff = CUTOFF  # between two frames
            images.append(read_colors(renderer.render(EYE)))
    assert counts[0] == counts[1] < counts[2]
    assert max_difference(images[0], images[2]) == 0
    assert max_difference(images[0], images[4]) > 20
    assert [max_difference(images[0], images[number]) for number in (1, 3, 5)] == [0, 0, 0]


def test_rectangles_and_tubes_are_point_lights_with_sides() -> None:
    lights = Lights()
    assert (
        lights.add_rectangle((0, 1, 0), (0, 0, -2), 5.0, 2.0, 1.0, (1, 0.5, 0), 3.0, source_radius=0.4) == 0
    )
    assert lights.add_tube((1, 0, 0), (0, 3, 0), 4.0, 1.5, 0.1) == 1
    rectangle, tube = lights.point
    assert rectangle["source_right"].tolist() == [-1.0, 0.0, 0.0]
    assert rectangle["source_up"].tolist() == [0.0, 0.5, 0.0]
    assert np.cross(rectangle["source_right"], rectangle["source_up"]).tolist() == [0.0, 0.0, -0.5]
    assert (rectangle["range"], rectangle["intensity"]) == (5.0, 3.0)
    assert tube["source_right"].tolist() == [0.0, 0.75, 0.0]
    assert not tube["source_up"].any()
    assert [round(float(radius), 6) for radius in lights.point["source_radius"]] == [0.4, 0.1]


@pytest.mark.parametrize("direction", [(0, 1, 0), (0, -1e-20, 0), (1e20, 1e20, 0), (0.3, 0.2, -0.9)])
def test_a_rectangle_shines_along_its_direction_even_along_up(direction: tuple[float, ...]) -> None:
    lights = Lights()
    lights.add_rectangle((0, 0, 0), direction, 5.0, 1.0, 1.0)
    normal = np.cross(*(lights.point[name][0].astype(float) for name in ("source_right", "source_up")))
    expected = np.array(direction) / np.linalg.norm(np.array(direction) / 1e10) / 1e10
    assert 4.0 * normal == pytest.approx(expected, abs=1e-6)


def test_a_rectangle_without_a_height_isn_t_a_tube() -> None:
    lights = Lights()
    lights.add_rectangle((0, 0, 0), (0, 0, 1), 5.0, 1.0, 0.0)
    assert lights.point["source_up"].any()


REFUSED: dict[str, dict[str, Any]] = {
    "a negative width": {"width": -1.0},
    "an infinite height": {"height": np.inf},
    "no direction": {"direction": (0, 0, 0)},
    "no up": {"up": (0, 0, 0)},
    "a diagonal beyond the range": {"width": 8.0, "height": 6.1},
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_rectangle_that_can_t_be_is_refused_and_not_added(name: str) -> None:
    lights, values = Lights(), {"direction": (0, 0, 1), "range": 5.0, "width": 8.0, "height": 6.0}
    with pytest.raises(ValidationError, match="scene-bad-light"):
        lights.add_rectangle((0, 0, 0), **{**values, **REFUSED[name]})
    assert len(lights) == 0
    lights.add_rectangle((0, 0, 0), **values)
    assert len(lights) == 1
