"""Files that other programs write: some of the glTF Asset Generator (`asset_generator/LICENSE`) and
trimesh's, which it writes for the test. The others are written here in the manner of exporters; no file of
theirs is here.
"""

import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from gltf_documents import TRIANGLE, GltfDocument, pack_glb

from renderer.content import load_model

FOLDER = Path(__file__).with_name("asset_generator")
UP = np.tile(np.float32([[0, 0, 1]]), (3, 1))


def make_triangle(**more):
    document = GltfDocument(nodes=[{"mesh": 0}])
    document.mesh(TRIANGLE, np.array([0, 1, 2], np.uint8), NORMAL=UP, **more)
    return document


def load_mode(number):
    """Return the vertices and the number of triangles of a file of the Asset Generator."""
    scene = load_model(FOLDER / f"Mesh_PrimitiveMode_{number}.gltf")
    assert scene.omissions == ()
    return scene.meshes.vertices["position"], scene.triangle_count


@pytest.mark.parametrize("number", ["01", "02", "03", "08", "09", "10"])
def test_lines_loops_and_strips_of_the_asset_generator_are_the_same_four_sides(number):
    position, triangles = load_mode(number)
    middles = sorted(position.reshape(4, 10, 3).mean(axis=1).round(3).tolist())
    assert triangles == 4 * 16
    assert np.array(middles) == pytest.approx(
        np.array([[-0.5, 0, 0], [0, -0.5, 0], [0, 0.4, 0], [0.5, -0.1, 0]]), abs=1e-3
    )


def test_points_of_the_asset_generator_are_where_its_buffer_has_them():
    position, triangles = load_mode("00")
    stored = np.fromfile(FOLDER / "Mesh_PrimitiveMode_00.bin", "<f4").reshape(1024, 3)
    assert triangles == 1024 * 8
    assert position.reshape(1024, 6, 3).mean(axis=1) == pytest.approx(stored, abs=1e-6)


def test_triangles_of_the_asset_generator_are_a_square():
    position, triangles = load_mode("06")
    assert (triangles, len(position)) == (2, 6)
    assert [position.min(axis=0).tolist(), position.max(axis=0).tolist()] == [[-0.5, -0.5, 0], [0.5, 0.5, 0]]


@pytest.mark.parametrize("kind", ["glb", "gltf"])
def test_a_scene_of_trimesh_is_read_with_its_points_and_paths(tmp_path, kind):
    rng = np.random.default_rng(0)
    positions, colors = rng.uniform(-1, 1, (50, 3)), rng.integers(0, 255, (50, 4)).astype(np.uint8)
    bends = rng.uniform(-1, 1, (9, 3))
    parts = {
        "points": trimesh.PointCloud(positions, colors=colors),
        "path": trimesh.load_path(bends),
        "box": trimesh.creation.box(),
    }
    written = trimesh.Scene(parts).export(file_type=kind)
    if kind == "glb":
        written = {"model.gltf": written}
    for name, content in written.items():
        (tmp_path / name).write_bytes(content)
    scene = load_model(tmp_path / "model.gltf")
    assert scene.omissions == ()
    assert scene.meshes.names == ("points", "path", "box")
    assert scene.meshes.triangle_counts.tolist() == [50 * 8, 8 * 16, 12]
    points, path, box = (scene.meshes.geometry(mesh).vertices for mesh in range(3))
    assert points["position"].reshape(50, 6, 3).mean(axis=1) == pytest.approx(positions, abs=1e-6)
    assert points["color"].reshape(50, 6, 4)[:, 5] == pytest.approx(colors / 255, abs=1e-6)
    middles = (bends[1:] + bends[:-1]) / 2
    assert path["position"].reshape(8, 10, 3).mean(axis=1) == pytest.approx(middles, abs=1e-6)
    assert np.abs(box["position"]).max() == 0.5


def test_one_view_is_interleaved_with_a_stride_and_gaps(tmp_path):
    """As engines write what they draw: 12 bytes of position, 4 of padding, a normal in bytes, a colour in
    bytes."""
    rows = np.zeros(3, [("p", "<f4", 3), ("gap", "<f4"), ("n", "i1", 4), ("c", "u1", 4), ("rest", "<u4", 2)])
    rows["p"], rows["n"][:, 2], rows["c"], rows["gap"] = TRIANGLE, 127, (255, 51, 0, 255), np.nan
    document = GltfDocument(nodes=[{"mesh": 0}])
    document.view(b"something before")
    view = document.view(rows.tobytes(), byteStride=rows.itemsize)
    kinds = (("POSITION", "VEC3", 5126, 0), ("NORMAL", "VEC3", 5120, 16), ("COLOR_0", "VEC4", 5121, 20))
    attributes = {
        name: document.add(
            "accessors",
            bufferView=view,
            byteOffset=at,
            componentType=code,
            count=3,
            type=kind,
            normalized=code < 5126,
        )
        for name, kind, code, at in kinds
    }
    document.add("meshes", primitives=[{"attributes": attributes}])
    document.values["extensionsUsed"] = document.values["extensionsRequired"] = ["KHR_mesh_quantization"]
    vertices = load_model(document.write(tmp_path / "a.glb")).meshes.vertices
    assert vertices["position"].tolist() == TRIANGLE.tolist()
    assert vertices["normal"].tolist() == UP.tolist()
    assert vertices["color"] == pytest.approx(np.tile([1, 0.2, 0, 1], (3, 1)))


def test_chunks_are_padded_with_zeros_and_others_follow(tmp_path):
    document = make_triangle()
    content = pack_glb(
        {**document.values, "buffers": [{"byteLength": len(document.data)}]}, bytes(document.data)
    )
    (length,) = struct.unpack("<I", content[12:16])
    padded = content[20 : 20 + length].rstrip() + bytes(8 - len(content[20 : 20 + length].rstrip()) % 4)
    rest = content[20 + length :] + struct.pack("<II", 4, 0x12345678) + b"more"
    (tmp_path / "a.glb").write_bytes(
        struct.pack("<4sIIII", b"glTF", 2, 20 + len(padded) + len(rest), len(padded), 0x4E4F534A)
        + padded
        + rest
    )
    assert load_model(tmp_path / "a.glb").triangle_count == 1
