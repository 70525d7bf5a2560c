"""Scenes are written as glTF and read back the same."""

import json

import numpy as np
import pytest
from gltf_documents import TRIANGLE, GltfDocument

from renderer import scene as scenes
from renderer.content import load_model, load_scene, save_scene
from renderer.scene import (
    AlphaMode,
    Camera,
    Scene,
    SceneBuilder,
    TextureMap,
    make_geometry,
    rotation,
    translation,
)
from rhi import Filter, SamplerDescriptor, Wrap
from rhi.errors import ValidationError

COLUMNS = {
    "nodes": ("parents", "local", "world", "dynamic"),
    "objects": (
        "node",
        "mesh",
        "material",
        "lower",
        "upper",
        "dynamic",
        "is_shown",
        "casts_shadow",
        "simulated",
    ),
    "meshes": ("vertices", "indices", "ranges", "lower", "upper"),
    "lights": ("directional", "point", "spot"),
}


def list_differences(first: Scene, second: Scene):
    """Names of what isn't the same in two scenes, to the last bit."""
    pairs = {
        f"{part}.{name}": (getattr(getattr(first, part), name), getattr(getattr(second, part), name))
        for part, names in COLUMNS.items()
        for name in names
    }
    pairs |= {name: (getattr(first, name), getattr(second, name)) for name in ("materials", "textures")}
    different = [
        name for name, (a, b) in pairs.items() if a.dtype != b.dtype or a.shape != b.shape or (a != b).any()
    ]
    same_images = len(first.images) == len(second.images) and all(
        np.array_equal(a, b) for a, b in zip(first.images, second.images, strict=True)
    )
    values = {
        "images": same_images,
        "samplers": first.samplers == second.samplers,
        "node names": first.nodes.names == second.nodes.names,
        "mesh names": first.meshes.names == second.meshes.names,
        "background": first.background == second.background,
        "haze": first.haze == second.haze,
        "ambient": (first.lights.sky, first.lights.ground) == (second.lights.sky, second.lights.ground),
        "views": list(first.views) == list(second.views)
        and all(map(same_camera, first.views.values(), second.views.values())),
        "paths": list(first.paths) == list(second.paths)
        and all(map(same_path, first.paths.values(), second.paths.values())),
    }
    return different + [name for name, same in values.items() if not same]


def same_camera(first, second):
    return (
        first.position.tolist() == second.position.tolist()
        and first.rotation.tolist() == second.rotation.tolist()
        and first.projection == second.projection
    )


def same_path(first, second):
    return first.projection == second.projection and all(
        getattr(first, name).tolist() == getattr(second, name).tolist()
        for name in ("positions", "targets", "ups")
    )


def save_and_load(scene, folder, name="saved.glb"):
    left_out = save_scene(scene, folder / name)
    return load_model(str(folder / name)), left_out


@pytest.mark.parametrize(
    "text", ["city:blocks=2,shadows=1", "night:blocks=2,lights=64", "grid:count=9,lights=4"]
)
@pytest.mark.parametrize("name", ["saved.glb", "saved.gltf"])
def test_a_generated_scene_is_read_back_the_same(tmp_path, text, name):
    scene = load_scene(text)
    loaded, left_out = save_and_load(scene, tmp_path, name)
    assert list_differences(scene, loaded) == []
    assert left_out == loaded.omissions == ()


def test_saving_a_loaded_scene_changes_no_byte(tmp_path):
    save_scene(load_scene("night:blocks=2,lights=16"), tmp_path / "one.glb")
    save_scene(load_model(str(tmp_path / "one.glb")), tmp_path / "two.glb")
    name = json.dumps(str(tmp_path / "one.glb")).encode()
    first, second = ((tmp_path / file).read_bytes() for file in ("one.glb", "two.glb"))
    assert first[first.index(b"BIN\0") :] == second[second.index(b"BIN\0") :]
    assert name in second  # scenes are named after what they were made from


def test_showing_a_loaded_hidden_node_shows_its_children(tmp_path):
    builder, mesh = SceneBuilder("hidden"), make_geometry(TRIANGLE, [0, 1, 2])
    below = builder.add_node(parent=builder.add_node())
    builder.add_objects(below, builder.add_mesh(mesh), builder.add_material())
    builder.hide(0)
    loaded, _ = save_and_load(builder.build(), tmp_path)
    assert not loaded.objects.is_shown.any()
    loaded.nodes.show(0)
    loaded.update()
    assert loaded.objects.is_shown.all()


def test_a_difference_is_found(tmp_path):
    scene = load_scene("grid:count=4")
    loaded, _ = save_and_load(scene, tmp_path)
    loaded.lights.point["position"][0, 0] += 1e-9
    loaded.materials["roughness"][0] += 1e-6
    assert list_differences(scene, loaded) == ["lights.point", "materials"]


def make_rich_scene():
    """A scene with one of everything that glTF or its extras can hold."""
    rng = np.random.default_rng(3)
    builder = SceneBuilder("rich")
    images = [builder.add_image(rng.integers(0, 256, (4, 4, 4)).astype(np.uint8)) for _ in range(2)]
    sampler = SamplerDescriptor(Filter.NEAREST, Filter.LINEAR, Filter.NEAREST, Wrap.CLAMP, Wrap.MIRROR)
    moved = TextureMap(images[1], 1, (0.25, 0.5), 0.0, (2.0, -3.0), sampler)
    materials = [
        builder.add_material(
            base_color=(0.5, 0.25, 0.1, 0.75),
            metallic=0.3,
            roughness=0.7,
            texture=images[0],
            normal_texture=images[1],
            normal_scale=0.3,
            occlusion_texture=moved,
            occlusion_strength=0.4,
            emissive=(9.0, 0.1, 0.0),
            emissive_texture=images[0],
            metallic_roughness_texture=images[1],
            alpha_mode=AlphaMode.BLEND,
        ),
        builder.add_material(texture=moved, shininess=77.0, specular_color=(0.1, 0.2, 0.3), rim_strength=0.6),
        builder.add_material(base_color=(0.2, 0.4, 0.6), emission=2.5, texture=images[0]),
        builder.add_material(
            emission=0.5, emissive=(0.3, 0.3, 0.3), emissive_texture=images[1], rim_power=2.0
        ),
        builder.add_material(metallic=0.0, alpha_mode=AlphaMode.MASK, alpha_cutoff=0.1, double_sided=True),
    ]
    uv = rng.normal(size=(3, 2))
    meshes = [
        builder.add_mesh(
            make_geometry(points, [0, 1, 2], None, uv, uv2=uv * 2, color=rng.random((3, 4))), name
        )
        for name, points in (("small", TRIANGLE), ("large", TRIANGLE * 2))
    ]
    root = builder.add_node(rotation((0.6, 0.8, 0.0), 0.3), name="root")
    below = builder.add_node(translation((1e6 + 0.1, 0.1, -3.0)), root, dynamic=True, name="below")
    builder.add_objects(below, meshes[1], materials[0])
    builder.add_objects([root, root], meshes, materials[1:3], casts_shadow=False)
    builder.add_objects(below, meshes[0], materials[3:])
    builder.hide(below)
    builder.lights.add_directional(
        (0.3, -0.7, 0.1), (0.1, 0.7, 0.3), 1.7, casts_shadow=True, angular_diameter=0.0093
    )
    builder.lights.add_points(rng.normal(size=(20, 3)) * 1e5, 7.3, rng.random((20, 3)), rng.random(20) * 90)
    builder.lights.add_spots(
        rng.normal(size=(20, 3)), rng.normal(size=(20, 3)), 3.1, 0.2, 0.7, (1, 0.9, 0.3), 5.5
    )
    builder.lights.point["source_radius"][::2] = builder.lights.spot["source_radius"][1::2] = 0.3
    builder.lights.add_rectangle((1, 2, 3), (0.3, -0.2, 0.9), 5.0, 1.3, 0.7, source_radius=0.2)
    builder.lights.add_tube((1, 2, 3), (0.3, -0.2, 0.9), 5.0, 1.3)
    builder.attach_lights("point", builder.lights.add_tube((1, 0, 2), (0.3, 0.4, 0.9), 5.0, 1.1, 0.1), below)
    builder.views["first"] = Camera.look_at(rng.normal(size=3), rng.normal(size=3))
    builder.views["flat"] = Camera.look_at(
        (1, 2, 3), (0, 0, 0), projection=scenes.Orthographic(4.0, 1.5, 0.5, 9.0)
    )
    builder.background, builder.haze = (0.1, 0.2, 0.3), 0.01
    return builder.build()


def test_a_scene_with_every_supported_feature_is_read_back_the_same(tmp_path):
    scene = make_rich_scene()
    loaded, left_out = save_and_load(scene, tmp_path)
    assert list_differences(scene, loaded) == []
    assert left_out == ()


def test_rotated_texture_coordinates_are_the_same_to_float32(tmp_path):
    builder = SceneBuilder("turned")
    image = builder.add_image(np.zeros((1, 1, 4), np.uint8))
    for turn, scale in ((0.5, (2.0, 3.0)), (-2.5, (0.1, 7.0)), (1.0, (1.0, -1.0))):
        builder.add_material(texture=TextureMap(image, 0, (0.25, -4.0), turn, scale), metallic=0.5)
    builder.add_objects(builder.add_node(), builder.add_mesh(make_geometry(TRIANGLE, [0, 1, 2])), 0)
    scene = builder.build()
    loaded, _ = save_and_load(scene, tmp_path, "saved.gltf")
    assert json.loads((tmp_path / "saved.gltf").read_text(encoding="utf-8"))["extensionsUsed"] == [
        "KHR_texture_transform"
    ]
    assert loaded.textures["transform"] == pytest.approx(scene.textures["transform"], rel=3e-7)


def test_a_camera_without_a_far_plane_has_one_for_other_programs(tmp_path):
    """Loaders of other engines fail without one. What another program has changed since is believed."""
    scene = load_scene("grid:count=1")
    scene.views["view"] = Camera.look_at((1, 2, 3), (0, 0, 0), projection=scenes.Perspective(near=0.5))
    loaded, _ = save_and_load(scene, tmp_path, "saved.gltf")
    assert loaded.views["view"].projection.far == np.inf
    file = tmp_path / "saved.gltf"
    document = json.loads(file.read_text(encoding="utf-8"))
    perspective = document["cameras"][-1]["perspective"]
    assert perspective["zfar"] == 0.5 * 2**24
    perspective["zfar"] = 100.0
    file.write_text(json.dumps(document), encoding="utf-8")
    assert load_model(str(file)).views["view"].projection.far == 100.0


def test_animations_are_read_back_the_same(tmp_path):
    document = GltfDocument(nodes=[{"children": [1, 2]}, {"mesh": 0}, {"mesh": 0, "translation": [1, 2, 3]}])
    document.mesh()
    document.animate(1, "translation", [0, 1, 3], [[0, 0, 0], [1, 2, 3], [4, 5, 6]], "STEP")
    document.animate(1, "rotation", [0, 2], [[0.1, 0.2, 0.3, 0.9]] * 2)
    document.animate(2, "scale", [0, 1], np.ones((6, 3)), "CUBICSPLINE")
    first = load_model(document.write(tmp_path / "first.glb"))
    loaded, left_out = save_and_load(first, tmp_path)
    assert left_out == ()
    for seconds in (0.0, 0.7, 1.9, 2.5):
        first.update(seconds)
        loaded.update(seconds)
        assert list_differences(first, loaded) == []


def test_simulations_that_are_not_of_gltf_are_listed(tmp_path):
    scene = load_scene("hall:columns=2,rows=2,flags=2,fountains=1")
    loaded, left_out = save_and_load(scene, tmp_path)
    assert {omission.what: omission.count for omission in left_out} == {
        "simulations of nodes": 12,
        "simulations of vertices": 1,
    }
    assert (loaded.nodes.world == scene.nodes.world).all()


def test_fog_and_bloom_are_listed(tmp_path):
    loaded, left_out = save_and_load(load_scene("city:blocks=1,fog=0.1,bloom=0.05"), tmp_path)
    assert [str(omission) for omission in left_out] == ["fog (scene)", "bloom (scene)"]
    assert loaded.fog is loaded.bloom is None


def test_a_spot_light_that_gltf_does_not_allow_is_listed(tmp_path):
    scene = load_scene("grid:count=1")
    scene.lights.add_spot((0, 0, 0), (0, 0, 1), 5.0, 0.3, 3.0)
    loaded, left_out = save_and_load(scene, tmp_path)
    assert [omission.what for omission in left_out] == ["cones of spot lights that glTF doesn't allow"]
    assert (loaded.lights.spot == scene.lights.spot).all()


def test_other_extensions_are_refused(tmp_path):
    with pytest.raises(ValidationError, match=r"\.glb, \.gltf") as error:
        save_scene(load_scene("grid:count=1"), tmp_path / "scene.obj")
    assert error.value.rule.id == "scene-unknown-format"
    assert list(tmp_path.iterdir()) == []
