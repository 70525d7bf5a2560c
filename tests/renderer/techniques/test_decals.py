"""Decals: the same in all techniques, nothing where there are none, and found by pixels however many there are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from frames import open_renderer
from hypothesis import given
from hypothesis import strategies as st
from nightly_reasons import ONLY_KERNELS
from numpy.typing import NDArray

import rhi
from renderer.content import BUILT_IN, load_scene, save_scene
from renderer.content.material_shaders import Marble
from renderer.frame.decals import list_cells
from renderer.frame.pixel_rays import compute_pixel_rays
from renderer.scene import AlphaMode, Camera, Perspective, Scene, SceneBuilder, scaling, translation
from renderer.shaders.decals import step_along_plane
from renderer.techniques import TECHNIQUES
from rhi.math import rotation
from rhi.shading import evaluate

SIZE = (96, 64)
EYE = Camera.look_at((0.0, 1.6, 2.2), (0.0, 0.2, 0.0), projection=Perspective(0.9, 1.5))
DOWN = rotation((1, 0, 0), -np.pi / 2)  # whose z axis is the world's y
EXACT = sorted(set(TECHNIQUES) - {"inferred"})  # which shades pixels by the light of their neighbours
Image = NDArray[np.int64]


def checks(size: int) -> NDArray[np.uint8]:
    rows, columns = np.indices((size, size)) * 4 // size
    image = np.full((size, size, 4), 255, np.uint8)
    image[..., :3] = np.where(((rows + columns) % 2)[..., None], (230, 60, 40), (40, 90, 220))
    return image


def make_scene(*, strength: float = 1.0, material: dict[str, Any] | None = None, sizes: int = 1) -> Scene:
    """A ball and a box on a floor, with a decal on all of them and one on the box, of images of as many sizes."""
    builder = SceneBuilder("decals")
    box, ball = (builder.add_mesh(BUILT_IN[name]()) for name in ("box", "sphere"))
    grey = builder.add_material(base_color=(0.6, 0.58, 0.55))
    other = builder.add_material(
        **(material or {"base_color": (0.0, 0.0, 0.1), "metallic": 0.2, "roughness": 0.6})
    )
    builder.add_objects(builder.add_node(translation((0, -0.5, 0)) @ scaling((9, 1, 9))), box, grey)
    builder.add_objects(builder.add_node(translation((0.6, 0.4, 0)) @ scaling((0.8, 0.8, 0.8))), ball, other)
    car = builder.add_node(translation((-0.6, 0.3, 0)), dynamic=True)
    builder.add_objects(builder.add_node(scaling((0.6, 0.6, 0.6)), car), box, grey)
    images = [builder.add_image(checks(16 + 4 * number)) for number in range(sizes)]
    for image in images[1:]:
        builder.add_material(texture=image)
    builder.add_decal(
        builder.add_node(translation((0, 0.4, 0)) @ DOWN), images[0], (2.0, 1.5, 1.0), strength=strength
    )
    front = builder.add_node(translation((0, 0, 0.3)), car)
    arguments: dict[str, Any] = {"color": (1.0, 1.0, 0.3), "strength": 0.8 * strength, "order": 1}
    builder.add_decal(front, images[-1], (0.4, 0.4, 0.2), **arguments)
    builder.lights.add_directional((0.6, -0.7, -0.45))
    builder.lights.add_point((0.0, 1.5, 1.0), 6.0, (3.0, 3.0, 3.0))
    builder.lights.sky = builder.lights.ground = (0.3, 0.3, 0.3)
    return builder.build()


def draw(device: rhi.Device, scene: Scene, technique: str = "forward", camera: Camera = EYE) -> Image:
    with open_renderer(device, scene, TECHNIQUES[technique](), visibility="none", size=SIZE) as renderer:
        return np.asarray(renderer.render(camera).image.read()[..., :3], np.int64)


@pytest.mark.nightly_cases("cl-*", "wgpu-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize(
    ("material", "sizes"), [(None, 1), ({"shader": Marble, "frequency": 3.0}, 1), (None, 11)], ids=str
)
def test_techniques_agree_about_decals(
    drawing_device: rhi.Device, material: dict[str, Any] | None, sizes: int
) -> None:
    """Within two levels, of materials' own shaders and of images in a table as well; what they agree about isn't the
    scene without decals."""
    images = [draw(drawing_device, make_scene(material=material, sizes=sizes), name) for name in EXACT]
    without = draw(drawing_device, make_scene(strength=0.0, material=material, sizes=sizes))
    assert (np.abs(images[0] - without).max(axis=2) > 30).mean() > 0.15
    assert [
        name for name, image in zip(EXACT, images, strict=True) if np.abs(image - images[0]).max() > 2
    ] == []


def record(null: rhi.Device, scene: Scene, camera: Camera) -> list[str]:
    with open_renderer(null, scene, TECHNIQUES["deferred"](), visibility="none", size=SIZE) as renderer:
        renderer.render(camera)
        null.stream.clear()
        renderer.render(camera)
        return [command.op.name for command in null.stream]


def test_decals_out_of_view_and_of_no_strength_add_no_command(null: rhi.Device) -> None:
    away = Camera.look_at((3.0, 1.0, 3.0), (4.2, 0.0, 4.2), projection=Perspective(0.9, 1.5))
    scene = make_scene()
    with open_renderer(null, scene, TECHNIQUES["deferred"](), visibility="none", size=SIZE) as renderer:
        names = []
        for camera in (EYE, away):
            renderer.render(camera)
            assert renderer._effects is not None
            names.append({effect.name for effect in renderer._effects.enabled})
        scene.decals.array["strength"] = 0.0
        renderer.render(EYE)
        names.append({effect.name for effect in renderer._effects.enabled})
    assert ["DECALS" in enabled for enabled in names] == [True, False, False]
    assert record(null, make_scene(), EYE) != record(null, make_scene(strength=0.0), EYE)
    assert record(null, make_scene(), away) == record(null, make_scene(strength=0.0), away)


def test_decals_need_no_pass_and_no_draw_of_their_own(null: rhi.Device) -> None:
    with_decals, without = (record(null, make_scene(strength=strength), EYE) for strength in (1.0, 0.0))
    for name in ("BEGIN_PASS", "DRAW_INDIRECT", "DRAW", "DRAW_MANY"):
        assert with_decals.count(name) == without.count(name)


@pytest.mark.nightly_cases("cl", "wgpu", reason=ONLY_KERNELS)
def test_a_decal_moves_with_its_node_and_the_others_stay(drawing_device: rhi.Device) -> None:
    scene, moved = make_scene(), make_scene()
    with open_renderer(
        drawing_device, scene, TECHNIQUES["forward"](), visibility="none", size=SIZE
    ) as renderer:
        before = np.asarray(renderer.render(EYE).image.read(), np.int64)
        for built in (scene, moved):
            (car,) = np.flatnonzero(built.nodes.dynamic & (built.nodes.parents < 0)).tolist()
            built.nodes.set_local(car, translation((-0.6, 0.3, 0.5)))
        after = np.asarray(renderer.render(EYE).image.read(), np.int64)
    moved.refresh()
    assert np.array_equal(after[..., :3], draw(drawing_device, moved))
    assert np.abs(after - before).max() > 50
    assert np.array_equal(moved.decals.centers[0], make_scene().decals.centers[0])
    assert np.allclose(moved.decals.centers[1] - make_scene().decals.centers[1], (0.0, 0.0, 0.5))


@pytest.mark.nightly_cases("cl", "wgpu", reason=ONLY_KERNELS)
def test_transparent_surfaces_have_no_decals(drawing_device: rhi.Device) -> None:
    glass = {"base_color": (0.2, 0.9, 0.3, 0.999), "alpha_mode": AlphaMode.BLEND, "specular_color": (0, 0, 0)}
    on, off = (draw(drawing_device, make_scene(strength=s, material=glass)) for s in (1.0, 0.0))
    ball = (slice(22, 30), slice(62, 70))  # its top, on which the decal lies
    assert np.abs(on[ball] - off[ball]).max() <= 1
    opaque = {**glass, "alpha_mode": AlphaMode.OPAQUE}
    assert np.abs(draw(drawing_device, make_scene(material=opaque))[ball] - off[ball]).max() > 50


boxes = st.lists(
    st.tuples(*[st.floats(-100.0, 100.0)] * 3, *[st.floats(1e-3, 50.0)] * 3), min_size=1, max_size=40
)


@given(boxes=boxes, offset=st.sampled_from((0.0, 1e5)), seed=st.integers(0, 9))
def test_each_point_of_a_box_is_in_a_cell_that_lists_it(boxes: list[Any], offset: float, seed: int) -> None:
    values = np.array(boxes)
    lower, upper = values[:, :3] + offset, values[:, :3] + offset + values[:, 3:]
    corner, density, counts, table = list_cells(lower, upper)
    random = np.random.default_rng(seed)
    for number in range(len(lower)):
        points = lower[number] + random.uniform(1e-6, 1.0 - 1e-6, (4, 3)) * (upper - lower)[number]
        for x, y, z in np.floor((points - corner) * density).astype(int).tolist():
            cell = (z * counts[1] + y) * counts[0] + x
            listed = table[table[cell] : table[cell + 1]].tolist()
            assert number in listed
            assert listed == sorted(set(listed))
    assert len(table) <= 1 + counts.prod() + 64 * len(lower)


def test_a_pixel_looks_at_few_of_hundreds_of_decals_in_a_hall() -> None:
    lower = np.random.default_rng(3).uniform(0.0, (60.0, 5.0, 40.0), (800, 3))
    _, _, counts, table = list_cells(lower, lower + 0.8)
    begins = table[: counts.prod() + 1].astype(np.int64)
    assert np.diff(begins).mean() < 6.0
    assert np.diff(begins).max() < 25


@given(
    pixel=st.tuples(st.floats(5.0, 90.0), st.floats(5.0, 60.0)),
    normal=st.tuples(st.floats(-0.7, 0.7), st.floats(-0.7, 0.7)),
    axis=st.sampled_from(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))),
)
def test_steps_to_the_next_pixel_are_those_of_rays_through_a_plane(
    pixel: tuple[float, float], normal: tuple[float, float], axis: tuple[float, float, float]
) -> None:
    """Against differences of intersections in float64: first order, to a ten thousandth of a pixel."""
    camera, plane = Camera((0, 0, 0), np.eye(3), Perspective(0.9, 1.5)), np.array([*normal, 1.0])
    plane /= np.linalg.norm(plane)

    def meet(x: float, y: float) -> NDArray[np.float64]:
        ray = np.array(((2 * x / SIZE[0] - 1) * 1.5, 1 - 2 * y / SIZE[1], -1 / np.tan(0.45))) * np.tan(0.45)
        return np.asarray(ray * (-4.0 / (ray @ plane)))

    h = 1e-4
    expected = (meet(pixel[0] + h * axis[0], pixel[1] + h * axis[1]) - meet(*pixel)) / h
    position = meet(*pixel)
    to_eye = -position / np.linalg.norm(position)
    if to_eye @ plane < 0.1:
        return
    step = evaluate(
        step_along_plane, compute_pixel_rays(camera, SIZE), position, plane, to_eye, np.array(axis)
    )
    assert np.abs(np.asarray(step) - expected).max() < 2e-3 * np.abs(expected).max()


BOUNDS = {
    "size": ((0.0, 1.0, 1e6), (-1e-9, 1.0, 1.0), (1.0, 1.0, 1.1e6)),
    "color": ((0.0, 1.0, 0.5), (0.0, 1.01, 0.5), (-0.1, 0.0, 0.0), (1.0, 1.0)),
    "strength": (1.0, 1.01, -0.01, float("nan")),
    "outer_angle": (np.pi, 3.2, 0.9),
    "inner_angle": (0.0, -0.1, 1.5),
}


@pytest.mark.parametrize("name", BOUNDS)
def test_values_out_of_range_are_refused(name: str) -> None:
    builder = SceneBuilder("one")
    node, image = builder.add_node(), builder.add_image(checks(8))
    good, *bad = BOUNDS[name]
    arguments: dict[str, Any] = {name: good}
    builder.add_decal(node, image, **arguments)
    for value in bad:
        arguments = {name: value}
        with pytest.raises(rhi.ValidationError) as error:
            builder.add_decal(node, image, **arguments)
        assert error.value.rule.id == "scene-bad-decal"


def test_images_of_high_range_unknown_nodes_and_values_written_later_are_refused(null: rhi.Device) -> None:
    builder = SceneBuilder("one")
    bright = builder.add_image(np.full((4, 4, 3), 2.0, np.float16))
    node = builder.add_node()
    for arguments, rule in (
        ((node, bright), "scene-bad-decal"),
        ((7, bright), "scene-bad-index"),
        ((0, 9), "scene-bad-index"),
    ):
        with pytest.raises(rhi.ValidationError) as error:
            builder.add_decal(*arguments)
        assert error.value.rule.id == rule
    scene = make_scene()
    scene.decals.array["strength"][0] = 2.0
    with pytest.raises(rhi.ValidationError) as error:
        draw(null, scene)
    assert error.value.rule.id == "scene-bad-decal"


def test_files_of_scenes_say_that_they_lack_decals(tmp_path: Path) -> None:
    omissions = [omission.what for omission in save_scene(make_scene(), tmp_path / "scene.glb")]
    assert "decals" in omissions
    assert not len(load_scene(str(tmp_path / "scene.glb")).decals)
