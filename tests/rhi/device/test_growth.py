"""Nothing outlives what it was made for, and no table of a device grows without bound."""

from __future__ import annotations

import gc
import linecache
import weakref
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from harness_kit import Corner
from null_kit import Camera, Kit

import rhi
from rhi import Device, Format, Op, SamplerDescriptor
from rhi.backends.null import NullBackend
from rhi.device.core import core
from rhi.device.core.timeline import MAX_WAITING, MAX_WAITING_BYTES
from rhi.device.queries.timers import MAX_EVENTS
from rhi.shading import Shader, StorageRW, Uniform, global_id, run_compute, vec4

pytestmark = pytest.mark.usefixtures("quick_collections")


CORNERS = np.array([[-1, -1], [1, -1], [0, 1]], np.float32)


def make_shader() -> type[Shader]:
    class Flat(Shader):
        camera: Uniform[Camera]

        def vertex(self, v: Corner) -> vec4:
            return vec4(v.position, 0.5, 1.0)

        def fragment(self) -> vec4:
            return self.camera.tint

    return Flat


class GrowthHarness:
    """A device with what outlives the programs of these tests."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.image = device.texture((4, 4), Format.RGBA8)
        self.camera = device.uniform(Camera(tint=(1, 1, 1, 1)))
        self.vertices = device.buffer(np.zeros(3, [("position", "<f4", 2)]))
        self.meshes = [device.mesh({"position": CORNERS}), device.mesh(self.vertices)]
        self.view = self.meshes[0].view(0, 3)

    def draw_everything(self, program: rhi.Program[...]) -> None:
        device, camera = self.device, self.camera
        vertices = np.zeros(4, [("position", "<f4", 2)])
        with device.render_pass(self.image):
            for mesh in (*self.meshes, self.view, device.transient.mesh(program, vertices)):
                device.draw(program, mesh, camera=camera)
            device.draw_many(program, self.meshes[0], self.meshes[0].draws([0, 0], 3), camera=camera)
            with device.immediate(program, rhi.Primitive.POINTS, camera=camera) as points:
                points.vertices(vertices)
        with device.record() as commands, commands.render_pass(self.image):
            commands.draw(program, self.meshes[0], camera=camera)
        device.submit(commands)
        device.present()


@pytest.fixture
def harness(null_device: Device) -> GrowthHarness:
    return GrowthHarness(null_device)


def ids(device: Device, op: Op, field: str) -> list[int]:
    return [command[field] for command in device.stream if command.op is op]


def test_nothing_keeps_a_destroyed_program_or_its_shader(harness: GrowthHarness) -> None:
    shader = make_shader()
    program = harness.device.program(shader)
    harness.draw_everything(program)
    program.destroy()
    seen = [weakref.ref(shader), weakref.ref(program.draw)]
    del shader, program
    gc.collect()
    assert [reference() for reference in seen] == [None, None]


def test_a_live_program_keeps_its_shader_alive(harness: GrowthHarness) -> None:
    shader = make_shader()
    program_id = harness.device.program(shader).id
    gc.collect()
    assert harness.device.program(shader).id == program_id


def test_a_programs_vertex_arrays_are_destroyed_with_it_and_only_those(harness: GrowthHarness) -> None:
    device, remaining = harness.device, harness.device.program(make_shader())
    harness.draw_everything(remaining)
    before = set(ids(device, Op.CREATE_VERTEX_ARRAY, "vertex_array"))
    program = device.program(make_shader())
    harness.draw_everything(program)
    vertex_arrays = set(ids(device, Op.CREATE_VERTEX_ARRAY, "vertex_array")) - before
    assert len(vertex_arrays) >= 3  # of the two meshes, and of transient vertices
    program.destroy()
    device.finish()
    assert set(ids(device, Op.DESTROY, "resource")) == {*vertex_arrays, program.id}


def test_a_shader_whose_program_was_destroyed_gets_another_that_draws(harness: GrowthHarness) -> None:
    shader = make_shader()
    first = harness.device.program(shader)
    harness.draw_everything(first)
    first.destroy()
    second = harness.device.program(shader)
    harness.draw_everything(second)
    assert second.id != first.id


def test_vertex_arrays_of_two_command_buffers_are_both_destroyed_with_the_program(
    harness: GrowthHarness,
) -> None:
    device, program = harness.device, harness.device.program(make_shader())
    buffers = []
    for _ in range(2):
        with device.record() as commands, commands.render_pass(harness.image):
            commands.draw(program, harness.meshes[0], camera=harness.camera)
        buffers.append(commands)
    device.submit(*buffers)
    vertex_arrays = ids(device, Op.CREATE_VERTEX_ARRAY, "vertex_array")
    assert len(vertex_arrays) == 2
    program.destroy()
    device.finish()
    assert set(ids(device, Op.DESTROY, "resource")) == {*vertex_arrays, program.id}


def test_the_draws_of_a_destroyed_program_still_count(harness: GrowthHarness) -> None:
    program = harness.device.program(make_shader())
    with harness.device.render_pass(harness.image):
        for _ in range(3):
            harness.device.draw(program, harness.meshes[0], camera=harness.camera)
    program.destroy()
    assert harness.device.statistics.draws == 3
    harness.device.reset_statistics()
    assert harness.device.statistics.draws == 0


def test_a_buffer_keeps_no_mesh_that_was_made_of_it(harness: GrowthHarness) -> None:
    mesh = harness.device.mesh(harness.vertices)
    seen = weakref.ref(mesh.data)
    del mesh
    gc.collect()
    assert seen() is None


def test_a_mesh_forgets_its_draws_with_a_buffer_that_it_was_made_of(harness: GrowthHarness) -> None:
    program = harness.device.program(make_shader())
    harness.draw_everything(program)
    harness.vertices.destroy()
    assert not harness.meshes[1].prepared_draws
    assert harness.meshes[0].prepared_draws


@pytest.mark.parametrize(
    ("make", "most"),
    [
        (lambda device: device.buffer(16), MAX_WAITING),
        (lambda device: device.buffer(1 << 20), MAX_WAITING_BYTES >> 20),
        (lambda device: device.texture((512, 512), Format.RGBA8), MAX_WAITING_BYTES >> 20),
    ],
)
def test_without_a_fence_destroyed_resources_are_released_in_two_lots(
    null_device: Device, make: Callable[[Device], Any], most: int
) -> None:
    highest = 0
    for _ in range(5 * most):
        make(null_device).destroy()
        highest = max(highest, len(null_device._core.timeline._retired))
    assert most <= highest <= 2 * most


def test_a_program_that_never_asks_for_fences_lets_the_backend_forget_them(
    null_device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []
    backend, timeline = null_device.backend_as(NullBackend), null_device._core.timeline
    completed = backend.completed

    def ask() -> int:
        asked.append(timeline.signalled)
        return completed()

    monkeypatch.setattr(backend, "completed", ask)
    for _ in range(3 * MAX_WAITING):
        null_device.signal()
    assert asked == [MAX_WAITING, 2 * MAX_WAITING, 3 * MAX_WAITING]


def test_a_few_destroyed_resources_cause_no_signal(kit: Kit) -> None:
    for _ in range(MAX_WAITING):
        kit.device.buffer(16).destroy()
    assert not kit.ops(Op.SIGNAL)
    kit.device.buffer(16)
    assert len(kit.ops(Op.SIGNAL)) == 1


def test_events_of_a_program_that_never_presents_are_bounded() -> None:
    with rhi.create_device("null", timing=True, record=False) as device:
        for _ in range(3 * MAX_EVENTS):
            with device.event("step"):
                pass
        timers = device._timers
        assert len(timers._roots) <= MAX_EVENTS
        created = next(device._core._ids)
        for _ in range(12 * MAX_EVENTS):
            with device.event("step"):
                pass
        device.finish()
        assert next(device._core._ids) - created < 8 * MAX_EVENTS  # queries are used again


@pytest.mark.parametrize("inside", [MAX_EVENTS - 1, MAX_EVENTS, MAX_EVENTS + 5])
def test_events_inside_an_open_one_are_labels_beyond_the_bound(inside: int) -> None:
    with rhi.create_device("null", timing=True) as device:
        before = len(device.stream)
        with device.event("all"):
            for _ in range(inside):
                with device.event("step"):
                    pass
        device.present()
        device.finish()
        assert len(device.timers[0].children) == min(inside, MAX_EVENTS - 1)
        labels = [command for command in device.stream[before:] if command.op is Op.PUSH_LABEL]
        assert len(labels) == inside + 1


def test_samplers_are_shared_and_too_many_different_ones_refused(
    null_device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    image = null_device.texture((4, 4), Format.RGBA8)
    monkeypatch.setattr(core, "MAX_SAMPLERS", 8)
    room = 8 - len(null_device._core._samplers)
    descriptors = [SamplerDescriptor(border=(0, (i + 1) / 16, 0, 0)) for i in range(room + 1)]
    for descriptor in descriptors[:room]:
        image.sampled(descriptor)
    with pytest.raises(rhi.ValidationError, match=r"^\[device-capability\]"):
        image.sampled(descriptors[room])
    image.sampled(descriptors[0])


def test_shaders_that_ran_on_the_cpu_leave_no_source_lines(null_device: Device) -> None:
    def run() -> None:
        class Count(Shader):
            out: StorageRW[float]

            def compute(self) -> None:
                self.out[global_id().x] = 1.0

        run_compute(Count, out=64)

    run()
    gc.collect()
    before = len(linecache.cache)
    run()
    gc.collect()
    assert len(linecache.cache) == before
