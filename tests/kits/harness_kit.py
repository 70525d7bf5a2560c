"""A device with resources, calls that use all of it, and a check that nothing was damaged.

What happens to the device between two checks is the tests' matter: interrupts, exhausted memory, errors of
the user.
"""

from __future__ import annotations

import gc
from collections.abc import Callable
from typing import Any

import numpy as np
from interrupts_kit import EXEMPT
from numpy.typing import NDArray

import rhi
from rhi.device.core.ring import Ring
from rhi.shading import Shader, Storage, StorageRW, Struct, Uniform, global_id, vec2, vec4

EXEMPT.add(__file__)


class Corner(Struct):
    position: vec2


class Tint(Struct):
    color: vec4


class Flat(Shader):
    tint: Uniform[Tint]

    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, 0.5, 1.0)

    def fragment(self) -> vec4:
        return self.tint.color


class SecondFlat(Flat): ...


class Count(Shader):
    work_group = (16, 1, 1)
    out: StorageRW[float]
    numbers: Storage[float]

    def compute(self) -> None:
        self.out[global_id().x] = self.numbers[global_id().x] + 1.0


SIZE = 16
FULL = np.array([[-1, -1], [3, -1], [-1, 3]], np.float32)
HALF = np.array([[-1, -1], [1, -1], [-1, 1]], np.float32)


class DeviceHarness:
    """A device, what the calls use, and the checks."""

    def __init__(self, device: rhi.Device, *, warm_up: bool = True) -> None:
        self.device = device
        self.image = device.texture((SIZE, SIZE), rhi.Format.RGBA8)
        self.other = device.texture((SIZE, SIZE), rhi.Format.RGBA8)
        self.samples = device.texture((SIZE, SIZE), rhi.Format.RGBA8, samples=4)
        self.depth = device.texture((SIZE, SIZE), rhi.Format.D32F)
        self.full = device.mesh({"position": FULL})
        self.half = device.mesh({"position": HALF}, np.array([0, 1, 2]))
        self.tints = [
            device.uniform(Tint(color=color)) for color in ((1, 0, 0, 1), (0, 1, 0, 0.5), (0, 0, 1, 1))
        ]
        self.flat, self.second = device.program(Flat), device.program(SecondFlat)
        self.count = device.program(Count)
        self.numbers = device.storage(float, np.arange(16, dtype=np.float32))
        self.out = device.storage(float, 16)
        self.query = device.occlusion_query()
        self.created: list[Any] = []
        with device.record() as self.commands:
            with self.commands.render_pass(self.other, clear=(0, 0, 0, 0)):
                with self.commands.states(rhi.Scissor(2, 2, 4, 4)), self.commands.event("recorded"):
                    self.commands.draw(self.flat, self.full, tint=self.tints[0])
        if warm_up:
            self.warm_up()

    def warm_up(self) -> None:
        """Create everything that is created once, and record the image and the number of resources."""
        device = self.device
        device.timing = device.capabilities.timestamps
        for _ in range(20):  # queries for events whose timestamps aren't read yet
            label(self)
        device.timing = False
        for _ in range(2):
            self.draw_image()
            self.visit_everything()
        self.expected = self.draw_image()
        self.settle()
        self.living = self.count_living()

    def visit_everything(self) -> None:
        """Create everything that calls create once, such as vertex arrays, before anything is counted."""
        for call in CALLS:
            if self.can(call):
                call(self)
                self.settle()

    def can(self, call: Callable[[DeviceHarness], object]) -> bool:
        capabilities = self.device.capabilities
        if call is draw_under_a_condition:
            return capabilities.shading and capabilities.conditional_rendering
        return capabilities.shading or call is not wait_for_a_query

    def draw_image(self) -> NDArray[Any]:
        """Draw with two programs, changing bindings and states, and a query and a condition."""
        device, (red, green, blue) = self.device, self.tints
        blend = rhi.BlendFunction(rhi.BlendFactor.SOURCE_ALPHA, rhi.BlendFactor.ONE_MINUS_SOURCE_ALPHA)
        with device.render_pass(self.image, self.depth, clear=(0.1, 0.2, 0.3, 0.4), clear_depth=0.0):
            device.draw(self.flat, self.half, tint=red)
            with device.states(blend, rhi.Scissor(3, 2, 7, 9), rhi.DepthTest.OFF):
                device.draw(self.flat, self.full, tint=green)
                with device.states(rhi.ColorWrite(True, False, True, True)):
                    device.draw(self.second, self.full, tint=blue)
            with self.query, device.states(rhi.Viewport(0, 0, SIZE / 2, SIZE), rhi.DepthTest.OFF):
                device.draw(self.flat, self.half, tint=blue)
            if device.capabilities.shading and device.capabilities.conditional_rendering:
                with device.conditional(self.query):
                    with device.states(rhi.Scissor(0, 12, 16, 4), rhi.DepthTest.OFF):
                        device.draw(self.second, self.full, tint=red)
        device.dispatch(self.count, 1, out=self.out, numbers=self.numbers)
        if device.capabilities.shading:
            assert self.query.wait() == SIZE * SIZE // 4 - SIZE // 2 or self.query.wait() > 0
            self.samples_passed = self.query.wait()
        if not device.capabilities.shading:
            return self.image.read()
        return np.concatenate([self.image.read().ravel(), self.out.read().view(np.uint8)])

    def settle(self) -> None:
        for resource in self.created:
            resource.destroy()
        self.created.clear()
        self.device.present()
        self.device.finish()
        self.device.finish()

    def count_living(self) -> int:
        """Return the number of resources of the backend."""
        backend: Any = self.device._backend
        if hasattr(backend, "_destroyers"):
            return len(backend._destroyers)
        tables = (backend._buffers, backend._textures, backend._queries)
        return len(backend._state.resources) + sum(
            len(table) for part in tables for table in vars(part).values() if isinstance(table, (dict, set))
        )

    def check(self) -> None:
        """Assert that nothing is open or lost, and that the device draws right."""
        core = self.device._core
        core.unlock()
        assert core.locked == []
        assert core.created is None
        core.scopes.end_unreferenced()  # as the next pass does
        assert list(core.scopes) == []
        assert core.render_pass is None
        assert core.states.requested[rhi.Scissor] == rhi.Scissor.OFF
        assert core.open_query is None
        assert not core.condition_open
        for ring in (memory for memory in core.frame_rings if isinstance(memory, Ring)):
            assert 0 <= ring._head - ring._tail <= ring.capacity
            assert ring.buffer or ring._head == 0
            assert all(a <= b for a, b in zip(ring._marks, list(ring._marks)[1:], strict=False))
        np.testing.assert_array_equal(self.draw_image(), self.expected)
        self.settle()
        assert self.device._timers.depth == 0
        if self.count_living() != self.living:
            gc.collect()  # command buffers release their memory with the last reference
            self.settle()
        assert self.count_living() == self.living


def create_a_buffer(harness: DeviceHarness) -> None:
    harness.created.append(harness.device.buffer(16))


def create_a_filled_buffer(harness: DeviceHarness) -> None:
    harness.created.append(harness.device.buffer(np.arange(9)))


def create_a_stream_buffer(harness: DeviceHarness) -> None:
    harness.created.append(harness.device.buffer(4096, usage=rhi.BufferUsage.STREAM))


def create_constants(harness: DeviceHarness) -> None:
    harness.created.append(harness.device.uniform(Tint(color=(1, 1, 1, 1))))


def create_an_array_of_constants(harness: DeviceHarness) -> None:
    harness.created.append(harness.device.uniform_array(Tint, 3))


def create_storage(harness: DeviceHarness) -> None:
    harness.created.append(harness.device.storage(float, np.zeros(4, np.float32)))


def create_a_texture(harness: DeviceHarness) -> None:
    harness.created.append(
        harness.device.texture(np.zeros((4, 4, 4), np.uint8), rhi.Format.RGBA8, levels=None)
    )


def create_a_mesh(harness: DeviceHarness) -> None:
    mesh = harness.device.mesh({"position": FULL}, np.array([0, 1, 2]), instances={"tint": FULL})
    harness.created.append(mesh)


def create_queries(harness: DeviceHarness) -> None:
    harness.created.append(harness.device.occlusion_query())
    harness.created.append(harness.device.query_set(2))


def create_a_program(harness: DeviceHarness) -> None:
    class Copy(Flat): ...

    harness.created.append(harness.device.program(Copy))


def make_things_to_destroy(harness: DeviceHarness) -> None:
    create_a_program(harness)
    program = harness.created[-1]
    create_a_buffer(harness)
    create_a_texture(harness)
    create_a_mesh(harness)
    create_queries(harness)
    with harness.device.render_pass(harness.other):
        harness.device.draw(program, harness.full, tint=harness.tints[0])
        harness.device.draw_many(program, harness.half, harness.half.draws([0, 0], 3), tint=harness.tints[0])
        harness.device.draw(harness.flat, harness.created[3], tint=harness.tints[0])


def destroy_everything(harness: DeviceHarness) -> None:
    for resource in harness.created:
        resource.destroy()


def draw(harness: DeviceHarness) -> None:
    device, (red, green, _) = harness.device, harness.tints
    with device.render_pass(harness.other, harness.depth, clear=(0, 0, 0, 0), clear_depth=0.0):
        device.draw(harness.flat, harness.full, tint=red)
        device.draw(harness.flat, harness.full, tint=green)
        device.draw(harness.second, harness.half, 2, tint=red)


def draw_a_new_mesh(harness: DeviceHarness) -> None:
    harness.created.append(harness.device.mesh({"position": FULL}))
    with harness.device.render_pass(harness.other):
        harness.device.draw(harness.flat, harness.created[-1], tint=harness.tints[0])


def change_states(harness: DeviceHarness) -> None:
    device = harness.device
    with device.states(rhi.CullMode.NONE, rhi.ColorWrite.OFF):
        with device.render_pass(harness.other):
            with device.states(rhi.Scissor(1, 1, 2, 2), rhi.DepthTest.OFF):
                with device.states(rhi.DepthWrite.OFF, rhi.Viewport(1, 2, 3, 4)):
                    device.draw(harness.flat, harness.full, tint=harness.tints[2])
                device.draw(harness.flat, harness.full, tint=harness.tints[1])


def draw_many(harness: DeviceHarness) -> None:
    with harness.device.render_pass(harness.other):
        harness.device.draw_many(
            harness.flat, harness.half, harness.half.draws([0, 0], 3), tint=harness.tints[1]
        )


def draw_counted(harness: DeviceHarness) -> None:
    harness.created.append(harness.device.query_set(2))
    with harness.device.render_pass(harness.other):
        draws = harness.half.draws([0, 0], 3)
        harness.device.draw_counted(
            harness.flat, harness.half, draws, harness.created[-1], tint=harness.tints[1]
        )


def draw_conditional(harness: DeviceHarness) -> None:
    if not harness.device.capabilities.conditional_rendering:
        return
    harness.created.append(harness.device.query_set(2))
    with harness.device.render_pass(harness.other):
        draws = harness.half.draws([0, 0], 3)
        harness.device.draw_counted(
            harness.flat, harness.half, draws, harness.created[-1], tint=harness.tints[1]
        )
        harness.device.draw_conditional(
            harness.flat, harness.half, draws, harness.created[-1], tint=harness.tints[1]
        )


def draw_transient_data(harness: DeviceHarness) -> None:
    device = harness.device
    with device.render_pass(harness.other):
        tint = device.transient.uniform(Tint(color=(1, 1, 0, 1)))
        vertices = np.zeros(3, [("position", "<f4", 2)])
        device.draw(
            harness.flat, device.transient.mesh(harness.flat, vertices, np.array([0, 1, 2])), tint=tint
        )
        with device.immediate(harness.second, rhi.Primitive.QUADS, tint=tint) as quads:
            for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)):
                quads.vertex(position=(x, y))


class SmallRing:
    """A ring of its own, which `destroy` takes back."""

    def __init__(self, harness: DeviceHarness) -> None:
        core = harness.device._core
        self.ring = Ring(core.backend, core.timeline, core.new_id, 256, "small")
        self._core = core

    def destroy(self) -> None:
        self.ring.mark(0)
        if self.ring.buffer:
            self._core.timeline.retire(self.ring.buffer)


def grow_a_ring(harness: DeviceHarness) -> None:
    harness.created.append(SmallRing(harness))
    ring = harness.created[-1].ring
    for _ in range(4):
        ring.write(bytes(200), 200, 4)
    ring.mark(harness.device.signal())


def clear_and_resolve(harness: DeviceHarness) -> None:
    with harness.device.states(rhi.Scissor(1, 1, 2, 2), rhi.ColorWrite.OFF, rhi.DepthWrite.OFF):
        with harness.device.render_pass(harness.samples, clear=(1, 0, 1, 0), resolve=harness.other):
            pass


def count_samples(harness: DeviceHarness) -> None:
    with harness.device.render_pass(harness.other):
        with harness.query:
            harness.device.draw(harness.flat, harness.full, tint=harness.tints[0])


def wait_for_a_query(harness: DeviceHarness) -> None:
    count_samples(harness)
    assert harness.query.wait() == SIZE * SIZE


def draw_under_a_condition(harness: DeviceHarness) -> None:
    count_samples(harness)
    with harness.device.render_pass(harness.other):
        with harness.device.conditional(harness.query, inverted=True):
            harness.device.draw(harness.flat, harness.full, tint=harness.tints[0])


def dispatch(harness: DeviceHarness) -> None:
    harness.device.dispatch(harness.count, 1, out=harness.out, numbers=harness.numbers)


def write_and_read(harness: DeviceHarness) -> None:
    harness.out.write(np.ones(16, np.float32))
    harness.out.read()
    harness.other.write(np.zeros((SIZE, SIZE, 4), np.uint8))
    harness.other.read()
    harness.other.copy_to(harness.other, region=rhi.Region(0, 0, 2, 2), x=4)
    harness.out.clear()


def lock(harness: DeviceHarness) -> None:
    with harness.out.lock(rhi.Access.READ_WRITE) as numbers:
        numbers[:] = 3
    with harness.other.lock(rhi.Access.WRITE) as texels:
        texels[:] = 3


def label(harness: DeviceHarness) -> None:
    with harness.device.event("outer"):
        with harness.device.event("inner"):
            pass


def label_with_times(harness: DeviceHarness) -> None:
    harness.device.timing = harness.device.capabilities.timestamps
    try:
        label(harness)
    finally:
        harness.device.timing = False


def submit(harness: DeviceHarness) -> None:
    harness.device.submit(harness.commands)


def record_and_submit(harness: DeviceHarness) -> None:
    with harness.device.record() as commands:
        with commands.render_pass(harness.other):
            commands.draw(
                harness.flat, harness.half, tint=commands.transient.uniform(Tint(color=(1, 1, 0, 1)))
            )
    harness.device.submit(commands)


def end_a_frame(harness: DeviceHarness) -> None:
    harness.device.present(harness.other)


def wait_for_a_fence(harness: DeviceHarness) -> None:
    harness.device.wait(harness.device.signal())


def bind_another_sampler(harness: DeviceHarness) -> None:
    harness.other.sampled(rhi.SamplerDescriptor(border=(0, 0, 0, 1)))


CALLS: list[Callable[[DeviceHarness], None]] = [
    create_a_buffer,
    create_a_filled_buffer,
    create_a_stream_buffer,
    create_constants,
    create_an_array_of_constants,
    create_storage,
    create_a_texture,
    create_a_mesh,
    create_queries,
    create_a_program,
    destroy_everything,
    draw,
    draw_a_new_mesh,
    change_states,
    draw_many,
    draw_counted,
    draw_conditional,
    draw_transient_data,
    grow_a_ring,
    clear_and_resolve,
    count_samples,
    wait_for_a_query,
    draw_under_a_condition,
    dispatch,
    write_and_read,
    lock,
    label,
    label_with_times,
    submit,
    record_and_submit,
    end_a_frame,
    wait_for_a_fence,
    bind_another_sampler,
]
