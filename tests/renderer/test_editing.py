"""Objects that come and go while a scene runs: it looks as one that is built anew, and costs as much."""

from __future__ import annotations

import numpy as np
import pytest
from frames import SIZE, open_renderer, read_colors, require_algorithm
from nightly_reasons import ONLY_KERNELS
from numpy.typing import NDArray
from refusals import refused_rule

from renderer.content import BUILT_IN
from renderer.frame import Effect
from renderer.renderer import FrameResult, Renderer
from renderer.scene import (
    AlphaMode,
    Camera,
    ObjectHandle,
    Scene,
    SceneBuilder,
    rotation,
    scaling,
    translation,
)
from renderer.shadows import ShadowSettings
from renderer.techniques import TECHNIQUES
from renderer.visibility import ALGORITHMS
from rhi import Device, ValidationError

EYE = Camera.look_at((0.0, 5.0, 11.0), (0.0, 0.5, 0.0)).with_aspect(SIZE[0] / SIZE[1])
SHADOWS = ShadowSettings(cascades=1, cascade_size=128, max_size=64, far_size=0)
SPARE = 12


def begin() -> SceneBuilder:
    """Return a floor, meshes 1 and 2 and materials 1 to 4, and lights that cast shadows."""
    builder = SceneBuilder("edited")
    for name in ("box", "torus", "sphere"):
        builder.add_mesh(BUILT_IN[name]())
    builder.add_material(base_color=(0.6, 0.6, 0.6))
    builder.add_material(base_color=(0.9, 0.2, 0.1))
    builder.add_material(base_color=(0.1, 0.3, 0.9), double_sided=True)
    builder.add_material(base_color=(0.2, 0.8, 0.2, 0.5), alpha_mode=AlphaMode.BLEND)
    builder.add_material(base_color=(0.9, 0.8, 0.1), emission=1.5)
    builder.lights.add_directional((-0.4, -1.0, -0.3), intensity=0.5, casts_shadow=True)
    builder.lights.add_point((2.0, 3.0, 1.0), 8.0, intensity=4.0, casts_shadow=True)
    builder.lights.add_spot(
        (-3.0, 4.0, 1.0), (0.4, -1.0, 0.0), 9.0, 0.4, 0.7, intensity=5.0, casts_shadow=True
    )
    builder.add_objects(builder.add_node(translation((0, -0.6, 0)) @ scaling((12, 1, 12))), 0, 0)
    return builder


def make_edited(glass: int = 3) -> Scene:
    """Return a scene with static objects 1 to 3, two of them below a node, and `SPARE` that are reserved."""
    builder = begin()
    group = builder.add_node(translation((0.3, 0.2, -0.1)), name="group")
    for number, parent in enumerate((-1, group, group)):
        node = builder.add_node(translation((3.0 * number - 3.0, 0.4, -2.0)), parent)
        builder.add_objects(node, 1 + number % 2, (1, 2, glass)[number])
    builder.reserve(SPARE, 1, 1)
    return builder.build()


def build_anew(scene: Scene) -> Scene:
    """Return a scene that has what another one shows, and no more."""
    builder, objects = begin(), scene.objects
    for row in np.flatnonzero(objects.is_shown).tolist()[1:]:
        node = builder.add_node(scene.nodes.world[objects.node[row]], dynamic=bool(objects.dynamic[row]))
        builder.add_objects(node, int(objects.mesh[row]), int(objects.material[row]))
    return builder.build()


class Editor:
    """Edits a scene at random."""

    def __init__(self, scene: Scene, seed: int, glass: int = 3) -> None:
        self.scene, self.random = scene, np.random.default_rng(seed)
        self.materials = 1, 2, glass, 4
        self.handles: list[ObjectHandle] = []
        self.fixed = [*scene.objects.node[1:4].tolist(), scene.nodes.find("group")]

    def random_transform(self) -> NDArray[np.float64]:
        turn = rotation(self.random.normal(size=3), self.random.uniform(0, 6))
        size = self.random.uniform(0.3, 1.2, 3) * self.random.choice([-1.0, 1.0], 3)
        return translation(self.random.uniform((-4, 0, -4), (4, 2, 4))) @ turn @ scaling(size)

    def pick(self) -> int:
        return self.scene.get_object_index(self.handles[int(self.random.integers(len(self.handles)))])

    def edit(self) -> None:
        scene, random = self.scene, self.random
        mesh, material = int(random.integers(1, 3)), int(random.choice(self.materials))
        kind = random.integers(7)
        if kind < 2 and len(self.handles) < SPARE:
            self.handles.append(scene.add_object(mesh, material, self.random_transform()))
        elif kind == 2 and self.handles:
            scene.remove_object(self.handles.pop(int(random.integers(len(self.handles)))))
        elif kind == 3:
            change = scene.nodes.hide if random.integers(2) else scene.nodes.show
            change(random.choice(self.fixed))
        elif kind == 4 and self.handles:
            row = self.pick()
            scene.nodes.set_local(scene.objects.node[row], self.random_transform())
        elif kind == 5 and self.handles:
            row = self.pick()
            scene.replace(row, mesh=mesh, material=material)
        elif kind == 6 and self.handles:
            row = self.pick()
            scene.nodes.set_parent(int(scene.objects.node[row]), int(random.choice([-1, self.fixed[-1]])))


def draw(renderer: Renderer) -> FrameResult:
    renderer.shadows.settings = SHADOWS
    renderer.render(EYE)
    return renderer.render(EYE)


def compare(device: Device, technique: str, algorithm: str, edits: int, *, every: int, seed: int = 1) -> None:
    """Edit a scene, and compare it with one that is built anew: its image, and what is drawn without
    queries."""
    glass = 1 if technique == "inferred" else 3  # which stipples glass by the rows of objects
    scene = make_edited(glass)
    editor = Editor(scene, seed, glass)
    with open_renderer(device, scene, TECHNIQUES[technique](), visibility=algorithm) as renderer:
        for number in range(edits):
            editor.edit()
            if number % every:
                continue
            frame = draw(renderer)
            new = build_anew(scene)
            with open_renderer(device, new, TECHNIQUES[technique](), visibility=algorithm) as other:
                expected = draw(other)
                if device.capabilities.renders:
                    difference = np.abs(read_colors(frame).astype(int) - read_colors(expected))
                    assert difference.max() <= 1, (number, difference.max(), (difference > 1).sum())
                if algorithm in ("none", "frustum"):
                    assert frame.statistics.draws == expected.statistics.draws, number
                    assert frame.statistics.triangles == expected.statistics.triangles, number
                    assert renderer.shadows.casters_drawn == other.shadows.casters_drawn == 0
                    expected_casters = sorted(
                        (report.name, report.casters) for report in other.shadows.reports
                    )
                    assert (
                        sorted((report.name, report.casters) for report in renderer.shadows.reports)
                        == expected_casters
                    )


@pytest.mark.nightly_cases("cl-forward", "cl-deferred_plus", "cl-clustered", reason=ONLY_KERNELS)
@pytest.mark.parametrize("technique", ["forward", "clustered", "deferred_plus"])
def test_an_edited_scene_looks_as_one_that_is_built_anew(drawing_device: Device, technique: str) -> None:
    compare(drawing_device, technique, "frustum", 48, every=8)


@pytest.mark.parametrize("algorithm", [name for name in ALGORITHMS if name != "auto"])
def test_each_algorithm_follows_edits(gl: Device, algorithm: str) -> None:
    require_algorithm(gl, algorithm)
    compare(gl, "forward", algorithm, 40, every=8, seed=2)


@pytest.mark.nightly
@pytest.mark.parametrize("technique", sorted(TECHNIQUES))
def test_two_thousand_edits_look_and_cost_as_a_scene_that_is_built_anew(
    drawing_device: Device, technique: str
) -> None:
    compare(drawing_device, technique, "frustum", 2000, every=50, seed=3)


@pytest.mark.parametrize("algorithm", ["none", "frustum"])
def test_an_edited_scene_costs_as_much_as_one_that_is_built_anew(null: Device, algorithm: str) -> None:
    compare(null, "forward", algorithm, 400, every=40, seed=4)


def test_a_hidden_object_needs_nothing(null: Device) -> None:
    """Neither effects nor shadow maps: the floor is all that receives shadows, glass all that is blended."""
    builder = begin()
    glass = builder.add_node(translation((0, 1, 0)))
    builder.add_objects(glass, 2, 3)
    scene = builder.build()
    with open_renderer(null, scene) as renderer:
        for hidden, effects, drawn in (((), True, 2), ((glass,), False, 1), ((0, glass), False, 0)):
            scene.nodes.show([0, glass])
            scene.nodes.hide(hidden)
            frame = draw(renderer)
            assert (Effect.TRANSPARENCY in frame.frames[0].effects.enabled) == effects
            assert frame.statistics.draws == drawn
            skipped = {report.reason for report in renderer.shadows.reports if report.state == "skipped"}
            assert ("it reaches nothing visible" in skipped) == (drawn == 0)


def test_an_edit_uploads_the_rows_that_it_changes(null: Device) -> None:
    builder = begin()
    nodes = builder.add_nodes(translation(np.random.default_rng(1).uniform(-4, 4, (5000, 3))), dynamic=True)
    builder.add_objects(nodes, 1, 1)
    for lights in (builder.lights.directional, builder.lights.point, builder.lights.spot):
        lights["casts_shadow"] = False
    scene = builder.build()
    with open_renderer(null, scene, visibility="none") as renderer:
        before = draw(renderer).statistics.upload_bytes
        scene.replace(17, material=0)
        assert renderer.render(EYE).statistics.upload_bytes == before + 112  # a row of `objects`
        scene.nodes.hide(scene.objects.node[40])
        renderer.render(EYE)
        assert renderer.render(EYE).statistics.upload_bytes == before


def test_a_hidden_node_hides_its_descendants_until_it_is_shown() -> None:
    scene = make_edited()
    nodes, node = scene.nodes, scene.objects.node
    for change, rows, expected in (
        (nodes.hide, nodes.find("group"), [0, 1]),
        (nodes.hide, node[2], [0, 1]),
        (nodes.show, nodes.find("group"), [0, 1, 3]),
        (nodes.hide, node[:2], [3]),
        (nodes.show, node[:4], [0, 1, 2, 3]),
    ):
        change(rows)
        scene.update()
        assert np.flatnonzero(scene.objects.is_shown).tolist() == expected
    assert refused_rule(lambda: nodes.hide(len(nodes))) == "scene-bad-index"


def test_bounds_follow_a_mesh_that_is_replaced() -> None:
    scene = make_edited()
    row = scene.get_object_index(scene.add_object(1, 1))
    scene.replace(row, mesh=2)
    assert scene.objects.upper[row] == pytest.approx([0.5, 0.5, 0.5])
    scene.replace(row, mesh=1)
    assert scene.objects.upper[row] == pytest.approx([0.5, 0.125, 0.5])


@pytest.mark.parametrize(
    ("rule", "rows", "arguments"),
    [
        ("scene-bad-index", 99, {"mesh": 1}),
        ("scene-bad-index", 4, {"mesh": 3}),
        ("scene-bad-index", 4, {"mesh": 1, "material": 9}),
        ("scene-fixed-mesh", [4, 1], {"mesh": 1}),
    ],
)
def test_a_refused_replacement_changes_nothing(rule: str, rows: int, arguments: dict[str, int]) -> None:
    scene = make_edited()
    before = scene.objects.mesh.copy(), scene.objects.material.copy(), scene.material_version
    with pytest.raises(ValidationError, match=rule):
        scene.replace(rows, **arguments)
    assert all(
        map(np.array_equal, before, (scene.objects.mesh, scene.objects.material, scene.material_version))
    )
    scene.replace([1, 4], material=2)  # the control
    assert scene.objects.material[[1, 4]].tolist() == [2, 2]


@pytest.mark.parametrize(
    ("animated", "refused"), [("none", False), ("beside", False), ("node", True), ("above", True)]
)
def test_a_mesh_within_declared_bounds_is_not_replaced(animated: str, refused: bool) -> None:
    """Bounds that hold at all times are those of the mesh that the scene was built with, also where they lie in
    the space of a dynamic node."""
    builder = begin()
    parent = builder.add_node(dynamic=True)
    above = builder.add_node(parent=parent, dynamic=True)
    node = builder.add_node(parent=above, dynamic=True)
    beside = builder.add_node(parent=parent, dynamic=True)
    (row,) = builder.add_objects(node, 1, 1).tolist()
    bounds = (-1, -1, -1), (1, 2, 1)
    moved = {"node": node, "above": above, "beside": beside}.get(animated)
    if moved is not None:
        builder.animate([moved], lambda seconds: translation([(0, seconds % 1.0, 0)]), bounds)
    scene = builder.build()
    before = scene.objects.boxes.lower.copy(), scene.objects.boxes.upper.copy()
    if refused:
        assert refused_rule(lambda: scene.replace(row, mesh=2)) == "scene-fixed-mesh"
        assert all(map(np.array_equal, before, (scene.objects.boxes.lower, scene.objects.boxes.upper)))
    else:
        scene.replace(row, mesh=2)
        assert scene.objects.mesh[row] == 2


def test_a_normal_map_needs_a_mesh_that_was_built_with_one() -> None:
    builder = begin()
    image = np.full((2, 2, 4), 128, np.uint8)
    mapped = builder.add_material(normal_texture=builder.add_image(image))
    builder.add_objects(builder.add_node(), 2, mapped)
    builder.reserve(1, 1, 0)
    scene = builder.build()
    assert refused_rule(lambda: scene.add_object(1, mapped)) == "scene-no-tangents"
    assert scene.objects.material[scene.get_object_index(scene.add_object(2, mapped))] == mapped


def test_nodes_animated_within_bounds_keep_their_parents_and_others_may_change_them() -> None:
    builder = begin()
    base, moved, below = (builder.add_node(dynamic=True, parent=parent) for parent in (-1, 1, 2))
    builder.add_objects(below, 1, 1)
    builder.animate([moved], lambda seconds: translation([(0, seconds % 1.0, 0)]), ((-1, -1, -1), (1, 2, 1)))
    nodes = builder.build().nodes
    for node in (moved, below):
        with pytest.raises(ValidationError, match="scene-fixed-parent"):
            nodes.set_parent(int(nodes.index_of_id[node]), -1)
    nodes.set_parent(int(nodes.index_of_id[base]), 0)


def test_a_handle_names_its_object_until_that_is_removed() -> None:
    scene = make_edited()
    handles = [scene.add_object(1, 1) for _ in range(SPARE)]
    assert len({scene.get_object_index(handle) for handle in handles}) == SPARE
    assert refused_rule(lambda: scene.add_object(1, 1)) == "scene-no-room"
    scene.nodes.set_parent(scene.objects.node[handles[3].object_index], scene.nodes.find("group"))
    scene.remove_object(handles[3])
    assert refused_rule(lambda: scene.remove_object(handles[3])) == "scene-removed-object"
    assert refused_rule(lambda: scene.add_object(1, 1, np.zeros((4, 4)))) == "scene-bad-transform"
    again = scene.add_object(2, 1)
    assert again.object_index == handles[3].object_index
    assert scene.nodes.parents[scene.objects.node[again.object_index]] == -1
    assert refused_rule(lambda: scene.get_object_index(handles[3])) == "scene-removed-object"
    assert scene.get_object_index(again) == again.object_index
    with pytest.raises(ValidationError, match="scene-removed-object"):
        scene.get_object_index(ObjectHandle(0, 0))  # one that wasn't reserved
