"""Points and lines of glTF: the solids that they become, and their images beside distances computed in
float64."""

import numpy as np
import pytest
from gltf_documents import TRIANGLE, UP, GltfDocument, make_morphing, make_skinned
from hypothesis import given
from hypothesis import strategies as st
from nightly_reasons import ONLY_KERNELS

from renderer.content import ModelLimits, load_model
from renderer.content.gltf.solids import POINT, SEGMENT, list_ends
from renderer.renderer import Renderer
from renderer.scene import Camera, Perspective
from renderer.techniques import TECHNIQUES, Forward
from renderer.visibility import ALGORITHMS, FrustumCulling, make_visibility
from rhi import to_srgb
from rhi.errors import ValidationError

MODES = ("points", "lines", "line loops", "line strips")
POSITIONS = np.array(
    [[-50, 0.3, 0], [-1, 0.8, 0.3], [0.2, -0.9, -0.4], [1.1, 0.6, 0], [50, 0, 0]], np.float32
)
ENDS = (
    [[0], [1], [2], [3], [4]],
    [[0, 1], [2, 3]],
    [[0, 1], [1, 2], [2, 3], [3, 4], [4, 0]],
    [[0, 1], [1, 2], [2, 3], [3, 4]],
)
COLOR, SHADE = np.array([0.9, 0.5, 0.1]), np.array([0.5, 1.0, 0.8])
SIZE, EYE, FOV = (96, 72), 4.0, 1.0


def make_file(mode, **more):
    """A primitive of this mode, with a material and colours of vertices, beside a strong light."""
    document = GltfDocument(
        nodes=[{"mesh": 0}, {"translation": [0, 0, 3], "extensions": {"KHR_lights_punctual": {"light": 0}}}],
        extensions={"KHR_lights_punctual": {"lights": [{"type": "point", "intensity": 300}]}},
        materials=[{"pbrMetallicRoughness": {"baseColorFactor": [*COLOR, 1]}}],
    )
    shades = np.tile(SHADE.astype(np.float32), (len(POSITIONS), 1))
    document.mesh(POSITIONS, mode=mode, material=0, COLOR_0=shades, **more)
    return document


def draw(device, scene, technique=None, visibility="auto", camera=None):
    """Return the image (h, w, 3) and what it took."""
    seen = camera or Camera.look_at(
        [0, 0, EYE], [0, 0, 0], projection=Perspective(FOV, SIZE[0] / SIZE[1], near=0.1, far=100)
    )
    culling = visibility or FrustumCulling(scene)
    with Renderer(device, scene, technique=technique or Forward(), visibility=culling, size=SIZE) as renderer:
        for _ in range(3):  # algorithms that ask for queries know the answers later
            frame = renderer.render(seen)
        pixels = frame.image.read()[..., :3].astype(int) if device.capabilities.renders else None
        return pixels, frame.statistics


def line_distances(mode):
    """Return the number of pixels between each pixel's centre and the nearest projected point or segment, (h,
    w)."""
    scale = SIZE[1] / 2 / np.tan(FOV / 2)
    at = POSITIONS.astype(np.float64)
    flat = np.array([SIZE[0], SIZE[1]]) / 2 + at[:, :2] * (1, -1) * scale / (EYE - at[:, 2:])
    pixels = np.stack(np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5), axis=-1)
    distances = np.full(SIZE[::-1], np.inf)
    for ends in ENDS[mode]:
        first, along = flat[ends[0]], flat[ends[-1]] - flat[ends[0]]
        share = np.clip((pixels - first) @ along / max(along @ along, 1e-9), 0, 1)
        distances = np.minimum(distances, np.linalg.norm(pixels - first - share[..., None] * along, axis=-1))
    extent = np.linalg.norm(np.ptp(at[np.unique(ENDS[mode])], axis=0))
    return distances, extent / 400 * scale / EYE


def check_frame(image, mode):
    """Near a point or a line each pixel has its colour, unlit; away from all there is the background
    alone."""
    distance, radius = line_distances(mode)
    x = 0.6 * COLOR * SHADE
    expected = 255 * to_srgb(np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0, 1))
    inside, outside = distance < 0.5 * radius, distance > 1.3 * radius
    assert inside.sum() > 20
    assert outside.sum() > 1000
    assert np.abs(image[inside] - expected).max() <= 1
    assert (image[outside] == image[-1, 0]).all()
    assert np.abs(image[-1, 0] - expected).max() > 50


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("mode", range(4), ids=MODES)
def test_points_and_lines_are_where_they_are_projected(drawing_device, tmp_path, mode):
    scene = load_model(make_file(mode).write(tmp_path / "a.glb"))
    assert scene.omissions == ()
    check_frame(draw(drawing_device, scene)[0], mode)


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("name", TECHNIQUES)
def test_every_technique_draws_lines(drawing_device, tmp_path, name):
    scene = load_model(make_file(3).write(tmp_path / "a.glb"))
    check_frame(draw(drawing_device, scene, TECHNIQUES[name]())[0], 3)


@pytest.mark.parametrize("name", [name for name in ALGORITHMS if name != "auto"])
def test_every_visibility_algorithm_lets_lines_be_drawn(gl, tmp_path, name):
    scene = load_model(make_file(3).write(tmp_path / "a.glb"))
    check_frame(draw(gl, scene, visibility=make_visibility(name, scene, gl))[0], 3)


@pytest.mark.parametrize(
    ("mode", "triangles"), [(0, 5 * 8), (1, 2 * 16), (2, 5 * 16), (3, 4 * 16)], ids=MODES
)
def test_a_primitive_is_one_draw_of_its_solids(null, tmp_path, mode, triangles):
    scene = load_model(make_file(mode).write(tmp_path / "a.glb"))
    statistics = draw(null, scene)[1]
    assert (statistics.draws, statistics.triangles) == (1, triangles)


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("casts", [True, False])
def test_a_line_casts_a_shadow(drawing_device, tmp_path, casts):
    """A line along z at a height of 1, in a sun that shines down along +x: its shadow lies at x = 1."""
    grey = [0.2, 0.2, 0.2]
    scene_extras = {
        "background": grey,
        "sky": grey,
        "ground": grey,
        "haze": 0,
        "shadowless": [] if casts else [1],
    }
    document = GltfDocument(
        nodes=[
            {"mesh": 0},
            {"mesh": 1},
            {
                "rotation": [-0.2706, -0.6533, -0.2706, 0.6533],
                "extensions": {"KHR_lights_punctual": {"light": 0}},
            },
        ],
        scenes=[{"nodes": [0, 1, 2], "extras": {"rhi": scene_extras}}],
    )
    sun = {"type": "directional", "intensity": 3, "extras": {"rhi": {"casts_shadow": True}}}
    document.values["extensions"] = {"KHR_lights_punctual": {"lights": [sun]}}
    floor = np.float32([[-4, 0, 4], [4, 0, 4], [4, 0, -4], [-4, 0, -4]])
    document.mesh(
        floor, np.uint8([0, 1, 2, 0, 2, 3]), material=document.add("materials", pbrMetallicRoughness={})
    )
    document.values["materials"][0]["pbrMetallicRoughness"] = {"metallicFactor": 0}
    document.mesh(np.float32([[0, 1, -50], [0, 1, 50]]), mode=1)
    scene = load_model(document.write(tmp_path / "a.glb"))
    assert scene.lights.directional["direction"][0] == pytest.approx([0.7071, -0.7071, 0], abs=1e-3)
    camera = Camera.look_at(
        [0, 6, 0.01], [0, 0, 0], projection=Perspective(FOV, SIZE[0] / SIZE[1], near=0.1, far=100)
    )
    image, _ = draw(drawing_device, scene, camera=camera)
    scale = SIZE[1] / 2 / np.tan(FOV / 2) / 6
    left, shaded, right = (image[36, round(SIZE[0] / 2 + x * scale)] for x in (-1, 1, 2))
    assert np.abs(left - right).max() <= 8
    assert ((right - shaded).min() > 30) == casts


# -- materials and normals -----------------------------------------------------------------------------------


def test_lines_with_normals_are_lit_and_lines_without_are_not(tmp_path):
    document = make_file(3)
    normals = np.tile(np.float32([[0, 0.6, 0.8]]), (len(POSITIONS), 1))
    document.mesh(POSITIONS, mode=3, material=0, NORMAL=normals)
    document.values["nodes"].append({"mesh": 1})
    document.mesh()
    document.values["meshes"][2]["primitives"][0]["material"] = 0
    document.values["nodes"].append({"mesh": 2})
    scene = load_model(document.write(tmp_path / "a.glb"))
    unlit, lit, triangle = scene.materials[scene.objects.material]
    assert unlit["emission"] * unlit["base_color"][:3] == pytest.approx(COLOR)
    assert lit == triangle
    assert lit["emission"] == 0
    assert lit["base_color"][:3] == pytest.approx(COLOR)
    assert scene.meshes.geometry(1).vertices["normal"] == pytest.approx(np.tile(normals[:1], (40, 1)))


def test_a_line_of_an_unlit_material_is_as_bright_as_one_of_a_lit_one(tmp_path):
    document = make_file(3)
    document.values["materials"][0]["extensions"] = {"KHR_materials_unlit": {}}
    scene = load_model(document.write(tmp_path / "a.glb"))
    (material,) = scene.materials[scene.objects.material]
    assert material["emission"] * material["base_color"][:3] == pytest.approx(COLOR)


@pytest.mark.parametrize("moves", [True, False])
def test_points_move_with_their_targets(tmp_path, moves):
    document = make_morphing(track=moves)
    document.values["meshes"][0]["primitives"][0]["mode"] = 0
    scene = load_model(document.write(tmp_path / "a.glb"))
    assert scene.objects.simulated.tolist() == [moves]
    scene.check_bounds([0.0, 0.7, 1.0])
    at = scene.meshes.vertices["position"][-18:].reshape(3, 6, 3).mean(axis=1)
    shift = (0, 0, 0) if moves else (1, 0, 0)  # a quarter of the first target, or what the track begins with
    assert at == pytest.approx(TRIANGLE + shift, abs=1e-6)


def test_lines_follow_the_joints_of_a_skin(tmp_path):
    document = make_skinned()
    primitive = document.values["meshes"][0]["primitives"][0]
    primitive["mode"] = 3
    scene = load_model(document.write(tmp_path / "a.glb"))
    assert (scene.omissions, scene.objects.simulated.tolist()) == ((), [True])
    scene.check_bounds(np.linspace(0.0, 4.0, 21))


# -- solids --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", range(4), ids=MODES)
@pytest.mark.parametrize("count", range(1, 6))
def test_ends_are_those_of_gl(mode, count):
    expected = {
        0: [[i] for i in range(count)],
        1: [[i, i + 1] for i in range(0, count - 1, 2)],
        2: [[i, (i + 1) % count] for i in range(count)] if count > 1 else [],
        3: [[i, i + 1] for i in range(count - 1)],
    }[mode]
    assert list_ends(np.arange(count), mode).tolist() == expected


@given(seed=st.integers(0, 2**32 - 1), size=st.sampled_from([1e-3, 1.0, 1e6]))
def test_solids_are_closed_and_face_outwards(seed, size):
    """Of each triangle the normal leads away from the middle, and each edge is there once in both
    directions."""
    positions = (size * np.random.default_rng(seed).uniform(-1, 1, (2, 3))).astype(np.float32)
    for solid, ends in ((POINT, [[0]]), (SEGMENT, [[0, 1]])):
        rows, corners, outward, radius = solid.make_vertices(positions, np.array(ends, np.uint32))
        at = positions[rows] + radius * outward
        a, b, c = at[corners].transpose(1, 0, 2)
        assert (np.einsum("ij,ij->i", np.cross(b - a, c - a), a - at.mean(axis=0)) > 0).all()
        edges = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]).tolist()
        assert sorted(edges) == sorted([b, a] for a, b in edges)
        assert len({tuple(edge) for edge in edges}) == len(edges)
        assert np.linalg.norm(outward, axis=1) == pytest.approx(1)


@pytest.mark.parametrize(
    ("positions", "radius"),
    [
        ([[0, 0, 0], [3, 4, 0]], 5 / 400),
        ([[7, 7, 7], [7, 7, 7]], 0.01),
        ([[0, 0, 0], [0, 0, 0]], 0.01),
        ([[2e6, 0, 0], [2e6, 0, 0]], 2e6 / 2**21),
        ([[0, 0, 0], [4, np.nan, 0]], 0.01),
    ],
)
def test_the_radius_is_a_fraction_of_the_extent_or_a_centimetre_and_never_less_than_float32_can_show(
    positions, radius
):
    with np.errstate(all="raise"):
        assert SEGMENT.make_vertices(np.float32(positions), np.uint32([[0, 1]]))[3] == pytest.approx(radius)


def test_a_segment_without_a_length_is_drawn_as_a_point(tmp_path):
    document = GltfDocument(nodes=[{"mesh": 0}])
    document.mesh(np.float32([[1, 2, 3], [1, 2, 3]]), mode=1)
    scene = load_model(document.write(tmp_path / "a.glb"))
    lower, upper = scene.bounds
    assert upper - lower == pytest.approx([0.02] * 3, rel=1e-4)
    assert lower + upper == pytest.approx([2, 4, 6])


def test_a_line_vertex_that_is_not_finite_is_refused(tmp_path):
    for value in (5.0, np.nan, np.inf):
        document = GltfDocument(nodes=[{"mesh": 0}])
        document.mesh(np.float32([[0, 0, 0], [0, 1, 0], [0, value, 1]]), mode=3)
        path = document.write(tmp_path / "a.glb")
        if np.isfinite(value):
            assert load_model(path).triangle_count == 32
            continue
        with pytest.raises(ValidationError, match="POSITION: vertex 2 is") as error:
            load_model(path)
        assert error.value.rule.id == "scene-bad-vertices"


def test_a_line_of_one_vertex_is_listed(tmp_path):
    document = GltfDocument(nodes=[{"mesh": 0}, {"mesh": 1}])
    document.mesh(NORMAL=UP[:3])
    document.mesh(POSITIONS[:1], mode=3)
    scene = load_model(document.write(tmp_path / "a.glb"))
    assert [omission.what for omission in scene.omissions] == ["primitives without a line"]
    assert scene.triangle_count == 1


def test_the_vertices_of_solids_count_against_the_limit_before_they_are_allocated(tmp_path):
    path = make_file(0).write(tmp_path / "a.glb")
    most = 5 + 5 + 5 * (6 + 24)
    assert load_model(path, ModelLimits(vertices=most)).triangle_count == 40
    with pytest.raises(ValidationError, match="scene-model-limit"):
        load_model(path, ModelLimits(vertices=most - 1))
