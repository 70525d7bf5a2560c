"""Casters at any height cast right shadows of the sun and leave the rest of the ground lit, against rays in
float64."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from frames import open_renderer
from hypothesis import given
from hypothesis import strategies as st
from nightly_reasons import FEWER_CASES
from numpy.typing import NDArray

import rhi
from renderer.content import BUILT_IN
from renderer.scene import Camera, Perspective, SceneBuilder, scaling, translation
from renderer.shadows import ShadowSettings
from renderer.shadows.cascades import fit_cascades
from renderer.shadows.huge_casters import cut_triangles
from renderer.techniques import Forward

Floats = NDArray[np.float64]
Box = tuple[Floats, Floats]
"""The lower and the upper corner."""

SIZE = (96, 72)
SETTINGS = ShadowSettings(cascades=3, cascade_size=512, distance=60.0)
EYE = Camera.look_at((0.0, 8.0, 10.0), (0, 0, 0), (0, 1, 0), Perspective(1.0, SIZE[0] / SIZE[1], 0.1))
HEIGHTS = (3.0, 30.0, 1e3, 7e4, 1e6, 1e7)
GROUNDS = (200.0, 1e5, 2e7)
SUNS = (0.0, 35.0, 65.0)
ROUNDED = {200.0: 0, 1e5: 0, 2e7: 130}
"""How many of 6,000 pixels may be wrong on a ground of this width: float32 rounds the corners of a triangle
of 2·10⁷ m by a metre, and with them the points that the view shows."""


def sun_direction(degrees: float) -> Floats:
    """Return the direction of sunlight that is `degrees` beside the vertical, as lights store it."""
    angle, turn = np.radians(degrees), 0.6
    down = (np.sin(angle) * np.cos(turn), -np.cos(angle), np.sin(angle) * np.sin(turn))
    return np.array(down, np.float32).astype(np.float64)


def make_boxes(*boxes: Box) -> SceneBuilder:
    """Return a scene of boxes without ambient light, in a grey without highlights."""
    builder = SceneBuilder("far casters")
    grey = builder.add_material(base_color=(0.8, 0.8, 0.8), specular_color=(0, 0, 0))
    box = builder.add_mesh(BUILT_IN["box"]())
    for lower, upper in boxes:
        middle, size = 0.5 * (lower + upper), upper - lower
        builder.add_objects(builder.add_node(translation(tuple(middle)) @ scaling(tuple(size))), box, grey)
    builder.lights.sky = builder.lights.ground = (0.0, 0.0, 0.0)
    return builder


def around(middle: Floats, size: float = 1.0) -> Box:
    return middle - 0.5 * size, middle + 0.5 * size


def ground(width: float) -> Box:
    return np.array((-0.5 * width, -1.0, -0.5 * width)), np.array((0.5 * width, 0.0, 0.5 * width))


def distances_along(origins: Floats, directions: Floats, box: Box) -> Floats:
    """Return the distance along rays (n, 3) to a box; infinite where they miss it."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(corner - origins) / directions for corner in box])
    enters, leaves = np.fmin(*ends).max(-1), np.fmax(*ends).min(-1)
    return np.where((leaves > np.maximum(enters, 0.0)) & (leaves > 0.0), np.maximum(enters, 0.0), np.inf)


def ground_pixels(boxes: list[Box]) -> tuple[NDArray[np.bool_], Floats]:
    """Return (h, w) which pixels show the ground, and the points (h · w, 3) of it."""
    x, y = ((np.arange(count) + 0.5) / count * 2 - 1 for count in SIZE)
    matrix = EYE.projection.matrix
    across, up = np.meshgrid(x / matrix[0, 0], -y / matrix[1, 1])
    rays = np.stack([across, up, -np.ones_like(across)], -1).reshape(-1, 3) @ EYE.rotation
    origins = np.broadcast_to(EYE.position, rays.shape)
    to_ground = -origins[:, 1] / np.where(rays[:, 1] < 0, rays[:, 1], np.nan)
    nearest = np.min([distances_along(origins, rays, box) for box in boxes], 0)
    shows = (to_ground < nearest) & (to_ground < 0.8 * SETTINGS.distance)
    return shows.reshape(SIZE[::-1]), origins + rays * np.nan_to_num(to_ground)[:, None]


def lit_by_rays(
    points: Floats, down: Floats, boxes: list[Box], settings: ShadowSettings
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return (n,) whether the sun reaches points of the ground, and whether that is sure within two
    texels."""
    texel = max(cascade.texel for cascade in fit_cascades([EYE], down, settings, 1.0, (0.0, 1.0)))
    axes = Camera.look_at((0, 0, 0), down).rotation
    blocked = []
    for angle in np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False):
        moved = points + 2.0 * texel * (np.cos(angle) * axes[0] + np.sin(angle) * axes[1])
        moved = moved - down * (moved[:, 1:2] / down[1])  # back to the ground, along the light
        toward = np.broadcast_to(-down, moved.shape)
        blocked.append(np.min([distances_along(moved, toward, box) for box in boxes], 0) < np.inf)
    return ~np.any(blocked, 0), np.all(blocked, 0) | ~np.any(blocked, 0)


def count_wrong(
    device: rhi.Device, width: float, boxes: list[Box], degrees: float, settings: ShadowSettings = SETTINGS
) -> tuple[int, int, int]:
    """Return the numbers of sure pixels of the ground that are wrong, that should be lit, and that should be dark."""
    down = sun_direction(degrees)
    builder = make_boxes(ground(width), *boxes)
    builder.lights.add_directional(tuple(down), casts_shadow=True, intensity=1.0 / -down[1])
    with open_renderer(device, builder.build(), Forward(), size=SIZE) as renderer:
        renderer.shadows.settings = settings
        image = renderer.render(EYE).image.read()[..., 0]
    shows, points = ground_pixels(boxes)
    lit, sure = (part.reshape(shows.shape) for part in lit_by_rays(points, down, boxes, settings))
    compared = shows & sure
    return (
        int(((image > 90) != lit)[compared].sum()),
        int((lit & compared).sum()),
        int((~lit & compared).sum()),
    )


def over(target: tuple[float, float], height: float, down: Floats) -> Floats:
    """Return the point at a height whose shadow falls on a target of the ground."""
    return np.asarray(np.array((target[0], 0.0, target[1])) - down * (height / -down[1]))


NEAR = around(np.array((2.0, 1.5, -2.0)))
"""A box close to the ground, whose shadow is in view under each sun."""


def cast_at(height: float, degrees: float, target: tuple[float, float] = (-2.0, 0.0)) -> Box:
    """Return a box at a height whose shadow falls on a target."""
    return around(over(target, height, sun_direction(degrees)), 3.0)


@pytest.mark.nightly_cases("cl-*", "gl-*-100000.0", reason=FEWER_CASES)
@pytest.mark.parametrize("width", GROUNDS)
@pytest.mark.parametrize("degrees", SUNS)
def test_a_caster_at_any_height_shades_only_the_ground_below_it(
    drawing_device: rhi.Device, degrees: float, width: float
) -> None:
    for height in HEIGHTS:
        wrong, lit, dark = count_wrong(drawing_device, width, [NEAR, cast_at(height, degrees)], degrees)
        assert lit > 5000
        assert dark > 20
        assert wrong <= ROUNDED[width], f"{wrong} pixels are wrong with a caster at {height:g} m"


def test_casters_at_all_heights_cast_their_shadows_together(drawing_device: rhi.Device) -> None:
    boxes = [cast_at(height, 35.0, (-8.0 + 3.5 * i, 1.0)) for i, height in enumerate(HEIGHTS)]
    wrong, _, dark = count_wrong(drawing_device, 200.0, boxes, 35.0)
    assert dark > 500
    assert wrong == 0


@pytest.mark.parametrize("height", [6.0, 1e3, 1e5, 1e7])
def test_a_tower_of_any_height_casts_all_of_its_shadow(drawing_device: rhi.Device, height: float) -> None:
    """It begins on the ground, and reaches above the depth range of each map."""
    tower = np.array((-1.0, 0.0, -1.0)), np.array((0.0, height, 0.0))
    wrong, lit, dark = count_wrong(drawing_device, 200.0, [tower, NEAR], 35.0)
    assert lit > 3000
    assert dark > 20
    assert wrong == 0


@pytest.mark.nightly_cases("cl-*", "wgpu-*", reason=FEWER_CASES)
@pytest.mark.parametrize("size", [64, 4096])
def test_maps_of_any_size_show_far_casters(drawing_device: rhi.Device, size: int) -> None:
    settings = replace(SETTINGS, cascade_size=size, cascades=1)
    boxes = [NEAR, cast_at(7e4, 35.0), cast_at(1e7, 35.0, (2.0, 3.0))]
    wrong, lit, _ = count_wrong(drawing_device, 1e5, boxes, 35.0, settings)
    assert lit > 2000
    assert wrong == 0


def test_without_far_casters_each_map_draws_its_casters_once(null: rhi.Device) -> None:
    """Control: only what reaches above a map's depth range is drawn to it once more."""
    draws = []
    for height in (30.0, 7e4):
        builder = make_boxes(ground(200.0), cast_at(height, 0.0))
        builder.lights.add_directional((0, -1, 0), casts_shadow=True)
        with open_renderer(null, builder.build(), Forward(), size=SIZE) as renderer:
            renderer.shadows.settings = replace(SETTINGS, cascades=1)
            start = len(null.stream)
            renderer.render(EYE)
        draws.append(sum(command.op is rhi.Op.DRAW_INDIRECT for command in list(null.stream)[start:]))
    assert draws[1] == draws[0] + 1


@given(st.integers(0, 2**32 - 1))
def test_the_cut_part_of_triangles_is_that_inside_the_map(seed: int) -> None:
    """Areas of the parts seen by a map of 2 m × 2 m are those that random points count."""
    random = np.random.default_rng(seed)
    triangle = random.uniform(-3.0, 3.0, (1, 3, 3))
    parts = triangle
    for axis, sign in product((0, 1), (1.0, -1.0)):
        parts = cut_triangles(parts, 1.0 - sign * parts[:, :, axis])
    assert (np.abs(parts[:, :, :2]) <= 1.0 + 1e-12).all()
    normal = np.cross(triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0])[0]
    areas = np.cross(parts[:, 1] - parts[:, 0], parts[:, 2] - parts[:, 0]) @ normal
    assert (areas >= -1e-9).all(), "a part is wound the other way"
    weights = random.dirichlet((1, 1, 1), 4000)
    inside = (np.abs((weights @ triangle[0])[:, :2]) <= 1.0).all(1).mean()
    assert areas.sum() / (normal @ normal) == pytest.approx(inside, abs=0.04)


@pytest.mark.nightly_cases("cl-*", "wgpu-*", reason=FEWER_CASES)
@pytest.mark.parametrize("degrees", [0.0, 65.0])
def test_shadows_on_a_ground_of_any_width_are_right_or_its_object_is_named(
    drawing_device: rhi.Device, caplog: pytest.LogCaptureFixture, degrees: float
) -> None:
    is_named = {}
    for width in (200.0, 1e5, 1e6, 4e6, 2e7, 1e9):
        caplog.clear()
        wrong, lit, dark = count_wrong(drawing_device, width, [NEAR], degrees)
        assert lit + dark > 5000
        warnings = [record.getMessage() for record in caplog.records if record.name == "rhi.shadows"]
        is_named[width] = bool(warnings)
        assert warnings or not wrong, f"{wrong} pixels are wrong on a ground of {width:g} m, without a word"
        assert all("object 0" in warning and f"{width:.3g} m wide" in warning for warning in warnings)
        assert len(warnings) <= 1
    assert not is_named[200.0]
    assert not is_named[1e5]
    assert is_named[2e7]


def test_a_ground_is_named_once_and_not_if_it_is_divided(
    null: rhi.Device, caplog: pytest.LogCaptureFixture
) -> None:
    def count_warnings(width: float, *, casts_shadow: bool = True) -> int:
        caplog.clear()
        builder = make_boxes(ground(width), NEAR)
        builder.lights.add_directional((0, -1, 0), casts_shadow=casts_shadow)
        with open_renderer(null, builder.build(), Forward(), size=SIZE) as renderer:
            renderer.shadows.settings = SETTINGS
            for _ in range(3):
                renderer.render(EYE)
            count = len([record for record in caplog.records if record.name == "rhi.shadows"])
            assert renderer.shadows.coarse_objects == ({0} if count else set())
            return count

    assert count_warnings(2e7) == 1
    assert count_warnings(2e7, casts_shadow=False) == 0
    caplog.clear()
    assert count_warnings(1e5) == 0
