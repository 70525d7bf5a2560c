"""Traces of commands that no device would have issued are refused as they are loaded; traces that need what a
device lacks, before they are replayed on it. Each case stands beside one that is right and differs in one
point."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from null_kit import hand_made_program

import rhi
from rhi import BlendFunction, Format, PolygonOffset, Region, StencilReadMask, StencilWriteMask, TextureKind
from rhi.commands.recorder import CommandWriter
from rhi.commands.stream import Failure
from rhi.conformance.validation.refusal import refuses
from rhi.contract import descriptors
from rhi.contract.backend import Capabilities
from rhi.contract.blocks import CompressedFormat
from rhi.contract.descriptors import (
    Attachment,
    DepthAttachment,
    QueryKind,
    SamplerDescriptor,
    TextureDescriptor,
)
from rhi.contract.states import State
from rhi.device.core.state_cache import StateCache
from rhi.trace import load, save
from rhi.trace.rules import TRACE_CAPABILITY, TRACE_REFERENCE
from rhi.trace.validation import check_capabilities

WHOLE = Capabilities(
    "null",
    "",
    "",
    alpha_test=True,
    wireframe=True,
    texture_buffer_copies=True,
    max_line_width=8.0,
    compressed_formats=frozenset(CompressedFormat),
)
PROGRAM = hand_made_program()
Issue = Callable[[CommandWriter], object]


def write(issue: Issue) -> CommandWriter:
    """The commands of `issue` on two buffers of 64 bytes, 1 and 2, and textures of 8×8 texels, 3 to 11."""
    writer = CommandWriter(WHOLE)
    for buffer in (1, 2):
        writer.create_buffer(buffer, descriptors.BufferDescriptor(64))
    for texture, format, samples, levels in (
        (3, Format.RGBA8, 1, 3), (4, Format.RGBA8, 4, 1), (5, Format.D32FS8, 1, 3), (6, Format.RGBA8UI, 1, 3),
        (7, Format.D32FS8, 4, 1), (8, Format.RGBA8UI, 4, 1), (9, Format.RGBA8, 1, 1), (10, Format.D32F, 1, 1),
    ):  # fmt: skip
        writer.create_texture(texture, TextureDescriptor((8, 8), format, levels=levels, samples=samples))
    writer.create_texture(11, TextureDescriptor((8, 8), Format.RGBA8, compressed=CompressedFormat.BC1))
    issue(writer)
    return writer


def begin(*targets: int, depth: DepthAttachment | None = None, samples: int = 1, resolve: int = 0) -> Issue:
    colors = tuple(Attachment(target, resolve=resolve) for target in targets)
    return lambda writer: (
        writer.begin_pass(descriptors.PassDescriptor((8, 8), colors, depth, samples)),
        writer.end_pass(),
    )


def copy(source: int, target: int, x: int = 0) -> Issue:
    return lambda writer: writer.copy_texture(source, 0, Region(0, 0, 4, 4), target, 0, x, 0, 0)


def create(**changes: object) -> Issue:
    descriptor: TextureDescriptor = replace(TextureDescriptor((8, 8), Format.RGBA8), **changes)  # type: ignore
    return lambda writer: writer.create_texture(12, descriptor)


def blocks(x: int, width: int) -> Issue:
    return lambda writer: writer.write_texture(11, 0, Region(x, 0, width, 4), bytes(8 * -(-width // 4)))


def conditional(kind: QueryKind) -> Issue:
    return lambda writer: (
        writer.create_query(12, kind),
        writer.begin_conditional(12, False),
        writer.end_conditional(),
    )


IMPOSSIBLE: dict[str, tuple[Issue, Issue]] = {
    "an overlapping copy within a buffer": (
        lambda writer: writer.copy_buffer(1, 0, 1, 28, 32),
        lambda writer: writer.copy_buffer(1, 0, 1, 32, 32),
    ),
    "an empty copy of a buffer": (
        lambda writer: writer.copy_buffer(1, 0, 2, 0, 0),
        lambda writer: writer.copy_buffer(1, 0, 2, 0, 4),
    ),
    "an overlapping copy within a texture": (copy(3, 3, 3), copy(3, 3, 4)),
    "a copy of several samples": (copy(4, 4, 4), copy(3, 9, 4)),
    "a copy to several samples": (copy(3, 4), copy(3, 9)),
    "a copy to another format": (copy(3, 6), copy(3, 9)),
    "a copy of color to depth": (copy(9, 10), copy(10, 10, 4)),
    "a copy of a compressed texture": (copy(11, 3), copy(9, 3)),
    "a resolve of one sample": (
        lambda writer: writer.resolve_texture(3, 9),
        lambda writer: writer.resolve_texture(4, 9),
    ),
    "a resolve of integers": (
        lambda writer: writer.resolve_texture(8, 6),
        lambda writer: writer.resolve_texture(4, 3),
    ),
    "a resolve of depth": (
        lambda writer: writer.resolve_texture(7, 5),
        lambda writer: writer.resolve_texture(4, 3),
    ),
    "mip levels of depth": (
        lambda writer: writer.generate_mipmaps(5),
        lambda writer: writer.generate_mipmaps(3),
    ),
    "mip levels of integers": (
        lambda writer: writer.generate_mipmaps(6),
        lambda writer: writer.generate_mipmaps(3),
    ),
    "mip levels of a compressed texture": (
        lambda writer: writer.generate_mipmaps(11),
        lambda writer: writer.generate_mipmaps(9),
    ),
    "a read of a compressed texture": (
        lambda writer: writer.read_texture(11, 0, Region(0, 0, 4, 4), False),
        lambda writer: writer.read_texture(9, 0, Region(0, 0, 4, 4), False),
    ),
    "an image of a compressed texture": (
        lambda writer: writer.bind_image(0, 11, 0, -1),
        lambda writer: writer.bind_image(0, 9, 0, -1),
    ),
    "a pass with several numbers of samples": (begin(3, 4), begin(3, 9)),
    "a pass with other samples than its targets": (begin(3, samples=4), begin(4, samples=4)),
    "a pass with one target twice": (begin(3, 3), begin(3, 9)),
    "a pass into a compressed texture": (begin(11), begin(9)),
    "a pass that resolves one sample": (begin(3, resolve=9), begin(4, samples=4, resolve=9)),
    "a pass that resolves integers": (begin(8, samples=4, resolve=6), begin(4, samples=4, resolve=3)),
    "a pass that resolves to another format": (
        begin(4, samples=4, resolve=6),
        begin(4, samples=4, resolve=3),
    ),
    "a pass that resolves to several samples": (
        begin(4, samples=4, resolve=4),
        begin(4, samples=4, resolve=3),
    ),
    "a clear of depth beyond 1": (
        begin(3, depth=DepthAttachment(5, clear=1.5)),
        begin(3, depth=DepthAttachment(5, clear=1.0)),
    ),
    "a clear of stencil beyond 8 bits": (
        begin(3, depth=DepthAttachment(5, clear_stencil=256)),
        begin(3, depth=DepthAttachment(5, clear_stencil=255)),
    ),
    "a clear of stencil that isn't there": (
        begin(3, depth=DepthAttachment(10, clear_stencil=1)),
        begin(3, depth=DepthAttachment(5, clear_stencil=1)),
    ),
    "a depth texture of three dimensions": (
        create(format=Format.D16, kind=TextureKind.D3),
        create(format=Format.D16, kind=TextureKind.D2_ARRAY),
    ),
    "an array of several samples": (
        create(kind=TextureKind.D2_ARRAY, layers=2, samples=4),
        create(samples=4),
    ),
    "levels of several samples": (create(levels=2, samples=4), create(levels=2)),
    "a compressed texture of three dimensions": (
        create(compressed=CompressedFormat.BC1, kind=TextureKind.D3),
        create(compressed=CompressedFormat.BC1),
    ),
    "a compressed texture of several samples": (
        create(compressed=CompressedFormat.BC1, samples=4),
        create(compressed=CompressedFormat.BC1),
    ),
    "a part of a block": (blocks(0, 3), blocks(0, 4)),
    "a program without vertices": (
        lambda writer: writer.create_program(12, replace(PROGRAM, stages=frozenset({rhi.Stage.FRAGMENT}))),
        lambda writer: writer.create_program(12, PROGRAM),
    ),
    "a condition on a counter": (conditional(QueryKind.COUNTER), conditional(QueryKind.OCCLUSION)),
    "a dispatch at an odd place": (
        lambda writer: (
            writer.create_program(12, compute((1, 1, 1))),
            writer.bind_program(12),
            writer.dispatch_indirect(1, 2),
        ),
        lambda writer: (
            writer.create_program(12, compute((1, 1, 1))),
            writer.bind_program(12),
            writer.dispatch_indirect(1, 4),
        ),
    ),
}


def compute(work_group: tuple[int, int, int]) -> rhi.ProgramDescriptor:
    return replace(PROGRAM, stages=frozenset({rhi.Stage.COMPUTE}), work_group=work_group, bindings=())


def saved(issue: Issue, tmp_path: Path) -> Path:
    save(write(issue).stream, tmp_path / "t.zip")
    return tmp_path / "t.zip"


@pytest.mark.parametrize("what", IMPOSSIBLE)
def test_a_trace_with_commands_that_no_device_issues_is_refused_on_load(what: str, tmp_path: Path) -> None:
    wrong, right = IMPOSSIBLE[what]
    with refuses(TRACE_REFERENCE):
        load(saved(wrong, tmp_path))
    check_capabilities(load(saved(right, tmp_path)).stream, WHOLE)


def test_a_texture_that_was_destroyed_is_not_bound_again(tmp_path: Path) -> None:
    def bind_twice(writer: CommandWriter, *, destroyed: int) -> None:
        writer.create_sampler(12, SamplerDescriptor())
        writer.bind_texture(0, 3, 12)
        writer.destroy(destroyed)
        writer.bind_texture(0, 3, 12)

    load(saved(lambda writer: bind_twice(writer, destroyed=9), tmp_path))
    with refuses(TRACE_REFERENCE):
        load(saved(lambda writer: bind_twice(writer, destroyed=3), tmp_path))


def test_a_resource_whose_destruction_failed_can_be_destroyed_again(tmp_path: Path) -> None:
    writer = write(lambda writer: (writer.destroy(1), writer.destroy(1)))
    with refuses(TRACE_REFERENCE):
        load(saved(lambda writer: (writer.destroy(1), writer.destroy(1)), tmp_path))
    writer.stream.failures[len(writer.stream) - 2] = Failure("device-lost", "")
    save(writer.stream, tmp_path / "t.zip")
    assert len(load(tmp_path / "t.zip")) == len(writer.stream)


# -- what a device lacks -------------------------------------------------------------------------------------


def set_states(*states: State) -> Issue:
    """The commands by which a device sets states."""
    cache = StateCache()

    def issue(writer: CommandWriter) -> None:
        with cache.scope(states):
            writer.set_states(cache.flush())

    return issue


LACKING: dict[str, tuple[dict[str, object], Issue, Issue]] = {
    "stencil references per face": (
        {"stencil_per_face": False},
        set_states(rhi.StencilReference(1, 2)),
        set_states(rhi.StencilReference(1, 1)),
    ),
    "stencil masks of reads per face": (
        {"stencil_per_face": False},
        set_states(StencilReadMask(1, 2)),
        set_states(StencilReadMask(1, 1)),
    ),
    "stencil masks of writes per face": (
        {"stencil_per_face": False},
        set_states(StencilWriteMask(1, 2)),
        set_states(StencilWriteMask(1, 1)),
    ),
    "blending per target": (
        {"blend_per_target": False},
        set_states(BlendFunction.ALPHA.at(1)),
        set_states(BlendFunction.ALPHA),
    ),
    "a clamp of depth offsets": (
        {"depth_bias_clamp": False},
        set_states(PolygonOffset(1.0, clamp=3.0)),
        set_states(PolygonOffset(1.0)),
    ),
    "the alpha test": ({"alpha_test": False}, set_states(rhi.AlphaTest.ON), set_states(rhi.CullMode.NONE)),
    "the function of the alpha test": (
        {"alpha_test": False},
        set_states(rhi.AlphaFunction.LESS),
        set_states(rhi.CullMode.NONE),
    ),
    "the reference of the alpha test": (
        {"alpha_test": False},
        set_states(rhi.AlphaReference(0.25)),
        set_states(rhi.CullMode.NONE),
    ),
    "a format of color targets": ({"unrenderable_formats": frozenset({Format.RGBA8UI})}, begin(6), begin(3)),
    "draws": (
        {"draws": False},
        lambda writer: writer.create_program(12, PROGRAM),
        lambda writer: writer.create_program(12, compute((1, 1, 1))),
    ),
    "copies at any byte": (
        {"copy_alignment": 4},
        lambda writer: writer.copy_buffer(1, 2, 2, 0, 4),
        lambda writer: writer.copy_buffer(1, 4, 2, 0, 4),
    ),
    "copies of any size": (
        {"copy_alignment": 4},
        lambda writer: writer.copy_buffer(1, 0, 2, 0, 6),
        lambda writer: writer.copy_buffer(1, 0, 2, 0, 8),
    ),
    "the layers of a cube": (
        {"max_texture_layers": 5},
        create(kind=TextureKind.CUBE, layers=6),
        create(kind=TextureKind.D2_ARRAY, layers=5),
    ),
    "a compressed format": (
        {"compressed_formats": frozenset({CompressedFormat.BC1})},
        create(compressed=CompressedFormat.BC7),
        create(compressed=CompressedFormat.BC1),
    ),
    "a slot": (
        {"max_image_slots": 2},
        lambda w: w.bind_image(2, 3, 0, -1),
        lambda w: w.bind_image(1, 3, 0, -1),
    ),
    "a slot of uniforms": (
        {"max_uniform_slots": 2},
        lambda w: w.bind_uniform(2, 1, 0, 16),
        lambda w: w.bind_uniform(1, 1, 0, 16),
    ),
    "a slot of storage": (
        {"max_storage_slots": 2},
        lambda w: w.bind_storage(2, 1, 0, 16),
        lambda w: w.bind_storage(1, 1, 0, 16),
    ),
    "a slot of textures": (
        {"max_texture_slots": 2},
        lambda w: (w.create_sampler(12, SamplerDescriptor()), w.bind_texture(2, 3, 12)),
        lambda w: (w.create_sampler(12, SamplerDescriptor()), w.bind_texture(1, 3, 12)),
    ),
}


@pytest.mark.parametrize("what", LACKING)
def test_a_trace_that_needs_more_than_the_device_has_is_refused_before_its_replay(
    what: str, tmp_path: Path
) -> None:
    lacking, wrong, right = LACKING[what]
    limits = replace(WHOLE, **lacking)  # type: ignore[arg-type]
    trace = load(saved(wrong, tmp_path))
    check_capabilities(trace.stream, WHOLE)
    with refuses(TRACE_CAPABILITY):
        check_capabilities(trace.stream, limits)
    check_capabilities(load(saved(right, tmp_path)).stream, limits)
