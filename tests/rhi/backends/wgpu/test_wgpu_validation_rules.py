"""Each validation rule of WebGPU, tried from both sides: what breaks it is refused at that call, what is beside
it works, and a pass that was drawn before stays.

WebGPU itself would refuse at submission, with all commands that were gathered. `RULES` has the rows of the
table in docs/backends-wgpu.md: tries that are accepted, and tries that are refused, with the rules of refusal.
They run on wgpu, on wgpu without features, on the null device with the profile `webgpu`, and in
`rhi.testing.portability`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nightly_reasons import FEWER_CASES

import rhi
import rhi.shading as sl
from rhi import (
    BlendColor,
    BlendFactor,
    BlendFunction,
    DepthBias,
    Device,
    Format,
    IndirectDraws,
    Scissor,
    TextureKind,
    Viewport,
)
from rhi.backends.null.null_capabilities import get_profile
from rhi.testing.portability import check_portability

PAGE = Path(__file__).parents[4] / "docs" / "backends-wgpu.md"
Try = Callable[[Device], object]


@dataclass
class Row:
    """A row of the table: its first cell begins with `text`.

    Attributes:
        accepted: tries that work.
        refused: tries that are refused.
        rules: the rules that refuse them.
    """

    text: str
    accepted: list[Try]
    refused: list[Try] = field(default_factory=list)
    rules: tuple[str, ...] = ()


class Corner(sl.Struct):
    position: sl.vec2


class Copy(sl.Shader):
    work_group = (4,)
    source: sl.Storage[float]
    target: sl.StorageRW[float]

    def compute(self) -> None:
        self.target[sl.global_id().x] = self.source[sl.global_id().x]


class WriteBoth(sl.Shader):
    work_group = (4,)
    first: sl.StorageRW[float]
    second: sl.StorageRW[float]

    def compute(self) -> None:
        self.first[sl.global_id().x] = 1.0
        self.second[sl.global_id().x] = 2.0


class Sampled(sl.FullScreen):
    source: sl.Texture2D

    def fragment(self) -> sl.vec4:
        return self.source.sample(sl.vec2(0.5, 0.5))


class White(sl.FullScreen):
    def fragment(self) -> sl.vec4:
        return sl.vec4(1.0, 1.0, 1.0, 1.0)


class Whole(sl.FullScreen):
    def fragment(self) -> sl.ivec4:
        return sl.ivec4(1, 2, 3, 4)


class Store(sl.Shader):
    work_group = (1,)
    target: sl.Image2D = sl.image(Format.R32F)

    def compute(self) -> None:
        self.target.store(sl.ivec2(0, 0), sl.vec4(1.0))


class StoreTwice(sl.Shader):
    work_group = (1,)
    first: sl.Image2D = sl.image(Format.R32F)
    second: sl.Image2D = sl.image(Format.R32F)

    def compute(self) -> None:
        self.first.store(sl.ivec2(0, 0), sl.vec4(1.0))
        self.second.store(sl.ivec2(0, 0), sl.vec4(1.0))


class CountGroups(sl.Shader):
    """Writes one to each of its numbers, which may be the counts of its own work-groups."""

    work_group = (1,)
    numbers: sl.StorageRW[sl.uint]

    def compute(self) -> None:
        self.numbers[sl.global_id().x] = sl.uint(1)


class Numbered(sl.FullScreen):
    """Writes to memory, which makes its draw a writer."""

    numbers: sl.StorageRW[sl.uint]

    def fragment(self) -> sl.vec4:
        self.numbers[0] = sl.uint(1)
        return sl.vec4(1.0)


class Shown(sl.FullScreen):
    numbers: sl.Storage[sl.uint]

    def fragment(self) -> sl.vec4:
        return sl.vec4(float(self.numbers[0]))


class Constants(sl.Struct):
    color: sl.vec4


class Matrix(sl.Struct):
    rows: sl.mat4


class ReadMatrix(sl.FullScreen):
    matrix: sl.Uniform[Matrix]

    def fragment(self) -> sl.vec4:
        return self.matrix.rows @ sl.vec4(1.0)


class UniformAndWrite(sl.Shader):
    work_group = (1,)
    constants: sl.Uniform[Constants]
    target: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        self.target[0] = self.constants.color


class Positions(sl.Shader):
    def vertex(self, v: Corner) -> sl.vec4:
        return sl.vec4(v.position, 0.5, 1.0)

    def fragment(self) -> sl.vec4:
        return sl.vec4(1.0)


class SampleAndStore(sl.Shader):
    work_group = (1,)
    source: sl.Texture2D
    target: sl.Image2D = sl.image(Format.R32F)

    def compute(self) -> None:
        self.target.store(sl.ivec2(0, 0), self.source.sample_lod(sl.vec2(0.5, 0.5), 0.0) + 1.0)


def image(device: Device, format: Format = Format.RGBA8, size: int = 8, **more: Any) -> rhi.Texture:
    return device.texture((size, size), format, **more)


def render(*states: Any, shader: Any = White, format: Format = Format.RGBA8, **more: Any) -> Try:
    """Return a try that draws with states into a new image."""

    def draw(device: Device) -> None:
        with device.render_pass(image(device, format), **more), device.states(*states):
            device.draw(device.program(shader), device.mesh(3))

    return draw


def render_viewport(x: float, y: float) -> Try:
    return lambda device: render(Viewport(x, y, 4, 4))(device)


def render_biased(units: float) -> Try:
    return lambda device: render(DepthBias(units))(device)


def blend_unblendable(number: int) -> Try:
    """Return a try that blends with one of the formats that the device can't blend."""

    formats = sorted(get_profile("webgpu").unblendable_formats, key=lambda format: format.name)

    def draw(device: Device) -> None:
        if (
            device.capabilities.backend == "wgpu"
            and formats[number] not in device.capabilities.unblendable_formats
        ):
            pytest.skip("the device blends this format")
        render(BlendFunction(BlendFactor.ONE, BlendFactor.ONE), format=formats[number])(device)

    return draw


def alias(*, shares: bool, shader: Any = WriteBoth, views: bool = False) -> Try:
    """Return a try of a dispatch with two bindings, which may share a buffer, or be two views of one."""

    def dispatch(device: Device) -> None:
        program, buffer = device.program(shader), device.buffer(64)
        first = device.storage(float, buffer) if views else device.storage(float, 16)
        second = first if shares and not views else device.storage(float, buffer if shares else 16)
        names = [binding.name for binding in program.descriptor.bindings]
        device.dispatch(program, 1, **dict(zip(names, (first, second), strict=True)))

    return dispatch


def alias_images(*targets: tuple[int, int]) -> Try:
    """Return a try of a dispatch with two images in one texture, by level and layer."""

    def dispatch(device: Device) -> None:
        texture = device.texture((8, 8), Format.R32F, kind=TextureKind.D2_ARRAY, layers=2, levels=2)
        first, second = (texture.image(*target) for target in targets)
        device.dispatch(device.program(StoreTwice), 1, first=first, second=second)

    return dispatch


def alias_constants(index: int, *, shares: bool) -> Try:
    """Return a try of a dispatch that reads constants, and may write the buffer that has them."""

    def dispatch(device: Device) -> None:
        constants = device.uniform_array(Constants, 4)
        target = device.storage(sl.vec4, constants.buffer if shares else 4)
        device.dispatch(device.program(UniformAndWrite), 1, constants=constants[index], target=target)

    return dispatch


def sample_in_pass(level: int | None) -> Try:
    """Return a try that samples a texture, of which one level is the target (None: another texture's)."""

    def draw(device: Device) -> None:
        texture = device.texture((8, 8), Format.RGBA8, levels=3)
        with device.render_pass(image(device) if level is None else texture.at(level)):
            device.draw(device.program(Sampled), device.mesh(3), source=texture)

    return draw


def indirect(**fields: Any) -> Try:
    """Return a try with fields of `IndirectDraws`; the buffer has room for two draws."""

    def draw(device: Device) -> None:
        mesh = device.mesh(3)
        records = np.zeros(10, np.uint32)
        values = {"draws": 1, **fields}
        with device.render_pass(image(device)):
            device.draw_indirect(device.program(White), mesh, IndirectDraws(device.buffer(records), **values))

    return draw


def attach(*formats: Format, **more: Any) -> Try:
    """Return a try that begins and ends a pass with targets of these formats."""

    def begin(device: Device) -> None:
        with device.render_pass([image(device, format) for format in formats], **more):
            pass

    return begin


def attach_bytes(beyond: int) -> Try:
    """Return a try of a pass whose targets have as many bytes a texel as the device allows, or more."""

    def begin(device: Device) -> None:
        count = device.capabilities.max_target_bytes // Format.RGBA32F.texel_bytes + beyond
        attach(*[Format.RGBA32F] * count)(device)

    return begin


def resolve(target: Try, end: Try) -> Try:
    """Return a try of a pass that resolves one texture to another."""

    def begin(device: Device) -> None:
        textures: Any = target(device), end(device)
        with device.render_pass(textures[0], resolve=textures[1]):
            pass

    return begin


def same_target(*levels_and_layers: tuple[int, int]) -> Try:
    """Return a try with two targets in one texture, by level and layer."""

    def begin(device: Device) -> None:
        texture = device.texture((8, 8), Format.RGBA8, kind=TextureKind.D2_ARRAY, layers=2, levels=2)
        with device.render_pass([texture.at(level, layer) for level, layer in levels_and_layers]):
            pass

    return begin


def two_sizes(first: int, second: int) -> Try:
    def begin(device: Device) -> None:
        with device.render_pass([image(device, size=first), image(device, size=second)]):
            pass

    return begin


def two_samples(first: int, second: int) -> Try:
    def begin(device: Device) -> None:
        with device.render_pass([image(device, samples=first), image(device, samples=second)]):
            pass

    return begin


def clear_depth(format: Format, **clears: Any) -> Try:
    def begin(device: Device) -> None:
        with device.render_pass(None, image(device, format), **clears):
            pass

    return begin


def inside_pass(act: Callable[[Device], object]) -> Try:
    def begin(device: Device) -> None:
        with device.render_pass(image(device)):
            act(device)

    return begin


def after_pass(act: Callable[[Device], object]) -> Try:
    def begin(device: Device) -> None:
        with device.render_pass(image(device)):
            pass
        act(device)

    return begin


def dispatch(groups: Any) -> Try:
    def run(device: Device) -> None:
        device.dispatch(
            device.program(Copy), groups, source=device.storage(float, 8), target=device.storage(float, 8)
        )

    return run


def dispatch_indirect(offset: int) -> Try:
    """Return a try that reads three counts from a buffer of four."""

    def run(device: Device) -> None:
        source, target = device.storage(float, 8), device.storage(float, 8)
        counts = device.storage(sl.uint, np.ones(4, np.uint32))
        device.dispatch_indirect(device.program(Copy), counts, offset, source=source, target=target)

    return run


def copy_buffer(size: int, offset: int, target_offset: int, *, within: bool = False) -> Try:
    def copy(device: Device) -> None:
        source = device.buffer(64)
        target = source if within else device.buffer(64)
        source.copy_to(target, size=size, offset=offset, target_offset=target_offset)

    return copy


def copy_texture(
    region: rhi.Region | None, x: int, y: int, format: Format = Format.RGBA8, samples: int = 1
) -> Try:
    def copy(device: Device) -> None:
        image(device, samples=samples).copy_to(image(device, format), region=region, x=x, y=y)

    return copy


def copy_within(region: rhi.Region | None, x: int, y: int) -> Try:
    """Return a try that copies a part of a texture to elsewhere in it."""

    def copy(device: Device) -> None:
        texture = image(device)
        texture.copy_to(texture, region=region, x=x, y=y)

    return copy


def vertex_stride(beyond: int) -> Try:
    """Return a try with vertices farther apart than the device's limit, or less far."""

    def draw(device: Device) -> None:
        size = device.capabilities.max_vertex_stride + beyond
        fields = {"names": ["position"], "formats": [("f4", 2)], "offsets": [0], "itemsize": size}
        mesh = device.mesh(np.zeros(3, np.dtype(fields)))  # type: ignore[call-overload]
        with device.render_pass(image(device)):
            device.draw(device.program(Positions), mesh)

    return draw


def constants_of(size: int) -> Try:
    """Return a try with a buffer of bytes where constants of 64 bytes are expected."""
    return bind(lambda device: device.buffer(size), ReadMatrix, "matrix")


def texture(size: tuple[int, int], format: Format = Format.R8, **more: Any) -> Try:
    return lambda device: device.texture(size, format, **more).destroy()


def bind(value: Callable[[Device], Any], shader: Any = Sampled, name: str = "source") -> Try:
    def draw(device: Device) -> None:
        with device.render_pass(image(device)):
            device.draw(device.program(shader), device.mesh(3), **{name: value(device)})

    return draw


def bind_compute(value: Callable[[Device], Any]) -> Try:
    return lambda device: device.dispatch(device.program(Store), 1, target=value(device))


def use_destroyed(act: Callable[[Device, rhi.Texture], object]) -> Try:
    def use(device: Device) -> None:
        texture = image(device)
        texture.destroy()
        act(device, texture)

    return use


def render_mesh(*view: int, instances: int = 1, **base: Any) -> Try:
    """Return a try that draws a part of three vertices with three indices, and with data of two instances."""

    def draw(device: Device) -> None:
        data = np.zeros(2, np.dtype([("position", "f4", 2)]))
        mesh = device.mesh({"unused": np.zeros((3, 2), np.float32)}, np.arange(3), instances=data)
        with device.render_pass(image(device)):
            device.draw(device.program(Positions), mesh.view(*view, **base), instances)

    return draw


def sized(text: str, measure: Callable[[rhi.Capabilities], int], beyond: int = 0) -> Try:
    """Return a try with a program of as many bindings, or numbers, as a limit of the device says.

    `text`: NUMBER is that number; a line with # is repeated for each of them, which takes the place of #. Null
    devices take the limits of WebGPU's profile, since some of their own are beyond the language.
    """

    def build(device: Device) -> None:
        is_real = device.capabilities.backend == "wgpu"
        number = measure(device.capabilities if is_real else get_profile("webgpu")) + beyond
        lines = ["from rhi.shading import *"]
        for line in text.splitlines():
            repeated = range(number) if "#" in line else range(1)
            lines += [line.replace("#", str(index)).replace("NUMBER", str(number)) for index in repeated]
        device.program(sl.from_source("\n".join(lines), "Sized"))

    return build


STORAGES = """
class Sized(Shader):
    work_group = (1,)
    f#: StorageRW[float]
    def compute(self) -> None:
        self.f#[0] = 1.0
"""
TEXTURES = """
class Sized(FullScreen):
    f#: Texture2D
    def fragment(self) -> vec4:
        color = vec4(0.0)
        color += self.f#.sample(vec2(0.5, 0.5))
        return color
"""
ATTRIBUTES = """
class Corner(Struct):
    f#: vec4

class Sized(Shader):
    def vertex(self, v: Corner) -> vec4:
        sum = vec4(0.0)
        sum += v.f#
        return sum
    def fragment(self) -> vec4:
        return vec4(1.0)
"""
VARYINGS = """
class Corner(Struct):
    position: vec4

class Moved(Struct):
    clip: vec4
    f#: vec4

class Sized(Shader):
    def vertex(self, v: Corner) -> Moved:
        return Moved(
            clip=v.position,
            f#=v.position,
        )
    def fragment(self, m: Moved) -> vec4:
        sum = vec4(0.0)
        sum += m.f#
        return sum
"""
GROUPS = """
class Sized(Shader):
    work_group = (NUMBER,)
    out: StorageRW[float]
    def compute(self) -> None:
        self.out[global_id().x] = 1.0
"""
SHARED = """
class Sized(Shader):
    work_group = (4,)
    out: StorageRW[float]
    memory = shared(float, NUMBER)
    def compute(self) -> None:
        self.memory[local_id().x] = 1.0
        barrier()
        self.out[global_id().x] = self.memory[0]
"""


def count_groups(device: Device) -> None:
    """Dispatch what the program itself overwrites: it has read three, and writes one."""
    counts = device.storage(sl.uint, np.array([3, 1, 1, 0], np.uint32))
    device.dispatch_indirect(device.program(CountGroups), counts, 0, numbers=counts)
    if device.capabilities.backend != "null":
        assert counts.read().tolist() == [1, 1, 1, 0]


def write_arguments(device: Device) -> None:
    """Draw with arguments that the draw itself overwrites."""
    arguments = device.storage(sl.uint, np.array([3, 1, 0, 0, 0], np.uint32))
    with device.render_pass(image(device)):
        device.draw_indirect(
            device.program(Numbered), device.mesh(3), IndirectDraws(arguments, 1), numbers=arguments
        )


def write_count(device: Device) -> None:
    """Draw as often as a number says that the draw itself overwrites."""
    count, arguments = device.storage(sl.uint, 4), device.buffer(np.array([3, 1, 0, 0, 0], np.uint32))
    draws = IndirectDraws(arguments, 1, count=count)
    with device.render_pass(image(device)):
        device.draw_indirect(device.program(Numbered), device.mesh(3), draws, numbers=count)


def write_then_read(device: Device) -> None:
    """Write memory in one draw of a pass, and read it in the next."""
    numbers, target = device.storage(sl.uint, np.zeros(4, np.uint32)), image(device)
    with device.render_pass(target):
        device.draw(device.program(Numbered), device.mesh(3), numbers=numbers)
        device.draw(device.program(Shown), device.mesh(3), numbers=numbers)
    if device.capabilities.backend != "null":
        assert (target.read() == 255).all()


def sample_and_store(value: float) -> Try:
    """Return a try that adds one to a texture's own texel."""

    def dispatch(device: Device) -> None:
        texture = image(device, Format.R32F)
        texture.write(np.full((8, 8, 1), value, np.float32))
        device.dispatch(device.program(SampleAndStore), 1, source=texture, target=texture.image())
        if device.capabilities.backend != "null":
            assert texture.read()[0, 0] == value + 1.0

    return dispatch


def sample_resolved(device: Device) -> None:
    """Sample the texture that the pass resolves to."""
    end = image(device)
    with device.render_pass(image(device, samples=4), resolve=end):
        device.draw(device.program(Sampled), device.mesh(3), source=end)


def sample_after_pass(device: Device) -> None:
    """Sample a texture that an earlier pass has drawn to."""
    target = image(device)
    with device.render_pass(target):
        pass
    bind(lambda _: target)(device)


def label_event(device: Device) -> None:
    with device.event("é"):
        pass


def query_in_itself(device: Device) -> None:
    query = device.occlusion_query()
    with device.render_pass(image(device)), query, query:
        pass


def query(*, twice: bool, nested: bool) -> Try:
    def draw(device: Device) -> None:
        first, second = device.occlusion_query(), device.occlusion_query()
        with device.render_pass(image(device)):
            with first:
                device.draw(device.program(White), device.mesh(3))
                if nested:
                    with second:
                        pass
            if twice:
                with first:
                    device.draw(device.program(White), device.mesh(3))

    return draw


UNCHECKED = "at most 50 million"
"""The row that nobody checks."""
MIN_TRIES = 3
"""Tries of each side of a rule."""

RULES: list[Row] = [
    Row(
        "usage scopes",
        [
            alias(shares=False, shader=Copy),
            alias_constants(0, shares=False),
            alias_constants(3, shares=False),
            write_then_read,
        ],
        [
            alias(shares=True, shader=Copy),
            alias(shares=True, shader=Copy, views=True),
            alias_constants(0, shares=True),
            alias_constants(3, shares=True),
        ],
        ("device-capability",),
    ),
    Row(
        "writable bindings",
        [alias(shares=False), alias_images((0, 0), (1, 0)), alias_images((0, 0), (0, 1))],
        [alias(shares=True), alias(shares=True, views=True), alias_images((1, 1), (1, 1))],
        ("device-capability",),
    ),
    Row("a texture that is sampled and stored to", [sample_and_store(value) for value in (0.0, 1.0, -2.5)]),
    Row("arguments that the same draw", [count_groups, write_arguments, write_count]),
    Row(
        "targets aren't bound",
        [sample_in_pass(None), sample_after_pass, bind(image)],
        [sample_in_pass(0), sample_in_pass(1), sample_in_pass(2), sample_resolved],
        ("pass-feedback",),
    ),
    Row(
        "each attachment once",
        [same_target((0, 0), (0, 1)), same_target((1, 0), (1, 1)), same_target((0, 1), (0, 0))],
        [same_target((0, 0), (0, 0)), same_target((1, 1), (1, 1)), same_target((0, 1), (0, 1))],
        ("pass-target",),
    ),
    Row(
        "formats, sizes, samples",
        [
            two_sizes(8, 8),
            two_samples(4, 4),
            attach(*[Format.R8] * 8),
            attach_bytes(0),
            resolve(lambda d: image(d, samples=4), image),
        ],
        [
            two_sizes(8, 7),
            two_samples(4, 1),
            attach(*[Format.R8] * 9),
            attach(Format.D32F),
            attach_bytes(1),
            lambda d: d.render_pass(None, image(d)).__enter__(),
            resolve(lambda d: image(d, samples=4), lambda d: image(d, Format.RGBA16F)),
            resolve(lambda d: image(d, samples=4), lambda d: image(d, size=4)),
            resolve(lambda d: image(d, samples=4), lambda d: image(d, samples=4)),
            resolve(lambda d: image(d, Format.RGBA8UI, samples=4), lambda d: image(d, Format.RGBA8UI)),
            resolve(image, image),
        ],
        ("pass-size", "pass-samples", "pass-target", "device-capability"),
    ),
    Row(
        "clear values of depth",
        [
            clear_depth(Format.D32F, clear_depth=0.0),
            clear_depth(Format.D32F, clear_depth=1.0),
            clear_depth(Format.D24S8, clear_depth=0.5, clear_stencil=255),
        ],
        [
            clear_depth(Format.D32F, clear_depth=-1e-7),
            clear_depth(Format.D32F, clear_depth=1.0000001),
            clear_depth(Format.D32F, clear_depth=float("nan")),
            clear_depth(Format.D24S8, clear_stencil=256),
            clear_depth(Format.D24S8, clear_stencil=-1),
        ],
        ("pass-clear", "device-argument"),
    ),
    Row(
        "one pass at a time",
        [after_pass(lambda d: render()(d)), after_pass(dispatch(1)), after_pass(copy_buffer(16, 0, 0))],
        [
            inside_pass(render()),
            inside_pass(lambda d: d.render_pass(image(d)).__enter__()),
            inside_pass(lambda d: inside_pass(lambda _: None)(d)),
        ],
        ("pass-nested", "pass-open"),
    ),
    Row(
        "outputs have the type",
        [render(), render(shader=Whole, format=Format.RGBA32I), render(format=Format.R8)],
        [render(format=Format.RGBA32I), render(shader=Whole), render(shader=Whole, format=Format.RGBA32UI)],
        ("program-output",),
    ),
    Row(
        "blending with formats",
        [
            render(BlendFunction(BlendFactor.ONE, BlendFactor.ONE)),
            render(BlendFunction(BlendFactor.ONE, BlendFactor.ONE), format=Format.RGBA16F),
            render(BlendFunction(BlendFactor.ONE, BlendFactor.ONE), shader=Whole, format=Format.RGBA32I),
        ],
        [blend_unblendable(0), blend_unblendable(1), blend_unblendable(2)],
        ("device-capability",),
    ),
    Row(
        "viewports: size",
        [
            render(Viewport(0, 0, 8192, 8192)),
            render(Viewport(0, 0, 1, 1)),
            render(Viewport(-100, 3.5, 200, 2)),
        ],
        [
            lambda d: render(Viewport(0, 0, 16384.5, 4))(d),
            lambda d: render(Viewport(0, 0, 4, 1e6))(d),
            lambda d: render(Viewport(0, 0, 1, 65537))(d),
        ],
        ("state-capability", "state-value"),
    ),
    Row(
        "viewports: within twice",
        [render(Viewport(x, y, 4, 4)) for x, y in ((32767, 0), (-32767, 0), (-30000, 32767))],
        [render_viewport(32768, 0), render_viewport(-32769, 0), render_viewport(0, 1e9)],
        ("state-value",),
    ),
    Row(
        "scissors lie inside",
        [render(Scissor(*scissor)) for scissor in ((4, 4, 100, 100), (8, 0, 1, 1), (70000, 70000, 8, 8))],
    ),
    Row(
        "depth biases",
        [render_biased(2.5), render_biased(2.0**31), render_biased(-(2.0**40))],
    ),
    Row(
        "stencil references",
        [
            render(BlendColor(0, 0, 0, 0)),
            render(Viewport(0, 0, 4, 4, 0.0, 1.0)),
            render(Viewport(0, 0, 4, 4, 0.25, 0.5)),
            render(Viewport(0, 0, 4, 4, 1.0, 0.0)),
        ],
        [
            lambda d: render(BlendColor(float("nan"), 0, 0, 0))(d),
            lambda d: render(Viewport(0, 0, 4, 4, -0.001, 1.0))(d),
            lambda d: render(Viewport(0, 0, 4, 4, 0.0, 1.001))(d),
        ],
        ("state-value", "state-capability", "device-argument"),
    ),
    Row(
        "vertex strides",
        [vertex_stride(-1024), vertex_stride(-4), vertex_stride(0)],
        [vertex_stride(4), vertex_stride(2048), vertex_stride(1 << 16)],
        ("device-capability",),
    ),
    Row(
        "draws stay within",
        [
            render_mesh(),
            render_mesh(2, 1),
            render_mesh(0, 1, base_vertex=2),
            render_mesh(instances=2),
            render_mesh(base_instance=1),
            render_mesh(1, 0),
            render_mesh(instances=0),
        ],
        [
            render_mesh(1, 3),
            render_mesh(3, 1),
            render_mesh(0, 1, base_vertex=3),
            render_mesh(instances=3),
            render_mesh(base_instance=1, instances=2),
            render_mesh(base_instance=2),
            render_mesh(instances=-1),
            render_mesh(instances=1 << 32),
        ],
        ("mesh-range", "draw-count", "device-argument"),
    ),
    Row(
        "indirect draws and dispatches",
        [
            indirect(),
            indirect(draws=2),
            indirect(offset=20),
            dispatch_indirect(0),
            dispatch_indirect(4),
        ],
        [
            dispatch_indirect(8),
            dispatch_indirect(2),
            dispatch_indirect(-4),
            indirect(draws=3),
            indirect(offset=24),
            indirect(draws=2, stride=24),
            indirect(offset=-4),
            indirect(offset=2),
            indirect(stride=10**30, draws=2),
            indirect(draws=-1),
        ],
        ("indirect-range", "device-argument"),
    ),
    Row(
        "number of work-groups",
        [dispatch(1), dispatch((1, 65535, 1)), dispatch(0)],
        [dispatch((2**31, 1, 1)), dispatch((1, 1, 2**31)), dispatch(-1), dispatch(2**40)],
        ("dispatch-size",),
    ),
    Row(
        "sizes and offsets of bound ranges",
        [
            alias_constants(1, shares=False),
            alias_constants(2, shares=False),
            lambda d: d.storage(sl.vec4, d.buffer(16)).destroy(),
        ],
        [
            constants_of(64),
            lambda d: d.storage(sl.vec4, d.buffer(12)),
            lambda d: d.storage(float, 0),
        ],
        ("binding-size", "binding-type", "buffer-size", "buffer-range", "device-argument"),
    ),
    Row(
        "types of bindings",
        [
            bind(image),
            bind(lambda d: image(d, Format.RGBA32F)),
            bind_compute(lambda d: image(d, Format.R32F).image()),
        ],
        [
            bind(lambda d: image(d, Format.RGBA32I)),
            bind(lambda d: d.texture((4, 4), Format.RGBA8, kind=TextureKind.D2_ARRAY, layers=2)),
            bind(lambda d: d.storage(float, 4)),
            bind_compute(lambda d: image(d).image()),
        ],
        ("binding-type",),
    ),
    Row(
        "number of bindings",
        [
            sized(STORAGES, lambda limits: limits.max_storage_slots),
            sized(TEXTURES, lambda limits: limits.max_texture_slots),
            sized(ATTRIBUTES, lambda limits: limits.max_vertex_attributes),
            sized(VARYINGS, lambda limits: limits.max_varyings),
            sized(GROUPS, lambda limits: limits.max_work_group[0]),
            sized(SHARED, lambda limits: limits.max_shared_bytes // 4),
        ],
        [
            sized(STORAGES, lambda limits: limits.max_storage_slots, 1),
            sized(TEXTURES, lambda limits: limits.max_texture_slots, 1),
            sized(ATTRIBUTES, lambda limits: limits.max_vertex_attributes, 1),
            sized(VARYINGS, lambda limits: limits.max_varyings, 1),
            sized(GROUPS, lambda limits: limits.max_work_group[0], 1),
            sized(SHARED, lambda limits: limits.max_shared_bytes // 4, 1),
        ],
        ("device-capability", "shading-out-of-range"),
    ),
    Row(
        "copies of buffers",
        [copy_buffer(64, 0, 0), copy_buffer(4, 60, 0), copy_buffer(16, 0, 32, within=True)],
        [
            copy_buffer(68, 0, 0),
            copy_buffer(8, 60, 0),
            copy_buffer(4, 0, 64),
            copy_buffer(4, -4, 0),
            copy_buffer(16, 0, 8, within=True),
            copy_buffer(3, 0, 0),
            copy_buffer(4, 2, 0),
        ],
        ("buffer-alignment", "buffer-range", "buffer-overlap", "device-argument"),
    ),
    Row(
        "copies of textures",
        [
            copy_texture(None, 0, 0),
            copy_texture(rhi.Region(0, 0, 4, 4), 4, 4),
            copy_texture(rhi.Region(7, 7, 1, 1), 0, 0),
            copy_within(rhi.Region(0, 0, 4, 4), 4, 4),
        ],
        [
            copy_texture(rhi.Region(0, 0, 9, 1), 0, 0),
            copy_texture(rhi.Region(0, 0, 4, 4), 5, 0),
            copy_texture(None, 0, 0, Format.RGBA16F),
            copy_texture(None, 0, 0, samples=4),
            copy_within(rhi.Region(0, 0, 5, 5), 4, 4),
            copy_within(None, 0, 0),
        ],
        ("texture-format", "texture-region", "texture-samples"),
    ),
    Row(
        "sizes, levels, layers",
        [texture((8192, 1)), texture((8, 8), levels=4), texture((4, 4), format=Format.RGBA8, samples=4)],
        [
            texture((1 << 20, 1)),
            texture((0, 1)),
            texture((8, 8), levels=5),
            texture((4, 4), format=Format.RGBA8, samples=3),
            texture((4, 4), kind=TextureKind.D2_ARRAY, layers=1 << 20),
            texture((8, 4), kind=TextureKind.CUBE),
            texture((8, 8), kind=TextureKind.D3, layers=0),
            texture((8, 8), format=Format.D32F, kind=TextureKind.D3, layers=4),
            texture((8, 8), format=Format.RGBA8, levels=2, samples=4),
            texture((8, 8), format=Format.RGBA8, kind=TextureKind.D2_ARRAY, layers=2, samples=4),
        ],
        ("texture-size", "texture-levels", "texture-samples", "texture-format"),
    ),
    Row(
        "sizes of buffers",
        [
            lambda d: d.buffer(4).destroy(),
            lambda d: d.buffer(1 << 20).destroy(),
            lambda d: d.buffer(20).destroy(),
        ],
        [lambda d: d.buffer(0), lambda d: d.buffer(1 << 60), lambda d: d.buffer(-4)],
        ("device-out-of-memory", "buffer-size", "device-argument", "device-capability"),
    ),
    Row(
        "each query once",
        [
            query(twice=False, nested=False),
            query(twice=False, nested=False),
            query(twice=False, nested=False),
        ],
        [query(twice=False, nested=True), query(twice=True, nested=True), query_in_itself],
        ("query-nested", "query-used"),
    ),
    Row(
        "debug groups",
        [lambda d: image(d, label="").destroy(), lambda d: image(d, label="é").destroy(), label_event],
        [
            lambda d: image(d, label="\ud800"),
            lambda d: d.event("\ud800"),
            lambda d: d.mesh(3, label="\ud800"),
        ],
        ("device-argument",),
    ),
    Row(
        "destroyed or mapped",
        [render(), lambda d: image(d).destroy(), lambda d: d.buffer(16).read()],
        [
            use_destroyed(lambda d, t: bind(lambda _: t)(d)),
            use_destroyed(lambda d, t: t.read()),
            use_destroyed(lambda d, t: d.render_pass(t)),
            use_destroyed(lambda d, t: t.copy_to(image(d))),
        ],
        ("resource-destroyed",),
    ),
]


@pytest.fixture(scope="module", params=["wgpu", "wgpu without features", "null"])
def restricted(request: pytest.FixtureRequest) -> Iterator[Device]:
    """A device with WebGPU's rules: of wgpu with and without features, and the null device with its profile."""
    if request.param == "null":
        with rhi.create_device("null", profile="webgpu") as device:
            yield device
        return
    request.getfixturevalue("usable")
    with pytest.MonkeyPatch.context() as patch:
        if request.param != "wgpu":
            patch.setenv("RHI_WGPU_PROFILE", "core")
        device = rhi.create_device("wgpu")
    with device:
        yield device


@pytest.fixture
def earlier(restricted: Device) -> Iterator[Device]:
    """A device that has drawn a pass, whose image is whole at the end of the test."""
    drawn = restricted.texture((8, 8), Format.RGBA8)
    with restricted.render_pass(drawn, clear=(0, 0, 0, 0)):
        restricted.draw(restricted.program(White), restricted.mesh(3))
    yield restricted
    if restricted.capabilities.backend != "null":
        assert (drawn.read() == 255).all()
    restricted.present()


def test_each_row_of_the_page_is_tried_from_both_sides() -> None:
    page = PAGE.read_text(encoding="utf-8").partition("## Validation rules")[2].partition("\n## ")[0]
    rows = [line.split(" | ")[0].removeprefix("| ") for line in page.splitlines() if line.startswith("| ")][
        1:
    ]
    untried = [row for row in rows if not any(row.startswith(rule.text) for rule in RULES)]
    assert [row for row in untried if not row.startswith(UNCHECKED)] == []
    assert all(any(row.startswith(rule.text) for row in rows) for rule in RULES)
    assert min(len(row.accepted) for row in RULES) >= MIN_TRIES
    assert min(len(row.refused) for row in RULES if row.rules) >= MIN_TRIES


ACCEPTED = [(row.text, number, act) for row in RULES for number, act in enumerate(row.accepted)]
REFUSED = [(row.text, number, act, row.rules) for row in RULES for number, act in enumerate(row.refused)]
IDS = [[f"{case[0]}-{case[1]}" for case in cases] for cases in (ACCEPTED, REFUSED)]


@pytest.mark.parametrize(("text", "number", "act"), ACCEPTED, ids=IDS[0])
def test_keeping_a_rule_of_webgpu_works(earlier: Device, text: str, number: int, act: Try) -> None:
    act(earlier)
    earlier.finish()


@pytest.mark.parametrize(("text", "number", "act", "rules"), REFUSED, ids=IDS[1])
def test_breaking_a_rule_of_webgpu_is_refused_at_its_call(
    earlier: Device, text: str, number: int, act: Try, rules: tuple[str, ...]
) -> None:
    with pytest.raises(rhi.RhiError) as error:
        act(earlier)
    assert error.value.rule.id in rules
    earlier.finish()


def list_obstacles(act: Try) -> list[str]:
    """Return the rules that a try breaks on a device with WebGPU's profile, or on any."""
    try:
        report = check_portability(act, {"webgpu": get_profile("webgpu")})
    except rhi.RhiError as error:
        return [error.rule.id]
    return [obstacle.error.rule.id for obstacle in report.obstacles["webgpu"]]


@pytest.mark.parametrize(("text", "number", "act"), ACCEPTED, ids=IDS[0])
def test_keeping_a_rule_of_webgpu_is_portable(text: str, number: int, act: Try) -> None:
    assert list_obstacles(act) == []


@pytest.mark.parametrize(("text", "number", "act", "rules"), REFUSED, ids=IDS[1])
def test_breaking_a_rule_of_webgpu_is_an_obstacle(
    text: str, number: int, act: Try, rules: tuple[str, ...]
) -> None:
    obstacles = list_obstacles(act)
    assert obstacles
    assert set(obstacles) <= set(rules)


# -- each format in each use -----------------------------------------------------------------------------------


STORED = """
class Stored(Shader):
    work_group = (1,)
    target: Image2D = image(Format.NAME)
    def compute(self) -> None:
        self.target.store(ivec2(0, 0), VALUE)
"""
USES = (
    "target",
    "samples",
    "sampled",
    "blended",
    "stored",
    "loaded and stored",
    "copied",
    "cleared and resolved",
)


def use(format: Format, how: str) -> Try:
    """Return a try that uses an image of a format in one way."""
    if how == "target":
        return attach(format)
    if how == "samples":
        return lambda device: image(device, format, samples=4).destroy()
    if how == "sampled":
        return bind(lambda device: image(device, format))
    if how == "blended":
        return render(BlendFunction(BlendFactor.ONE, BlendFactor.ONE), format=format)
    if how == "copied":
        return lambda device: image(device, format).copy_to(
            image(device, format), region=rhi.Region(4, 4, 4, 4)
        )
    if how == "cleared and resolved":
        return resolve(lambda device: image(device, format, samples=4), lambda device: image(device, format))
    value = "vec4(1.0)" if how == "stored" else "self.target.load(ivec2(0, 0)) + vec4(1.0)"
    text = STORED.replace("NAME", format.name).replace("VALUE", value)

    def dispatch(device: Device) -> None:
        program: Any = device.program(
            sl.from_source(f"from rhi import Format\nfrom rhi.shading import *\n{text}")
        )
        device.dispatch(program, 1, target=image(device, format).image())

    return dispatch


@pytest.mark.nightly_cases("null-*", "wgpu-*", "*stored", "*copied", "*resolved", reason=FEWER_CASES)
@pytest.mark.parametrize("how", USES)
def test_each_format_is_refused_at_its_use_or_works(earlier: Device, how: str) -> None:
    """As `check_portability` says, if the device has nothing but WebGPU's profile."""
    refused = {}
    for format in Format:
        try:
            use(format, how)(earlier)
        except rhi.RhiError as error:
            refused[format] = error.rule.id
        earlier.finish()
    assert not {"device-driver", "shader-driver", "device-lost"} & set(refused.values())
    if earlier.capabilities.unfilterable_formats == get_profile("webgpu").unfilterable_formats:
        assert set(refused) == {format for format in Format if list_obstacles(use(format, how))}
