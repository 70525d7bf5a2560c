"""Commands that are recorded once and submitted in each frame, and frames that overlap."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from nightly_reasons import ONLY_KERNELS
from occlusion_scenes import (
    DEVICE,
    ORIGIN,
    Oracle,
    draw_with,
    make_boxes,
    make_camera,
    make_cloud,
    require_algorithm,
    walk,
)

import rhi
from renderer.content import load_scene
from renderer.renderer import Renderer
from renderer.scene import Camera, Depth, Perspective, Scene
from renderer.shaders.prefix_sum import PrefixSum
from renderer.visibility import NoCulling, make_visibility
from renderer.visibility.command_cache import CommandCache, clear
from rhi import Op
from rhi.backends.null import Activity, CostModel, Lane, NullBackend, SimulatedBackend, Simulation
from rhi.shading import uint

CAMERA = make_camera((0.0, 0.0, 30.0), ORIGIN, near=0.1)


# -- repeated commands -------------------------------------------------------------------------------------


def count_commands(device: rhi.Device, repeated: CommandCache, *keys: str) -> list[tuple[int, int, int]]:
    """Return for each key in turn: how often commands were issued, the commands recorded, and the clears
    executed."""
    counts = []
    buffer = device.storage(float, 4)
    for key in keys:
        issued: list[rhi.Encoder] = []

        def issue(encoder: rhi.Encoder, issued: list[rhi.Encoder] = issued) -> None:
            issued.append(encoder)
            clear(encoder, buffer)

        before, recorded = len(device.stream), device.statistics.recorded_commands
        repeated.execute((key, buffer), issue)
        done = device.stream[before:].filter(Op.CLEAR_BUFFER)
        counts.append((len(issued), device.statistics.recorded_commands - recorded, len(done)))
    return counts


def test_repeated_commands_are_recorded_and_unchanged_commands_are_only_submitted(null: rhi.Device) -> None:
    repeated = CommandCache(null, "test")
    # A label is two commands of the recording.
    assert count_commands(null, repeated, *"aaaa") == [(1, 0, 1), (1, 3, 1), (0, 0, 1), (0, 0, 1)]


def test_commands_that_change_in_each_frame_are_not_recorded(null: rhi.Device) -> None:
    repeated = CommandCache(null, "")
    assert count_commands(null, repeated, *"abab") == [(1, 0, 1)] * 4
    assert count_commands(null, repeated, *"bbc") == [(1, 0, 1), (1, 1, 1), (1, 0, 1)]


def test_commands_that_were_forgotten_are_issued_anew(null: rhi.Device) -> None:
    repeated = CommandCache(null, "")
    count_commands(null, repeated, *"aaa")
    repeated.forget()
    key = ("a",)
    issued: list[rhi.Encoder] = []
    for _ in range(3):
        repeated.execute(key, issued.append)
    assert issued[0] is null
    assert len(issued) == 2


def test_commands_that_failed_are_issued_again(null: rhi.Device) -> None:
    repeated = CommandCache(null, "")
    issued: list[rhi.Encoder] = []

    def fail(encoder: rhi.Encoder) -> None:
        issued.append(encoder)
        raise RuntimeError("no")

    for _ in range(2):
        with pytest.raises(RuntimeError):
            repeated.execute(("a",), fail)
    assert issued == [null, null], "what failed wasn't executed, so it doesn't come again"
    repeated.execute(("a",), lambda encoder: None)
    with pytest.raises(RuntimeError):
        repeated.execute(("a",), fail)
    assert isinstance(issued[-1], rhi.CommandBuffer)
    repeated.execute(("a",), issued.append)
    assert isinstance(issued[-1], rhi.CommandBuffer)
    assert issued[-1] is not issued[-2]


def test_dispatches_are_recorded_when_they_come_again_with_the_same_bindings(null: rhi.Device) -> None:
    repeated, program, recorded = CommandCache(null, ""), null.program(PrefixSum), []
    first, other = (null.storage(uint, 4) for _ in range(2))
    for counts in (first, first, first, other, other):
        before = null.statistics.recorded_commands
        repeated.dispatch([(program, 1, {"counts": counts})])
        recorded.append(null.statistics.recorded_commands - before)
    assert recorded[1] == recorded[4] > recorded[0] == recorded[2] == recorded[3] == 0
    assert len(null.stream.filter(Op.DISPATCH)) == 5


# -- culling on the device ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", DEVICE)
def test_culling_on_the_device_records_once_and_submits_the_same_commands(
    null: rhi.Device, name: str
) -> None:
    scene = make_cloud()
    oracle = Oracle(null, scene, name)
    algorithm = make_visibility(name, scene, null)
    cameras = [make_camera((0.1 * frame, 0.0, 30.0), ORIGIN, near=0.1) for frame in range(8)]
    recorded, executed, waits = [], [], 0
    with Renderer(null, scene, size=(64, 36)) as renderer:
        for frame, camera in enumerate(cameras):
            oracle.visible_objects = oracle.guessed = set(range(frame, 60, 1 + frame))
            before, earlier = len(null.stream), null.statistics.recorded_commands
            draw_with(renderer, algorithm, camera)
            commands = null.stream[before:]
            waits += len(commands.filter(frozenset({Op.WAIT, Op.READ_BUFFER})))
            executed.append(
                [
                    c.op
                    for c in commands.filter(
                        frozenset({Op.DISPATCH, Op.DRAW, Op.DRAW_INDIRECT, Op.BEGIN_PASS})
                    )
                ]
            )
            recorded.append(null.statistics.recorded_commands - earlier)
    settled = 3 if name == "two_pass" else 2  # its first frame has nothing to reproject
    assert [count > 0 for count in recorded] == [frame + 1 == settled for frame in range(8)]
    assert executed[settled - 1 :] == [executed[-1]] * (9 - settled)
    assert len(executed[-1]) > 8
    assert waits == 0


@pytest.mark.parametrize("name", DEVICE)
def test_another_size_direction_of_depth_or_target_is_recorded_anew(null: rhi.Device, name: str) -> None:
    scene = make_cloud()
    Oracle(null, scene, name, visible_objects={1})
    algorithm = make_visibility(name, scene, null)
    standard = replace(CAMERA, projection=Perspective(near=0.1, far=90.0, depth=Depth.STANDARD))
    with Renderer(null, scene, size=(64, 36)) as renderer:

        def records(camera: Camera = CAMERA) -> bool:
            """Return whether anything was recorded in four frames, and check that it is in use then."""
            counts = [null.statistics.recorded_commands]
            for _ in range(4):
                draw_with(renderer, algorithm, camera)
                counts.append(null.statistics.recorded_commands)
            assert counts[4] == counts[3]
            return counts[4] > counts[0]

        assert records()
        assert not records()
        assert records(standard)
        assert records()
        renderer.size = (32, 18)
        assert records()
        renderer.size = (64, 36)
        assert records()
        assert not records()


@pytest.mark.parametrize("name", [*DEVICE, "conditional", "chc_plus_plus"])
def test_a_new_size_with_questions_in_flight_changes_no_pixel(device: rhi.Device, name: str) -> None:
    require_algorithm(device, name)
    scene = load_scene("city:blocks=8,detail=2")
    none, algorithm = NoCulling(scene), make_visibility(name, scene, device)
    with Renderer(device, scene, size=(97, 55)) as renderer:
        for index, (camera, seconds) in enumerate(walk(scene, "ground", range(600, 664, 4))):
            if index % 4 == 3:
                renderer.size = ((64, 64), (97, 55))[renderer.size == (64, 64)]
            image = draw_with(renderer, algorithm, camera, seconds).image.read()
            assert (image == draw_with(renderer, none, camera, seconds).image.read()).all(), index
    algorithm.destroy()


# -- frames of one batch -----------------------------------------------------------------------------------


def count_recorded(device: rhi.Device, scene: Scene, name: str, cameras: list[Camera]) -> list[int]:
    """Return the number of commands recorded in each frame, at a time that passes."""
    algorithm, counts = make_visibility(name, scene, device), []
    with Renderer(device, scene, visibility=algorithm, size=(64, 36)) as renderer:
        for frame, camera in enumerate(cameras):
            before = device.statistics.recorded_commands
            renderer.render(camera, frame / 60)
            counts.append(device.statistics.recorded_commands - before)
    return counts


def test_drawing_everything_is_recorded_once_however_camera_and_objects_move(null: rhi.Device) -> None:
    scene = load_scene("hall:columns=12,rows=4,flags=1")
    assert len(scene.objects.dynamic_indices)
    cameras = [scene.paths["ground"].camera(20 * frame) for frame in range(8)]
    counts = count_recorded(null, scene, "none", cameras)
    assert counts[1] > 4
    assert counts[:1] + counts[2:] == [0] * 7


def test_the_objects_in_the_frustum_are_recorded_when_their_number_repeats(null: rhi.Device) -> None:
    scene = make_cloud(400)
    near = [make_camera((0.0, 0.0, 1.0 + distance), ORIGIN, near=0.1) for distance in range(5)]
    with Renderer(null, scene, visibility=make_visibility("frustum", scene, null)) as renderer:
        assert len({len(renderer.render(camera).visible) // 32 for camera in near}) == 5
    counts = count_recorded(null, scene, "frustum", [*near, near[-1], near[-1], near[0], near[0]])
    assert [count > 0 for count in counts] == [False] * 5 + [True, False, False, True]


def test_a_few_objects_more_or_fewer_in_view_record_nothing(null: rhi.Device) -> None:
    scene = make_cloud(400)
    near = [
        make_camera((0.0, 0.0, distance), ORIGIN, near=0.1) for distance in (2.0, 2.5, 2.2, 2.6, 3.0, 2.0)
    ]
    with Renderer(null, scene, visibility=make_visibility("frustum", scene, null)) as renderer:
        drawn = [len(renderer.render(camera).visible) for camera in near]
    assert all(96 < count <= 128 for count in (*drawn[:4], drawn[5]))
    assert len(set(drawn)) > 3
    assert drawn[4] > 128, "the control: it takes another number of draws"
    counts = count_recorded(null, scene, "frustum", near)
    assert [count > 0 for count in counts] == [False, True, False, False, False, False]


def test_draws_that_make_up_the_number_are_of_nothing(null: rhi.Device) -> None:
    scene = make_cloud(400)
    camera = make_camera((0.0, 0.0, 3.0), ORIGIN, near=0.1)
    with Renderer(null, scene, visibility=make_visibility("frustum", scene, null)) as renderer:
        nearer = make_camera((0.0, 0.0, 2.0), ORIGIN, near=0.1)
        for eye in (camera, nearer):  # what the larger number left behind isn't drawn
            visible = renderer.render(eye).visible
            (command,) = null.stream.filter(Op.DRAW_INDIRECT)[-1:]
            (buffer,) = [
                buffer_or_none
                for buffer_or_none in [renderer.view.batch._buffer]
                if buffer_or_none is not None
            ]
            draws = buffer.read()[: command.values[4]]
            assert len(draws) == -(-len(visible) // 32) * 32
            assert sorted(draws["base_instance"][: len(visible)].tolist()) == visible.tolist()
            assert (draws["instances"][: len(visible)] == 1).all()
            assert not draws["instances"][len(visible) :].any()


@pytest.mark.parametrize("depth", Depth)
@pytest.mark.parametrize("name", ["none", "frustum"])
def test_a_steady_frame_that_is_submitted_changes_no_states(
    null: rhi.Device, name: str, depth: Depth
) -> None:
    scene = make_cloud()
    camera = CAMERA.with_projection(Perspective(near=0.1, far=90.0, depth=depth))
    changes = []
    with Renderer(null, scene, visibility=make_visibility(name, scene, null)) as renderer:
        for _ in range(4):
            changes.append(renderer.render(camera).statistics.hardware_state_changes)
    assert changes == [1, 0, 0, 0]  # the depth function, in which equal depths pass


@pytest.mark.parametrize("name", ["none", "frustum"])
def test_a_frame_that_is_submitted_looks_as_one_that_is_drawn_at_once(device: rhi.Device, name: str) -> None:
    """The objects move, and the camera."""
    scene = load_scene("hall:columns=6,flags=2")
    path, frames = scene.paths["ground"], set()
    with Renderer(device, scene, visibility=make_visibility(name, scene, device), size=(97, 55)) as renderer:
        for frame in range(0, 60, 10):
            before = device.statistics.recorded_commands
            image = renderer.render(path.camera(frame), frame / 60).image.read()
            recorded = device.statistics.recorded_commands > before
            fresh = make_visibility(name, scene, device)
            with Renderer(device, scene, visibility=fresh, size=(97, 55)) as other:
                assert (image == other.render(path.camera(frame), frame / 60).image.read()).all(), frame
            frames.add((image.tobytes(), recorded))
    assert len(frames) == 6, "a frame that doesn't change proves nothing"
    assert name == "frustum" or any(recorded for _, recorded in frames)


def test_a_frame_that_is_submitted_draws_the_objects_of_its_own_view(null: rhi.Device) -> None:
    """Two views see one object each, so the commands are the same."""
    scene = make_boxes(np.array([[-50.0, 0.0, 0.0], [50.0, 0.0, 0.0]]), np.ones((2, 3)))
    views = [make_camera((x, 0.0, 9.0), (x, 0.0, 0.0), near=0.1) for x in (-50.0, 50.0)]
    drawn = []
    with Renderer(null, scene, visibility=make_visibility("frustum", scene, null)) as renderer:
        for view in (0, 0, 1, 0):
            assert renderer.render(views[view]).visible.tolist() == [view]
            null.finish()
            (draw,) = null.stream.draws()
            draw_bytes = null.backend_as(NullBackend).read_buffer(
                draw["buffer"], draw["offset"], rhi.DRAW.itemsize
            )
            drawn.append(int(np.frombuffer(draw_bytes, rhi.DRAW)["base_instance"][0]))
            null.stream.clear()
    assert drawn == [0, 0, 1, 0]


# -- frames that overlap -----------------------------------------------------------------------------------


def measure_overlap(name: str, *, waits: bool = False) -> float:
    """Return for how much of the time of the one with less work CPU and GPU worked side by side, in frames
    that cost both about as much. `waits`: the program waits for the GPU after each frame."""
    scene = make_cloud()
    cost = CostModel(command=900.0, vertex=0.0, pixel=0.0, byte=0.0, state_change=0.0, invocation=0.0)
    simulation = Simulation(cost, call=1000, submission_latency=10, wake_latency=10, batch=10**6)
    with rhi.create_device("null", simulation=simulation) as device:
        gpu = device.backend_as(SimulatedBackend)
        oracle = Oracle(device, scene, name)
        oracle.visible_objects = oracle.guessed = set(range(0, 60, 5))
        algorithm = make_visibility(name, scene, device)
        with Renderer(device, scene, size=(64, 36)) as renderer:
            for _ in range(3):
                draw_with(renderer, algorithm, CAMERA)
            device.finish()
            begin = gpu.timeline.end
            for _ in range(12):
                draw_with(renderer, algorithm, CAMERA)
                if waits:
                    device.finish()
            device.finish()
            timeline = gpu.timeline
            busy = [timeline.total(lane, Activity.BUSY, begin) for lane in Lane]
            return (sum(busy) - (timeline.end - begin)) / min(busy)


@pytest.mark.parametrize("name", ["none", "frustum", "conditional", *DEVICE])
def test_a_frame_is_recorded_while_the_gpu_draws_the_one_before(name: str) -> None:
    assert measure_overlap(name) > 0.8


def count_early_frames(
    device: rhi.Device, size: tuple[int, int] = (320, 180), *, waits: bool
) -> tuple[int, int]:
    """Return of how many frames the tree of timers says that the CPU began them before the GPU had ended the
    one before, and how many were looked at."""
    scene, trees = load_scene("city:blocks=4,detail=2"), []
    device.timing = True
    with Renderer(device, scene, visibility=NoCulling(scene), size=size) as renderer:
        for frame in range(12):
            renderer.render(scene.paths["ground"].camera(20 * frame))
            if waits:
                device.finish()
            if device.timers and (not trees or device.timers is not trees[-1]):
                trees.append(device.timers)
        device.finish()
    early = 0
    for (before,), (node,) in pairwise(trees):
        assert before.gpu_span is not None
        assert node.cpu_span is not None
        early += node.cpu_span[0] < before.gpu_span[1]
    return early, len(trees) - 1


def test_the_timer_tree_shows_that_a_frame_is_recorded_while_the_gpu_draws_the_one_before() -> None:
    cost = CostModel(command=2000.0, vertex=0.0, pixel=0.0, byte=0.0, state_change=0.0, invocation=0.0)
    simulation = Simulation(cost, call=1000, submission_latency=10, wake_latency=10, batch=10**6)
    for waits in (False, True):
        with rhi.create_device("null", simulation=simulation) as device:
            early, frames = count_early_frames(device, waits=waits)
        assert frames > 6
        assert early == (0 if waits else frames)


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_the_timer_tree_of_a_real_device_shows_it_too(device: rhi.Device) -> None:
    if device.backend_name == "wgpu":
        pytest.skip("its timestamps are of no clock that the CPU has")
    early, frames = count_early_frames(device, waits=True)
    assert (early, frames) == (0, 11)
    # Frames of so many pixels take a device many times as long as recording one: so it is still at work when
    # the next one begins, also where others keep this thread from running for as long as a small frame takes.
    early, frames = count_early_frames(device, (960, 540), waits=False)
    assert early > 0


def test_frames_that_are_waited_for_alternate_with_the_gpu() -> None:
    for name in ("none", "conditional"):
        assert measure_overlap(name, waits=True) < 0.5
