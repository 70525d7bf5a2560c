"""Broken glTF files: each is refused in one line that names the file and the place, and none ends in a
traceback."""

import json
from copy import deepcopy

import numpy as np
import pytest
from gltf_documents import TRIANGLE, GltfDocument, make_morphing, make_skinned, pack_glb
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from renderer.content import load_model
from rhi.errors import RhiError, ValidationError

SCENE_EXTRAS = {
    "background": [0, 0, 0],
    "haze": 0.5,
    "sky": [1, 1, 1],
    "ground": [0, 0, 0],
    "dynamic": [1],
    "objects": [1, 0],
    "shadowless": [0],
    "paths": [
        {
            "name": "ground",
            "perspective": 1.0,
            "aspect": 1.5,
            "near": 0.1,
            "depth": "reversed",
            "positions": [0, 0, 0, 1, 1, 1],
            "targets": [1, 0, 0, 2, 1, 1],
            "ups": [0, 1, 0],
        }
    ],
}
SPECULAR = {
    "specular_color": [0.1, 0.1, 0.1],
    "shininess": 32,
    "rim_strength": 0.5,
    "rim_power": 4,
    "emission": 1,
    "emissive": [0, 0, 0],
}


def make_document():
    """A file with a part of everything."""
    document = GltfDocument(
        scene=0,
        scenes=[{"nodes": [0, 3, 4], "extras": {"rhi": SCENE_EXTRAS}}],
        nodes=[
            {"name": "root", "children": [1, 2]},
            {"mesh": 0, "translation": [1, 0, 0]},
            {"camera": 0, "extensions": {"KHR_lights_punctual": {"light": 0}}},
            {"mesh": 0, "matrix": np.eye(4).ravel().tolist()},
            {"camera": 0, "extras": {"rhi": {"holder": True}}},
        ],
        cameras=[{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}],
        extensions={"KHR_lights_punctual": {"lights": [{"type": "spot", "spot": {"outerConeAngle": 0.5}}]}},
        materials=[
            {"pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 1], "baseColorTexture": {"index": 0}}},
            {"extras": {"rhi": SPECULAR}},
        ],
        textures=[{"source": 0, "sampler": 0}],
        samplers=[{"wrapS": 10497}],
        images=[{"uri": "data:image/png;base64,AAAA"}],
    )
    document.mesh(
        indices=np.array([0, 1, 2], np.uint16), NORMAL=np.tile(np.float32([[0, 0, 1]]), (3, 1)), material=0
    )
    rows, values = document.view(np.array([1], np.uint8).tobytes()), document.view(TRIANGLE[1:2].tobytes())
    sparse = {
        "count": 1,
        "indices": {"bufferView": rows, "componentType": 5121},
        "values": {"bufferView": values},
    }
    document.values["accessors"][0]["sparse"] = sparse
    document.animate(1, "translation", [0, 1], [[0, 0, 0], [1, 0, 0]])
    return document


def refusal(document, folder, name="bad.glb"):
    path = document.write(folder / name)
    with pytest.raises(ValidationError) as error:
        load_model(path)
    assert error.value.given.startswith(path)
    return error.value.rule.id, error.value.given.removeprefix(path).removeprefix(": "), error.value.allowed


def with_triangle(**values):
    """Return a document with a mesh of one triangle."""
    document = GltfDocument(**values)
    document.mesh()
    return document


def test_the_whole_document_is_read(tmp_path):
    scene = load_model(make_document().write(tmp_path / "good.glb"))
    assert len(scene.objects) == 2


@pytest.mark.parametrize(
    ("path", "value", "where"),
    [
        (("asset", "version"), "1.0", "asset.version"),
        (("asset",), 5, "asset"),
        (("scene",), 1, "scene"),
        (("scenes", 0, "nodes", 1), 9, "scenes[0].nodes[1]"),
        (("scenes", 0, "nodes", 1), 1, "scenes[0].nodes[1]"),
        (("nodes", 0, "children", 0), 0, "scenes[0].nodes[0]"),
        (("nodes", 1, "children"), [0], "scenes[0].nodes[0]"),
        (("nodes", 1, "children"), [2], "nodes[1].children[0]"),
        (("nodes", 1, "mesh"), 1, "nodes[1].mesh"),
        (("nodes", 1, "mesh"), -1, "nodes[1].mesh"),
        (("nodes", 1, "translation"), [1, 2], "nodes[1].translation"),
        (("nodes", 1, "translation", 0), "x", "nodes[1].translation"),
        (("nodes", 1, "translation", 0), 1e999, "nodes[1].translation"),
        (("nodes", 1, "rotation"), [0, 0, 0, 0], "nodes[1].rotation"),
        (("nodes", 3, "matrix", 3), 1, "nodes[3].matrix"),
        (("nodes", 2, "camera"), True, "nodes[2].camera"),
        (
            ("nodes", 2, "extensions", "KHR_lights_punctual"),
            {},
            "nodes[2].extensions.KHR_lights_punctual.light",
        ),
        (
            ("extensions", "KHR_lights_punctual", "lights", 0, "type"),
            3,
            "extensions.KHR_lights_punctual.lights[0].type",
        ),
        (("meshes", 0, "primitives", 0, "mode"), 7, "meshes[0].primitives[0].mode"),
        (("meshes", 0, "primitives", 0, "material"), 5, "meshes[0].primitives[0].material"),
        (("meshes", 0, "primitives", 0, "attributes", "NORMAL"), 2, "accessors[2].type"),
        (
            ("materials", 0, "pbrMetallicRoughness", "baseColorFactor", 0),
            -1,
            "materials[0].pbrMetallicRoughness.baseColorFactor",
        ),
        (("materials", 0, "alphaMode"), "SOFT", "materials[0].alphaMode"),
        (("textures", 0, "sampler"), 3, "textures[0].sampler"),
        (("samplers", 0, "wrapS"), 1, "samplers[0].wrapS"),
        (("accessors", 0, "count"), 0, "accessors[0].count"),
        (("accessors", 0, "count"), 100, "accessors[0]"),
        (("accessors", 0, "byteOffset"), 4, "accessors[0]"),
        (("accessors", 0, "componentType"), 5124, "accessors[0].componentType"),
        (("accessors", 0, "bufferView"), 77, "accessors[0].bufferView"),
        (
            ("accessors", 0, "sparse", "indices", "componentType"),
            5126,
            "accessors[0].sparse.indices.componentType",
        ),
        (("accessors", 0, "sparse", "count"), 4, "accessors[0].sparse.count"),
        (("bufferViews", 0, "byteOffset"), 10_000, "bufferViews[0]"),
        (("bufferViews", 0, "byteStride"), 8, "bufferViews[0].byteStride"),
        (("bufferViews", 0, "byteLength"), 0, "bufferViews[0].byteLength"),
        (
            ("animations", 0, "samplers", 0, "interpolation"),
            "FAST",
            "animations[0].samplers[0].interpolation",
        ),
        (("animations", 0, "samplers", 0, "output"), 2, "accessors[2].type"),
        (("animations", 0, "channels", 0, "target", "node"), 5, "animations[0].channels[0].target.node"),
        (("extensionsRequired",), ["KHR_draco_mesh_compression"], "extensionsRequired"),
    ],
)
def test_a_wrong_value_is_refused_with_its_path(tmp_path, path, value, where):
    document = make_document()
    container = document.values
    for step in path[:-1]:
        container = container[step]
    container[path[-1]] = value
    rule, message, _ = refusal(document, tmp_path)
    assert rule == "scene-unreadable-model"
    assert message.startswith(f"{where}: ")


def test_an_index_beyond_the_vertices_is_refused_and_the_last_one_is_not(tmp_path):
    for last, fits in ((2, True), (3, False)):
        document = GltfDocument(nodes=[{"mesh": 0}])
        document.mesh(indices=np.array([0, 1, last], np.uint8))
        if fits:
            assert load_model(document.write(tmp_path / "a.glb")).triangle_count == 1
        else:
            assert refusal(document, tmp_path)[1:] == ("accessors[1]: element 2 is index 3", "0 to 2")


def test_nodes_that_contain_each_other_are_refused(tmp_path):
    document = GltfDocument(nodes=[{"mesh": 0, "children": [1]}, {"children": [0]}])
    document.mesh()
    assert refusal(document, tmp_path)[1] == "nodes: each node is the child of another, in a cycle"
    document.values["scenes"] = [{"nodes": [0]}]
    assert refusal(document, tmp_path)[1] == "scenes[0].nodes[0]: 0 is a child of nodes[1]"


@pytest.mark.parametrize(
    "uri", ["not-there.bin", "https://example.org/a.bin", "data:,abc", "data:x;base64,!!"]
)
def test_a_buffer_that_cannot_be_read_is_refused(tmp_path, uri):
    document = make_document()
    values = {**document.values, "buffers": [{"uri": uri, "byteLength": len(document.data)}]}
    (tmp_path / "bad.gltf").write_text(json.dumps(values), encoding="utf-8")
    with pytest.raises(ValidationError, match=r"buffers\[0\]\.uri") as error:
        load_model(str(tmp_path / "bad.gltf"))
    assert error.value.rule.id == "scene-unreadable-model"


@pytest.mark.parametrize(
    "name", ["KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_texture_basisu"]
)
def test_the_tip_for_a_required_extension_is_to_export_without_it(tmp_path, name):
    path = with_triangle(nodes=[{"mesh": 0}], extensionsRequired=[name]).write(tmp_path / "bad.glb")
    with pytest.raises(
        ValidationError, match=rf"extensionsRequired: {name}[^$]*tip: +export it without compression"
    ):
        load_model(path)


def test_vertices_that_are_there_only_compressed_are_refused_and_others_are_read(tmp_path):
    document = with_triangle(nodes=[{"mesh": 0}], extensionsUsed=["KHR_draco_mesh_compression"])
    primitive = document.values["meshes"][0]["primitives"][0]
    primitive["extensions"] = {"KHR_draco_mesh_compression": {"bufferView": 0}}
    scene = load_model(document.write(tmp_path / "good.glb"))
    assert [omission.what for omission in scene.omissions] == ["KHR_draco_mesh_compression"]
    document.values["accessors"][0].pop("bufferView")
    path = "meshes[0].primitives[0].extensions.KHR_draco_mesh_compression"
    assert refusal(document, tmp_path)[1:] == (
        f"{path}: only compressed vertices",
        "accessors with the same vertices, uncompressed",
    )


@pytest.mark.parametrize(
    ("buffer", "problem", "allowed"),
    [
        (
            {"extensions": {"EXT_meshopt_compression": {}}},
            "uri: missing, with EXT_meshopt_compression",
            "the buffer's",
        ),
        ({}, "uri: missing", "the buffer's file, or data:"),
        ({"uri": "data:;base64,AAAAAAAA"}, "byteLength: 36", "at most 6, the length of the data"),
    ],
)
def test_a_buffer_without_bytes_is_refused_with_its_source(tmp_path, buffer, problem, allowed):
    values = with_triangle(nodes=[{"mesh": 0}]).values | {"buffers": [{"byteLength": 36, **buffer}]}
    (tmp_path / "bad.gltf").write_text(json.dumps(values), encoding="utf-8")
    with pytest.raises(ValidationError) as error:
        load_model(tmp_path / "bad.gltf")
    assert error.value.given == f"{tmp_path / 'bad.gltf'}: buffers[0].{problem}"
    assert error.value.allowed.startswith(allowed)
    assert ("without compression" in error.value.tip) == ("extensions" in buffer)


@pytest.mark.parametrize("content", [b"<html>", b"version https://git-lfs", '{"asset": 1}'.encode("utf-16")])
def test_a_file_that_is_not_gltf_is_refused_with_its_first_bytes(tmp_path, content):
    (tmp_path / "bad.glb").write_bytes(content)
    with pytest.raises(ValidationError) as error:
        load_model(tmp_path / "bad.glb")
    assert error.value.given == f"{tmp_path / 'bad.glb'}: it begins with {content[:16]!r}"
    assert error.value.allowed == "a .glb, or a JSON object in UTF-8"


def test_a_chunk_beyond_the_file_is_refused_with_the_room_that_there_is(tmp_path):
    content = pack_glb(with_triangle(nodes=[{"mesh": 0}]).values, b"")
    room = len(content) - 20
    (tmp_path / "bad.glb").write_bytes(content[:12] + (room + 1).to_bytes(4, "little") + content[16:])
    with pytest.raises(ValidationError) as error:
        load_model(tmp_path / "bad.glb")
    assert error.value.given == f"{tmp_path / 'bad.glb'}: a chunk of {room + 1} bytes at byte 12"
    assert error.value.allowed == f"{room} or less, padded to 4 bytes"


def test_a_glb_that_was_cut_off_anywhere_is_refused(tmp_path):
    make_document().write(tmp_path / "whole.glb")
    content = (tmp_path / "whole.glb").read_bytes()
    for size in (*range(1, 40), 100, len(content) // 2, len(content) - 1):
        (tmp_path / "cut.glb").write_bytes(content[:size])
        with pytest.raises(ValidationError, match=r"^\[scene-unreadable-model\]"):
            load_model(str(tmp_path / "cut.glb"))


@pytest.mark.parametrize(
    "text", [b"[]", b"{", b"\xff\xfe", b"[" * 100_000, b'{"asset": {"version": 1' + b"0" * 5000]
)
def test_json_that_is_no_document_is_refused(tmp_path, text):
    (tmp_path / "bad.gltf").write_bytes(text)
    with pytest.raises(ValidationError, match=r"^\[scene-unreadable-model\]"):
        load_model(str(tmp_path / "bad.gltf"))


@pytest.mark.parametrize(
    ("document", "reason"),
    [
        (GltfDocument(), "it has no meshes, and its scene has no nodes"),
        (GltfDocument(nodes=[{}], scenes=[{}]), "it has no meshes, and its scene has no nodes"),
        (
            GltfDocument(nodes=[{}], meshes=[{"primitives": []}]),
            "none of its 1 meshes has a triangle, a line or a",
        ),
        (with_triangle(nodes=[{}, {}]), "none of its 2 nodes has one of its 1 meshes"),
        (
            with_triangle(nodes=[{}, {"mesh": 0}], scenes=[{"nodes": [0]}]),
            "nodes[1] has a mesh, but scenes[0] has no node whose mesh is drawn",
        ),
    ],
)
def test_a_file_of_which_nothing_is_drawn_says_why(document, reason, tmp_path):
    rule, message, _ = refusal(document, tmp_path)
    assert rule == "scene-empty-model"
    assert reason in message


MAPS = ["normalTexture", "occlusionTexture", "emissiveTexture", "pbrMetallicRoughness.baseColorTexture"]
MAPS.append("pbrMetallicRoughness.metallicRoughnessTexture")


@pytest.mark.parametrize("name", MAPS)
def test_a_texture_of_a_material_without_an_index_is_refused(name, tmp_path):
    for use in ({}, {"texCoord": 0}, {"index": None}):
        material = use
        for part in reversed(name.split(".")):
            material = {part: material}
        rule, message, _ = refusal(with_triangle(materials=[material]), tmp_path)
        assert rule == "scene-unreadable-model"
        assert f"materials[0].{name}.index: {'null' if 'index' in use else 'missing'}" in message


@pytest.mark.parametrize(("name", "field"), [("normalTexture", "scale"), ("occlusionTexture", "strength")])
def test_a_strength_of_a_map_that_is_no_number_is_refused_with_and_without_a_texture(name, field, tmp_path):
    for use in ({field: "1"}, {field: "1", "index": 0}):
        rule, message, _ = refusal(with_triangle(materials=[{name: use}]), tmp_path)
        assert rule == "scene-unreadable-model"
        assert f"materials[0].{name}.{field}: 1" in message


JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-2, 10),
    st.integers(),
    st.floats(),
    st.text(max_size=3),
    st.just([]),
    st.just({}),
    st.lists(st.integers(-2, 5), max_size=4),
    st.just({"extensions": []}),
)


def list_paths(value, above=()):
    """All places in a document."""
    yield above
    pairs = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, child in pairs:
        yield from list_paths(child, (*above, key))


QUICK = settings(deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
DOCUMENTS = [make_document(), make_skinned(), make_morphing()]
DOCUMENTS[2].values["meshes"][0]["primitives"].append(
    {**DOCUMENTS[2].values["meshes"][0]["primitives"][0], "mode": 2}
)
PATHS = [
    (number, path)
    for number, document in enumerate(DOCUMENTS)
    for path in list_paths(document.values)
    if path
]
DAMAGES = st.sampled_from(range(len(DOCUMENTS))).flatmap(
    lambda number: st.tuples(
        st.just(DOCUMENTS[number]),
        st.lists(
            st.tuples(
                st.sampled_from([path for document_number, path in PATHS if document_number == number]), JUNK
            ),
            min_size=1,
            max_size=4,
        ),
    )
)


def damage(values, path, junk):
    container = values
    for step in path[:-1]:
        try:
            container = container[step]
        except (KeyError, IndexError, TypeError):
            return
    if isinstance(container, dict) and junk is None:
        container.pop(path[-1], None)
    elif isinstance(container, dict) or (isinstance(container, list) and path[-1] in range(len(container))):
        container[path[-1]] = deepcopy(junk)


def pack(values, document):
    return pack_glb({**values, "buffers": [{"byteLength": len(document.data)}]}, bytes(document.data))


def load_damaged(folder, content):
    path = folder / "damaged.glb"
    path.write_bytes(content)
    try:
        scene = load_model(str(path))
    except RhiError as error:
        refused = error
    else:
        assert len(scene.objects) > 0
        scene.check_bounds([0.0, 0.7])
        return
    assert refused.given.startswith(str(path)), refused  # a refusal names the file


def load_with_damages(folder, case):
    document, damages = case
    values = deepcopy(document.values)
    for path, junk in damages:
        damage(values, path, junk)
    load_damaged(folder, pack(values, document))


@pytest.mark.parametrize(
    "document", [candidate for candidate in DOCUMENTS if "shininess" in repr(candidate.values)]
)
def test_a_specular_material_without_its_exponent_is_refused_by_the_file(tmp_path, document):
    for row, material in enumerate(document.values["materials"]):
        if "shininess" in repr(material):
            load_with_damages(
                tmp_path, (document, [(("materials", row, "extras", "rhi", "shininess"), None)])
            )


@settings(QUICK, max_examples=200)
@given(case=DAMAGES)
def test_a_damaged_document_is_read_or_refused(tmp_path, case):
    load_with_damages(tmp_path, case)


@pytest.mark.nightly
@settings(QUICK, max_examples=20_000, derandomize=False)
@given(case=DAMAGES)
def test_thousands_of_damaged_documents_are_read_or_refused(tmp_path, case):
    load_with_damages(tmp_path, case)


@settings(QUICK, max_examples=100)
@given(data=st.data(), document=st.sampled_from(DOCUMENTS))
def test_a_file_with_damaged_bytes_is_read_or_refused(tmp_path, data, document):
    content = bytearray(pack(document.values, document))
    for at, byte in data.draw(
        st.lists(st.tuples(st.integers(0, len(content) - 1), st.integers(0, 255)), max_size=8)
    ):
        content[at] = byte
    load_damaged(tmp_path, bytes(content))
