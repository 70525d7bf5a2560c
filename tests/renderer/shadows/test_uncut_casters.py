"""Huge casters that aren't cut to a map (masks, simulated meshes, height fields, meshes of many triangles) cast
right shadows of the sun, against rays in float64, or are named."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frames import open_renderer
from nightly_reasons import FEWER_CASES
from numpy.typing import NDArray
from test_far_casters import (
    EYE,
    NEAR,
    SETTINGS,
    SIZE,
    Box,
    ground,
    ground_pixels,
    lit_by_rays,
    over,
    sun_direction,
)

import rhi
from renderer.content import BUILT_IN
from renderer.scene import AlphaMode, SceneBuilder, scaling, translation
from renderer.scene.catch_up import Recompute
from renderer.scene.height_fields import HeightField
from renderer.scene.meshes import MeshGeometry, make_geometry
from renderer.techniques import Forward

KINDS = ("mask", "simulated", "many triangles")
"""The kinds of casters. A height field is a ground only."""
SIZES = (10.0, 1e3, 1e5, 1e7)
"""Of casters above the ground, in metres."""
WIDTHS = (200.0, 1e5, 1e6)
"""Of grounds, in metres; float32 rounds points of wider ones, which the renderer says."""


class StillVertices:
    """A simulation whose vertices never move."""

    def __init__(self, vertices: NDArray[Any]) -> None:
        self._vertices = vertices

    catch_up = Recompute()

    def set_time(self, members: NDArray[np.int64], seconds: float) -> None:
        """Nothing moves."""

    def vertices(self, members: NDArray[np.int64]) -> NDArray[Any]:
        """The vertices of all members, one after another."""
        return np.tile(self._vertices, len(members))


def make_fine_box(parts: int = 110) -> MeshGeometry:
    """Return a box of side 1 with more triangles than are cut."""
    steps = np.linspace(-0.5, 0.5, parts + 1)
    u, v = (values.ravel() for values in np.meshgrid(steps, steps))
    first = (np.arange(parts)[:, None] * (parts + 1) + np.arange(parts)).ravel()
    quads = np.stack(
        [first, first + 1, first + parts + 2, first, first + parts + 2, first + parts + 1], 1
    ).ravel()
    positions, indices = [], []
    for axis in range(3):
        for side in (1.0, -1.0):
            face = np.zeros((len(u), 3))
            face[:, axis], face[:, (axis + 1) % 3], face[:, (axis + 2) % 3] = 0.5 * side, side * u, v
            indices.append(quads + len(positions) * len(u))
            positions.append(face)
    return make_geometry(np.concatenate(positions), np.concatenate(indices))


class UncutScene:
    """A scene of grey boxes without ambient light, of which some aren't cut."""

    def __init__(self) -> None:
        self.builder = SceneBuilder("uncut casters")
        grey: dict[str, Any] = {"base_color": (0.8, 0.8, 0.8), "specular_color": (0, 0, 0)}
        self.grey = self.builder.add_material(**grey)
        texels = np.full((64, 64, 4), 255, np.uint8)
        texels[0, 0, 3] = 0  # far from what the view shows; without it the material is as good as opaque
        image = self.builder.add_image(texels)
        self.mask = self.builder.add_material(
            **grey, texture=image, alpha_mode=AlphaMode.MASK, alpha_cutoff=0.5
        )
        self.box = self.builder.add_mesh(BUILT_IN["box"]())
        self.builder.lights.sky = self.builder.lights.ground = (0.0, 0.0, 0.0)

    def add(self, box: Box, kind: str = "") -> None:
        """Add a box of a kind."""
        lower, upper = box
        middle, size = 0.5 * (lower + upper), upper - lower
        mesh, material = self.box, self.mask if kind == "mask" else self.grey
        if kind == "many triangles":
            mesh = self.builder.add_mesh(make_fine_box())
        geometry = BUILT_IN["box"]()
        if kind == "simulated":
            corner = np.full(3, 0.5)
            mesh = self.builder.add_mesh(geometry, bounds=(-corner, corner))
        if kind == "height field":
            lengths = float(size[0]), float(size[2])
            field = HeightField(np.zeros((65, 65), np.float32), lengths, 1 << 12)
            mesh = self.builder.add_height_field(field)
            middle, size = np.zeros(3), np.ones(3)
        node = self.builder.add_node(translation(tuple(middle)) @ scaling(tuple(size)))
        rows = self.builder.add_objects(node, mesh, material)
        if kind == "simulated":
            self.builder.simulate(rows, StillVertices(geometry.vertices))

    def count_wrong(self, device: rhi.Device, degrees: float, boxes: list[Box]) -> tuple[int, int, int]:
        """Return the numbers of sure pixels of the ground that are wrong, that should be lit, and that should be
        dark."""
        down = sun_direction(degrees)
        self.builder.lights.add_directional(tuple(down), casts_shadow=True, intensity=1.0 / -down[1])
        with open_renderer(device, self.builder.build(), Forward(), size=SIZE) as renderer:
            renderer.shadows.settings = SETTINGS
            image = renderer.render(EYE).image.read()[..., 0]
        shows, points = ground_pixels(boxes)
        lit, sure = (part.reshape(shows.shape) for part in lit_by_rays(points, down, boxes, SETTINGS))
        compared = shows & sure
        wrong = ((image > 90) != lit)[compared].sum()
        return int(wrong), int((lit & compared).sum()), int((~lit & compared).sum())


def slab(size: float, degrees: float) -> Box:
    """Return a slab as high above the ground as it is wide, the shadow of whose edge crosses the view."""
    edge = over((-2.0, 0.0), size, sun_direction(degrees))
    return edge - np.array((size, 0.0, size)), edge + np.array((0.0, 0.1, size))


@pytest.mark.nightly_cases("wgpu-*", "cl-*", "gl-*-simulated-*", reason=FEWER_CASES)
@pytest.mark.parametrize("degrees", [0.0, 35.0, 65.0])
@pytest.mark.parametrize("kind", KINDS)
def test_a_huge_caster_of_any_kind_shades_only_the_ground_below_it(
    drawing_device: rhi.Device, caplog: pytest.LogCaptureFixture, kind: str, degrees: float
) -> None:
    for size in SIZES:
        caplog.clear()
        scene, caster = UncutScene(), slab(size, degrees)
        scene.add(ground(200.0))
        scene.add(NEAR)
        scene.add(caster, kind)
        wrong, lit, dark = scene.count_wrong(drawing_device, degrees, [NEAR, caster])
        assert lit > 1000
        assert dark > 1000
        is_named = any("object 2 " in record.getMessage() for record in caplog.records)
        assert is_named or wrong == 0, f"{wrong} pixels are wrong below a slab of {size:g} m, without a word"
        assert is_named == (size == 1e7)


@pytest.mark.nightly_cases("wgpu-*", "cl-*", "gl-*-simulated-*", reason=FEWER_CASES)
@pytest.mark.parametrize("degrees", [0.0, 65.0])
@pytest.mark.parametrize("kind", [*KINDS, "height field"])
def test_a_huge_ground_of_any_kind_does_not_shade_itself(
    drawing_device: rhi.Device, kind: str, degrees: float
) -> None:
    for width in WIDTHS:
        scene = UncutScene()
        scene.add(ground(width), kind)
        scene.add(NEAR)
        wrong, lit, _ = scene.count_wrong(drawing_device, degrees, [NEAR])
        assert lit > 5000
        assert wrong == 0, f"{wrong} pixels are wrong on a ground of {width:g} m"
