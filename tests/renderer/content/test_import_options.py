"""Options of model files: scale, centre, parts left out, merged meshes, levels of detail, meshlets."""

import numpy as np
import pytest
from gltf_documents import GltfDocument, make_morphing, make_skinned, rotation_quaternion
from nightly_reasons import ONLY_KERNELS

from renderer.content import (
    ImportOptions,
    ModelLimits,
    add_model,
    change_options,
    load_model,
    load_scene,
    save_scene,
)
from renderer.content.shapes import bumpy_sphere
from renderer.renderer import Renderer
from renderer.scene import Orthographic, SceneBuilder
from renderer.scene.simplification import simplify
from tests.renderer.refusals import refused_rule

SIZE = (64, 48)
QUAD = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
CORNERS = np.array([0, 1, 2, 0, 2, 3], np.uint16)


def make_room():
    """Four quads of two materials, one of them mirrored and one that moves; a lit floor; two lights, and two cameras,
    of which one light and one camera move."""
    document = GltfDocument(
        nodes=[
            {"name": "room", "children": [1, 2, 3, 4, 5, 7, 8]},
            {"name": "left", "mesh": 0, "translation": [-2, 0, 0]},
            {"name": "right", "mesh": 0, "translation": [2, 0, 0], "scale": [-1.5, 1, 1]},
            {"name": "blue", "mesh": 1, "translation": [0, 0, 1]},
            {"name": "cart", "mesh": 0, "translation": [0, 1, 2], "children": [6]},
            {"name": "bulb", "translation": [0, 2, 3]},
            {"name": "headlight", "translation": [0, 0, 1]},
            {"name": "eye", "camera": 0, "translation": [0, 1, 9]},
            {
                "name": "floor",
                "mesh": 2,
                "rotation": rotation_quaternion(-90, 0).tolist(),
                "scale": [9, 9, 1],
            },
        ]
    )
    document.mesh(QUAD, CORNERS, material=0, NORMAL=np.tile(np.float32([[0, 0, 1]]), (4, 1)))
    document.mesh(QUAD, CORNERS, material=1)
    document.mesh(QUAD - np.float32([0.5, 0.5, 0]), CORNERS, material=2)
    for name, mesh in zip(("wall", "panel", "ground"), document.values["meshes"], strict=True):
        mesh["name"] = name
    for color in ([0.9, 0.4, 0.2, 1], [0.2, 0.4, 0.9, 1], [0.9, 0.4, 0.2, 1]):
        pbr = {"baseColorFactor": color, "metallicFactor": 0, "roughnessFactor": 0.5}
        document.add("materials", pbrMetallicRoughness=pbr, doubleSided=True)
    document.add("cameras", type="perspective", perspective={"yfov": 0.9, "znear": 0.1, "zfar": 50})
    document.add(
        "cameras", type="orthographic", orthographic={"xmag": 4, "ymag": 3, "znear": 0.1, "zfar": 50}
    )
    lights = [
        {"type": "point", "intensity": 90, "range": 12},
        {"type": "spot", "intensity": 60, "range": 9, "spot": {"outerConeAngle": 0.6}},
    ]
    document.values["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
    nodes = document.values["nodes"]
    for node, light in ((5, 0), (6, 1)):
        nodes[node]["extensions"] = {"KHR_lights_punctual": {"light": light}}
    nodes[6]["camera"] = 1
    document.animate(4, "translation", [0, 1], [[0, 1, 2], [1, 1, 3]])
    return document


@pytest.fixture
def room(tmp_path):
    return make_room().write(tmp_path / "room.glb")


def drawn_corners(scene):
    """The corners of all triangles in the world, (t, 3, 3), sorted."""
    corners = []
    for mesh, node in zip(scene.objects.mesh.tolist(), scene.objects.node.tolist(), strict=True):
        part = scene.meshes.geometry(mesh).transformed(scene.nodes.world[node])
        corners.append(part.vertices["position"][part.indices].reshape(-1, 9))
    joined = np.concatenate(corners).astype(np.float64)
    return joined[np.lexsort(np.round(joined, 4).T)].reshape(-1, 3, 3)


def test_a_scale_multiplies_all_lengths_of_the_file(room):
    plain, scaled = load_model(room), load_model(room, options=ImportOptions(scale=0.25))
    for seconds in (0.0, 0.5):
        plain.update(seconds)
        scaled.update(seconds)
        assert np.allclose(drawn_corners(scaled), 0.25 * drawn_corners(plain), atol=1e-6)
        for name in ("point", "spot"):
            before, after = getattr(plain.lights, name), getattr(scaled.lights, name)
            assert np.allclose(after["position"], 0.25 * before["position"])
            assert np.allclose(after["range"], 0.25 * before["range"])
            assert np.allclose(after["intensity"], 0.0625 * before["intensity"])
        for name, view in plain.views.items():
            assert np.allclose(scaled.views[name].position, 0.25 * view.position)
            assert np.allclose(scaled.views[name].rotation, view.rotation)
    assert scaled.views["eye"].projection.near == pytest.approx(0.025)
    moving = scaled.views["headlight"].projection
    assert isinstance(moving, Orthographic)
    assert (moving.height, moving.far) == pytest.approx((1.5, 12.5))


def test_centring_moves_the_middle_of_all_objects_to_the_origin(room):
    plain, centred = load_model(room), load_model(room, options=ImportOptions(scale=2.0, centre=True))
    lower, upper = centred.bounds
    assert np.allclose(lower + upper, 0.0, atol=1e-5)
    low, high = plain.bounds
    assert np.allclose(upper - lower, 2.0 * (high - low), atol=1e-5)
    assert np.allclose(centred.lights.point["position"], 2.0 * plain.lights.point["position"] - (low + high))


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_a_scaled_camera_sees_the_same_image(drawing_device, room):
    plain, scaled = load_model(room), load_model(room, options=ImportOptions(scale=0.125, centre=True))
    images = []
    for scene in (plain, scaled):
        scene.lights.sky = scene.lights.ground = (0.1, 0.1, 0.1)
        camera = scene.views["eye"].with_aspect(SIZE[0] / SIZE[1])
        with Renderer(drawing_device, scene, size=SIZE) as renderer:
            images.append([renderer.render(camera, time).image.read().astype(int) for time in (0.0, 0.5)])
    first, second = np.array(images)
    assert np.abs(first - second).max(axis=-1).mean() < 0.05
    assert (np.abs(first - second) > 2).mean() < 0.005  # at edges
    assert first[..., :3].std() > 15


def test_parts_are_left_out_by_the_names_of_nodes_and_meshes(room):
    def names(*without):
        scene = load_model(room, options=ImportOptions(without=without))
        return sorted(scene.nodes.names[node] for node in scene.objects.node), scene

    assert names()[0] == ["blue", "cart", "floor", "left", "right"]
    assert names("l*")[0] == ["blue", "cart", "floor", "right"]
    assert names("wall", "ground")[0] == ["blue"]
    left, scene = names("cart")
    assert left == ["blue", "floor", "left", "right"]
    assert len(scene.lights.spot) == 0
    assert "headlight" not in scene.views
    _, scene = names("wall")
    assert scene.meshes.names == ("panel", "ground")
    assert len(scene.materials) == 2


def test_names_that_match_nothing_are_refused_and_add_nothing(room):
    builder = SceneBuilder("empty")
    before = {name: repr(value) for name, value in vars(builder).items()}
    for without, rule in (
        (("wal",), "scene-unknown-part"),
        (("wall", "Left"), "scene-unknown-part"),
        (("room",), "scene-empty-model"),
        (("*",), "scene-empty-model"),
    ):
        options = ImportOptions(scale=2.0, without=without)
        assert refused_rule(lambda options=options: add_model(builder, room, options=options)) == rule
    for file, content in (("bad.obj", "v 0 0 0\nv 1 0 0\nv 0 1e99 0\nf 1 2 3\n"), ("b.glb", "glTF")):
        path = room.replace("room.glb", file)
        with open(path, "w", encoding="utf-8") as stream:
            stream.write(content)
        refused_rule(lambda path=path: add_model(builder, path, options=ImportOptions(scale=2.0)))
    assert {name: repr(value) for name, value in vars(builder).items()} == before
    add_model(builder, room, options=ImportOptions(without=("wall",)))
    assert builder.object_count == 2


def test_a_refusal_after_meshes_were_added_undoes_them(room):
    builder = SceneBuilder("two")
    add_model(builder, room)
    before = builder.object_count, builder.mesh_count, len(builder.lights), list(builder.views)
    limits = ModelLimits(vertices=40)  # enough to read the file, too few to merge it
    merge = ImportOptions(merge=True)
    assert refused_rule(lambda: add_model(builder, room, limits, merge)) == "scene-model-limit"
    assert (builder.object_count, builder.mesh_count, len(builder.lights), list(builder.views)) == before
    add_model(builder, room, ModelLimits(vertices=80), merge)
    assert len(builder.build().objects) == before[0] + 3


@pytest.mark.parametrize(
    "values",
    [
        {"scale": 0.0},
        {"scale": -1.0},
        {"scale": np.nan},
        {"scale": np.inf},
        {"scale": 2e6},
        {"scale": "2"},
        {"scale": True},
        {"centre": 1},
        {"merge": "yes"},
        {"without": "wall"},
        {"without": ("",)},
        {"without": (3,)},
        {"without": 3},
        {"levels": -1},
        {"levels": 13},
        {"levels": 1.5},
        {"levels": True},
        {"meshlet_size": 7},
        {"meshlet_size": 4097},
    ],
    ids=str,
)
def test_bad_options_are_refused(values):
    assert refused_rule(lambda: ImportOptions(**values)) == "scene-bad-import"
    ImportOptions(scale=np.float32(2.0), without=["wall"], centre=np.True_, levels=12)


def test_merging_draws_the_same_triangles_in_fewer_objects(room):
    plain, merged = load_model(room), load_model(room, options=ImportOptions(merge=True))
    names = [merged.nodes.names[node] for node in merged.objects.node]
    assert len(merged.objects) == 3  # orange ones that stand still; the blue one; the cart
    assert {"blue", "cart"} < set(names)
    assert len(merged.meshes) == 3
    for seconds in (0.0, 0.7):
        plain.update(seconds)
        merged.update(seconds)
        assert np.allclose(drawn_corners(merged), drawn_corners(plain), atol=1e-5)


def test_merged_meshes_look_like_the_parts(drawing_device, room):
    images = []
    for options in (None, ImportOptions(merge=True)):
        scene = load_model(room, options=options)
        with Renderer(drawing_device, scene, size=SIZE) as renderer:
            camera = scene.views["eye"].with_aspect(SIZE[0] / SIZE[1])
            images.append(renderer.render(camera, 0.5).image.read().astype(int))
    assert (np.abs(images[0] - images[1]) > 1).mean() < 0.005
    assert images[0][..., :3].std() > 15


def test_merged_objects_are_hidden_and_shown_with_their_nodes(room, tmp_path):
    builder = SceneBuilder("hidden")
    add_model(builder, room)
    left = builder._node_names.index("left")
    builder.hide([left])
    save_scene(builder.build(), tmp_path / "hidden.glb")
    scene = load_model(tmp_path / "hidden.glb", options=ImportOptions(merge=True))
    hidden = np.flatnonzero(~scene.objects.is_shown)
    assert [scene.nodes.names[node] for node in scene.objects.node[hidden]] == ["left"]
    assert len(scene.objects) == 4


def test_merging_leaves_moving_deformed_and_blended_objects_apart(tmp_path):
    merge = ImportOptions(merge=True)
    for document in (make_skinned(), make_morphing()):
        document.add("nodes", mesh=0)  # the same mesh, standing still
        document.add("nodes", mesh=0, translation=[9, 0, 0])
        path = document.write(tmp_path / "deformed.glb")
        plain, merged = load_model(path), load_model(path, options=merge)
        plain.update(0.5)
        merged.update(0.5)
        assert merged.simulated
        assert len(merged.objects) == len(plain.objects) - (document.values["nodes"][-1].get("skin") is None)
    document = make_room()
    for material in document.values["materials"]:
        material["alphaMode"] = "BLEND"
    assert len(load_model(document.write(tmp_path / "glass.glb"), options=merge).objects) == 5


def test_far_meshes_keep_their_precision_when_merged(tmp_path):
    document = GltfDocument(nodes=[{"mesh": 0, "translation": [1e7 + x, 0, 0]} for x in (0, 2)])
    document.mesh()
    scene = load_model(document.write(tmp_path / "far.glb"), options=ImportOptions(merge=True))
    (mesh,), (node,) = scene.objects.mesh, scene.objects.node
    positions = scene.meshes.geometry(mesh).vertices["position"] + scene.nodes.world[node][:3, 3]
    assert sorted(set((positions[:, 0] - 1e7).tolist())) == [0.0, 1.0, 2.0, 3.0]


def test_scene_text_has_the_options(room):
    scene = load_scene(f"{room}:scale=0.5,centre,without=cart|pan*,merge,outside")
    assert len(scene.objects) == 1
    lower, upper = scene.bounds
    assert np.allclose(lower + upper, 0.0, atol=1e-5)
    assert scene.name == f"{room}:scale=0.5,centre,without=cart|pan*,merge,outside"
    assert change_options(f"{room}:scale=0.5,centre", "scale=3") == f"{room}:scale=3,centre"
    assert change_options(room, "scale=3") == f"{room}:scale=3"


@pytest.mark.parametrize(
    ("options", "rule"),
    [
        ("scal=2", "scene-unknown-key"),
        ("middle", "scene-unknown-key"),
        ("scale", "scene-spec-syntax"),
        ("centre=1", "scene-spec-syntax"),
        ("scale=1,scale=2", "scene-spec-syntax"),
        ("scale=big", "scene-bad-import"),
        ("scale=0", "scene-bad-import"),
        ("without=", "scene-bad-import"),
        ("without=wall|", "scene-bad-import"),
        ("without=door", "scene-unknown-part"),
        ("", "scene-unknown-key"),
    ],
)
def test_bad_options_of_scene_text_are_refused(room, options, rule):
    assert refused_rule(lambda: load_scene(f"{room}:{options}")) == rule


def test_a_saved_scene_keeps_the_imported_parts(room, tmp_path):
    options = ImportOptions(scale=0.5, centre=True, without=("floor",), merge=True)
    scene = load_model(room, options=options)
    save_scene(scene, tmp_path / "saved.glb")
    again = load_model(tmp_path / "saved.glb")
    assert np.array_equal(again.nodes.world, scene.nodes.world)
    assert np.allclose(drawn_corners(again), drawn_corners(scene))


def test_a_saved_scene_can_be_scaled_and_go_without_parts(room, tmp_path):
    builder = SceneBuilder("saved")
    add_model(builder, room)
    scene = builder.build()
    scene.objects.casts_shadow[-1] = False
    scene.haze = 0.5
    file = tmp_path / "saved.glb"
    save_scene(scene, file)
    partial = load_model(file, options=ImportOptions(scale=2.0, without=("left",)))
    assert partial.haze == 0.25
    names = [scene.nodes.names[node] for node in scene.objects.node]
    left = [partial.nodes.names[node] for node in partial.objects.node]
    assert left == [name for name in names if name != "left"]
    shadowless = [name for name, casts in zip(names, scene.objects.casts_shadow, strict=True) if not casts]
    assert [left[row] for row in np.flatnonzero(~partial.objects.casts_shadow)] == shadowless


def test_objects_of_an_obj_file_are_left_out_by_name(tmp_path):
    (tmp_path / "two.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 5 0 0\nv 6 0 0\nv 5 1 0\no door\nf 1 2 3\no wall\nf 4 5 6\n",
        encoding="utf-8",
    )
    both = load_model(tmp_path / "two.obj")
    assert both.triangle_count == 2
    wall = load_model(tmp_path / "two.obj", options=ImportOptions(without=("door",), scale=2.0))
    assert wall.triangle_count == 1
    assert np.allclose(wall.bounds[0], (10, 0, 0))
    refused = refused_rule(
        lambda: load_model(tmp_path / "two.obj", options=ImportOptions(without=("window",)))
    )
    assert refused == "scene-unknown-part"


@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_meshes_of_files_get_levels(tmp_path, scale):
    builder, geometry = SceneBuilder("ball"), bumpy_sphere(16)
    builder.add_objects(builder.add_node(), builder.add_mesh(geometry), builder.add_material())
    path = tmp_path / "ball.glb"
    save_scene(builder.build(), path)
    assert not len(load_model(path, options=ImportOptions(scale=scale)).meshes.level_ranges)
    scene = load_scene(f"{path}:scale={scale},levels=3")
    expected = simplify(geometry, 3)
    assert len(expected) > 1
    assert scene.meshes.level_ranges["index_count"].tolist() == [len(level.indices) for level in expected]
    assert scene.meshes.level_errors[0] == pytest.approx([level.error for level in expected], rel=1e-5)


def test_meshes_of_files_are_cut(tmp_path):
    builder = SceneBuilder("ball")
    builder.add_objects(builder.add_node(), builder.add_mesh(bumpy_sphere(16)), builder.add_material())
    path = tmp_path / "ball.glb"
    save_scene(builder.build(), path)
    assert not len(load_model(path).meshes.meshlet_ranges)
    meshes = load_scene(f"{path}:meshlet_size=32").meshes
    assert len(meshes.meshlet_ranges) == -(-int(meshes.triangle_counts[0]) // 32)


def test_skinned_and_morphing_meshes_are_never_cut(tmp_path):
    for make in (make_skinned, make_morphing):
        path = tmp_path / f"{make.__name__}.glb"
        make().write(path)
        assert not len(load_model(path, options=ImportOptions(meshlet_size=8)).meshes.meshlet_ranges)


def test_levels_beside_other_options(room, tmp_path):
    merged = load_model(room, options=ImportOptions(merge=True, levels=2))
    assert len(merged.objects) == 3
    assert not len(merged.meshes.level_ranges)  # its quads have nothing to leave out
    for make in (make_skinned, make_morphing):  # what may change has none
        path = tmp_path / f"{make.__name__}.glb"
        make().write(path)
        assert load_model(path, options=ImportOptions(levels=2)).meshes.level_begins[-1] == 0
    assert refused_rule(lambda: load_scene(f"{room}:levels=many")) == "scene-bad-import"
    assert refused_rule(lambda: load_scene(f"{room}:levels")) == "scene-spec-syntax"
