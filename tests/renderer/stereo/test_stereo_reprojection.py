"""The right eye's image made from the left one's: where pixels move to, and the holes that they leave."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np
import pytest
from frames import open_renderer as open_any
from nightly_reasons import ONLY_KERNELS

import rhi
from renderer import scene as scenes
from renderer.content import load_scene
from renderer.content.shapes import box
from renderer.renderer import FrameResult, Renderer
from renderer.scene import (
    Camera,
    Depth,
    Orthographic,
    Perspective,
    Projection,
    Scene,
    StereoRig,
    scaling,
    translation,
)
from renderer.stereo import Stereo, read_hole_mask
from rhi import Op
from rhi.math import multiply

SIZE: Final = (96, 54)
open_renderer = partial(open_any, size=SIZE, visibility="frustum")
NEAR, FAR = 3.0, 27.0
# With this projection, P00 · width / 2 is 27 pixels: a wall moves by +2, the box before it by -6.
PROJECTION: Final = Perspective(np.pi / 2, SIZE[0] / SIZE[1])
RIG: Final = StereoRig(1.0, 9.0)


@pytest.fixture(scope="module")
def wall() -> Scene:
    """A box before a wall of many colours, both seen from the front, in light that has no direction."""
    builder = scenes.SceneBuilder("wall")
    mesh = builder.add_mesh(box())
    rng = np.random.default_rng(1)
    columns, rows = np.meshgrid(np.arange(-60, 61, 4), np.arange(-32, 33, 4))
    tiles = np.stack([columns.ravel(), rows.ravel(), np.full(columns.size, -FAR - 2.0)], axis=1)
    positions = np.concatenate([tiles, [(0.0, 0.0, -NEAR - 0.5)]])
    sizes = np.where(np.arange(len(positions)) < len(tiles), 4.0, 1.0)[:, None] * np.ones(3)
    nodes = builder.add_nodes(multiply(translation(positions), scaling(sizes)))
    colors = rng.uniform(0.1, 1.0, (len(positions), 4))
    materials = [builder.add_material(base_color=tuple(color), specular_color=(0, 0, 0)) for color in colors]
    builder.add_objects(nodes, mesh, materials)
    return builder.build()


def look(projection: Projection = PROJECTION) -> Camera:
    return Camera.look_at((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), projection=projection)


def draw(renderer: Renderer, camera: Camera, rig: StereoRig, *, moved: bool) -> tuple[FrameResult, Any, Any]:
    """Return the result and the images of both eyes."""
    renderer.stereo = Stereo(rig, "color", is_reprojected=moved)
    result = renderer.render(camera)
    left, right = (image.read() for image in result.eye_images)
    return result, left, right


@pytest.mark.parametrize("depth", list(Depth))
def test_pixels_move_by_the_parallax_of_their_depth(
    drawing_device: rhi.Device, wall: Scene, depth: Depth
) -> None:
    camera = look(Perspective(PROJECTION.fov, PROJECTION.aspect, depth=depth))
    with open_renderer(drawing_device, wall) as renderer:
        _, left, drawn = draw(renderer, camera, RIG, moved=False)
        result, same, moved = draw(renderer, camera, RIG, moved=True)
        holes = read_hole_mask(result.frames[1])
    assert np.array_equal(same, left), "the left eye is drawn as before"
    assert np.array_equal(moved[~holes], drawn[~holes])
    # The box is 9 pixels high and wide: 27 / 3. Beside it the eye sees 8 pixels of the wall, P00 · e · (1/z1
    # - 1/z2).
    wide = holes.sum(axis=1)
    assert sorted(set(wide.tolist())) == [2, 10], "2 at the left edge, where the wall moves away from it"
    assert (wide == 10).sum() == 9
    middle = np.flatnonzero(holes[27])
    assert middle[:2].tolist() == [0, 1]
    assert np.diff(middle[2:]).tolist() == [1] * 7
    # Holes show the wall: the pixel to their right.
    assert np.array_equal(moved[27, middle[2:]], np.repeat(drawn[27, middle[-1] + 1][None], 8, axis=0))


def test_eyes_without_a_distance_move_nothing(drawing_device: rhi.Device, wall: Scene) -> None:
    with open_renderer(drawing_device, wall) as renderer:
        result, left, right = draw(renderer, look(), StereoRig(0.0, 9.0), moved=True)
        assert np.array_equal(left, right)
        assert not read_hole_mask(result.frames[1]).any()
        assert np.array_equal(result.image.read(), left)


def test_all_converges_where_the_wall_is(drawing_device: rhi.Device, wall: Scene) -> None:
    with open_renderer(drawing_device, wall) as renderer:
        for convergence, edge in ((FAR, []), (FAR * 0.9, [0]), (FAR * 1.1, [95])):
            result, left, right = draw(renderer, look(), StereoRig(6.0, convergence), moved=True)
            holes = np.flatnonzero(read_hole_mask(result.frames[1])[0]).tolist()
            assert holes == edge, "to the left of what moves to the right, and the other way round"
            if not edge:
                assert np.array_equal(left[0], right[0])


PROJECTIONS: Final = {
    "parallel": (Orthographic(20.0, near=0.5, far=100.0), StereoRig(1.0, 9.0)),
    "parallel, standard depth": (
        Orthographic(20.0, near=0.5, far=100.0, depth=Depth.STANDARD),
        StereoRig(1.0, 9.0),
    ),
    "with an end": (Perspective(PROJECTION.fov, near=0.5, far=60.0), RIG),
}


@pytest.mark.parametrize("name", PROJECTIONS)
def test_each_projection_shifts_pixels(drawing_device: rhi.Device, wall: Scene, name: str) -> None:
    projection, rig = PROJECTIONS[name]
    with open_renderer(drawing_device, wall) as renderer:
        _, left, drawn = draw(renderer, look(projection), rig, moved=False)
        result, _, moved = draw(renderer, look(projection), rig, moved=True)
        seen = ~read_hole_mask(result.frames[1])
    errors = np.abs(moved.astype(int) - drawn)[..., :3].max(axis=2)
    unmoved = np.abs(left.astype(int) - drawn)[..., :3].max(axis=2)
    # A pixel moves by whole pixels: at most half a pixel off, at the seams of tiles that are wider than that.
    assert (errors[seen] > 2).mean() < 0.35
    assert (errors[seen] > 2).mean() < 0.7 * (unmoved[seen] > 2).mean()


class Looker:
    """A layer that keeps the depth of each eye."""

    def __init__(self) -> None:
        self.depths: list[Any] = []

    def render(self, device: rhi.Device, frame: Any) -> None:
        self.depths.append(frame.targets.depth.read())

    def destroy(self) -> None:
        pass


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_layers_find_the_depth_of_moved_pixels(drawing_device: rhi.Device, wall: Scene) -> None:
    looker = Looker()
    with open_renderer(drawing_device, wall) as renderer:
        renderer.layers.append(looker)
        draw(renderer, look(), RIG, moved=False)
        result, _, _ = draw(renderer, look(), RIG, moved=True)
        seen = ~read_hole_mask(result.frames[1])
    left, right, same, moved = looker.depths
    assert np.array_equal(left, same)
    assert np.abs(moved - right)[seen].max() < 1e-6
    assert len(np.unique(moved.round(4))) >= 2


def test_images_and_depth_are_the_same_where_rows_of_copies_are_aligned(
    drawing_device: rhi.Device, wall: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on wgpu: rows of 96 pixels are then 128 apart in buffers."""
    results = []
    for alignment in (drawing_device.capabilities.copy_row_alignment, 256):
        limits = replace(drawing_device.capabilities, copy_row_alignment=alignment)
        monkeypatch.setattr(drawing_device._core, "capabilities", limits)
        with open_renderer(drawing_device, wall) as renderer:
            renderer.layers.append(looker := Looker())
            result, _, moved = draw(renderer, look(), RIG, moved=True)
            results.append((moved, looker.depths[1], read_hole_mask(result.frames[1]), result.image.read()))
    assert results[0][2].any()
    for tight, aligned in zip(*results, strict=True):
        assert np.array_equal(tight, aligned)


def test_only_the_left_eye_draws_the_scene(null: rhi.Device) -> None:
    scene = load_scene("city:blocks=6")
    draws, passes = [], []
    for moved in (False, True):
        with open_renderer(null, scene) as renderer:
            renderer.stereo = Stereo(RIG, "color", is_reprojected=moved)
            before = len(null.stream)
            draws.append(renderer.render(scene.paths["ground"].camera(600)).statistics.draws)
            passes.append(len(null.stream[before:].filter(Op.BEGIN_PASS)))
    assert draws[0] == 2 * draws[1] > 0
    assert passes == [2, 1], "without layers, no depth is made either"


def test_lights_are_not_positioned_for_an_eye_that_draws_nothing(null: rhi.Device) -> None:
    scene = load_scene("grid:count=9,lights=16")
    camera, placed = next(iter(scene.views.values())), []
    for moved in (False, True):
        with open_renderer(null, scene) as renderer:
            renderer.stereo = Stereo(RIG, "color", is_reprojected=moved)
            renderer.render(camera)
            aside = replace(camera, position=np.add(camera.position, (0.1, 0.0, 0.0)))
            null.stream.clear()
            renderer.render(aside)
            placed.append(sum("positions" in command.bindings for command in null.stream.filter(Op.DISPATCH)))
    assert placed == [1, 0]


def test_eyes_that_are_toed_in_are_refused() -> None:
    assert Stereo(StereoRig(1.0, 9.0), is_reprojected=True).is_reprojected
    with pytest.raises(rhi.ValidationError, match=r"^\[stereo-bad-value\]"):
        Stereo(StereoRig(1.0, 9.0, is_toed_in=True), is_reprojected=True)
