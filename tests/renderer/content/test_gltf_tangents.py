"""Tangents of glTF files follow what happens to texture coordinates and to vertices: each file is beside one
in which it has happened already, and both are the same image."""

from __future__ import annotations

import io
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from gltf_documents import GltfDocument, rotation_quaternion
from nightly_reasons import FEWER_CASES, ONLY_KERNELS
from PIL import Image

from renderer.content import load_model, save_scene
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.renderer import Renderer
from renderer.scene import Camera, Perspective
from renderer.techniques.table import TECHNIQUES
from tests.renderer.conftest import open_device

QUAD = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
CORNERS = np.array([0, 1, 2, 0, 2, 3], np.uint16)
EYE = Camera.look_at((0.0, 0.0, 4.0), (0.0, 0.0, 0.0), projection=Perspective(0.7, 1.0, 0.1))
LEANING = np.array([0.6, 0.25, 0.76])
"""The normal of the map, the same everywhere: it leans along u, and up a little."""
LIGHT = [-0.3, 0.2, 0.06, 0.93]  # a rotation: light from the upper right
TRANSFORMS: dict[str, dict[str, Any]] = {
    "moved": {"offset": [0.3, 0.6]},
    "scaled": {"scale": [2, 3]},
    "turned a quarter": {"rotation": np.pi / 2},
    "turned": {"rotation": 0.5},
    "turned back": {"rotation": -2.2},
    "turned and scaled": {"rotation": 0.8, "scale": [2, 0.5], "offset": [0.1, 0.2]},
    "mirrored along u": {"scale": [-1, 1]},
    "mirrored along v": {"scale": [1, -1]},
    "turned by mirrors": {"scale": [-2, -1]},
    "mirrored and turned": {"scale": [-1, 2], "rotation": 1.1},
}
SHAPES = {"square": (1.0, 1.0), "wide": (1.2, 0.6)}
LAYOUTS = {"upright": UV, "mirrored": UV * (-1, 1), "on its side": UV[:, ::-1] * (1, -1)}


def transform_uv(uv: np.ndarray[Any, Any], transform: dict[str, Any]) -> np.ndarray[Any, Any]:
    """Texture coordinates after KHR_texture_transform, as its specification writes it."""
    (x, y), angle = transform.get("scale", (1, 1)), transform.get("rotation", 0.0)
    scale = np.diag([x, y, 1.0])
    rotation = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    move = np.eye(3)
    move[:2, 2] = transform.get("offset", (0, 0))
    return (np.column_stack([uv, np.ones(len(uv))]) @ (move @ rotation @ scale).T)[:, :2]


def compute_tangents(points: np.ndarray[Any, Any], uv: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """The tangent (4,) of a flat quad, by the inverse of its map from the first three corners."""
    steps = np.linalg.solve(uv[1:3] - uv[0], points[1:3] - points[0])
    normal = np.cross(points[1] - points[0], points[2] - points[0])
    side = np.sign(np.dot(np.cross(normal, steps[0]), -steps[1]))
    return np.array([*(steps[0] / np.linalg.norm(steps[0])), side])


class QuadFile:
    """A quad with a normal map that is the same everywhere, under one light."""

    def __init__(
        self, *, transform: dict[str, Any] | None = None, uv_set: int = 0, double_sided: bool = True
    ) -> None:
        self.document = GltfDocument(nodes=[])
        file = io.BytesIO()
        texel = np.round((LEANING / np.linalg.norm(LEANING) * 0.5 + 0.5) * 255).astype(np.uint8)
        Image.fromarray(np.tile(texel, (4, 4, 1))).save(file, "PNG")
        self.document.add("images", bufferView=self.document.view(file.getvalue()), mimeType="image/png")
        self.document.add("textures", source=0)
        use: dict[str, Any] = {"index": 0, "texCoord": uv_set}
        if transform is not None:
            use["extensions"] = {"KHR_texture_transform": transform}
        pbr = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
        material = {"pbrMetallicRoughness": pbr, "normalTexture": use, "doubleSided": double_sided}
        self.document.add("materials", **material)
        light = {"type": "directional", "intensity": 3.0}
        self.document.values["extensions"] = {"KHR_lights_punctual": {"lights": [light]}}
        shines = {"KHR_lights_punctual": {"light": 0}}
        self.document.add("nodes", rotation=LIGHT, extensions=shines)

    def add_mesh(self, points: Any, uv: Any, **more: Any) -> int:
        arrays = {name: np.asarray(value, np.float32) for name, value in more.items() if name.isupper()}
        arrays.setdefault("NORMAL", np.tile(np.float32([0, 0, 1]), (4, 1)))
        rest = {name: value for name, value in more.items() if not name.isupper()}
        arrays["TEXCOORD_0"] = np.asarray(uv, np.float32)
        mesh: int = self.document.mesh(points, CORNERS, material=0, **arrays, **rest)
        return mesh

    def load(self, folder: Any, name: str) -> Any:
        scene = load_model(self.document.write(folder / f"{name}.glb"))
        scene.lights.sky = scene.lights.ground = (0.0, 0.0, 0.0)
        return scene


@pytest.fixture(scope="module", params=["gl", "cl", "wgpu"])
def device(request: pytest.FixtureRequest) -> Iterator[Any]:
    with open_device(request.param) as opened:
        yield opened


def draw(device: Any, scene: Any, seconds: float = 0.0, technique: str = "forward") -> int:
    """The brightness of the pixel in the middle."""
    with Renderer(device, scene, size=(32, 32), visibility="none") as renderer:
        renderer.technique = TECHNIQUES[technique]()
        pixel = renderer.render(EYE, seconds).image.read()[16, 16, :3]
    assert np.ptp(pixel) == 0
    return int(pixel[0])


def make_pair(
    folder: Any, transform: dict[str, Any], shape: tuple[float, float], layout: Any, *, stored: bool
) -> tuple[Any, Any]:
    """Load a file with a transform, and one with the texture coordinates that it makes."""
    points = QUAD * np.array([*shape, 1.0], np.float32)
    scenes = []
    for name, used, uv in (
        ("transformed", transform, layout),
        ("baked", None, transform_uv(layout, transform)),
    ):
        file = QuadFile(transform=used)
        more = {"TANGENT": np.tile(compute_tangents(points, uv), (4, 1))} if stored else {}
        file.document.add("nodes", mesh=file.add_mesh(points, uv, **more))
        scenes.append(file.load(folder, name))
    return scenes[0], scenes[1]


@pytest.mark.nightly_cases("cl*", "wgpu*", reason=FEWER_CASES)
@pytest.mark.parametrize("stored", [False, True], ids=["computed", "stored"])
@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("shape", SHAPES)
def test_tangents_follow_the_transform_of_a_normal_map(
    device: Any, tmp_path: Any, shape: str, layout: str, stored: bool
) -> None:
    """The light differs between the transforms, so a frame that ignores one is seen."""
    seen = set()
    for name, transform in TRANSFORMS.items():
        transformed, baked = make_pair(tmp_path, transform, SHAPES[shape], LAYOUTS[layout], stored=stored)
        here, there = draw(device, transformed), draw(device, baked)
        assert abs(here - there) <= 1, name
        seen.add(there // 8)
    assert len(seen) >= 5


@pytest.mark.parametrize("shape", SHAPES)
def test_the_reference_ray_tracer_sees_the_same(tmp_path: Any, shape: str) -> None:
    for name, transform in TRANSFORMS.items():
        pair = make_pair(tmp_path, transform, SHAPES[shape], UV, stored=False)
        transformed, baked = (RayTracer(scene).draw(EYE, (3, 3))[1, 1] for scene in pair)
        assert np.abs(transformed.astype(int) - baked).max() <= 1, name


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("stored", [False, True], ids=["computed", "stored"])
def test_a_node_that_stretches_and_mirrors_keeps_them_together(
    device: Any, tmp_path: Any, stored: bool
) -> None:
    for scale in ((1.5, 0.7, 1.0), (-1.0, 1.0, 1.0), (0.8, -1.3, 1.0)):
        images = []
        for used, uv in ((TRANSFORMS["turned"], UV), (None, transform_uv(UV, TRANSFORMS["turned"]))):
            file = QuadFile(transform=used)
            more = {"TANGENT": np.tile(compute_tangents(QUAD, uv), (4, 1))} if stored else {}
            file.document.add("nodes", mesh=file.add_mesh(QUAD, uv, **more), scale=list(scale))
            images.append(draw(device, file.load(tmp_path, "a")))
        assert abs(images[0] - images[1]) <= 1


@pytest.mark.nightly_cases("cl*", "wgpu*", reason=FEWER_CASES)
@pytest.mark.parametrize("technique", ["deferred", "deferred_plus", "forward_plus", "clustered_deferred"])
def test_every_technique_turns_them_alike(device: Any, tmp_path: Any, technique: str) -> None:
    for name in ("turned", "mirrored and turned", "mirrored along u"):
        transformed, baked = make_pair(tmp_path, TRANSFORMS[name], SHAPES["wide"], UV, stored=False)
        here, there = draw(device, transformed, technique=technique), draw(device, baked, technique=technique)
        assert abs(here - there) <= 2


def test_a_second_set_of_coordinates_is_turned_by_its_own_transform(device: Any, tmp_path: Any) -> None:
    turned, other = TRANSFORMS["turned"], UV * (0.3, -1.7)
    transformed, baked = QuadFile(transform=turned, uv_set=1), QuadFile()
    transformed.document.add("nodes", mesh=transformed.add_mesh(QUAD, other, TEXCOORD_1=UV))
    baked.document.add("nodes", mesh=baked.add_mesh(QUAD, transform_uv(UV, turned)))
    assert abs(draw(device, transformed.load(tmp_path, "a")) - draw(device, baked.load(tmp_path, "b"))) <= 1


def test_a_saved_file_is_read_back_as_it_was(tmp_path: Any) -> None:
    transformed, _ = make_pair(tmp_path, TRANSFORMS["turned"], SHAPES["wide"], UV, stored=False)
    save_scene(transformed, tmp_path / "saved.glb")
    again = load_model(tmp_path / "saved.glb")
    assert np.allclose(again.meshes.vertices["tangent"], transformed.meshes.vertices["tangent"], atol=1e-6)
    assert np.abs(transformed.meshes.vertices["tangent"][:, 3]) == pytest.approx(
        0.5
    )  # 1.2 along u, 0.6 along v


# -- skins and targets -----------------------------------------------------------------------------------

TURNS = {
    "in its plane": rotation_quaternion(70),
    "about y": rotation_quaternion(40, axis=1),
    "about x": rotation_quaternion(-35, axis=0),
}


def make_skinned_quad(
    folder: Any, stored: bool, layout: Any, scale: Any, turn: Any, *, by_joint: bool
) -> Any:
    """Load a quad that its only joint turns, at the end of an animation, or that its node has turned."""
    file = QuadFile()
    more: dict[str, Any] = {}
    if stored:
        more["TANGENT"] = np.tile(compute_tangents(QUAD, layout), (4, 1))
    if not by_joint:
        mesh = file.add_mesh(QUAD, layout, **more)
        file.document.add("nodes", mesh=mesh, rotation=list(turn), scale=list(scale))
        return file.load(folder, "node")
    mesh = file.add_mesh(QUAD, layout, WEIGHTS_0=np.tile((1, 0, 0, 0), (4, 1)), **more)
    primitive = file.document.values["meshes"][mesh]["primitives"][0]
    primitive["attributes"]["JOINTS_0"] = file.document.accessor(np.zeros((4, 4), np.uint8))
    joint = file.document.add("nodes", scale=list(scale))
    file.document.add("skins", joints=[joint])
    file.document.animate(joint, "rotation", [0.0, 1.0], [[0, 0, 0, 1], turn])
    file.document.add("nodes", mesh=mesh, skin=0)
    return file.load(folder, "joint")


@pytest.mark.nightly_cases("cl*", "wgpu*", reason=FEWER_CASES)
@pytest.mark.parametrize("stored", [False, True], ids=["computed", "stored"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_tangents_follow_a_joint_as_they_follow_a_node(
    device: Any, tmp_path: Any, layout: str, stored: bool
) -> None:
    seen = set()
    for name, turn in TURNS.items():
        for scale in ((1, 1, 1), (1.5, 0.6, 1)):
            parts = (tmp_path, stored, LAYOUTS[layout], scale, turn)
            here = draw(device, make_skinned_quad(*parts, by_joint=True), seconds=0.9999999)
            there = draw(device, make_skinned_quad(*parts, by_joint=False))
            assert abs(here - there) <= 1, (name, scale)
            seen.add(there // 8)
    assert len(seen) >= 2


def test_a_joint_that_mirrors_turns_the_bitangent(device: Any, tmp_path: Any) -> None:
    """The quad is seen from behind, until its joint mirrors it: then it is that of the file that is beside
    it."""
    for scale in ((-1, 1, 1), (1, -1, 1)):
        file, baked = QuadFile(double_sided=False), QuadFile(double_sided=False)
        mirrored = QUAD * np.float32(scale)
        more = {"TANGENT": np.tile(compute_tangents(QUAD, UV), (4, 1))}
        mesh = file.add_mesh(QUAD, UV, WEIGHTS_0=np.tile((1, 0, 0, 0), (4, 1)), **more)
        primitive = file.document.values["meshes"][mesh]["primitives"][0]
        primitive["attributes"]["JOINTS_0"] = file.document.accessor(np.zeros((4, 4), np.uint8))
        primitive["indices"] = file.document.accessor(CORNERS[::-1].copy())
        joint = file.document.add("nodes", scale=list(scale))
        file.document.add("skins", joints=[joint])
        file.document.animate(
            joint, "rotation", [0.0, 1.0], [[0, 0, 0, 1]] * 2
        )  # so it isn't the object's node
        file.document.add("nodes", mesh=mesh, skin=0)
        mesh = baked.add_mesh(mirrored, UV)
        baked.document.values["meshes"][mesh]["primitives"][0]["indices"] = baked.document.accessor(
            CORNERS[::-1].copy()
        )
        baked.document.add("nodes", mesh=mesh)
        there = draw(device, baked.load(tmp_path, "baked"))
        assert there > 30
        assert abs(draw(device, file.load(tmp_path, "joint")) - there) <= 1


def rotate(points: Any, degrees: float) -> np.ndarray[Any, Any]:
    sine, cosine = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    return np.asarray(points) @ np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])


@pytest.mark.nightly_cases("cl*", "wgpu*", reason=FEWER_CASES)
@pytest.mark.parametrize("stored", [False, True], ids=["computed", "stored"])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_tangents_follow_targets(device: Any, tmp_path: Any, layout: str, stored: bool) -> None:
    """A target turns the quad in its plane: tangents of the file have a target, too; others are computed."""
    uv, seen = LAYOUTS[layout], set()
    for degrees in (35.0, 80.0, -60.0):
        turned = rotate(QUAD, degrees)
        file, baked = QuadFile(), QuadFile()
        target = {"POSITION": file.document.accessor(np.float32(turned - QUAD))}
        more = {}
        if stored:
            before, after = compute_tangents(QUAD, uv), compute_tangents(turned, uv)
            more["TANGENT"] = np.tile(before, (4, 1))
            target["TANGENT"] = file.document.accessor(np.tile(np.float32(after - before)[:3], (4, 1)))
        mesh = file.add_mesh(QUAD, uv, targets=[target], **more)
        file.document.values["meshes"][mesh]["weights"] = [0.0]
        node = file.document.add("nodes", mesh=mesh)
        file.document.animate(node, "weights", [0.0, 1.0], [0.0, 1.0])
        baked.document.add("nodes", mesh=baked.add_mesh(turned, uv))
        here = draw(device, file.load(tmp_path, "target"), seconds=0.9999999)
        there = draw(device, baked.load(tmp_path, "baked"))
        assert abs(here - there) <= 1, degrees
        seen.add(there // 8)
    assert len(seen) >= 2


def test_a_seam_of_mirrored_coordinates_stays_one_where_a_joint_moves_it(tmp_path: Any) -> None:
    """Two quads beside each other share an edge, and their texture is mirrored at it."""
    points = np.array([[x, y, 0] for x in (-1, 0, 1) for y in (-1, 1)], np.float32)
    uv = np.array([[abs(x), y] for x in (-1, 0, 1) for y in (1, 0)], np.float32)
    corners = np.array([0, 2, 1, 1, 2, 3, 2, 4, 3, 3, 4, 5], np.uint16)
    file = QuadFile()
    mesh = file.document.mesh(
        points, corners, material=0, NORMAL=np.tile(np.float32([0, 0, 1]), (6, 1)), TEXCOORD_0=uv,
        WEIGHTS_0=np.tile(np.float32([1, 0, 0, 0]), (6, 1)),
    )  # fmt: skip
    primitive = file.document.values["meshes"][mesh]["primitives"][0]
    primitive["attributes"]["JOINTS_0"] = file.document.accessor(np.zeros((6, 4), np.uint8))
    joint = file.document.add("nodes")
    file.document.add("skins", joints=[joint])
    file.document.animate(joint, "rotation", [0.0, 1.0], [[0, 0, 0, 1], rotation_quaternion(90)])
    file.document.add("nodes", mesh=mesh, skin=0)
    scene = file.load(tmp_path, "a")
    vertices = scene.meshes.geometry(int(scene.objects.mesh[0])).vertices
    assert len(vertices) == 4 + 2 * 2  # both vertices of the seam, twice
    left = vertices["position"][:, 0] + np.where(vertices["tangent"][:, 3] < 0, -0.1, 0.1) < 0
    along = np.where(left, -1.0, 1.0)
    assert np.allclose(vertices["tangent"][:, 0], along)
