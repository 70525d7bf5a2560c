"""Model files: what is read from them, and what is refused."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from gltf_documents import GltfDocument

from renderer.content import add_model, load_model, load_scene, save_scene
from renderer.scene import SceneBuilder
from rhi.errors import ValidationError

OBJ = """mtllib two.mtl
v 0 0 0
v 1 0 0
v 0 1 0
v 0 0 1
vt 0 0
vt 1 0
vt 0 1
usemtl red
f 1/1 2/2 3/3
usemtl blue
f 1/1 3/3 4/2
"""
MTL = "newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n"
PLY = """ply
format ascii 1.0
element vertex 3
property float x
property float y
property float z
element face {faces}
property list uchar int vertex_indices
end_header
{vertices}
"""
STL = """solid one
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1 0
endloop
endfacet
endsolid one
"""


def refusal(path):
    with pytest.raises(ValidationError) as error:
        load_model(str(path))
    assert str(path) in str(error.value)
    return error.value.rule.id


def test_obj_keeps_materials_and_texture_coordinates(tmp_path):
    (tmp_path / "two.mtl").write_text(MTL, encoding="utf-8")
    (tmp_path / "two.obj").write_text(OBJ, encoding="utf-8")
    scene = load_model(str(tmp_path / "two.obj"))
    assert scene.triangle_count == 2
    colors = scene.materials["base_color"][scene.objects.material][:, :3]
    assert sorted(colors.tolist()) == [[0, 0, 1], [1, 0, 0]]
    corner = scene.meshes.vertices[(scene.meshes.vertices["position"] == (0, 1, 0)).all(1)]
    assert np.allclose(corner["uv"], (0, 0))  # v = 1 in the file is the image's first row


def test_a_texture_is_kept_and_its_first_row_is_the_top(tmp_path):
    from PIL import Image

    pixels = np.zeros((2, 2, 3), np.uint8)
    pixels[0] = (255, 0, 0)
    Image.fromarray(pixels).save(tmp_path / "paint.png")
    (tmp_path / "two.mtl").write_text(
        "newmtl red\nmap_Kd paint.png\nnewmtl blue\nKd 0 0 1\n", encoding="utf-8"
    )
    (tmp_path / "two.obj").write_text(OBJ, encoding="utf-8")
    scene = load_model(str(tmp_path / "two.obj"))
    assert len(scene.images) == 1
    assert scene.images[0][0].tolist() == [[255, 0, 0, 255]] * 2
    assert sorted(scene.materials["texture"].tolist()) == [-1, 0]


def test_ply_and_stl_are_read(tmp_path):
    (tmp_path / "a.ply").write_text(
        PLY.format(faces=1, vertices="0 0 0\n1 0 0\n0 1 0\n3 0 1 2"), encoding="utf-8"
    )
    (tmp_path / "a.stl").write_text(STL, encoding="utf-8")
    for name in ("a.ply", "a.stl"):
        scene = load_scene(str(tmp_path / name))
        assert scene.triangle_count == 1
        assert np.allclose(scene.objects.upper[0], (1, 1, 0))
        assert {"ground", "sky"} == set(scene.paths)
        assert np.allclose(np.abs(scene.meshes.vertices["normal"]), (0, 0, 1))


def test_a_grid_of_a_model_file(tmp_path):
    (tmp_path / "a.ply").write_text(
        PLY.format(faces=1, vertices="5 5 5\n9 5 5\n5 9 5\n3 0 1 2"), encoding="utf-8"
    )
    scene = load_scene(f"grid:mesh={tmp_path / 'a.ply'},count=3")
    assert scene.triangle_count == 3
    assert scene.meshes.upper[0].max() == pytest.approx(1.0)


def test_a_model_far_from_its_origin_keeps_its_shape(tmp_path):
    far = "\n".join(f"{4e6 + x} {y} 0" for x, y in ((0, 0), (0.125, 0), (0, 0.125)))
    (tmp_path / "far.ply").write_text(
        PLY.replace("float", "double").format(faces=1, vertices=far + "\n3 0 1 2"), encoding="utf-8"
    )
    scene = load_model(str(tmp_path / "far.ply"))
    assert np.allclose(scene.objects.upper - scene.objects.lower, (0.125, 0.125, 0.0), atol=1e-6)
    assert scene.objects.lower[0, 0] == pytest.approx(4e6)
    assert np.abs(scene.meshes.vertices["position"]).max() < 1.0


def test_a_missing_file_is_refused():
    assert refusal("no/such/model.glb") == "scene-missing-file"


def test_an_unknown_extension_is_refused(tmp_path):
    (tmp_path / "model.fbx").write_bytes(b"x")
    with pytest.raises(ValidationError, match=r"\.gltf, \.glb, \.obj, \.ply, \.stl") as error:
        load_model(str(tmp_path / "model.fbx"))
    assert error.value.rule.id == "scene-unknown-format"


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("a.glb", "scene-unreadable-model"),
        ("a.gltf", "scene-unreadable-model"),
        ("a.ply", "scene-unreadable-model"),
        ("a.stl", "scene-empty-model"),  # these two are plain text, in which no triangle is found
        ("a.obj", "scene-empty-model"),
    ],
)
def test_rubbish_is_refused(tmp_path, name, rule):
    (tmp_path / name).write_bytes(b"\x00\x01rubbish" * 40)
    assert refusal(tmp_path / name) == rule


def test_a_folder_is_refused(tmp_path):
    (tmp_path / "folder.obj").mkdir()
    assert refusal(tmp_path / "folder.obj") == "scene-unreadable-model"


@pytest.mark.parametrize("name", ["a.glb", "a.obj", "a.ply", "a.stl"])
def test_an_empty_file_is_refused(tmp_path, name):
    (tmp_path / name).write_bytes(b"")
    assert refusal(tmp_path / name) == "scene-empty-model"


def test_points_without_triangles_are_refused(tmp_path):
    (tmp_path / "points.ply").write_text(
        PLY.format(faces=0, vertices="0 0 0\n1 0 0\n0 1 0"), encoding="utf-8"
    )
    assert refusal(tmp_path / "points.ply") == "scene-empty-model"


@pytest.mark.parametrize("bad", ["nan", "inf", "1e39"])
def test_vertices_that_are_not_finite_are_refused(tmp_path, bad):
    (tmp_path / "bad.ply").write_text(
        PLY.replace("float", "double").format(faces=1, vertices=f"0 0 0\n1 {bad} 0\n0 1 0\n3 0 1 2"),
        encoding="utf-8",
    )
    assert refusal(tmp_path / "bad.ply") == "scene-bad-vertices"


def test_a_nan_in_gltf_is_refused(tmp_path):
    document = GltfDocument(nodes=[{"mesh": 0}])
    document.mesh([[0, 0, 0], [1, float("nan"), 0], [0, 1, 0]])
    assert refusal(document.write(tmp_path / "model.gltf")) == "scene-bad-vertices"


def test_a_face_that_names_a_missing_vertex_is_refused(tmp_path):
    (tmp_path / "bad.ply").write_text(
        PLY.format(faces=1, vertices="0 0 0\n1 0 0\n0 1 0\n3 0 1 7"), encoding="utf-8"
    )
    assert refusal(tmp_path / "bad.ply") == "scene-unreadable-model"


def test_scenes_without_files_import_no_reader_of_files() -> None:
    program = "import sys, renderer.content; print(*{'renderer.content.gltf', 'trimesh'} & {*sys.modules})"
    assert (
        subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, check=True, encoding="utf-8"
        ).stdout
        == "\n"
    )


def test_a_model_is_loaded_from_a_path_or_a_text_and_saved_again(tmp_path: Path) -> None:
    saved = tmp_path / "box.glb"
    save_scene(load_scene("grid:count=1"), saved)
    scenes = load_model(saved), load_model(str(saved))
    assert scenes[0].name == scenes[1].name == str(saved)
    save_scene(scenes[0], tmp_path / "again.glb")
    assert len(load_model(tmp_path / "again.glb").objects) == len(scenes[0].objects)
    builder = SceneBuilder("two")
    add_model(builder, saved)
    add_model(builder, str(saved))
    assert builder.object_count == 2 * len(scenes[0].objects)
