"""glTF files: what is read of meshes, materials, nodes, cameras and lights, and what is listed as left
out."""

import base64
import io
import json

import numpy as np
import pytest
from gltf_documents import TRIANGLE, GltfDocument
from nightly_reasons import ONLY_KERNELS
from PIL import Image

from renderer.cli import main
from renderer.content import add_model, load_model, save_scene
from renderer.content.material_shaders import Brushed
from renderer.renderer import Renderer
from renderer.scene import AlphaMode, Camera, Orthographic, SceneBuilder, ShadingModel
from renderer.techniques import TECHNIQUES
from renderer.visibility import ALGORITHMS, make_visibility
from rhi import Filter, ValidationError, Wrap, to_srgb

QUAD = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], np.float32)
UP = np.tile(np.array([[0, 0, 1]], np.float32), (4, 1))


def load(document, folder, name="model.glb"):
    return load_model(document.write(folder / name))


def one_mesh(**mesh):
    document = GltfDocument(nodes=[{"mesh": 0}])
    document.mesh(**mesh)
    return document


def left_out(scene):
    return {omission.what: omission.count for omission in scene.omissions}


def png(pixels):
    file = io.BytesIO()
    Image.fromarray(np.asarray(pixels, np.uint8)).save(file, "PNG")
    return file.getvalue()


def with_image(pixels=((((255, 0, 0, 255),),)), **material):
    document = one_mesh(material=0)
    document.add("images", bufferView=document.view(png(pixels)), mimeType="image/png")
    document.add("textures", source=0)
    document.add("materials", **material)
    return document


@pytest.mark.parametrize("extras", ["by hand", 7, True, None, [1, 2], {"name": 5}, {"other": 1}])
def test_extras_are_any_json(tmp_path, extras):
    document = GltfDocument(nodes=[{"mesh": 0}], meshes=[])
    document.mesh()
    mesh, node = document.values["meshes"][0], document.values["nodes"][0]
    mesh |= {"name": "stone", "extras": extras}
    mesh["primitives"][0]["extras"] = node["extras"] = extras
    scene = load(document, tmp_path)
    assert scene.meshes.names == ("5" if isinstance(extras, dict) and "name" in extras else "stone",)


# -- containers ----------------------------------------------------------------------------------------------


def test_both_containers_give_the_same_scene(tmp_path):
    document = one_mesh(positions=QUAD, indices=np.array([0, 1, 2], np.uint16), NORMAL=UP)
    binary, text = load(document, tmp_path, "a.glb"), load(document, tmp_path, "a.gltf")
    assert (binary.meshes.vertices == text.meshes.vertices).all()
    assert (binary.meshes.indices == text.meshes.indices).all()


def test_a_buffer_may_stand_in_the_document_itself(tmp_path):
    document = one_mesh()
    uri = "data:application/octet-stream;base64," + base64.b64encode(bytes(document.data)).decode()
    values = document.values | {"buffers": [{"uri": uri, "byteLength": len(document.data)}]}
    (tmp_path / "a.gltf").write_text(json.dumps(values), encoding="utf-8")
    assert load_model(str(tmp_path / "a.gltf")).triangle_count == 1


@pytest.mark.parametrize("uri", ["my%20caf%C3%A9%2B1.bin", "my café+1.bin"])
def test_a_file_name_may_be_escaped(tmp_path, uri):
    document = one_mesh()
    (tmp_path / "my café+1.bin").write_bytes(document.data)
    values = document.values | {"buffers": [{"uri": uri, "byteLength": len(document.data)}]}
    (tmp_path / "a.gltf").write_text(json.dumps(values), encoding="utf-8")
    assert load_model(str(tmp_path / "a.gltf")).triangle_count == 1


# -- accessors -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["u1", "u2", "u4"])
def test_indices_of_all_sizes_are_read(tmp_path, kind):
    scene = load(one_mesh(positions=QUAD, indices=np.array([2, 1, 3], kind), NORMAL=UP), tmp_path)
    assert scene.meshes.indices.tolist() == [2, 1, 3]


@pytest.mark.parametrize(
    ("kind", "stored", "expected"),
    [
        ("u1", [0, 51, 255], [0.0, 0.2, 1.0]),
        ("u2", [0, 13107, 65535], [0.0, 0.2, 1.0]),
        ("i1", [-128, -127, 127], [-1.0, -1.0, 1.0]),
        ("i2", [-32768, -32767, 32767], [-1.0, -1.0, 1.0]),
    ],
)
def test_normalised_integers_become_floats(tmp_path, kind, stored, expected):
    document = one_mesh()
    uv = document.accessor(np.array([stored, stored], kind).T.copy(), normalized=True)
    document.values["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = uv
    scene = load(document, tmp_path)
    assert scene.meshes.vertices["uv"][:, 0].tolist() == np.float32(expected).tolist()


def test_quantised_positions_are_read_as_they_are(tmp_path):
    document = GltfDocument(nodes=[{"mesh": 0, "scale": [0.5, 0.5, 0.5]}])
    position = document.accessor((TRIANGLE * 100).astype(np.int16))
    document.add("meshes", primitives=[{"attributes": {"POSITION": position}}])
    document.values["extensionsRequired"] = document.values["extensionsUsed"] = ["KHR_mesh_quantization"]
    scene = load(document, tmp_path)
    assert scene.meshes.vertices["position"].tolist() == (TRIANGLE * 100).tolist()
    assert scene.objects.upper[0] == pytest.approx([50, 50, 0])


@pytest.mark.parametrize("has_base", [True, False])
def test_sparse_elements_replace_those_of_their_accessor(tmp_path, has_base):
    document = GltfDocument(nodes=[{"mesh": 0}])
    indices, values = (
        document.view(np.array([1, 2], np.uint8).tobytes()),
        document.view(TRIANGLE[1:].tobytes()),
    )
    sparse = {
        "count": 2,
        "indices": {"bufferView": indices, "componentType": 5121},
        "values": {"bufferView": values},
    }
    base = np.full((3, 3), 7, np.float32)
    number = document.accessor(base, sparse=sparse)
    if not has_base:
        del document.values["accessors"][number]["bufferView"]
    document.add("meshes", primitives=[{"attributes": {"POSITION": number}}])
    position = load(document, tmp_path).meshes.vertices["position"]
    assert position.tolist() == [[7.0 * has_base] * 3, *TRIANGLE[1:].tolist()]


# -- meshes --------------------------------------------------------------------------------------------------


def test_strips_and_fans_face_as_their_triangles_do(tmp_path):
    strip = load(one_mesh(positions=QUAD, mode=5, NORMAL=UP), tmp_path, "strip.glb")
    assert strip.meshes.indices.tolist() == [0, 1, 2, 1, 3, 2]
    fan = load(one_mesh(positions=QUAD[[0, 1, 3, 2]], mode=6, NORMAL=UP), tmp_path, "fan.glb")
    assert fan.meshes.indices.tolist() == [1, 2, 0, 2, 3, 0]


def test_missing_normals_are_flat(tmp_path):
    bent = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32)
    indices = np.array([0, 1, 2, 0, 2, 3], np.uint8)
    vertices = load(one_mesh(positions=bent, indices=indices), tmp_path).meshes.vertices
    assert vertices["normal"].tolist() == [[0, 0, 1]] * 3 + [[1, 0, 0]] * 3


def test_normals_that_are_no_directions_are_computed_and_listed(tmp_path):
    normals = np.array([[0, 0, 0], [0, 0, 3], [np.nan, 0, 0]], np.float32)
    scene = load(one_mesh(NORMAL=normals), tmp_path)
    assert scene.meshes.vertices["normal"].tolist() == [[0, 0, 1]] * 3
    assert left_out(scene) == {"normals that aren't directions": 2}


def test_coordinates_that_are_no_numbers_are_0_and_listed(tmp_path):
    uvs = np.array([[0.5, 0.25], [np.nan, 1.0], [1.0, np.inf]], np.float32)
    scene = load(one_mesh(TEXCOORD_0=uvs), tmp_path)
    assert scene.meshes.vertices["uv"].tolist() == [[0.5, 0.25], [0, 0], [0, 0]]
    assert left_out(scene) == {"TEXCOORD_0 that isn't a number": 2}


def test_second_uvs_tangents_and_colours_are_read(tmp_path):
    document = with_image(
        normalTexture={"index": 0}, occlusionTexture={"index": 0, "texCoord": 1, "strength": 0.5}
    )
    attributes = document.values["meshes"][0]["primitives"][0]["attributes"]
    tangent = np.array([[0, 1, 0, -1]] * 3, np.float32)
    attributes["NORMAL"] = document.accessor(UP[:3])
    attributes["TANGENT"] = document.accessor(tangent)
    attributes["TEXCOORD_0"] = document.accessor(TRIANGLE[:, :2].copy())
    attributes["TEXCOORD_1"] = document.accessor(2 * TRIANGLE[:, :2])
    attributes["COLOR_0"] = document.accessor(np.array([[255, 0, 51]] * 3, np.uint8), normalized=True)
    vertices = load(document, tmp_path).meshes.vertices
    assert vertices["tangent"].tolist() == tangent.tolist()
    assert vertices["uv2"].tolist() == (2 * TRIANGLE[:, :2]).tolist()
    assert vertices["color"][0] == pytest.approx([1, 0, 0.2, 1])


def test_primitives_that_share_a_large_array_get_the_part_that_they_use(tmp_path):
    many = np.arange(300, dtype=np.float32).reshape(100, 3)
    document = one_mesh(
        positions=many, indices=np.array([90, 95, 99], np.uint8), NORMAL=np.tile(UP[:1], (100, 1))
    )
    meshes = load(document, tmp_path).meshes
    assert meshes.vertices["position"].tolist() == many[[90, 95, 99]].tolist()
    assert meshes.indices.tolist() == [0, 1, 2]


# -- assets --------------------------------------------------------------------------------------------------


def test_primitives_with_the_same_accessors_are_one_mesh(tmp_path):
    document = GltfDocument(nodes=[{"mesh": 0}, {"mesh": 1}])
    document.mesh()
    document.values["meshes"].append(document.values["meshes"][0])
    scene = load(document, tmp_path)
    assert (len(scene.meshes), len(scene.objects)) == (1, 2)


def test_the_same_content_is_loaded_once_across_files(tmp_path):
    material = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    paths = [with_image(**material).write(tmp_path / name) for name in ("a.glb", "b.gltf")]
    other = with_image([[[0, 255, 0, 255]]], **material)
    other.values["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = other.accessor(TRIANGLE * 2)
    builder = SceneBuilder("three files")
    for path in (*paths, other.write(tmp_path / "c.glb")):
        add_model(builder, path)
    scene = builder.build()
    assert (len(scene.objects), len(scene.meshes), len(scene.images)) == (3, 2, 2)
    again = load_model(paths[0])
    assert again.images[0] is scene.images[0]


# -- materials -----------------------------------------------------------------------------------------------


FULL_MATERIAL = {
    "pbrMetallicRoughness": {
        "baseColorFactor": [0.5, 0.25, 1, 0.75],
        "metallicFactor": 0.25,
        "roughnessFactor": 0.5,
        "baseColorTexture": {"index": 0},
        "metallicRoughnessTexture": {"index": 0},
    },
    "normalTexture": {"index": 0, "scale": 2},
    "occlusionTexture": {"index": 0, "strength": 0.5},
    "emissiveTexture": {"index": 0},
    "emissiveFactor": [1, 0.5, 0],
    "alphaMode": "MASK",
    "alphaCutoff": 0.25,
    "doubleSided": True,
    "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 8}},
}


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("model", ShadingModel.METALLIC_ROUGHNESS),
        ("base_color", [0.5, 0.25, 1, 0.75]),
        ("metallic", 0.25),
        ("roughness", 0.5),
        ("normal_scale", 2),
        ("occlusion_strength", 0.5),
        ("emissive", [8, 4, 0]),
        ("alpha_mode", AlphaMode.MASK),
        ("alpha_cutoff", 0.25),
        ("double_sided", 1),
    ],
)
def test_a_material_is_read_with_its_factors(tmp_path, field, value):
    scene = load(with_image(**FULL_MATERIAL), tmp_path)
    assert scene.materials[0][field].tolist() == value


def test_a_material_is_read_with_its_textures(tmp_path):
    scene = load(with_image(**FULL_MATERIAL), tmp_path)
    maps = ("metallic_roughness_texture", "normal_texture", "occlusion_texture")
    rows = [int(scene.materials[0][name]) for name in ("texture", *maps, "emissive_texture")]
    assert scene.textures["is_color"][rows].tolist() == [1, 0, 0, 0, 1]
    assert scene.textures["image"][rows].tolist() == [0] * 5


def test_nothing_of_a_full_material_is_left_out(tmp_path):
    assert left_out(load(with_image(**FULL_MATERIAL), tmp_path)) == {}


def test_a_primitive_without_a_material_gets_the_default_one(tmp_path):
    scene = load(one_mesh(), tmp_path)
    assert scene.materials["base_color"].tolist() == [[1, 1, 1, 1]]
    assert (scene.materials["metallic"].item(), scene.materials["roughness"].item()) == (1, 1)


BRUSHED = {
    "anisotropyStrength": 0.75,
    "anisotropyRotation": 0.5,
    "anisotropyTexture": {"index": 0},
}


def test_an_anisotropic_material_gets_the_shader_of_brushed_metal(tmp_path):
    scene = load(
        with_image(**FULL_MATERIAL | {"extensions": {"KHR_materials_anisotropy": BRUSHED}}), tmp_path
    )
    assert [custom.shader for custom in scene.shaders] == [Brushed]
    (values,) = scene.parameters
    assert (values["anisotropy"][0], values["anisotropy_rotation"][0]) == (0.75, 0.5)
    assert scene.textures["is_color"][values["anisotropy_texture"][0]] == 0
    assert scene.materials["roughness"][0] == 0.5
    assert "tangent" in scene.meshes.vertices.dtype.names
    assert left_out(scene) == {}


LIGHT_MAP = {"index": 0, "intensity": 5}


@pytest.mark.parametrize(("use", "uv_set"), [({}, 1), ({"texCoord": 0}, 0), ({"texCoord": 1}, 1)])
def test_a_light_map_is_linear_and_read_by_the_second_texture_coordinates_unless_it_says_others(
    tmp_path, use, uv_set
):
    """Its texels are lux, of which a white surface reflects 1 / π of a unit here."""
    document = with_image(**FULL_MATERIAL | {"extensions": {"MOZ_lightmap": LIGHT_MAP | use}})
    scene = load(document, tmp_path)
    row = int(scene.materials[0]["light_map_texture"])
    assert (scene.textures["is_color"][row], scene.textures["uv_set"][row]) == (0, uv_set)
    assert scene.materials[0]["light_map_color"].tolist() == pytest.approx([5 / np.pi] * 3)
    assert left_out(scene) == {}


def test_the_transform_of_a_light_map_is_read(tmp_path):
    moved = LIGHT_MAP | {"extensions": {"KHR_texture_transform": {"offset": [0.5, 0.25], "scale": [2, 2]}}}
    scene = load(with_image(extensions={"MOZ_lightmap": moved}), tmp_path)
    row = int(scene.materials[0]["light_map_texture"])
    assert scene.textures["transform"][row].tolist() == [[2, 0, 0.5], [0, 2, 0.25]]


@pytest.mark.parametrize(
    "wrong", [{"index": 3}, {"intensity": -1}, {"intensity": "bright"}, {"texCoord": -1}]
)
def test_a_wrong_light_map_is_refused(tmp_path, wrong):
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        load(with_image(extensions={"MOZ_lightmap": LIGHT_MAP | wrong}), tmp_path)


def test_the_light_map_of_an_unlit_material_is_left_out(tmp_path):
    extensions = {"KHR_materials_unlit": {}, "MOZ_lightmap": LIGHT_MAP}
    scene = load(with_image(extensions=extensions), tmp_path)
    assert scene.materials[0]["light_map_texture"] == -1
    assert "light maps of unlit materials" in left_out(scene)


def test_a_material_without_anisotropy_has_no_shader_of_its_own(tmp_path):
    scene = load(with_image(extensions={"KHR_materials_anisotropy": {"anisotropyStrength": 0}}), tmp_path)
    assert (list(scene.shaders), left_out(scene)) == ([], {})


@pytest.mark.parametrize("strength", [-0.1, 1.1])
def test_anisotropy_beyond_its_range_is_refused(tmp_path, strength):
    document = with_image(extensions={"KHR_materials_anisotropy": {"anisotropyStrength": strength}})
    with pytest.raises(ValidationError, match="anisotropyStrength"):
        load(document, tmp_path)


@pytest.mark.parametrize(
    ("use", "is_read"),
    [
        ({}, True),
        ({"extensions": {"KHR_texture_transform": {"scale": [2, 2]}}}, False),
        ({"texCoord": 1}, False),
    ],
)
def test_anisotropy_is_left_out_beside_textures_that_are_transformed(tmp_path, use, is_read):
    document = with_image(
        pbrMetallicRoughness={"baseColorTexture": {"index": 0, **use}},
        extensions={"KHR_materials_anisotropy": BRUSHED},
    )
    scene = load(document, tmp_path)
    assert bool(scene.shaders) is is_read
    assert any("anisotropy" in omission for omission in left_out(scene)) is not is_read


def test_anisotropy_is_saved_and_read_again(tmp_path):
    scene = load(
        with_image(**FULL_MATERIAL | {"extensions": {"KHR_materials_anisotropy": BRUSHED}}), tmp_path
    )
    path = tmp_path / "saved.glb"
    assert not save_scene(scene, path)
    again = load_model(path)
    assert [custom.shader for custom in again.shaders] == [Brushed]
    for name in ("anisotropy", "anisotropy_rotation"):
        assert again.parameters[0][name][0] == scene.parameters[0][name][0]


def test_an_unlit_material_only_emits(tmp_path):
    document = with_image(
        pbrMetallicRoughness={"baseColorFactor": [0.5, 1, 1, 0.5], "baseColorTexture": {"index": 0}},
        extensions={"KHR_materials_unlit": {}},
        alphaMode="BLEND",
    )
    scene = load(document, tmp_path)
    material = scene.materials[0]
    assert (material["emission"] * material["base_color"][:3]).tolist() == [0.5, 1, 1]
    assert material["base_color"][:3].max() <= 2e-6  # what a light of 2,000 leaves is no step of 8 bits
    assert material["base_color"][3] == 0.5
    assert material["specular_color"].tolist() == [0, 0, 0]
    assert scene.textures["is_color"][[material["texture"]]].tolist() == [1]


def test_a_texture_keeps_its_sampler_and_its_transform(tmp_path):
    transform = {"offset": [0.25, 0.5], "scale": [2, 3], "rotation": 0.5, "texCoord": 1}
    used = {"index": 0, "extensions": {"KHR_texture_transform": transform}}
    document = with_image(pbrMetallicRoughness={"baseColorTexture": used})
    document.values["textures"][0]["sampler"] = document.add(
        "samplers", magFilter=9728, minFilter=9985, wrapS=33071, wrapT=33648
    )
    scene = load(document, tmp_path)
    texture = scene.textures[scene.materials["texture"][0]]
    sampler = scene.samplers[texture["sampler"]]
    assert (sampler.magnify, sampler.minify, sampler.mip) == (Filter.NEAREST, Filter.LINEAR, Filter.NEAREST)
    assert (sampler.wrap_u, sampler.wrap_v) == (Wrap.CLAMP, Wrap.MIRROR)
    assert texture["uv_set"] == 1
    cosine, sine = np.cos(0.5), np.sin(0.5)
    expected = [[2 * cosine, 3 * sine, 0.25], [-2 * sine, 3 * cosine, 0.5]]
    assert texture["transform"] == pytest.approx(np.array(expected), abs=1e-6)


@pytest.mark.parametrize(
    "broken", [{"uri": "not-there.png"}, {"uri": "https://example.org/a.png"}, "rubbish"]
)
def test_an_image_that_cannot_be_read_is_listed_and_the_material_goes_without(tmp_path, broken):
    document = with_image(pbrMetallicRoughness={"baseColorTexture": {"index": 0}})
    if broken == "rubbish":
        broken = {"bufferView": document.view(b"rubbish!"), "mimeType": "image/png"}
    document.values["images"] = [broken]
    scene = load(document, tmp_path, "model.gltf")
    assert scene.materials["texture"].tolist() == [-1]
    (omission,) = scene.omissions
    assert omission.what.startswith("an image that can't be read")
    assert omission.where == "images[0]"


def test_images_of_all_kinds_become_four_channels(tmp_path):
    deep = np.array([[0, 257 * 7], [65535, 257]], np.uint16)
    for pixels, expected in ((deep, [0, 7, 255, 1]), (np.array([[3, 4], [5, 6]], np.uint8), [3, 4, 5, 6])):
        file = io.BytesIO()
        Image.fromarray(pixels).save(file, "PNG")
        document = with_image(pbrMetallicRoughness={"baseColorTexture": {"index": 0}})
        document.values["images"][0]["bufferView"] = document.view(file.getvalue())
        image = load(document, tmp_path).images[0]
        assert image[..., :3].reshape(-1, 3).tolist() == [[grey] * 3 for grey in expected]
        assert (image[..., 3] == 255).all()


def test_unsupported_material_extensions_are_listed(tmp_path):
    document = with_image(extensions={"KHR_materials_clearcoat": {}, "KHR_materials_sheen": {}})
    assert left_out(load(document, tmp_path)) == {"KHR_materials_clearcoat": 1, "KHR_materials_sheen": 1}


# -- nodes, cameras, lights ----------------------------------------------------------------------------------


def test_nodes_have_the_transforms_of_their_parts_or_their_matrix(tmp_path):
    turn = [0, np.sin(np.pi / 4), 0, np.cos(np.pi / 4)]  # a quarter about y: x becomes -z
    matrix = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 5, 6, 7, 1]
    document = GltfDocument(
        scene=0,
        scenes=[{"nodes": [1, 0]}],
        nodes=[
            {"name": "parts", "translation": [1, 2, 3], "rotation": turn, "scale": [2, 1, 1], "mesh": 0},
            {"name": "matrix", "matrix": matrix, "children": [2]},
            {"name": "below", "mesh": 0},
        ],
    )
    document.mesh()
    scene = load(document, tmp_path)
    assert scene.nodes.names == ("parts", "matrix", "below")
    assert scene.nodes.parents.tolist() == [-1, -1, 1]
    assert scene.nodes.world[0] @ (1, 0, 0, 1) == pytest.approx([1, 2, 1, 1])
    assert scene.nodes.world[2][:3, 3].tolist() == [5, 6, 7]


def test_only_the_default_scene_is_read_and_others_are_listed(tmp_path):
    document = GltfDocument(
        scene=1,
        scenes=[{"nodes": [0]}, {"nodes": [1]}],
        nodes=[{"mesh": 0, "name": "a"}, {"mesh": 0, "name": "b"}],
    )
    document.mesh()
    scene = load(document, tmp_path)
    assert scene.nodes.names == ("b",)
    assert left_out(scene) == {"other scenes": 1}


def test_cameras_become_views(tmp_path):
    document = GltfDocument(
        nodes=[
            {"mesh": 0},
            {"name": "near", "translation": [0, 0, 5], "camera": 0, "scale": [3, 3, 3]},
            {"name": "flat", "rotation": [0, 1, 0, 0], "camera": 1},
        ],
        cameras=[
            {
                "type": "perspective",
                "perspective": {"yfov": 0.7, "znear": 0.5, "zfar": 20, "aspectRatio": 1.5},
            },
            {"type": "orthographic", "orthographic": {"xmag": 4, "ymag": 2, "znear": 1, "zfar": 9}},
        ],
    )
    document.mesh()
    scene = load(document, tmp_path)
    near, flat = scene.views["near"], scene.views["flat"]
    assert list(scene.views) == ["near", "flat"]
    assert near.position.tolist() == [0, 0, 5]
    assert near.forward.tolist() == pytest.approx([0, 0, -1])
    assert near.projection.matrix == pytest.approx(near.projection.__class__(0.7, 1.5, 0.5, 20).matrix)
    assert flat.forward.tolist() == pytest.approx([0, 0, 1])
    assert flat.projection == Orthographic(4.0, 2.0, 1.0, 9.0)


def test_an_infinite_camera_has_no_far_plane(tmp_path):
    document = one_mesh()
    document.values["nodes"].append({"camera": 0})
    document.add("cameras", type="perspective", perspective={"yfov": 1, "znear": 0.1})
    (view,) = load(document, tmp_path).views.values()
    assert view.projection.far == np.inf


def test_lights_are_read_at_their_nodes(tmp_path):
    down = [-np.sin(np.pi / 4), 0, 0, np.cos(np.pi / 4)]  # -z becomes -y
    document = GltfDocument(
        nodes=[
            {"mesh": 0},
            {"translation": [1, 2, 3], "rotation": down, "children": [2, 3, 4]},
            {"extensions": {"KHR_lights_punctual": {"light": 0}}},
            {"extensions": {"KHR_lights_punctual": {"light": 1}}},
            {"extensions": {"KHR_lights_punctual": {"light": 2}}},
        ],
        extensions={
            "KHR_lights_punctual": {
                "lights": [
                    {"type": "directional", "intensity": np.pi},
                    {"type": "point", "color": [1, 0.5, 0], "intensity": 2 * np.pi, "range": 7},
                    {"type": "spot", "spot": {"innerConeAngle": 0.2, "outerConeAngle": 0.4}, "range": 9},
                ]
            }
        },
    )
    document.mesh()
    lights = load(document, tmp_path).lights
    assert len(lights) == 3  # no sun is added
    assert lights.directional["direction"][0] == pytest.approx([0, -1, 0], abs=1e-7)
    assert lights.directional["intensity"][0] == pytest.approx(1.0)
    assert lights.point["position"].tolist() == [[1, 2, 3]]
    assert (lights.point["intensity"][0], lights.point["range"][0]) == (pytest.approx(2.0), 7)
    assert lights.point["color"].tolist() == [[1, 0.5, 0]]
    assert lights.spot["direction"][0] == pytest.approx([0, -1, 0], abs=1e-7)
    assert (lights.spot["inner"][0], lights.spot["outer"][0]) == pytest.approx((0.2, 0.4))


def test_a_light_without_a_range_ends_where_it_is_faint(tmp_path):
    document = one_mesh()
    document.values["nodes"][0]["extensions"] = {"KHR_lights_punctual": {"light": 0}}
    document.values["extensions"] = {"KHR_lights_punctual": {"lights": [{"type": "point", "intensity": 100}]}}
    (light,) = load(document, tmp_path).lights.point
    assert light["intensity"] / light["range"] ** 2 == pytest.approx(1 / 512, rel=1e-4)


def test_a_file_without_lights_gets_a_sun(tmp_path):
    assert len(load(one_mesh(), tmp_path).lights.directional) == 1


# -- scenes without objects ----------------------------------------------------------------------------------

LIGHT_NODE = {"extensions": {"KHR_lights_punctual": {"light": 0}}}
EMPTY = {
    "lights": GltfDocument(
        nodes=[LIGHT_NODE], extensions={"KHR_lights_punctual": {"lights": [{"type": "point"}]}}
    ),
    "cameras": GltfDocument(
        nodes=[{"camera": 0}], cameras=[{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}]
    ),
    "nodes": GltfDocument(nodes=[{"children": [1]}, {"name": "below"}], scenes=[{"nodes": [0]}]),
    "moving nodes": GltfDocument(nodes=[{}]),
}
EMPTY["moving nodes"].animate(0, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]])


@pytest.mark.parametrize("kind", EMPTY)
def test_a_file_without_meshes_is_a_scene_in_which_nothing_is_shown(tmp_path, kind):
    scene = load(EMPTY[kind], tmp_path)
    assert scene.objects.is_shown.tolist() == [False]
    assert len(scene.lights) == 1  # its own, or a sun
    assert next(iter(scene.views)) == ("camera 0" if kind == "cameras" else "overview")
    scene.check_bounds([0.0, 0.7])
    save_scene(scene, tmp_path / "again.glb")
    assert load_model(tmp_path / "again.glb").objects.is_shown.tolist() == [False]


@pytest.mark.parametrize("kind", EMPTY)
@pytest.mark.parametrize("name", TECHNIQUES)
def test_every_technique_draws_nothing_of_it(null, tmp_path, kind, name):
    scene = load(EMPTY[kind], tmp_path)
    with Renderer(null, scene, technique=TECHNIQUES[name](), size=(32, 32)) as renderer:
        frame = renderer.render(Camera.look_at([0, 0, 3], [0, 0, 0]))
    assert (frame.statistics.draws, frame.statistics.triangles) == (0, 0)


@pytest.mark.parametrize("name", ALGORITHMS)
def test_every_visibility_algorithm_finds_nothing_in_it(gl, tmp_path, name):
    scene = load(EMPTY["lights"], tmp_path)
    with Renderer(gl, scene, visibility=make_visibility(name, scene, gl), size=(32, 32)) as renderer:
        for seconds in (0.0, 0.1, 0.2):
            frame = renderer.render(Camera.look_at([0, 0, 3], [0.5, 0.5, 0]), seconds)
    assert frame.statistics.triangles == 0


@pytest.mark.nightly_cases("cl-[!f]*", "cl-forward_?*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("name", TECHNIQUES)
def test_its_frame_is_the_background(drawing_device, tmp_path, name):
    scene = load(EMPTY["lights"], tmp_path)
    with Renderer(drawing_device, scene, technique=TECHNIQUES[name](), size=(32, 32)) as renderer:
        image = renderer.render(Camera.look_at([0, 0, 3], [0.5, 0.5, 0])).image.read()[..., :3]
    assert np.abs(image - 255 * to_srgb(np.array(scene.background))).max() <= 1


def test_its_lights_join_a_scene_under_construction(tmp_path):
    builder = SceneBuilder("two files")
    add_model(builder, one_mesh().write(tmp_path / "a.glb"))
    add_model(builder, EMPTY["lights"].write(tmp_path / "b.glb"))
    scene = builder.build()
    assert (len(scene.objects), len(scene.lights)) == (1, 1)


def test_the_command_line_renders_it(tmp_path, capsys):
    path = EMPTY["lights"].write(tmp_path / "lights.gltf")
    assert main(["render", path, "--backend", "null", "--size", "32x32", "--technique", "forward"]) == 0
    assert "triangles:              0" in capsys.readouterr().out
