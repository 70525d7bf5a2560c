"""A device with resources, calls that use all of it, and a check that nothing was damaged.

What happens to the device between two checks is the tests' matter: interrupts, exhausted memory, errors of the user.
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


class Other(Flat): ...


class Count(Shader):
    work_group = (16, 1, 1)
    out: StorageRW[float]
    numbers: Storage[float]

    def compute(self) -> None:
        self.out[global_id().x] = self.numbers[global_id().x] + 1.0


SIZE = 16
FULL = np.array([[-1, -1], [3, -1], [-1, 3]], np.float32)
HALF = np.array([[-1, -1], [1, -1], [-1, 1]], np.float32)


class House:
    """A device, what the calls use, and the checks."""

    def __init__(self, device: rhi.Device, *, warm_up: bool = True) -> None:
        self.device = device
        self.image = device.texture((SIZE, SIZE), rhi.Format.RGBA8)
        self.other = device.texture((SIZE, SIZE), rhi.Format.RGBA8)
        self.samples = device.texture((SIZE, SIZE), rhi.Format.RGBA8, samples=4)
        self.depth = device.texture((SIZE, SIZE), rhi.Format.D32F)
        self.full = device.mesh({"position": FULL})
        self.half = device.mesh({"position": HALF}, np.array([0, 1, 2]))
        self.tints = [device.uniform(Tint(color=color)) for color in ((1, 0, 0, 1), (0, 1, 0, 0.5), (0, 0, 1, 1))]
        self.flat, self.second = device.program(Flat), device.program(Other)
        self.count = device.program(Count)
        self.numbers = device.storage(float, np.arange(16, dtype=np.float32))
        self.out = device.storage(float, 16)
        self.query = device.occlusion_query()
        self.made: list[Any] = []
        with device.record() as self.commands:
            with self.commands.render_pass(self.other, clear=(0, 0, 0, 0)):
                with self.commands.states(rhi.Scissor(2, 2, 4, 4)), self.commands.event("recorded"):
                    self.commands.draw(self.flat, self.full, tint=self.tints[0])
        if warm_up:
            self.warm_up()

    def warm_up(self) -> None:
        """Let everything exist that is made once, and note how the picture looks and how much there is."""
        device = self.device
        device.timing = device.capabilities.timestamps
        for _ in range(20):  # queries for events whose timestamps aren't read yet
            label(self)
        device.timing = False
        for _ in range(2):
            self.picture()
            self.visit_everything()
        self.expected = self.picture()
        self.settle()
        self.living = self.count_living()

    def visit_everything(self) -> None:
        """Let everything that calls make once, such as vertex arrays, exist before anything is counted."""
        for call in CALLS:
            if self.can(call):
                call(self)
                self.settle()

    def can(self, call: Callable[[House], object]) -> bool:
        return self.device.capabilities.shading or call not in (wait_for_a_query, draw_under_a_condition)

    def picture(self) -> NDArray[Any]:
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
            if device.capabilities.shading:
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
        for made in self.made:
            made.destroy()
        self.made.clear()
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
        core.scopes.end_unheld()  # as the next pass does
        assert list(core.scopes) == []
        assert core.render_pass is None
        assert core.states.wanted[rhi.Scissor] == rhi.Scissor.OFF
        assert core.open_query is None
        assert not core.condition_open
        for ring in (memory for memory in core.frame_rings if isinstance(memory, Ring)):
            assert 0 <= ring._head - ring._tail <= ring.capacity
            assert ring.buffer or ring._head == 0
            assert all(a <= b for a, b in zip(ring._marks, list(ring._marks)[1:], strict=False))
        np.testing.assert_array_equal(self.picture(), self.expected)
        self.settle()
        assert self.device._timers.depth == 0
        if self.count_living() != self.living:
            gc.collect()  # command buffers release their memory with the last reference
            self.settle()
        assert self.count_living() == self.living


def create_a_buffer(house: House) -> None:
    house.made.append(house.device.buffer(16))


def create_a_filled_buffer(house: House) -> None:
    house.made.append(house.device.buffer(np.arange(9)))


def create_a_stream_buffer(house: House) -> None:
    house.made.append(house.device.buffer(4096, usage=rhi.BufferUsage.STREAM))


def create_constants(house: House) -> None:
    house.made.append(house.device.uniform(Tint(color=(1, 1, 1, 1))))


def create_an_array_of_constants(house: House) -> None:
    house.made.append(house.device.uniform_array(Tint, 3))


def create_storage(house: House) -> None:
    house.made.append(house.device.storage(float, np.zeros(4, np.float32)))


def create_a_texture(house: House) -> None:
    house.made.append(house.device.texture(np.zeros((4, 4, 4), np.uint8), rhi.Format.RGBA8, levels=None))


def create_a_mesh(house: House) -> None:
    mesh = house.device.mesh({"position": FULL}, np.array([0, 1, 2]), instances={"tint": FULL})
    house.made.append(mesh)


def create_queries(house: House) -> None:
    house.made.append(house.device.occlusion_query())
    house.made.append(house.device.query_set(2))


def create_a_program(house: House) -> None:
    class Copy(Flat): ...

    house.made.append(house.device.program(Copy))


def make_things_to_destroy(house: House) -> None:
    create_a_program(house)
    program = house.made[-1]
    create_a_buffer(house)
    create_a_texture(house)
    create_a_mesh(house)
    create_queries(house)
    with house.device.render_pass(house.other):
        house.device.draw(program, house.full, tint=house.tints[0])
        house.device.draw_many(program, house.half, house.half.draws([0, 0], 3), tint=house.tints[0])
        house.device.draw(house.flat, house.made[3], tint=house.tints[0])


def destroy_everything(house: House) -> None:
    for made in house.made:
        made.destroy()


def draw(house: House) -> None:
    device, (red, green, _) = house.device, house.tints
    with device.render_pass(house.other, house.depth, clear=(0, 0, 0, 0), clear_depth=0.0):
        device.draw(house.flat, house.full, tint=red)
        device.draw(house.flat, house.full, tint=green)
        device.draw(house.second, house.half, 2, tint=red)


def draw_a_new_mesh(house: House) -> None:
    house.made.append(house.device.mesh({"position": FULL}))
    with house.device.render_pass(house.other):
        house.device.draw(house.flat, house.made[-1], tint=house.tints[0])


def change_states(house: House) -> None:
    device = house.device
    with device.states(rhi.CullMode.NONE, rhi.ColorWrite.OFF):
        with device.render_pass(house.other):
            with device.states(rhi.Scissor(1, 1, 2, 2), rhi.DepthTest.OFF):
                with device.states(rhi.DepthWrite.OFF, rhi.Viewport(1, 2, 3, 4)):
                    device.draw(house.flat, house.full, tint=house.tints[2])
                device.draw(house.flat, house.full, tint=house.tints[1])


def draw_many(house: House) -> None:
    with house.device.render_pass(house.other):
        house.device.draw_many(house.flat, house.half, house.half.draws([0, 0], 3), tint=house.tints[1])


def draw_counted(house: House) -> None:
    house.made.append(house.device.query_set(2))
    with house.device.render_pass(house.other):
        draws = house.half.draws([0, 0], 3)
        house.device.draw_counted(house.flat, house.half, draws, house.made[-1], tint=house.tints[1])


def draw_conditional(house: House) -> None:
    if not house.device.capabilities.conditional_rendering:
        return
    house.made.append(house.device.query_set(2))
    with house.device.render_pass(house.other):
        draws = house.half.draws([0, 0], 3)
        house.device.draw_counted(house.flat, house.half, draws, house.made[-1], tint=house.tints[1])
        house.device.draw_conditional(house.flat, house.half, draws, house.made[-1], tint=house.tints[1])


def draw_transient_data(house: House) -> None:
    device = house.device
    with device.render_pass(house.other):
        tint = device.transient.uniform(Tint(color=(1, 1, 0, 1)))
        vertices = np.zeros(3, [("position", "<f4", 2)])
        device.draw(house.flat, device.transient.mesh(house.flat, vertices, np.array([0, 1, 2])), tint=tint)
        with device.immediate(house.second, rhi.Primitive.QUADS, tint=tint) as quads:
            for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)):
                quads.vertex(position=(x, y))


class SmallRing:
    """A ring of its own, which `destroy` takes back."""

    def __init__(self, house: House) -> None:
        core = house.device._core
        self.ring = Ring(core.backend, core.timeline, core.new_id, 256, "small")
        self._core = core

    def destroy(self) -> None:
        self.ring.mark(0)
        if self.ring.buffer:
            self._core.timeline.retire(self.ring.buffer)


def grow_a_ring(house: House) -> None:
    house.made.append(SmallRing(house))
    ring = house.made[-1].ring
    for _ in range(4):
        ring.write(bytes(200), 200, 4)
    ring.mark(house.device.signal())


def clear_and_resolve(house: House) -> None:
    with house.device.states(rhi.Scissor(1, 1, 2, 2), rhi.ColorWrite.OFF, rhi.DepthWrite.OFF):
        with house.device.render_pass(house.samples, clear=(1, 0, 1, 0), resolve=house.other):
            pass


def count_samples(house: House) -> None:
    with house.device.render_pass(house.other):
        with house.query:
            house.device.draw(house.flat, house.full, tint=house.tints[0])


def wait_for_a_query(house: House) -> None:
    count_samples(house)
    assert house.query.wait() == SIZE * SIZE


def draw_under_a_condition(house: House) -> None:
    count_samples(house)
    with house.device.render_pass(house.other):
        with house.device.conditional(house.query, inverted=True):
            house.device.draw(house.flat, house.full, tint=house.tints[0])


def dispatch(house: House) -> None:
    house.device.dispatch(house.count, 1, out=house.out, numbers=house.numbers)


def write_and_read(house: House) -> None:
    house.out.write(np.ones(16, np.float32))
    house.out.read()
    house.other.write(np.zeros((SIZE, SIZE, 4), np.uint8))
    house.other.read()
    house.other.copy_to(house.other, region=rhi.Region(0, 0, 2, 2), x=4)
    house.out.clear()


def lock(house: House) -> None:
    with house.out.lock(rhi.Access.READ_WRITE) as numbers:
        numbers[:] = 3
    with house.other.lock(rhi.Access.WRITE) as texels:
        texels[:] = 3


def label(house: House) -> None:
    with house.device.event("outer"):
        with house.device.event("inner"):
            pass


def label_with_times(house: House) -> None:
    house.device.timing = house.device.capabilities.timestamps
    try:
        label(house)
    finally:
        house.device.timing = False


def submit(house: House) -> None:
    house.device.submit(house.commands)


def record_and_submit(house: House) -> None:
    with house.device.record() as commands:
        with commands.render_pass(house.other):
            commands.draw(house.flat, house.half, tint=commands.transient.uniform(Tint(color=(1, 1, 0, 1))))
    house.device.submit(commands)


def end_a_frame(house: House) -> None:
    house.device.present(house.other)


def wait_for_a_fence(house: House) -> None:
    house.device.wait(house.device.signal())


def bind_another_sampler(house: House) -> None:
    house.other.sampled(rhi.SamplerDescriptor(border=(0, 0, 0, 1)))


CALLS: list[Callable[[House], None]] = [
    create_a_buffer, create_a_filled_buffer, create_a_stream_buffer, create_constants, create_an_array_of_constants,
    create_storage, create_a_texture, create_a_mesh, create_queries, create_a_program, destroy_everything, draw,
    draw_a_new_mesh, change_states, draw_many, draw_counted, draw_conditional, draw_transient_data, grow_a_ring,
    clear_and_resolve,
    count_samples, wait_for_a_query, draw_under_a_condition, dispatch, write_and_read, lock, label,
    label_with_times, submit,
    record_and_submit, end_a_frame, wait_for_a_fence, bind_another_sampler,
]  # fmt: skip
