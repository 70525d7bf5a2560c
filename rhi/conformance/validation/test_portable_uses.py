"""Uses of memory, targets and states that WebGPU refuses only when commands are submitted.

There a refusal would be raised at another call, and commands that have nothing to do with it would be lost.
So each is refused at its own call, or works: after each, an image that was drawn before has its color.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest

import rhi
import rhi.shading as sl
from rhi import BlendFactor, BlendFunction, Device, Format, IndirectDraws, TextureKind, Viewport
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle
from rhi.conformance.validation.refusal import refuses
from rhi.errors import rules
from rhi.shading import (
    FullScreen,
    Image2D,
    Shader,
    Storage,
    StorageRW,
    Struct,
    Texture2D,
    Uniform,
    image,
    vec2,
    vec4,
)

SIZE = (4, 4)


@pytest.fixture
def earlier(recording: Device) -> Iterator[None]:
    """A pass that was drawn before. At the end of the test its image is there."""
    with recording.texture(SIZE, Format.R8) as drawn, recording.mesh(rectangle()) as mesh:
        with recording.render_pass(drawn, clear=(0, 0, 0, 0)):
            if recording.capabilities.draws:
                recording.draw(recording.program(Colored), mesh)
        yield
        if recording.capabilities.renders:
            assert_same(drawn.read(), 255)


# -- memory that is written and used a second time -----------------------------------------------------------


class Corner(Struct):
    position: vec2


class ShiftedCorner(Struct):
    position: vec2
    shift: vec2


class Constants(Struct):
    color: vec4


class ReadAndWrite(Shader):
    work_group = (8,)
    source: Storage[float]
    target: StorageRW[float]

    def compute(self) -> None:
        self.target[sl.global_id().x] = self.source[sl.global_id().x] + 1.0


class WriteTwice(Shader):
    work_group = (8,)
    first: StorageRW[float]
    second: StorageRW[float]

    def compute(self) -> None:
        self.first[sl.global_id().x] = 1.0
        self.second[sl.global_id().x] = 1.0


class UniformAndWrite(Shader):
    work_group = (1,)
    constants: Uniform[Constants]
    target: StorageRW[vec4]

    def compute(self) -> None:
        self.target[0] = self.constants.color


class WriteWhileDrawing(Shader):
    target: StorageRW[vec2]

    def vertex(self, v: ShiftedCorner) -> vec4:
        return vec4(v.position + v.shift, 0.5, 1.0)

    def fragment(self) -> vec4:
        self.target[3] = vec2(1.0, 1.0)
        return vec4(1.0, 1.0, 1.0, 1.0)


class LoadAndStore(Shader):
    work_group = (1,)
    source: Image2D = image(Format.R32F)
    target: Image2D = image(Format.R32F)

    def compute(self) -> None:
        self.target.store(sl.ivec2(0, 0), self.source.load(sl.ivec2(0, 0)) + vec4(1.0))


class StoreTwice(Shader):
    work_group = (1,)
    first: Image2D = image(Format.R32F)
    second: Image2D = image(Format.R32F)

    def compute(self) -> None:
        self.first.store(sl.ivec2(0, 0), vec4(1.0))
        self.second.store(sl.ivec2(0, 0), vec4(1.0))


def refuses_aliases(device: Device) -> Any:
    """Return a block in which a second use of written memory is refused, where the device takes none."""
    if device.capabilities.aliased_writes:
        return nullcontext()
    return refuses(rules.DEVICE_CAPABILITY, device)


@pytest.mark.requires("compute", "max_storage_slots")
@pytest.mark.usefixtures("earlier")
@pytest.mark.parametrize("shader", [ReadAndWrite, WriteTwice])
def test_storage_is_written_by_a_dispatch_that_has_it_twice_or_refused(
    recording: Device, shader: Any
) -> None:
    program = recording.program(shader)
    names = [binding.name for binding in program.descriptor.bindings]
    with recording.storage(float, 8) as values, recording.storage(float, 8) as others:
        with refuses_aliases(recording):
            recording.dispatch(program, 1, **dict.fromkeys(names, values))
        if recording.capabilities.aliased_writes and recording.capabilities.shading:
            assert_same(values.read(), 1)
        recording.dispatch(program, 1, **dict(zip(names, (values, others), strict=True)))
        if recording.capabilities.shading:
            assert_same(others.read(), 1 + (recording.capabilities.aliased_writes and shader is ReadAndWrite))


@pytest.mark.requires("compute", "max_storage_slots")
@pytest.mark.usefixtures("earlier")
def test_constants_are_written_by_the_dispatch_that_reads_them_or_refused(recording: Device) -> None:
    constants = recording.uniform_array(Constants, 4)
    target, other = recording.storage(vec4, constants.buffer), recording.storage(vec4, 4)
    program = recording.program(UniformAndWrite)
    with refuses_aliases(recording):
        recording.dispatch(program, 1, constants=constants[1], target=target)
    recording.dispatch(program, 1, constants=constants[1], target=other)
    constants.destroy()
    other.destroy()


@pytest.mark.requires("draws", "max_storage_slots")
@pytest.mark.usefixtures("earlier")
@pytest.mark.parametrize("what", ["vertices", "indices", "instances"])
@pytest.mark.parametrize("call", ["draw", "draw_many", "draw_indirect"])
def test_vertices_are_written_by_the_draw_that_reads_them_or_refused(
    recording: Device, what: str, call: str
) -> None:
    corners = np.zeros(4, np.dtype([("position", "f4", 2)]))
    buffers: dict[str, Any] = {
        "vertices": recording.buffer(corners),
        "indices": recording.buffer(np.arange(4, dtype=np.uint32).repeat(2)),
        "instances": recording.buffer(np.zeros(4, np.dtype([("shift", "f4", 2)]))),
    }
    mesh = recording.mesh(buffers["vertices"], buffers["indices"], instances=buffers["instances"])
    arguments = recording.buffer(mesh.draws([0], 3))
    program, other = recording.program(WriteWhileDrawing), recording.storage(vec2, 4)

    def draw(target: Any) -> None:
        if call == "draw":
            recording.draw(program, mesh, target=target)
        elif call == "draw_many":
            recording.draw_many(program, mesh, mesh.draws([0], 3), target=target)
        else:
            recording.draw_indirect(program, mesh, IndirectDraws(arguments, 1), target=target)

    with recording.texture(SIZE, Format.RGBA8) as target, recording.render_pass(target):
        with refuses_aliases(recording):
            draw(recording.storage(vec2, buffers[what]))
        draw(other)
    for resource in (mesh, arguments, other, *buffers.values()):
        resource.destroy()


@pytest.mark.requires("compute", "max_image_slots")
@pytest.mark.usefixtures("earlier")
@pytest.mark.parametrize("shader", [LoadAndStore, StoreTwice])
def test_an_image_is_written_by_a_dispatch_that_has_it_twice_or_refused(
    recording: Device, shader: Any
) -> None:
    if Format.R32F in recording.capabilities.unstorable_formats:
        pytest.skip("no images of R32F")
    program = recording.program(shader)
    names = [binding.name for binding in program.descriptor.bindings]

    def dispatch(*images: Any) -> None:
        recording.dispatch(program, 1, **dict(zip(names, images, strict=True)))

    layers = recording.texture(SIZE, Format.R32F, kind=TextureKind.D2_ARRAY, layers=2, levels=2)
    with layers, recording.texture(SIZE, Format.R32F) as other:
        with refuses_aliases(recording):
            dispatch(layers.image(0, 0), layers.image(0, 0))
        dispatch(layers.image(0, 0), layers.image(0, 1))
        dispatch(layers.image(0, 0), layers.image(1, 0))
        dispatch(layers.image(0, 0), other.image())


@pytest.mark.requires("draws", "max_storage_slots")
@pytest.mark.usefixtures("earlier")
def test_a_command_buffer_refuses_the_same_calls_as_a_device(recording: Device) -> None:
    program = recording.program(ReadAndWrite)
    if not recording.capabilities.compute:
        pytest.skip("no dispatches")
    with recording.storage(float, 8) as values, recording.record() as commands:
        with refuses_aliases(recording):
            commands.dispatch(program, 1, source=values, target=values)


# -- passes --------------------------------------------------------------------------------------------------


class Sampled(FullScreen):
    source: Texture2D

    def fragment(self) -> vec4:
        return self.source.sample(vec2(0.5, 0.5))


def samples(device: Device) -> int:
    if len(device.capabilities.sample_counts) < 2:
        pytest.skip("no textures of several samples")
    return device.capabilities.sample_counts[-1]


@pytest.mark.usefixtures("earlier")
def test_two_targets_are_not_resolved_to_one_texture(recording: Device) -> None:
    count = samples(recording)
    targets = [recording.texture(SIZE, Format.RGBA8, samples=count) for _ in range(2)]
    ends = [recording.texture(SIZE, Format.RGBA8) for _ in range(2)]
    with refuses(rules.PASS_TARGET, recording):
        recording.render_pass(targets, clear=(1, 1, 1, 1), resolve=[ends[0], ends[0]])
    with recording.render_pass(targets, clear=(1, 1, 1, 1), resolve=ends):
        pass
    assert_same(ends[1].read(), 255)
    for texture in (*targets, *ends):
        texture.destroy()


@pytest.mark.requires("draws")
@pytest.mark.usefixtures("earlier")
def test_a_pass_samples_its_resolve_target_or_refuses_to(recording: Device) -> None:
    target = recording.texture(SIZE, Format.RGBA8, samples=samples(recording))
    mesh, program = recording.mesh(3), recording.program(Sampled)
    with (
        target,
        mesh,
        recording.texture(SIZE, Format.RGBA8) as end,
        recording.texture(SIZE, Format.RGBA8) as resolved,
    ):
        allowed = recording.capabilities.resolve_feedback
        with recording.render_pass(target, clear=(0, 0, 0, 1), resolve=end):
            with nullcontext() if allowed else refuses(rules.PASS_FEEDBACK, recording):
                recording.draw(program, mesh, source=end)
            recording.draw(program, mesh, source=resolved)
        with recording.render_pass(target, clear=(0, 0, 0, 1)):
            recording.draw(program, mesh, source=end)


@pytest.mark.requires("draws")
@pytest.mark.usefixtures("earlier")
@pytest.mark.parametrize("kind", [float, vec2, sl.vec3])
def test_an_output_has_the_channels_of_its_target(recording: Device, kind: Any) -> None:
    class One(FullScreen):
        def fragment(self) -> float:
            return 1.0

    class Two(FullScreen):
        def fragment(self) -> vec2:
            return vec2(1.0, 1.0)

    class Three(FullScreen):
        def fragment(self) -> sl.vec3:
            return sl.vec3(1.0, 1.0, 1.0)

    shader, channels = {float: (One, 1), vec2: (Two, 2), sl.vec3: (Three, 3)}[kind]
    program = recording.program(shader)
    with recording.mesh(3) as mesh:
        for form in (Format.R8, Format.RG8, Format.RGBA8):
            with recording.texture(SIZE, form) as target:
                with recording.render_pass(target, clear=(0, 0, 0, 0)):
                    if form.channels > channels:
                        with refuses(rules.PROGRAM_OUTPUT, recording):
                            recording.draw(program, mesh)
                    else:
                        recording.draw(program, mesh)
                if recording.capabilities.renders:
                    assert_same(target.read(), 0 if form.channels > channels else 255)


@pytest.mark.requires("draws")
@pytest.mark.usefixtures("earlier")
def test_blending_with_a_format_that_cannot_is_refused_before_the_draw(recording: Device) -> None:
    capabilities = recording.capabilities
    usable = set(Format) - capabilities.unrenderable_formats - capabilities.unsupported_formats
    program, added = recording.program(Colored), BlendFunction(BlendFactor.ONE, BlendFactor.ONE)
    with recording.mesh(rectangle()) as mesh:
        for form in usable & capabilities.unblendable_formats:
            with recording.texture(SIZE, form) as target, recording.render_pass(target, clear=(0, 0, 0, 0)):
                with recording.states(added):
                    for _ in range(2):
                        with refuses(rules.DEVICE_CAPABILITY, recording):
                            recording.draw(program, mesh)
                recording.draw(program, mesh)
                with recording.states(added), refuses(rules.DEVICE_CAPABILITY, recording):
                    recording.draw(program, mesh)
        with recording.texture(SIZE, Format.R8) as target, recording.render_pass(target):
            with recording.states(added):
                recording.draw(program, mesh)


# -- limits --------------------------------------------------------------------------------------------------


@pytest.mark.requires("draws")
@pytest.mark.usefixtures("earlier")
@pytest.mark.parametrize("seed", range(3))
def test_a_viewport_is_as_large_as_the_device_says(recording: Device, seed: int) -> None:
    size = recording.capabilities.max_texture_size
    generator = np.random.default_rng(seed)
    starts = [-2 * size, -size - 0.5, -1.0, 0.0, 0.5, size / 2, size, 2 * size - 5, 2 * size - 1]
    extents = [0.0, 1e-30, 0.5, 4.0, size / 2 + 0.25, size - 1, size]
    program = recording.program(Colored)
    with recording.texture(SIZE, Format.R8) as target, recording.mesh(rectangle()) as mesh:
        for _ in range(30):
            (x, y), (width, height) = generator.choice(starts, 2), generator.choice(extents, 2)
            if max(abs(x), abs(y)) > 32767 or max(width, height) > 16384:
                continue  # no Viewport has these
            fits = max(width, height) <= size
            view = Viewport(float(x), float(y), float(width), float(height))
            with recording.render_pass(target):
                if fits:
                    with recording.states(view):
                        recording.draw(program, mesh)
                else:
                    with refuses(rules.STATE_CAPABILITY, recording), recording.states(view):
                        recording.draw(program, mesh)


@pytest.mark.requires("draws")
@pytest.mark.usefixtures("earlier")
def test_vertices_are_as_far_apart_as_the_device_says(recording: Device) -> None:
    most, step = recording.capabilities.max_vertex_stride, recording.capabilities.vertex_alignment
    program = recording.program(WriteNothing)
    with recording.texture(SIZE, Format.RGBA8) as target, recording.render_pass(target):
        for stride in (most, most + max(step, 4)):
            fields: Any = {"names": ["position"], "formats": [("f4", 2)], "offsets": [0], "itemsize": stride}
            with recording.mesh(np.zeros(3, np.dtype(fields))) as mesh:
                if stride > most:
                    with refuses(rules.DEVICE_CAPABILITY, recording):
                        recording.draw(program, mesh)
                else:
                    recording.draw(program, mesh)


class WriteNothing(Shader):
    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, 0.5, 1.0)

    def fragment(self) -> vec4:
        return vec4(1.0, 1.0, 1.0, 1.0)


def test_a_3d_texture_is_no_larger_than_the_device_says(recording: Device) -> None:
    most = recording.capabilities.max_volume_size
    for size, depth in (((most + 1, 1), 1), ((1, most + 1), 1)):
        with refuses(rules.TEXTURE_SIZE, recording):
            recording.texture(size, Format.R8, kind=TextureKind.D3, layers=depth)
    for size in ((most, 1), (1, most)):
        recording.texture(size, Format.R8, kind=TextureKind.D3, layers=1).destroy()


@pytest.mark.requires("draws", "indirect_count")
@pytest.mark.usefixtures("earlier")
@pytest.mark.parametrize("number", [-(1 << 31), -4, 1 << 31, 1 << 34, 1 << 62, 1 << 63, 10**30])
@pytest.mark.parametrize("name", ["draws", "offset", "stride", "count_offset"])
def test_numbers_of_indirect_draws_are_bounded(recording: Device, name: str, number: int) -> None:
    program = recording.program(WriteNothing)
    mesh = recording.mesh(np.zeros(3, np.dtype([("position", "f4", 2)])))
    with (
        mesh,
        recording.buffer(mesh.draws([0], 3)) as arguments,
        recording.texture(SIZE, Format.RGBA8) as target,
    ):
        with recording.buffer(np.ones(1, np.uint32)) as count, recording.render_pass(target):
            for counts in (None, count):
                numbers = {"draws": 1, "offset": 0, "stride": 20, "count_offset": 0}
                with refuses(rules.INDIRECT_RANGE, recording):
                    indirect = IndirectDraws(arguments, count=counts, **(numbers | {name: number}))
                    recording.draw_indirect(program, mesh, indirect)
                recording.draw_indirect(program, mesh, IndirectDraws(arguments, count=counts, **numbers))


@pytest.mark.requires("draws")
@pytest.mark.usefixtures("earlier")
@pytest.mark.parametrize("units", [-3e38, -(2.0**31), 2.0**31 - 1, 2.0**31, 3e38])
def test_a_depth_bias_may_be_as_large_as_a_float(recording: Device, units: float) -> None:
    with recording.texture(SIZE, Format.D32F) as depth, recording.mesh(rectangle()) as mesh:
        with recording.render_pass(depth=depth, clear_depth=0.0), recording.states(rhi.DepthBias(units)):
            recording.draw(recording.program(Colored), mesh)


@pytest.mark.parametrize("text", ["\udc80", "a\ud800b"])
def test_labels_that_no_driver_accepts_are_refused(recording: Device, text: str) -> None:
    with refuses(rules.DEVICE_ARGUMENT, recording):
        recording.texture(SIZE, Format.R8, label=text)
    with refuses(rules.DEVICE_ARGUMENT, recording):
        recording.event(text)
    with recording.event("Ünïcödé"):
        recording.texture(SIZE, Format.R8, label="\u00e4\U0001f600").destroy()
