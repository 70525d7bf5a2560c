"""Messages about refused glTF files and about parts that are left out: bounds in full, null as null, and
each extension that isn't read, wherever it is used."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterator
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_documents import TRIANGLE, GltfDocument, make_morphing, make_skinned, pack_glb

from renderer.content import load_model, load_scene
from renderer.renderer import Renderer
from renderer.scene import Camera
from rhi import ValidationError, create_device

Step = str | int


def make_full_document() -> GltfDocument:
    """A file that has every number that is read."""
    document = GltfDocument(
        scene=0,
        scenes=[{"nodes": [0, 1, 2, 3, 4]}],
        nodes=[
            {"mesh": 0, "translation": [1, 0, 0], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1]},
            {"mesh": 0, "matrix": np.eye(4).ravel().tolist()},
            {"camera": 0, "extensions": {"KHR_lights_punctual": {"light": 0}}},
            {"camera": 1, "extensions": {"KHR_lights_punctual": {"light": 1}}},
            {"extensions": {"KHR_lights_punctual": {"light": 2}}},
        ],
        cameras=[
            {"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1, "zfar": 9, "aspectRatio": 1.5}},
            {"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1, "znear": 0.1, "zfar": 9}},
        ],
        extensions={
            "KHR_lights_punctual": {
                "lights": [
                    {"type": "spot", "range": 5, "spot": {"outerConeAngle": 0.5, "innerConeAngle": 0.1}},
                    {"type": "point", "color": [1, 1, 1], "intensity": 2, "range": 3},
                    {"type": "directional", "intensity": 1},
                ]
            }
        },
        samplers=[{"minFilter": 9987, "magFilter": 9729, "wrapS": 10497, "wrapT": 10497}],
        textures=[{"source": 0, "sampler": 0}],
    )
    use = {"index": 0, "texCoord": 0}
    use["extensions"] = {"KHR_texture_transform": {"offset": [0, 0], "rotation": 0.1, "scale": [1, 1]}}  # type: ignore[assignment]
    pixel = base64.b64decode(
        "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
    )
    document.add("images", bufferView=document.view(pixel), mimeType="image/png")
    document.add(
        "materials",
        pbrMetallicRoughness={
            "baseColorFactor": [1, 1, 1, 1],
            "metallicFactor": 1,
            "roughnessFactor": 1,
            "baseColorTexture": deepcopy(use),
        },
        normalTexture={**deepcopy(use), "scale": 1},
        occlusionTexture={**deepcopy(use), "strength": 1},
        emissiveFactor=[0.1, 0.1, 0.1],
        alphaCutoff=0.5,
        extensions={"KHR_materials_emissive_strength": {"emissiveStrength": 2}},
    )
    document.mesh(material=0, TEXCOORD_0=np.zeros((3, 2), np.float32), mode=4)
    return document


DOCUMENTS = {"everything": make_full_document(), "a skin": make_skinned(), "targets": make_morphing()}


def list_numbers(value: Any, above: tuple[Step, ...] = ()) -> Iterator[tuple[Step, ...]]:
    """The paths of all numbers of a document, one of each list of numbers."""
    if isinstance(value, bool | str):
        return
    if isinstance(value, int | float):
        yield above
    elif isinstance(value, dict):
        for key, part in value.items():
            yield from list_numbers(part, (*above, key))
    elif isinstance(value, list):
        is_numbers = bool(value) and all(isinstance(part, int | float) for part in value)
        for at, part in enumerate(value[:1] if is_numbers else value):
            yield from list_numbers(part, (*above, at))


NUMBERS = [(name, path) for name, document in DOCUMENTS.items() for path in list_numbers(document.values)]


def write_changed(folder: Path, document: GltfDocument, path: tuple[Step, ...], value: Any) -> Path:
    values = deepcopy(document.values)
    container: Any = values
    for step in path[:-1]:
        container = container[step]
    container[path[-1]] = value
    file = folder / "a.glb"
    whole = {**values, "buffers": [{"byteLength": len(document.data)}]}
    file.write_bytes(pack_glb(whole, bytes(document.data)))
    return file


def explain(file: Path) -> tuple[str, str]:
    """The refusal of a file without its name: given and allowed; or its omissions."""
    try:
        scene = load_model(file)
    except ValidationError as error:
        return error.given.removeprefix(f"{file}: "), error.allowed
    return "; ".join(map(str, scene.omissions)), "read"


def test_the_documents_are_read_whole(tmp_path: Path) -> None:
    for document in DOCUMENTS.values():
        assert load_model(document.write(tmp_path / "a.glb")).omissions == ()
    assert len(NUMBERS) > 100


@pytest.mark.parametrize("name", DOCUMENTS)
def test_messages_name_null_as_null_and_an_absent_value_as_missing(tmp_path: Path, name: str) -> None:
    count = 0
    for path in [path for document, path in NUMBERS if document == name]:
        text, allowed = explain(write_changed(tmp_path, DOCUMENTS[name], path, None))
        if allowed != "read" or text:
            assert "missing" not in text, path
            assert re.search(r"\bnull\b|None", text), (path, text)
            assert "None" not in text or isinstance(path[-1], int), (
                path,
                text,
            )  # in a list, as Python shows it
            count += 1
    assert count > 10


@pytest.mark.parametrize("value", [1e38, -1e38, 2**70, "x", True, []])
@pytest.mark.parametrize("name", DOCUMENTS)
def test_messages_state_both_bounds_of_a_number(tmp_path: Path, name: str, value: Any) -> None:
    """Both ends of a range, all values of a list, or that there is none."""
    count = 0
    for path in [path for document, path in NUMBERS if document == name]:
        text, allowed = explain(write_changed(tmp_path, DOCUMENTS[name], path, value))
        if allowed in ("read", ""):
            continue
        count += 1
        is_range = re.search(r"-?[0-9][0-9.e+-]* to [0-9][0-9.e+-]*", allowed.replace(",", ""))
        is_list = re.fullmatch(r"[A-Z0-9_, ()a-z]+", allowed)
        assert is_range or is_list, (path, text, allowed)
        assert "or more" not in allowed, path
        if is_range and value == 1e38:
            upper = float(is_range[0].split(" to ")[1])
            assert upper < 1e38, (path, allowed)
    assert count > 10


# -- one bad camera ----------------------------------------------------------------------------------------

CAMERAS: dict[str, dict[str, Any]] = {
    "mirrored": {"type": "orthographic", "orthographic": {"xmag": -1, "ymag": 1, "znear": 0.1, "zfar": 9}},
    "flat": {"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 0, "znear": 0.1, "zfar": 9}},
    "reversed": {"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1, "znear": 9, "zfar": 1}},
    "without numbers": {"type": "orthographic"},
    "wide": {"type": "perspective", "perspective": {"yfov": 4, "znear": 0.1}},
    "at the eye": {"type": "perspective", "perspective": {"yfov": 1, "znear": 0}},
    "null": {"type": "perspective", "perspective": {"yfov": None, "znear": 0.1}},
    "fish": {"type": "fisheye"},
    "nothing": {},
}


@pytest.mark.parametrize("name", CAMERAS)
def test_a_bad_camera_is_listed_as_omitted_and_the_rest_is_read(tmp_path: Path, name: str) -> None:
    good = {"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}
    nodes: list[dict[str, Any]] = [{"mesh": 0}, {"camera": 0}, {"camera": 1, "name": "good"}]
    document = GltfDocument(nodes=nodes, cameras=[CAMERAS[name], good])
    document.mesh()
    scene = load_model(document.write(tmp_path / "a.glb"))
    assert list(scene.views) == ["good"]
    assert len(scene.objects) == 1
    (omission,) = scene.omissions
    assert omission.what.startswith("a camera that can't be read (cameras[0].")
    assert omission.where == "cameras[0]"


# -- extensions --------------------------------------------------------------------------------------------


def list_objects(value: Any, above: tuple[Step, ...] = ()) -> Iterator[tuple[Step, ...]]:
    """The paths of all objects of a document, those in `extras` and of extensions' names left out."""
    if isinstance(value, dict):
        if above and above[-1] != "extensions":
            yield above
        for key, part in value.items():
            if key != "extras":
                yield from list_objects(part, (*above, key))
    elif isinstance(value, list):
        for at, part in enumerate(value):
            yield from list_objects(part, (*above, at))


OBJECTS = [(name, path) for name, document in DOCUMENTS.items() for path in list_objects(document.values)]


@pytest.mark.parametrize("extension", ["EXT_unheard_of", "KHR_materials_variants", "KHR_texture_basisu"])
def test_an_unknown_extension_is_listed_wherever_it_is_used(tmp_path: Path, extension: str) -> None:
    for name, path in OBJECTS:
        if {"attributes", "targets"} & set(path):  # whose fields are accessors
            continue
        values = deepcopy(DOCUMENTS[name].values)
        container: Any = values
        for step in path:
            container = container[step]
        container.setdefault("extensions", {})[extension] = {}
        values["extensionsUsed"] = [extension]
        whole = {**values, "buffers": [{"byteLength": len(DOCUMENTS[name].data)}]}
        (tmp_path / "a.glb").write_bytes(pack_glb(whole, bytes(DOCUMENTS[name].data)))
        (omission,) = load_model(tmp_path / "a.glb").omissions
        where = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path).lstrip(".")
        assert (omission.what, omission.where, omission.count) == (extension, where, 1)
    assert len(OBJECTS) > 60


def test_an_extension_of_the_whole_file_is_listed_where_its_parts_are_used(tmp_path: Path) -> None:
    document = GltfDocument(nodes=[{"mesh": 0}], extensionsUsed=["KHR_materials_variants"])
    document.values["extensions"] = {"KHR_materials_variants": {"variants": [{"name": "red"}]}}
    document.mesh()
    (omission,) = load_model(document.write(tmp_path / "a.glb")).omissions
    assert str(omission) == "KHR_materials_variants (the file)"
    primitive = document.values["meshes"][0]["primitives"][0]
    primitive["extensions"] = {"KHR_materials_variants": {"mappings": []}}
    (omission,) = load_model(document.write(tmp_path / "a.glb")).omissions
    assert str(omission) == "KHR_materials_variants (meshes[0].primitives[0])"


def test_a_supported_extension_is_listed_at_objects_where_it_is_not_read(tmp_path: Path) -> None:
    document = GltfDocument(nodes=[{"mesh": 0}], extensionsUsed=["KHR_materials_unlit"])
    document.mesh()
    document.values["meshes"][0]["extensions"] = {"KHR_materials_unlit": {}}
    (omission,) = load_model(document.write(tmp_path / "a.glb")).omissions
    assert str(omission) == "KHR_materials_unlit (meshes[0])"


def test_unsupported_morph_attributes_are_listed(tmp_path: Path) -> None:
    document = make_morphing()
    (first, _) = document.values["meshes"][0]["primitives"][0]["targets"]
    first["TEXCOORD_0"] = first["_OWN"] = document.accessor(np.zeros((3, 2), np.float32))
    where = "meshes[0].primitives[0].targets[0]"
    messages = [str(omission) for omission in load_model(document.write(tmp_path / "a.glb")).omissions]
    assert messages == [f"offsets of {name} in a morph target ({where})" for name in ("TEXCOORD_0", "_OWN")]


# -- versions and addresses --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("asset", "problem"),
    [
        ({"version": "2.0"}, ""),
        ({"version": "2.7"}, ""),
        ({"version": "2.0", "minVersion": "2.0"}, ""),
        ({"version": "2.7", "minVersion": "2.0"}, ""),
        ({"version": "2.0", "minVersion": "1.0"}, ""),
        ({"version": "2.7", "minVersion": "2.1"}, "minVersion: 2.1"),
        ({"version": "2.0", "minVersion": "3.0"}, "minVersion: 3.0"),
        ({"version": "2.0", "minVersion": "two"}, "minVersion: two"),
        ({"version": "2.0", "minVersion": None}, "minVersion: null"),
        ({"version": "2.0", "minVersion": 2.0}, "minVersion: 2.0"),
        ({"version": "1.0"}, "version: 1.0"),
        ({"version": "3.0", "minVersion": "2.0"}, "version: 3.0"),
        ({"version": "2x"}, "version: 2x"),
        ({"version": None}, "version: null"),
        ({}, "version: missing"),
    ],
)
def test_a_version_is_refused_by_the_field_that_says_it(
    tmp_path: Path, asset: dict[str, Any], problem: str
) -> None:
    document = GltfDocument(nodes=[{"mesh": 0}])
    document.mesh()
    document.values["asset"] = asset
    text, allowed = explain(Path(document.write(tmp_path / "a.glb")))
    assert text == (f"asset.{problem}" if problem else "")
    assert ("2.0" in allowed) == bool(problem) or "string" in allowed


ADDRESSES = {
    "b.bin": True,
    "./b.bin": True,
    "sub/../b.bin": True,
    "with%20space.bin": True,
    "with space.bin": True,
    "file:///{folder}/b.bin": True,
    "FILE:///{folder}/b.bin": True,
    "file://localhost/{folder}/b.bin": True,
    "file:///{folder}/with%20space.bin": True,
    "file:b.bin": True,
    "{folder}/b.bin": True,
    "file://elsewhere/{folder}/b.bin": False,
    "file:///{folder}/../out.bin": False,
    "file:///{folder}/missing.bin": False,
    "file:": False,
    "https://example.org/b.bin": False,
    "ftp://example.org/b.bin": False,
    "": False,
}


@pytest.mark.parametrize("address", ADDRESSES)
def test_local_addresses_are_read_and_others_refused(tmp_path: Path, address: str) -> None:
    folder = tmp_path / "model"
    (folder / "sub").mkdir(parents=True)
    for name in ("b.bin", "with space.bin", "../out.bin"):
        (folder / name).write_bytes(TRIANGLE.tobytes())
    document = GltfDocument(nodes=[{"mesh": 0}])
    document.mesh()
    uri = address.replace("/{folder}", str(folder)).replace("{folder}", str(folder))
    values = document.values | {"buffers": [{"byteLength": TRIANGLE.nbytes, "uri": uri}]}
    (folder / "a.gltf").write_text(json.dumps(values), encoding="utf-8")
    text, allowed = explain(folder / "a.gltf")
    assert (allowed == "read") == ADDRESSES[address], (text, allowed)
    if not ADDRESSES[address]:
        assert text.startswith(f"buffers[0].uri: {uri}"[:60])


# -- numbers that aren't -----------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_weights_of_joints_that_are_no_numbers_are_refused(tmp_path: Path, value: float) -> None:
    document = make_skinned()
    attributes = document.values["meshes"][0]["primitives"][0]["attributes"]
    weights = np.tile(np.float32([1, 0, 0, 0]), (10, 1))
    attributes["WEIGHTS_0"] = document.accessor(weights)
    assert explain(Path(document.write(tmp_path / "a.glb"))) == ("", "read")
    weights[3, 1] = value
    attributes["WEIGHTS_0"] = document.accessor(weights)
    text, allowed = explain(Path(document.write(tmp_path / "a.glb")))
    assert text.startswith("meshes[0].primitives[0].attributes.WEIGHTS_0: vertex 3 is [1.0, ")
    assert allowed == "finite numbers"


@pytest.mark.parametrize("seconds", [1e18, -1e18, 1e300, 1.1e12])
def test_a_time_that_no_step_reaches_is_refused(seconds: float) -> None:
    scene = load_scene("yard:pools=1")
    camera = Camera.look_at((0.0, 2.0, 8.0), (0.0, 0.0, 0.0))
    with create_device("null") as device, Renderer(device, scene, size=(16, 16)) as renderer:
        with pytest.raises(ValidationError) as error:
            renderer.render(camera, seconds)
        assert (error.value.rule.id, error.value.allowed) == ("animation-time", "-1e+12 to 1e+12")
        with pytest.raises(ValidationError, match="scene-not-finite"):
            renderer.render(camera, np.nan)
        renderer.render(camera, 1.7e9)  # the time of day of a clock


# -- hostile values ----------------------------------------------------------------------------------------

HOSTILE: dict[str, Any] = {
    "negative": -1,
    "fraction": 0.5,
    "31 bits": 2**31,
    "63 bits": 2**63,
    "400 digits": 10**400,
    "infinite": float("inf"),
    "negative infinity": -float("inf"),
    "nan": float("nan"),
    "text": "1",
    "object": {},
}
NEVER_A_NUMBER = ("infinite", "negative infinity", "nan", "text", "object", "400 digits")


def step_text(path: tuple[Step, ...]) -> str:
    """A path as refusals write it."""
    text = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path)
    return text.removeprefix(".")


def check_hostile_value(folder: Path, document: GltfDocument, path: tuple[Step, ...], kind: str) -> bool:
    """Return whether a value is refused, by a message that names its path or where that leads."""
    file = write_changed(folder, document, path, HOSTILE[kind])
    text, allowed = explain(file)
    if allowed == "read":
        assert kind not in NEVER_A_NUMBER or text, (path, kind)
        return False
    assert (step_text(path[:-1]) or step_text(path)) in text, (path, text)
    return True


@pytest.mark.parametrize("kind", HOSTILE)
def test_hostile_numbers_of_files_are_refused_with_their_path(tmp_path: Path, kind: str) -> None:
    sample = NUMBERS[len(kind) % 5 :: 5]
    refused = [check_hostile_value(tmp_path, DOCUMENTS[name], path, kind) for name, path in sample]
    assert sum(refused) > len(refused) // 3


@pytest.mark.nightly
@pytest.mark.parametrize("kind", HOSTILE)
@pytest.mark.parametrize("name", DOCUMENTS)
def test_all_hostile_numbers_of_files_are_refused_with_their_path(
    tmp_path: Path, name: str, kind: str
) -> None:
    paths = [path for document, path in NUMBERS if document == name]
    refused = [check_hostile_value(tmp_path, DOCUMENTS[name], path, kind) for path in paths]
    assert sum(refused) > len(refused) // 3


UNREADABLE_ADDRESSES = {
    "a zero": "a\0b",
    "an escaped zero": "%00",
    "a zero in a file address": "file:///%00",
    "half a pair": "\ud800",
    "too long": "x" * 5000,
    "nothing": "",
    "this folder": ".",
    "a device": "/dev/zero",
    "another computer": "http://host/a.bin",
    "half a host": "http://[",
    "cut base64": "data:application/octet-stream;base64,AAA",
    "no base64": "data:,",
}


@pytest.mark.parametrize("uri", UNREADABLE_ADDRESSES.values(), ids=UNREADABLE_ADDRESSES)
@pytest.mark.parametrize("field", ["buffers", "images"])
def test_addresses_that_name_no_file_are_refused_with_their_path(
    tmp_path: Path, field: str, uri: str
) -> None:
    document = make_full_document()
    values = {**document.values, "buffers": [{"byteLength": len(document.data), "uri": "data.bin"}]}
    (tmp_path / "data.bin").write_bytes(document.data)
    file = tmp_path / "a.gltf"
    file.write_text(json.dumps(values), encoding="utf-8")
    assert load_model(file).omissions == ()
    changed = deepcopy(values)
    changed[field][0] = {"byteLength": len(document.data), "uri": uri}
    file.write_text(json.dumps(changed), encoding="utf-8")
    text, allowed = explain(file)
    assert f"{field}[0].uri: " in text, (text, allowed)  # an image is left out, by name
    assert (allowed == "read") is (field == "images")


def test_a_file_cut_at_any_byte_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "a.glb"
    for document in DOCUMENTS.values():
        content = Path(document.write(file)).read_bytes()
        for length in range(0, len(content), 97):
            file.write_bytes(content[:length])
            text, allowed = explain(file)
            assert allowed != "read", (length, text)


def test_thousands_of_cameras_with_the_same_name_have_short_names(tmp_path: Path) -> None:
    camera = {"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}
    nodes: list[dict[str, Any]] = [{"mesh": 0}, *([{"camera": 0, "name": "door"}] * 2000)]
    document = GltfDocument(nodes=nodes, cameras=[camera])
    document.mesh()
    views = list(load_model(document.write(tmp_path / "a.glb")).views)
    assert views[:4] == ["door", "door'", "door'3", "door'4"]
    assert len(set(views)) == 2000
    assert max(map(len, views)) < 12


def test_a_map_that_is_stretched_without_bounds_has_finite_tangents(tmp_path: Path) -> None:
    document = make_full_document()
    transform = document.values["materials"][0]["normalTexture"]["extensions"]["KHR_texture_transform"]
    transform |= {"scale": [1e-29, 1e29], "rotation": 0.0}
    uv = np.float32([[0, 0], [1e30, 0], [0, 1e-30]])
    mesh = document.values["meshes"][0]["primitives"][0]["attributes"]
    mesh["TEXCOORD_0"] = document.accessor(uv)
    with np.errstate(over="raise"):
        scene = load_model(document.write(tmp_path / "a.glb"))
    assert scene.meshes.with_tangents
    assert np.isfinite(scene.meshes.vertices["tangent"]).all()
