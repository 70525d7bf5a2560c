"""Frames of glTF files: OpenCL's beside OpenGL's, pixel by pixel."""

import io
import os
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from gltf_documents import STRIP, make_skinned
from PIL import Image

from renderer.content import load_model
from renderer.renderer import Renderer
from renderer.scene import Camera, Perspective
from renderer.techniques import Forward
from renderer.visibility import NoCulling
from tests.renderer.conftest import open_device

FOLDER = Path(os.environ.get("RHI_TEST_MODELS", "/usr/share/assimp/models")) / "glTF2"
SIZE = (64, 48)


@pytest.fixture(scope="module")
def devices():
    with ExitStack() as stack:
        opened = []
        for name in ("gl", "cl"):
            opened.append(stack.enter_context(open_device(name)))
            if not opened[-1].capabilities.renders:
                pytest.skip(f"the {name} device draws nothing")
        yield opened


def draw(devices, scene, camera, seconds):
    """Return each device's frames (times, h, w, 3), drawn by forward shading."""
    results = []
    for device in devices:
        with Renderer(device, scene, visibility=NoCulling(scene), size=SIZE) as renderer:
            renderer.technique = Forward()
            images = [renderer.render(camera, time).image.read()[..., :3] for time in seconds]
        results.append(np.stack(images).astype(int))
    return results


def add_texture(document, seed, low, high):
    """Add an image of random blocks of 2 × 2 texels and a texture of it; return the texture's number."""
    rng = np.random.default_rng(seed)
    pixels = rng.integers(low, high, (8, 8, 3), np.uint8).repeat(2, axis=0).repeat(2, axis=1)
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    image = document.add("images", bufferView=document.view(file.getvalue()), mimeType="image/png")
    return document.add("textures", source=image)


def make_file():
    """A strip that its bones bend beside one that its target shifts, with all maps, on two sets of texture
    coordinates and a transform, lit by a sun, a point light and a spot light, before a camera."""
    document = make_skinned()
    nodes = document.values["nodes"]
    uv = np.stack([STRIP[:, 0], STRIP[:, 1] / 4], 1).astype(np.float32)
    tangents = np.tile(np.float32([[1, 0, 0, 1]]), (len(STRIP), 1))
    (first,) = document.values["meshes"][0]["primitives"]
    first["attributes"] |= {
        "TEXCOORD_0": document.accessor(uv),
        "TEXCOORD_1": document.accessor(1 - uv),
        "TANGENT": document.accessor(tangents),
    }
    shift = np.zeros_like(STRIP)
    shift[-4:, 0] = 1.5
    attributes = first["attributes"].items()
    shared = {name: number for name, number in attributes if not name.startswith(("JOINTS", "WEIGHTS"))}
    target = {"POSITION": document.accessor(shift)}
    second = {"attributes": shared, "indices": first["indices"], "targets": [target]}
    document.add("meshes", primitives=[second], weights=[0.0])
    base, rough, normal, dark, bright = (
        add_texture(document, seed, low, high)
        for seed, (low, high) in enumerate([(60, 255), (90, 255), (110, 146), (100, 255), (0, 120)])
    )
    nearest = document.add("samplers", magFilter=9728, minFilter=9728)
    document.values["textures"][normal]["sampler"] = nearest  # normals filtered to 8 bits are up to 0.45° off
    turned = {
        "extensions": {"KHR_texture_transform": {"scale": [2, 3], "rotation": 0.4, "offset": [0.25, 0]}}
    }
    first["material"] = document.add(
        "materials",
        pbrMetallicRoughness={
            "baseColorTexture": {"index": base},
            "metallicFactor": 0.2,
            "roughnessFactor": 0.6,
        },
        normalTexture={"index": normal},
        emissiveTexture={"index": bright, "texCoord": 1},
        emissiveFactor=[0.5, 0.3, 0.1],
        doubleSided=True,
    )
    second["material"] = document.add(
        "materials",
        pbrMetallicRoughness={
            "baseColorTexture": {"index": base, "texCoord": 1, **turned},
            "metallicRoughnessTexture": {"index": rough},
        },
        occlusionTexture={"index": dark, "texCoord": 1},
        doubleSided=True,
    )
    document.add("cameras", type="perspective", perspective={"yfov": 0.9, "znear": 0.1, "zfar": 50})
    lights = [
        {"type": "directional", "intensity": 2},
        {"type": "point", "color": [1, 0.6, 0.3], "intensity": 20, "range": 9},
        {
            "type": "spot",
            "color": [0.3, 0.6, 1],
            "intensity": 60,
            "range": 12,
            "spot": {"outerConeAngle": 0.6},
        },
    ]
    document.values["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
    nodes.append({"mesh": 1, "translation": [2, 0, 0]})
    document.animate(len(nodes) - 1, "weights", [0, 1, 2], [0, 1, 0])
    nodes.append({"camera": 0, "translation": [1, 2, 6]})
    for light, position in enumerate(([0, 5, 5], [-1, 3, 2], [3, 2, 4])):
        nodes.append({"translation": position, "extensions": {"KHR_lights_punctual": {"light": light}}})
    return document


def test_a_file_with_all_that_is_read_is_the_same_frame_on_both(devices, tmp_path):
    """At two times, since bones and targets move. llvmpipe filters images of 8 bits to 8 bits, lanes in
    floats; of 6,144 pixels one is 2 off, and none more."""
    scene = load_model(make_file().write(tmp_path / "all.glb"))
    assert scene.omissions == ()
    assert len(scene.lights) == 3
    camera = scene.views["camera 0"].with_aspect(SIZE[0] / SIZE[1])
    gl, cl = draw(devices, scene, camera, (0.0, 0.75))
    off = np.abs(gl - cl).max(axis=-1)
    assert off.max() <= 2
    assert (off > 1).sum() < 10
    assert gl.std() > 20.0
    assert (np.abs(gl[0] - gl[1]).max(axis=-1) > 20).mean() > 0.1  # and it does move


@pytest.mark.nightly
@pytest.mark.skipif(
    not FOLDER.is_dir(), reason=f"there is no {FOLDER}: install assimp-testmodels, or set RHI_TEST_MODELS"
)
@pytest.mark.parametrize(
    "name",
    ["2CylinderEngine-glTF-Binary/2CylinderEngine.glb", "textureTransform/TextureTransformTest.gltf"],
)
def test_files_of_others_are_the_same_frame_on_both(devices, name):
    scene = load_model(str(FOLDER / name))
    lower, upper = scene.bounds
    middle, size = (lower + upper) / 2, float(np.linalg.norm(upper - lower))
    seen = Perspective(near=size / 100, far=size * 3)
    camera = Camera.look_at(middle + size * np.array([0.3, 0.4, 0.8]), middle, projection=seen)
    gl, cl = draw(devices, scene, camera.with_aspect(SIZE[0] / SIZE[1]), (0.0,))
    off = np.abs(gl - cl).max(axis=-1)
    assert (off > 3).mean() < 0.005
    assert gl.std() > 5.0
