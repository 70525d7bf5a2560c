"""Images that model files name: formats by a list; none starts a program or ends in a traceback."""

import base64
import random

import numpy as np
import pytest
from gltf_documents import GltfDocument
from image_files import LISTED, WAYS_TO_RUN_A_PROGRAM, ProgramWatch, make_deep_png, save

from renderer.content import load_model
from rhi import ValidationError

TEXELS = np.random.default_rng(2).integers(0, 256, (4, 4, 3), np.uint8)
OBJ = "mtllib {mtl}\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n"
PLY = """ply
format ascii 1.0
comment TextureFile wood.png
element vertex 3
property float x
property float y
property float z
property float s
property float t
element face 1
property list uchar int vertex_indices
end_header
0 0 0 0 0
1 0 0 0 1
0 1 0 1 0
3 0 1 2
"""


def make_gltf(folder, content, where):
    """Write a triangle whose texture has this content; return the path of the file."""
    document = GltfDocument(nodes=[{"mesh": 0}], textures=[{"source": 0}])
    document.values["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    document.mesh(material=0, TEXCOORD_0=np.zeros((3, 2), np.float32))
    if where == "view":
        document.add("images", bufferView=document.view(content), mimeType="image/png")
    elif where == "data":
        document.add("images", uri=f"data:image/png;base64,{base64.b64encode(content).decode()}")
    else:
        (folder / "wood.png").write_bytes(content)
        document.add("images", uri="wood.png")
    return document.write(folder / "a.gltf")


def make_others(folder, content, where):
    """Write an OBJ or a PLY, likewise."""
    (folder / "wood.png").write_bytes(content)
    if where == "ply":
        (folder / "a.ply").write_text(PLY, encoding="utf-8")
        return str(folder / "a.ply")
    material = "newmtl m\nmap_Kd wood.png\n"
    if where == "material file":  # which is an image, too, and is named as the texture of its own material
        (folder / "wood.png").unlink()
        material = content.decode("latin1") + "newmtl m\nmap_Kd a.mtl\n"
    (folder / "a.mtl").write_text(material, encoding="latin1")
    (folder / "a.obj").write_text(OBJ.format(mtl="a.mtl"), encoding="utf-8")
    return str(folder / "a.obj")


MAKERS = {
    **dict.fromkeys(("view", "data", "file"), make_gltf),
    **dict.fromkeys(("obj", "ply", "material file"), make_others),
}


@pytest.mark.parametrize("where", MAKERS)
@pytest.mark.parametrize("content", WAYS_TO_RUN_A_PROGRAM.values(), ids=WAYS_TO_RUN_A_PROGRAM)
def test_no_image_of_a_model_starts_a_program(tmp_path, monkeypatch, content, where):
    from PIL import EpsImagePlugin

    monkeypatch.setattr(EpsImagePlugin, "gs_binary", None)
    programs = ProgramWatch(tmp_path / "programs", monkeypatch)
    scene = load_model(MAKERS[where](tmp_path, content, where))
    assert programs.calls == []
    assert {image.shape for image in scene.images} <= {(2, 2, 4)}  # trimesh's plain grey, in its place
    messages = [omission.what.partition(" (")[0] for omission in scene.omissions]
    assert messages == ["an image that can't be read"] or (where == "material file" and not messages)


@pytest.mark.parametrize("where", [name for name in MAKERS if name != "material file"])
@pytest.mark.parametrize("name", LISTED)
def test_listed_formats_are_read_wherever_a_model_names_them(tmp_path, name, where):
    scene = load_model(MAKERS[where](tmp_path, save(name, TEXELS), where))
    assert scene.omissions == ()
    assert [image.shape for image in scene.images] == [(4, 4, 4)]


@pytest.mark.parametrize("where", [name for name in MAKERS if name != "material file"])
def test_a_damaged_image_is_listed_as_omitted(tmp_path, where):
    outcomes = set()
    for seed in range(20):
        pick, data = random.Random(seed), bytearray(save("PNG" if seed % 2 else "JPEG", TEXELS))
        for _ in range(4):
            data[pick.randrange(len(data))] = pick.randrange(256)
        path = MAKERS[where](tmp_path, bytes(data), where)
        rules = []
        try:
            scene = load_model(path)
        except ValidationError as error:
            rules = [error.rule.id]
        assert rules in ([], ["scene-model-limit"])  # it claims too many pixels
        if not rules:
            assert bool(scene.images) != bool(scene.omissions) or where == "ply"
            outcomes.add(bool(scene.omissions))
    assert outcomes == {True, False}


@pytest.mark.parametrize("size", [1, 2, 3, 4])
def test_sixteen_bits_are_rounded_and_keep_their_transparency(tmp_path, size):
    channels = np.random.default_rng(size).integers(0, 65536, (5, 5, size), np.uint16)
    transparent = channels[2, 2] if size in (1, 3) else None
    content = make_deep_png(channels, transparent)
    (image,) = load_model(make_gltf(tmp_path, content, "view")).images
    rounded = np.rint(channels / 257.0).astype(np.uint8)
    assert np.array_equal(image[..., :3], np.broadcast_to(rounded[..., : 1 if size < 3 else 3], (5, 5, 3)))
    alpha = np.full((5, 5), 255) if size in (1, 3) else rounded[..., -1]
    if transparent is not None:
        alpha[(channels == transparent).all(axis=2)] = 0
    assert np.array_equal(image[..., 3], alpha)
