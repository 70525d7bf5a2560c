"""The scene with many materials: its counts, its materials, and how much of it walls hide."""

import numpy as np
import pytest

import rhi
from renderer.content import load_scene
from renderer.content.surfaces import KINDS, paint_surface
from renderer.lab.measure.exact_visibility import ExactVisibility
from renderer.scene import ShadingModel

SMALL = "bazaar:instances=700,materials=40,meshes=12,lights=16,detail=4"


@pytest.fixture(scope="module")
def small():
    return load_scene(SMALL)


def test_it_has_as_many_instances_materials_and_meshes_as_asked_for(small):
    things = small.objects.mesh[np.char.startswith(np.array(small.meshes.names)[small.objects.mesh], "thing")]
    assert len(small.objects) == 700 + 16
    assert len(np.unique(things)) == 12
    metals = small.materials["model"] == ShadingModel.METALLIC_ROUGHNESS
    assert metals.sum() == 40
    assert set(np.flatnonzero(metals)) <= set(small.objects.material.tolist())
    assert len(small.lights.point) == 16


def test_each_material_has_three_textures_of_its_own_surface(small):
    metals = small.materials[small.materials["model"] == ShadingModel.METALLIC_ROUGHNESS]
    names = ("texture", "normal_texture", "metallic_roughness_texture")
    images = np.stack([small.textures["image"][metals[name]] for name in names], axis=1)
    assert (np.diff(images, axis=1) == 1).all()
    assert (images[:, 0] % 3 == 0).all()
    assert small.textures["is_color"][metals["texture"]].all()
    assert not small.textures["is_color"][metals["normal_texture"]].any()


def test_its_lights_are_as_large_as_their_bulbs_if_they_have_a_radius(small):
    spheres = load_scene(f"{SMALL},seed=0,radius=0.25")
    assert spheres.name == f"{small.name},radius=0.25"
    assert not small.lights.point["source_radius"].any()
    assert (spheres.lights.point["source_radius"] == 0.25).all()
    size = (spheres.objects.upper - spheres.objects.lower)[
        spheres.objects.mesh == spheres.meshes.names.index("bulb")
    ]
    assert np.allclose(size[:, 1], 0.5, atol=0.01)


def test_a_share_of_its_lights_goes_around_with_their_bulbs(small):
    scene = load_scene(f"{SMALL},seed=0,radius=0.25,moving=0.25")
    assert scene.name == f"{small.name},radius=0.25,moving=0.25"
    bulbs = np.flatnonzero(scene.objects.mesh == scene.meshes.names.index("bulb"))
    positions = []
    for seconds in (0.0, 1.0, 2.5):
        scene.update(seconds)
        lights = scene.lights.point["position"].astype(np.float64)
        middles = scene.nodes.world[scene.objects.node[bulbs]][:, :3, 3]
        np.testing.assert_allclose(middles, lights, atol=1e-5)
        positions.append(lights)
    moved = np.linalg.norm(positions[1] - positions[0], axis=1) > 0.1
    assert moved.tolist() == [True] * 4 + [False] * 12
    still = small.lights.point["position"]
    np.testing.assert_allclose(np.linalg.norm(positions[2][:4] - still[:4], axis=1), 0.6, atol=1e-5)
    np.testing.assert_array_equal(positions[2][4:], still[4:].astype(np.float64))
    assert scene.check_bounds([0.5, 4.0, 20.0]) is None


def test_few_instances_are_all_floors_and_walls():
    assert len(load_scene("bazaar:instances=16,materials=1,meshes=1,lights=0,detail=4").objects) == 16


def test_a_seed_gives_the_same_scene_and_another_one_another():
    first, same, other = (load_scene(f"{SMALL},seed={seed}") for seed in (1, 1, 2))
    assert (first.nodes.local == same.nodes.local).all()
    assert (first.meshes.vertices == same.meshes.vertices).all()
    assert first.materials.tobytes() == same.materials.tobytes() != other.materials.tobytes()
    assert not np.array_equal(first.nodes.local, other.nodes.local)


def test_all_of_it_is_in_the_view_and_walls_hide_most(small):
    planes = small.views["corner"].with_aspect(16 / 9).frustum.planes
    middle = 0.5 * (small.objects.lower + small.objects.upper)
    assert (middle @ planes[:, :3].T + planes[:, 3] > -1.0).all()
    with rhi.create_device("gl") as device:
        exact = ExactVisibility(device, small, (320, 180))
        share = len(exact.visible_objects(small.views["corner"])) / len(small.objects)
        exact.destroy()
    assert 0.1 < share < 0.5


@pytest.mark.parametrize("kind", KINDS)
def test_a_surface_repeats_without_a_seam(kind):
    surface = paint_surface(kind, 64, 3)
    for image in (surface.color, surface.normal, surface.metal_roughness):
        pixels = image[..., :3].astype(int)
        for axis in (0, 1):
            inside = np.abs(np.diff(pixels, axis=axis)).mean(axis=(1 - axis, 2))
            seam = np.abs(np.take(pixels, 0, axis) - np.take(pixels, -1, axis)).mean()
            assert seam <= inside.max() + 1.0


def test_normals_of_a_surface_lean_downhill():
    surface = paint_surface("studs", 96, 0)
    normals = surface.normal[..., :3] / 127.5 - 1.0
    assert np.linalg.norm(normals, axis=-1) == pytest.approx(1.0, abs=0.02)
    stud = normals[:16, :16]  # one of six by six, highest in its middle
    assert stud[8, :7, 0].mean() < -0.1 < 0.1 < stud[8, 9:, 0].mean()  # left leans left
    assert stud[9:, 8, 1].mean() < -0.1 < 0.1 < stud[:7, 8, 1].mean()  # the lower rows lean down: green is up
