"""Files that others have made: those of the Debian package assimp-testmodels, where it is installed.

`RHI_TEST_MODELS` names another folder with its contents.
"""

import os
from pathlib import Path

import numpy as np
import pytest

from renderer.content import load_model, save_scene
from rhi.errors import ValidationError

FOLDER = Path(os.environ.get("RHI_TEST_MODELS", "/usr/share/assimp/models")) / "glTF2"

pytestmark = pytest.mark.skipif(
    not FOLDER.is_dir(), reason=f"there is no {FOLDER}: install assimp-testmodels, or set RHI_TEST_MODELS"
)


def load(name):
    return load_model(str(FOLDER / name))


def test_a_large_scene_is_read_and_read_back_the_same(tmp_path):
    engine = load("2CylinderEngine-glTF-Binary/2CylinderEngine.glb")
    assert (len(engine.nodes), len(engine.objects), engine.triangle_count) == (82, 115, 121_496)
    assert len(engine.materials) == 34
    assert list(engine.views) == ["camera 0"]
    assert engine.omissions == ()
    assert save_scene(engine, tmp_path / "engine.glb") == ()
    again = load_model(str(tmp_path / "engine.glb"))
    assert (again.meshes.vertices == engine.meshes.vertices).all()
    assert (again.nodes.world == engine.nodes.world).all()
    assert (again.objects.mesh == engine.objects.mesh).all()


def test_unsupported_material_extensions_of_a_downloaded_model_are_listed():
    coated = load("ClearCoat-glTF/ClearCoatTest.gltf")
    assert [(omission.what, omission.count) for omission in coated.omissions] == [
        ("KHR_materials_clearcoat", 6)
    ]


def test_texture_transforms_are_read():
    scene = load("textureTransform/TextureTransformTest.gltf")
    still = np.eye(3)[:2]
    assert (np.abs(scene.textures["transform"] - still).max(axis=(1, 2)) > 0.0).sum() >= 5


@pytest.mark.parametrize(
    ("name", "location"),
    [
        ("IndexOutOfRange/IndexOutOfRange.gltf", "accessors[0]"),
        ("MissingBin/BoxTextured.gltf", "buffers[0].uri"),
        ("RecursiveNodes/RecursiveNodes.gltf", "scenes[0].nodes[0]"),
        ("wrongTypes/badArray.gltf", "meshes[0].primitives"),
        ("wrongTypes/badUint.gltf", "materials[0].pbrMetallicRoughness.baseColorTexture.index"),
        ("draco/2CylinderEngine.gltf", "extensionsRequired"),
    ],
)
def test_broken_files_are_refused_with_the_path(name, location):
    with pytest.raises(ValidationError) as error:
        load(name)
    assert error.value.given.startswith(f"{FOLDER / name}: {location}: ")


def test_every_file_is_read_or_refused_by_its_name():
    paths = [path for path in FOLDER.rglob("*") if path.suffix in (".gltf", ".glb")]
    assert len(paths) > 40
    read = 0
    for path in paths:
        try:
            read += len(load_model(str(path)).objects) > 0
        except ValidationError as error:
            assert str(path) in str(error)  # noqa: PT017
    assert read > 20
