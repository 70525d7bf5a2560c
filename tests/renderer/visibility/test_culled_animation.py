"""Animated objects that aren't drawn cost nothing, and are drawn as of their frame when they show again."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest
from nightly_reasons import ONLY_KERNELS
from occlusion_scenes import DEVICE, WAITING, Oracle, draw_with, require_algorithm

import rhi
from renderer.content import BUILT_IN, load_scene
from renderer.content.hall import _Sway
from renderer.renderer import Renderer
from renderer.scene import (
    Camera,
    Orthographic,
    Recompute,
    Scene,
    SceneBuilder,
    rotation,
    scaling,
    translation,
)
from renderer.visibility import FrustumCulling, NoCulling, make_visibility
from rhi import Op
from rhi.math import multiply

HALL = "hall:columns=18,rows=2,flags=10,fountains=4"
OBJECT_POSITION_BYTES = 32
"""Bytes of an object's place on the device; its other row, of its linear transform, stays the same."""
AWAY = Camera.look_at((0.0, 500.0, 0.0), (0.0, 1000.0, 0.0))
WRITES = {Op.WRITE_BUFFER}


class Bobbing:
    """Things that go up and down; `requested_members` counts the members whose transforms were asked for,
    `calls` the calls."""

    catch_up = Recompute()
    calls = 0
    requested_members = 0

    def __init__(self, positions: np.ndarray) -> None:
        self.object_positions = positions
        self.height = np.zeros(len(positions))

    def set_time(self, members: np.ndarray, seconds: float) -> None:
        Bobbing.calls += 1
        self.height[members] = np.sin(3.0 * seconds + members)

    def transforms(self, members: np.ndarray) -> np.ndarray:
        Bobbing.calls += 1
        Bobbing.requested_members += len(members)
        return translation(self.object_positions[members] + np.array([0, 1, 0]) * self.height[members, None])


def make_bobbing(count: int = 40, bounded: bool = True) -> Scene:
    """Make a row of things along x, 4 m apart, each on a node of its own."""
    Bobbing.calls = Bobbing.requested_members = 0
    builder = SceneBuilder("bobbing")
    object_positions = np.stack([4.0 * np.arange(count), np.zeros(count), np.zeros(count)], axis=1)
    nodes = builder.add_nodes(translation(object_positions), dynamic=True)
    builder.add_objects(nodes, builder.add_mesh(BUILT_IN["box"]()), builder.add_material())
    half = np.array([0.5, 1.5, 0.5])
    builder.animate(
        nodes,
        Bobbing(object_positions),
        (object_positions - half, object_positions + half) if bounded else None,
    )
    scene = builder.build()
    Bobbing.calls = Bobbing.requested_members = 0
    return scene


def look_at_first(count: int) -> Camera:
    """Return a camera that sees the first `count` things, and nothing of the others."""
    aim = np.array([2.0 * (count - 1), 0.0, 0.0])
    return Camera.look_at((aim[0], 0.0, 50.0), aim, projection=Orthographic(4.0 * count, aspect=1.0))


def count_writes(device: rhi.Device) -> int:
    write_count = sum(command.op in WRITES for command in device.stream)
    device.stream.clear()
    return write_count


def test_with_nothing_drawn_nothing_is_called_and_nothing_written(null: rhi.Device) -> None:
    scene = make_bobbing()
    with Renderer(null, scene, visibility=FrustumCulling(scene), size=(64, 64)) as renderer:
        renderer.render(AWAY, 0.0)
        null.stream.clear()
        Bobbing.calls = 0
        for frame in range(1, 11):
            result = renderer.render(AWAY, frame / 60)
            assert result.statistics.upload_bytes == 0
            assert result.statistics.skipped_simulations == 40
        assert Bobbing.calls == 0
        assert count_writes(null) == 0


def test_an_object_that_leaves_the_view_is_not_animated_from_that_frame_on(null: rhi.Device) -> None:
    scene = make_bobbing()
    with Renderer(null, scene, visibility=FrustumCulling(scene), size=(64, 64)) as renderer:
        renderer.animation_lag = 0.0
        assert len(renderer.render(look_at_first(40), 0.1).visible) == 40
        Bobbing.calls = 0
        assert renderer.render(AWAY, 0.2).statistics.skipped_simulations == 40
        assert Bobbing.calls == 0
        assert len(renderer.render(look_at_first(40), 0.2).visible) == 40
        assert Bobbing.calls == 2


@pytest.mark.parametrize(("count", "bounded"), [(20, True), (40, True), (20, False)])
def test_drawn_objects_are_animated_in_one_call_and_their_transforms_are_written(
    null: rhi.Device, count: int, bounded: bool
) -> None:
    scene = make_bobbing(bounded=bounded)
    camera = look_at_first(count)
    with Renderer(null, scene, visibility=FrustumCulling(scene), size=(64, 64)) as renderer:
        renderer.animation_lag = 0.0
        for frame in range(2):
            renderer.render(camera, frame / 60)
        null.stream.clear()
        Bobbing.calls = Bobbing.requested_members = 0
        result = renderer.render(camera, 0.5)
    assert sorted(result.visible.tolist()) == list(range(count))
    animated = count if bounded else 40  # what has no bounds is animated everywhere
    assert (Bobbing.calls, Bobbing.requested_members) == (2, animated)
    assert result.statistics.upload_bytes == animated * OBJECT_POSITION_BYTES
    assert count_writes(null) == 1  # the rows of one array; the draws are those of the last frame


@pytest.mark.parametrize("name", WAITING)
def test_hidden_objects_are_not_animated(null: rhi.Device, name: str) -> None:
    scene = make_bobbing()
    oracle = Oracle(null, scene, name)
    algorithm = make_visibility(name, scene, null)
    camera = look_at_first(40)
    with Renderer(null, scene, size=(64, 64)) as renderer:
        renderer.animation_lag = 0.0
        oracle.visible_objects = {3, 4, 9}
        for frame in range(1, 12):
            Bobbing.calls = Bobbing.requested_members = 0
            result = draw_with(renderer, algorithm, camera, frame / 60)
        assert set(result.visible.tolist()) == oracle.visible_objects
        assert (Bobbing.calls, Bobbing.requested_members) == (
            2,
            3,
        )  # at once, however many batches were drawn
        oracle.visible_objects = set()
        for frame in range(12, 40):  # until all are asked about again
            Bobbing.calls = 0
            result = draw_with(renderer, algorithm, camera, frame / 60)
        assert (len(result.visible), Bobbing.calls) == (0, 0)
        oracle.visible_objects = {3, 4, 9, 30}
        returned = draw_with(renderer, algorithm, camera, 40 / 60)
        assert set(returned.visible.tolist()) == oracle.visible_objects
        heights = scene.nodes.world[scene.objects.node[[3, 30]], 1, 3]
        assert heights == pytest.approx(np.sin(3.0 * 40 / 60 + np.array([3, 30])), abs=1e-15)


def make_reference(monkeypatch: pytest.MonkeyPatch) -> Scene:
    """Make the hall as if no animation had bounds: everything moves in every frame."""
    animate = SceneBuilder.animate
    with monkeypatch.context() as always:
        always.setattr(
            SceneBuilder, "animate", lambda self, nodes, motion, bounds: animate(self, nodes, motion)
        )
        return load_scene(HALL)


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("name", ["frustum", "chc_plus_plus", "stop_and_wait", *DEVICE, "software_depth"])
def test_objects_that_show_again_are_drawn_as_of_their_frame(
    drawing_device: rhi.Device, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    require_algorithm(drawing_device, name)
    hall, always = load_scene(HALL), make_reference(monkeypatch)
    assert len(hall.objects.simulated_indices) == len(always.objects.simulated_indices) + 60
    path, size = hall.paths["ground"], (97, 55)
    skipped = 0
    with (
        Renderer(drawing_device, always, visibility=NoCulling(always), size=size) as reference,
        Renderer(
            drawing_device,
            hall,
            visibility=make_visibility(name, hall, drawing_device),
            size=size,
            validation=True,
        ) as renderer,
    ):
        reference.animation_lag = renderer.animation_lag = 0.0
        for frame, seconds in ((0, 0.0), (3, 0.3), (900, 0.6), (903, 0.9), (3, 40.0), (6, 40.1), (900, 0.2)):
            expected = reference.render(path.camera(frame), seconds)
            result = renderer.render(path.camera(frame), seconds)
            assert (result.image.read() == expected.image.read()).all(), frame
            skipped += result.statistics.skipped_simulations
        late = renderer.render(path.camera(900), 0.9).image.read()
        assert (late != expected.image.read()).any()  # the control: time shows
    assert skipped > 0


def test_only_drawn_flags_of_the_hall_sway(null: rhi.Device, monkeypatch: pytest.MonkeyPatch) -> None:
    hall = load_scene("hall:flags=32")
    requested_members: list[int] = []
    transforms = _Sway.transforms
    monkeypatch.setattr(
        _Sway,
        "transforms",
        lambda self, members: (requested_members.append(len(members)), transforms(self, members))[1],
    )
    with Renderer(null, hall, visibility=FrustumCulling(hall), size=(64, 36)) as renderer:
        renderer.animation_lag = 0.0
        camera = hall.views["flags"]
        for frame in range(6):
            drawn = renderer.render(camera, frame / 60).visible
    flags = np.intersect1d(drawn, hall.objects.dynamic_indices)
    assert 0 < len(flags) < 192
    assert len(requested_members) == 6
    # A segment's transform depends on those before it, up to the pole.
    part, flag = np.divmod(np.searchsorted(hall.objects.dynamic_indices, flags), 32)
    assert requested_members[-1] == sum(
        int(part[flag == flag_index].max()) + 1 for flag_index in np.unique(flag)
    )


def test_a_segment_is_where_it_would_be_if_all_were_animated() -> None:
    hall, always = load_scene(HALL), load_scene(HALL)
    simulator = hall.make_simulator()
    last = hall.objects.dynamic_indices[-3:]
    for seconds in (0.4, 77.0, 3600.0):
        simulator.begin_frame(seconds)
        hall.refresh()
        simulator.advance(last)
        always.update(seconds)
        node = hall.objects.node[last]
        # The same operations in the same order: equal to the last bit.
        assert (hall.nodes.world[node] == always.nodes.world[node]).all()
    others = hall.objects.node[hall.objects.dynamic_indices[:-3]]
    assert (hall.nodes.world[others] != always.nodes.world[others]).any()


def test_two_renderers_of_one_scene_show_a_time_each(gl: rhi.Device) -> None:
    scene, alone = make_bobbing(), make_bobbing()
    camera = look_at_first(6)
    with Renderer(gl, scene, size=(48, 48)) as first_renderer, Renderer(gl, scene, size=(48, 48)) as other:
        for first, second in ((0.1, 0.6), (0.1, 0.7), (0.2, 0.2), (0.9, 0.1)):
            images = [
                first_renderer.render(camera, first).image.read(),
                other.render(camera, second).image.read(),
            ]
            for image, seconds in zip(images, (first, second), strict=True):
                with Renderer(gl, alone, size=(48, 48)) as fresh:
                    assert (image == fresh.render(camera, seconds).image.read()).all()
        assert (images[0] != images[1]).any()


def test_a_moving_parent_moves_the_bounds_of_a_culled_object(gl: rhi.Device) -> None:
    builder = SceneBuilder("cart")
    cart = builder.add_node(dynamic=True, name="cart")
    wheel = builder.add_node(parent=cart, dynamic=True)
    builder.add_objects(wheel, builder.add_mesh(BUILT_IN["box"]()), builder.add_material(emission=1.0))
    builder.animate(
        wheel, lambda seconds: rotation((0, 0, 1), np.array([seconds])), ((-1, -1, -1), (1, 1, 1))
    )
    scene = builder.build()
    away = Camera.look_at((0.0, 0.0, 5.0), (0.0, 0.0, 10.0))
    there = Camera.look_at((50.0, 0.0, 5.0), (50.0, 0.0, 0.0))
    images = []
    for name in ("frustum", "two_pass"):
        scene.nodes.set_local(scene.nodes.find("cart"), np.eye(4))
        with Renderer(gl, scene, visibility=make_visibility(name, scene, gl), size=(48, 48)) as renderer:
            renderer.render(away, 0.3)
            scene.nodes.set_local(scene.nodes.find("cart"), translation((50.0, 0.0, 0.0)))
            renderer.render(away, 0.5)
            assert scene.objects.lower[0] == pytest.approx((49.0, -1.0, -1.0))
            images.append(renderer.render(there, 0.8).image.read())
    assert (images[0] == images[1]).all()
    assert (images[0] != images[0][0, 0]).any()


def test_bounds_below_an_animated_node_are_those_of_the_nearest_animated_one() -> None:
    builder = SceneBuilder("crane")
    base = builder.add_node(translation((10.0, 0.0, 0.0)))
    arm = builder.add_node(parent=base, dynamic=True)
    hook = builder.add_node(parent=arm, dynamic=True)
    load = builder.add_node(translation((0.0, -1.0, 0.0)), parent=hook)
    box = builder.add_mesh(BUILT_IN["box"]())
    builder.add_objects([arm, load, base], box, builder.add_material())
    builder.animate(arm, lambda seconds: translation([(0.0, 3.0, 0.0)]), ((-1, 2, -1), (1, 4, 1)))
    builder.animate(hook, lambda seconds: np.eye(4)[None], ((-5, -5, -5), (5, 5, 5)))
    objects = builder.build().objects
    assert objects.lower[:, 0] == pytest.approx((9.0, 5.0, 9.5))
    assert objects.lower[:, 1] == pytest.approx((2.0, -5.0, -0.5))  # in the space of the base
    assert objects.simulated.tolist() == [True, True, False]


def test_children_of_a_node_without_bounds_are_animated_in_every_frame(null: rhi.Device) -> None:
    builder = SceneBuilder("rocket")
    rocket = builder.add_node(dynamic=True)
    fin = builder.add_node(parent=rocket, dynamic=True)
    builder.add_objects(fin, builder.add_mesh(BUILT_IN["box"]()), builder.add_material())
    builder.animate(rocket, lambda seconds: translation([(0.0, 100.0 * seconds, 0.0)]))
    builder.animate(fin, lambda seconds: rotation((0, 1, 0), np.array([seconds])), ((-1, -1, -1), (1, 1, 1)))
    scene = builder.build()
    with Renderer(null, scene, visibility=FrustumCulling(scene), size=(64, 64)) as renderer:
        renderer.render(AWAY, 2.0)
    expected = multiply(translation((0.0, 200.0, 0.0)), rotation((0, 1, 0), 2.0))
    assert (scene.nodes.world[scene.objects.node[0]] == expected).all()
    assert scene.objects.lower[0, 1] == pytest.approx(199.5)


def test_vertices_of_adjacent_meshes_are_written_together(null: rhi.Device) -> None:
    hall = load_scene("hall:columns=6,rows=2,flags=0,fountains=6")
    with Renderer(null, hall, visibility=NoCulling(hall), size=(64, 36)) as renderer:
        renderer.render(hall.views["overview"], 0.0)
        renderer.render(hall.views["overview"], 0.5)
        null.stream.clear()
        result = renderer.render(hall.views["overview"], 1.0)
    assert result.statistics.simulation_steps == 6 * 30
    writes = [command for command in null.stream if command.op in WRITES]
    sizes = sorted(len(bytes(command["data"])) for command in writes)
    assert sizes[-1] == 6 * 1080 * 32
    assert len(writes) == 1  # the vertices; the draws are those of the last frame


def widen(scene: Scene, by: float) -> None:
    scene.objects.boxes.lower[scene.objects.simulated] += by
    scene.objects.refresh_bounds(scene.nodes, np.arange(len(scene.objects)))


TIMES = np.linspace(0.0, 12.0, 97)


@pytest.mark.parametrize("text", [HALL, "hall:columns=6,rows=2,flags=3,fountains=2,seed=5"])
def test_bounds_of_the_hall_hold_at_all_times(text: str) -> None:
    hall = load_scene(text)
    hall.check_bounds(TIMES)
    # Once more, by other means: the world boxes of the flags' vertices.
    meshes, objects, rows = hall.meshes, hall.objects, hall.objects.dynamic_indices
    least, most = np.full((len(rows), 3), np.inf), np.full((len(rows), 3), -np.inf)
    for seconds in TIMES.tolist():
        hall.update(seconds)
        for number, row in enumerate(rows.tolist()):
            begin = int(meshes.ranges["base_vertex"][objects.mesh[row]])
            size = int(meshes.vertex_counts[objects.mesh[row]])
            points = meshes.vertices["position"][begin : begin + size]
            world = hall.nodes.world[objects.node[row]]
            moved = points @ world[:3, :3].T + world[:3, 3]
            least[number] = np.minimum(least[number], moved.min(0))
            most[number] = np.maximum(most[number], moved.max(0))
    slack = 1e-6 * np.abs(objects.lower[rows]).max()  # vertices are float32
    assert (least >= objects.lower[rows] - slack).all()
    assert (most <= objects.upper[rows] + slack).all()
    room = (objects.upper - objects.lower)[rows].prod(1) / (most - least).prod(1)
    assert np.median(room) < 2.0  # and the bounds are no larger than they need be, but for poles at an angle


def test_bounds_that_do_not_hold_are_refused_by_name() -> None:
    scene = make_bobbing(3)
    scene.check_bounds(TIMES)
    widen(scene, 0.1)
    with pytest.raises(rhi.ValidationError, match="scene-left-bounds") as refused:
        scene.check_bounds(TIMES)
    assert "object" in refused.value.given


@pytest.mark.parametrize("validation", [True, False])
def test_a_renderer_with_validation_checks_the_bounds_of_drawn_objects(
    null: rhi.Device, validation: bool
) -> None:
    scene = make_bobbing(6)
    widen(scene, 0.6)
    with Renderer(null, scene, visibility=NoCulling(scene), size=(64, 64), validation=validation) as renderer:
        rule_id = None
        for frame in range(12):
            try:
                renderer.render(look_at_first(6), frame / 6)
            except rhi.ValidationError as error:
                rule_id = error.rule.id
                break
    assert rule_id == ("scene-left-bounds" if validation else None)


class NoResult:
    catch_up = Recompute()

    def set_time(self, members: np.ndarray, seconds: float) -> None:
        pass


class NoPolicy:
    def transforms(self, members: np.ndarray) -> np.ndarray:
        return scaling(np.ones((len(members), 3)))


@pytest.mark.parametrize(
    ("change", "rule"),
    [
        (lambda b, n: b.animate(n, NoResult()), "scene-bad-simulation"),
        (lambda b, n: b.animate(n, NoPolicy()), "scene-bad-simulation"),
        (lambda b, n: b.animate([7], lambda seconds: np.eye(4)), "scene-bad-index"),
        (lambda b, n: [b.animate(n, lambda seconds: np.eye(4)) for _ in range(2)], "scene-shared-node"),
        (lambda b, n: b.animate(n, lambda s: np.eye(4), ((1, 1, 1), (0, 2, 2))), "visibility-bad-bounds"),
        (lambda b, n: b.animate(n, lambda s: np.eye(4), ((0, 0), (1, 1))), "visibility-bad-bounds"),
        (
            lambda b, n: b.animate(n, lambda s: np.eye(4), ((0, 0, np.nan), (1, 1, 1))),
            "visibility-bad-bounds",
        ),
        (lambda b, n: b.animate(n, lambda seconds: np.eye(4), ((0, 0, 0), (1, 1, 1))), None),
    ],
)
def test_invalid_animations_are_refused(change: object, rule: str | None) -> None:
    builder = SceneBuilder("bad")
    nodes = builder.add_nodes(np.eye(4)[None], dynamic=True)
    builder.add_objects(nodes, builder.add_mesh(BUILT_IN["box"]()), builder.add_material())
    with nullcontext() if rule is None else pytest.raises(rhi.ValidationError) as refused:
        change(builder, nodes)
        builder.build()
    assert rule == (refused and refused.value.rule.id)
