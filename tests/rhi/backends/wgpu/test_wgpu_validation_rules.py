"""Each validation rule of WebGPU, tried from both sides: what breaks it is refused at that call, what is beside
it works, and a pass that was drawn before stays.

WebGPU itself would refuse at submission, with all commands that were gathered. `RULES` has the rows of the
table in docs/backends-wgpu.md: tries that are accepted, and tries that are refused, with the rules of refusal.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

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

    def draw(device: Device) -> None:
        formats = sorted(device.capabilities.unblendable_formats, key=lambda format: format.name)
        if number >= len(formats):
            pytest.skip("the device blends all formats")
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
        size = fields.pop("size", 40)
        records = np.zeros(size // 4, np.uint32)
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


def texture(size: tuple[int, int], **more: Any) -> Try:
    return lambda device: device.texture(size, more.pop("format", Format.R8), **more).destroy()


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


ELSEWHERE = (
    "draws stay within",
    "number of bindings",
    "at most 50 million",
)
"""Rows with tests of their own: the kit's draws, programs of many bindings, and one that nobody checks."""

RULES: list[Row] = [
    Row(
        "usage scopes",
        [
            alias(shares=False, shader=Copy),
            alias_constants(0, shares=False),
            alias_constants(3, shares=False),
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
    Row(
        "a texture that is sampled and stored to",
        [
            lambda device: device.dispatch(
                device.program(SampleAndStore), 1, source=(t := image(device, Format.R32F)), target=t.image()
            )
        ],
    ),
    Row(
        "arguments that the same draw",
        [
            lambda device: device.dispatch_indirect(
                device.program(Copy),
                (
                    counts := device.storage(
                        float, np.array([1, 1, 1, 0, 0, 0, 0, 0], np.uint32).view(np.float32)
                    )
                ),
                0,
                source=device.storage(float, 8),
                target=counts,
            )
        ],
    ),
    Row(
        "targets aren't bound",
        [sample_in_pass(None)],
        [sample_in_pass(0), sample_in_pass(1), sample_in_pass(2)],
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
        [two_sizes(8, 8), two_samples(4, 4), attach(*[Format.R8] * 8)],
        [two_sizes(8, 7), two_samples(4, 1), attach(*[Format.R8] * 9), attach(Format.D32F)],
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
        "indirect draws and dispatches",
        [indirect(), indirect(draws=2), indirect(offset=20)],
        [
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
        ],
        [
            copy_texture(rhi.Region(0, 0, 9, 1), 0, 0),
            copy_texture(rhi.Region(0, 0, 4, 4), 5, 0),
            copy_texture(None, 0, 0, Format.RGBA16F),
            copy_texture(None, 0, 0, samples=4),
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
        ],
        ("texture-size", "texture-levels", "texture-samples"),
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
        [query(twice=False, nested=True), query(twice=True, nested=True)],
        ("query-nested", "query-used"),
    ),
    Row(
        "debug groups",
        [lambda d: image(d, label="").destroy(), lambda d: image(d, label="é").destroy()],
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


@pytest.fixture(scope="module")
def wgpu(usable: None) -> Iterator[Device]:
    with rhi.create_device("wgpu") as device:
        yield device


@pytest.fixture
def earlier(wgpu: Device) -> Iterator[Device]:
    """A device that has drawn a pass, whose image is whole at the end of the test."""
    drawn = wgpu.texture((8, 8), Format.RGBA8)
    with wgpu.render_pass(drawn, clear=(0, 0, 0, 0)):
        wgpu.draw(wgpu.program(White), wgpu.mesh(3))
    yield wgpu
    assert (drawn.read() == 255).all()
    wgpu.present()


def test_each_row_of_the_page_that_refuses_is_tried() -> None:
    page = PAGE.read_text(encoding="utf-8").partition("## Validation rules")[2].partition("\n## ")[0]
    rows = [line.split(" | ")[0].removeprefix("| ") for line in page.splitlines() if line.startswith("| ")][
        1:
    ]
    untried = [row for row in rows if not any(row.startswith(rule.text) for rule in RULES)]
    assert [row for row in untried if not row.startswith(ELSEWHERE)] == []
    assert all(any(row.startswith(rule.text) for row in rows) for rule in RULES)
    assert min(len(row.refused) for row in RULES if row.rules) >= 2


ACCEPTED = [(row.text, number, act) for row in RULES for number, act in enumerate(row.accepted)]
REFUSED = [(row.text, number, act, row.rules) for row in RULES for number, act in enumerate(row.refused)]


@pytest.mark.parametrize(("text", "number", "act"), ACCEPTED, ids=[f"{a[0]}-{a[1]}" for a in ACCEPTED])
def test_keeping_a_rule_of_webgpu_works(earlier: Device, text: str, number: int, act: Try) -> None:
    act(earlier)
    earlier.finish()


@pytest.mark.parametrize(("text", "number", "act", "rules"), REFUSED, ids=[f"{r[0]}-{r[1]}" for r in REFUSED])
def test_breaking_a_rule_of_webgpu_is_refused_at_its_call(
    earlier: Device, text: str, number: int, act: Try, rules: tuple[str, ...]
) -> None:
    with pytest.raises(rhi.RhiError) as error:
        act(earlier)
    assert error.value.rule.id in rules
    earlier.finish()
