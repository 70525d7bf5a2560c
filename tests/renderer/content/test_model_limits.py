"""The limits of a model file: bytes, pixels, vertices and time are limited, and files elsewhere aren't
read."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from image_files import make_png
from PIL import Image

from renderer.content import ModelLimits, load_model, load_scene
from renderer.content.limits import Budget
from rhi import ValidationError

TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")


def write(
    folder: Path, *, buffer: str = "a.bin", image: str = "", accessors: Any = None, meshes: int = 1
) -> Path:
    """Write a file of one triangle, or of other accessors of positions, textured if there is an image."""
    views = [{"buffer": 0, "byteLength": TRIANGLE.nbytes}]
    first = {"type": "VEC3", "componentType": 5126, "count": 3, "bufferView": 0}
    document: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": buffer, "byteLength": TRIANGLE.nbytes}],
        "bufferViews": views,
        "accessors": accessors or [first],
        "meshes": [
            {"primitives": [{"attributes": {"POSITION": number % len(accessors or [first])}, "material": 0}]}
            for number in range(meshes)
        ],
        "materials": [{}],
        "nodes": [{"mesh": number} for number in range(meshes)],
    }
    if image:
        document["images"], document["textures"] = [{"uri": image}], [{"source": 0}]
        document["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    folder.mkdir(exist_ok=True)
    (folder / "a.bin").write_bytes(TRIANGLE.tobytes())
    path = folder / "a.gltf"
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def refused(load: Callable[[], object]) -> ValidationError:
    with pytest.raises(ValidationError) as error:
        load()
    return error.value


@pytest.mark.parametrize("count", [1 << 24, 1 << 31])
def test_a_few_characters_of_json_do_not_take_gigabytes(tmp_path: Path, count: int) -> None:
    zeros = {"type": "VEC3", "componentType": 5126, "count": count}
    error = refused(lambda: load_model(write(tmp_path, accessors=[zeros])))
    assert error.rule.id == "scene-model-limit"
    assert "elements without bytes" in error.given


def test_neither_do_many_accessors_of_a_few_elements_each(tmp_path: Path) -> None:
    zeros = [{"type": "VEC3", "componentType": 5126, "count": 1 << 17} for _ in range(9)]
    assert (
        refused(lambda: load_model(write(tmp_path, accessors=zeros, meshes=9))).rule.id == "scene-model-limit"
    )
    budget = Budget("a.gltf", used={"bytes": 1 << 20})
    budget.spend_zeros((1 << 20) + 16 * (1 << 20))  # as many as a large file has bytes for
    assert refused(lambda: budget.spend_zeros(1)).rule.id == "scene-model-limit"
    few = write(tmp_path, accessors=[zeros[0] | {"count": 30}] * 9, meshes=9)
    assert len(load_model(few).objects) == 9


def test_bytes_vertices_and_seconds_are_counted(tmp_path: Path) -> None:
    path = write(tmp_path)
    size = path.stat().st_size + TRIANGLE.nbytes
    for limits, least in ((ModelLimits(bytes=size), size - 1), (ModelLimits(vertices=6), 5)):
        (name,) = {
            field
            for field in ("bytes", "vertices")
            if getattr(limits, field) != getattr(ModelLimits(), field)
        }
        assert len(load_model(path, limits).objects) == 1
        error = refused(lambda name=name, least=least: load_model(path, ModelLimits(**{name: least})))  # type: ignore[misc]
        assert error.rule.id in ("scene-model-limit", "scene-unreadable-model")
        assert f"{least:,}" in error.allowed or "bytes" in error.given
    with pytest.raises(OSError, match="more than 9 bytes"):  # before they are read
        Budget("a.gltf", ModelLimits(bytes=9)).read(path)
    error = refused(lambda: load_model(path, ModelLimits(seconds=0.0)))
    assert (error.rule.id, error.allowed) == ("scene-model-limit", "at most 0 s")
    assert len(load_scene(f"{path}:unlimited").objects) == 1


def test_the_pixels_of_an_image_are_counted_before_it_is_decoded(tmp_path: Path) -> None:
    path = write(tmp_path, image="a.png")
    rows = bytes((1 + 8200 // 8) * 8192)  # of a bit for each pixel
    (tmp_path / "a.png").write_bytes(make_png(8193, 8192, rows, depth=1, color_type=0))
    error = refused(lambda: load_model(path))
    assert error.rule.id == "scene-model-limit"
    assert "67,117,056 pixels" in error.given
    Image.new("RGB", (8, 4)).save(tmp_path / "a.png")
    assert load_model(path, ModelLimits(pixels=256)).images[0].shape == (4, 8, 4)
    assert refused(lambda: load_model(path, ModelLimits(pixels=255))).rule.id == "scene-model-limit"
    budget = Budget("a.gltf", ModelLimits(pixels=600))
    content = (tmp_path / "a.png").read_bytes()
    for _ in range(18):
        budget.spend_image(content)
    assert refused(lambda: budget.spend_image(content)).rule.id == "scene-model-limit"  # all together


@pytest.mark.parametrize("suffix", [".gltf", ".glb", ".obj", ".ply", ".stl"])
def test_a_pipe_or_folder_is_refused_instead_of_waited_for(tmp_path: Path, suffix: str) -> None:
    pipe, folder = tmp_path / f"pipe{suffix}", tmp_path / f"folder{suffix}"
    os.mkfifo(pipe)
    folder.mkdir()
    for path in (pipe, folder):
        error = refused(lambda path=path: load_model(path))  # type: ignore[misc]
        assert error.rule.id == "scene-unreadable-model"
        assert "isn't a regular file" in error.given


def test_neither_is_a_buffer_or_an_image(tmp_path: Path) -> None:
    path = write(tmp_path, buffer="pipe")
    os.mkfifo(tmp_path / "pipe")
    assert "isn't a regular file" in refused(lambda: load_model(path)).given
    path = write(tmp_path, image="pipe")
    assert "isn't a regular file" in str(load_model(path).omissions[0])


@pytest.mark.parametrize("uri", ["../out.bin", "{}/out.bin", "link.bin", "a/../../out.bin", "%2e%2e/out.bin"])
def test_files_elsewhere_are_read_only_if_that_is_asked_for(tmp_path: Path, uri: str) -> None:
    (tmp_path / "out.bin").write_bytes(TRIANGLE.tobytes())
    inside = tmp_path / "inside"
    path = write(inside, buffer=uri.format(tmp_path))
    (inside / "a").mkdir()
    (inside / "link.bin").symlink_to(tmp_path / "out.bin")
    error = refused(lambda: load_model(path))
    assert error.rule.id == "scene-unreadable-model"
    assert str(inside) in error.allowed
    assert "outside" in error.allowed
    assert len(load_model(path, ModelLimits(outside=True)).objects) == 1
    scene = load_scene(f"{path}:outside")
    assert scene.name == f"{path}:outside"


def test_files_below_the_folder_are_read(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "b.bin").write_bytes(TRIANGLE.tobytes())
    assert len(load_model(write(tmp_path, buffer="data/b.bin")).objects) == 1


def test_a_material_of_an_obj_elsewhere_is_not_read(tmp_path: Path) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    Image.new("RGB", (2, 2), (255, 0, 0)).save(inside / "red.png")
    triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n"
    for folder in (tmp_path, inside):
        (folder / "m.mtl").write_text("newmtl m\nmap_Kd red.png\n", encoding="utf-8")
    (inside / "a.obj").write_text(f"mtllib ../m.mtl\n{triangle}", encoding="utf-8")
    (inside / "b.obj").write_text(f"mtllib m.mtl\n{triangle}", encoding="utf-8")
    assert [image[0, 0, 0] for image in load_model(inside / "b.obj").images] == [255]
    for limits in (ModelLimits(pixels=4), ModelLimits(vertices=5), ModelLimits(bytes=len(triangle))):
        error = refused(lambda limits=limits: load_model(inside / "b.obj", limits))  # type: ignore[misc]
        assert error.rule.id in ("scene-model-limit", "scene-unreadable-model")
    assert len(load_model(inside / "b.obj", ModelLimits(vertices=6)).objects) == 1
    (inside / "red.png").unlink()
    os.mkfifo(inside / "red.png")
    load_model(inside / "b.obj")  # doesn't wait
    (inside / "m.mtl").unlink()
    assert [image[0, 0, 0] for image in load_model(inside / "a.obj").images] != [255]
