"""Height fields in frames: every technique, algorithm, shadow map and eye draws the triangles that were
chosen."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from bisection_reference import list_cameras, make_hills
from frames import open_renderer as open_any

import rhi
from renderer.content import load_scene
from renderer.content.gltf import write_gltf
from renderer.renderer import Renderer
from renderer.scene import Camera, HeightField, Scene, SceneBuilder, StereoRig, scaling
from renderer.stereo import Stereo
from renderer.techniques import TECHNIQUES
from renderer.tessellation import TessellationSettings

CAMERAS = list_cameras()
FIRST, SECOND = CAMERAS["random 0"], CAMERAS["random 5"]
open_renderer = partial(open_any, size=(64, 32), visibility="frustum")


def make_scene(
    field: HeightField, *, is_field: bool = True, light: bool = False, mirrored: bool = False
) -> Scene:
    """Make a scene of a height field or of its mesh, and a box on it."""
    builder = SceneBuilder("hills")
    mesh = builder.add_height_field(field) if is_field else builder.add_mesh(field.make_mesh())
    turned = scaling((-1.0, 1.0, 1.0)) if mirrored else np.eye(4)
    builder.add_objects(builder.add_node(turned), mesh, builder.add_material(base_color=(0.3, 0.5, 0.2)))
    if light:
        builder.lights.add_point((0.0, 60.0, 0.0), 200.0)
        builder.lights.cast_shadows()
    else:
        builder.lights.add_directional((0.0, -0.8, -0.5))
    return builder.build()


@pytest.fixture(scope="module")
def images(device: rhi.Device) -> dict[str, np.ndarray]:
    """Images of a field all of whose triangles are chosen, of its mirror image, and of the mesh of all of
    them."""
    results = {}
    for name, is_field, mirrored in (
        ("field", True, False),
        ("mesh", False, False),
        ("mirrored", True, True),
    ):
        scene = make_scene(make_hills(), is_field=is_field, mirrored=mirrored)
        with open_renderer(device, scene) as renderer:
            renderer.tessellator.settings = TessellationSettings(0.01)
            result = renderer.render(FIRST if not mirrored else _mirror(FIRST))
            results[name] = result.image.read().astype(int)
            results[f"{name} count"] = np.array(result.statistics.triangles)
    return results


def _mirror(camera: Camera) -> Camera:
    """Return the camera that sees a mirrored world as a mirror image."""
    turn = np.array([-1.0, 1.0, 1.0])
    rotation = camera.rotation * turn
    rotation[0] *= -1.0
    return Camera(camera.position * turn, rotation, camera.projection)


def test_all_triangles_of_a_field_make_the_image_of_its_mesh(images: dict[str, np.ndarray]) -> None:
    assert images["mesh"][..., 1].std() > 20.0
    assert np.abs(images["field"] - images["mesh"]).max() <= 1
    assert 1000 < images["field count"] <= images["mesh count"] == 2 * 32 * 32


def test_a_mirrored_field_is_the_mirror_image(images: dict[str, np.ndarray]) -> None:
    assert images["mirrored count"] == images["field count"]
    away = np.abs(images["mirrored"][:, ::-1] - images["field"]).max(-1)
    assert (away > 2).mean() < 0.01  # where an edge passes exactly through a pixel's centre


def record(null: rhi.Device, renderer: Renderer, camera: Camera) -> list[tuple[bool, rhi.Op]]:
    """Return the operation of each command of a frame, and whether it chooses triangles."""
    null.stream.clear()
    renderer.render(camera)
    return [("tessellation" in command.labels, command.op) for command in null.stream]


@pytest.mark.parametrize("technique", TECHNIQUES)
def test_each_technique_chooses_triangles_once_before_all_else(null: rhi.Device, technique: str) -> None:
    field = make_hills(8)
    scene = make_scene(field)
    with open_renderer(null, scene, TECHNIQUES[technique]()) as renderer:
        for camera in (FIRST, SECOND):
            commands = record(null, renderer, camera)
            dispatches = [number for number, entry in enumerate(commands) if entry == (True, rhi.Op.DISPATCH)]
            assert len(dispatches) == field.levels + 2
            draws = [number for number, (_, op) in enumerate(commands) if op is rhi.Op.DRAW_INDIRECT]
            assert max(dispatches) < min(draws)
            buffers = [command["buffer"] for command in null.stream.filter(rhi.Op.DRAW_INDIRECT)]
            assert renderer.resources.tessellated_draws.owner.id in buffers
            if technique in ("forward", "deferred"):  # which have no other indirect draws
                assert set(buffers) == {renderer.resources.tessellated_draws.owner.id}


def test_two_eyes_share_triangles(null: rhi.Device) -> None:
    with open_renderer(null, make_scene(make_hills(8))) as renderer:
        renderer.stereo = Stereo(StereoRig())
        commands = record(null, renderer, FIRST)
    assert commands.count((True, rhi.Op.DISPATCH)) == 6 + 2


@pytest.mark.parametrize("is_field", [True, False])
def test_a_light_s_shadow_map_is_drawn_again_with_other_triangles(null: rhi.Device, is_field: bool) -> None:
    scene = make_scene(make_hills(8), is_field=is_field, light=True)
    with open_renderer(null, scene) as renderer:
        drawn = []
        for camera in (FIRST, FIRST, replace(FIRST, position=FIRST.position + 0.01)):
            record(null, renderer, camera)
            drawn.append(any(report.state == "drawn" for report in renderer.shadows.reports))
    assert drawn == [True, False, is_field]


def test_a_field_is_saved_as_a_mesh_of_equal_triangles(tmp_path: Path) -> None:
    field = make_hills(8, limit=64)
    write_gltf(make_scene(field), tmp_path / "hills.glb")
    read = load_scene(str(tmp_path / "hills.glb"))
    assert read.triangle_count == 64
    assert not read.tessellated
