"""Where llvmpipe may differ from float64, and the known faults of drivers and backends, by name.

docs/backends-gl.md and docs/backends-cl.md describe each. Here are the draws that meet it, and the smallest
program that shows it.
"""

from __future__ import annotations

from typing import Final

from rhi import AlphaTest, BlendFactor, BlendFunction, CullMode, Format, Primitive, Scissor, State
from rhi.conformance.programs import Effect, Fault, Program, Tolerances
from rhi.conformance.programs.interpreter import merge_states
from rhi.conformance.programs.model import Draw, Image, Part, Pass, ShaderKind, Shape, Subresource
from rhi.contract.formats import ChannelKind


def _samples(program: Program, step: Pass) -> int:
    subresource = step.colors[0] if step.colors else step.depth
    assert subresource is not None
    return program.images[subresource.image].samples


def _spills(program: Program, step: Pass, draw: Draw, _: int) -> bool:
    return _samples(program, step) > 1


def _reruns(program: Program, step: Pass, draw: Draw, _: int) -> bool:
    return _samples(program, step) > 1 and draw.shader in (ShaderKind.COUNT, ShaderKind.COUNT_EARLY)


def _discards_early(_: Program, __: Pass, draw: Draw, ___: int) -> bool:
    if draw.shader is ShaderKind.DISCARD_EARLY:
        return True
    return draw.shader is ShaderKind.COUNT_EARLY and merge_states(draw)[AlphaTest] is AlphaTest.ON


def _leaves_factors_unclamped(program: Program, step: Pass, draw: Draw, target: int) -> bool:
    format = program.images[step.colors[target].image].format
    function = merge_states(draw)[BlendFunction][target]
    factors = (function.source, function.destination, function.source_alpha, function.destination_alpha)
    inverts = any(factor is not None and factor.name.startswith("ONE_MINUS") for factor in factors)
    return format.kind is ChannelKind.SNORM and inverts


FAULTS: Final = (
    Fault("several samples reach a texel beyond the scissor", Effect.SPILL, _spills),
    Fault("several samples run fragments of clipped triangles more than once", Effect.RERUN, _reruns),
    Fault("queries don't count what is discarded after early tests", Effect.COUNT, _discards_early),
    Fault("factors 1 - x of signed targets aren't clamped", Effect.COLOR, _leaves_factors_unclamped),
)

LLVMPIPE: Final = Tolerances(
    blends_in_format=True,
    signed_steps=1.0,
    encode_srgb=1.0,
    decode_srgb=1.5e-3,
    clip_margin=2.0,
    mip_steps=1.0,
    faults=FAULTS,
)

SPILL, RERUN, EARLY, SIGNED = FAULTS
_BOX = ((2.0, 2.0), (2.0, 6.0), (6.0, 6.0), (6.0, 2.0))
_SHAPE = Shape(Primitive.QUADS, tuple((x, y, 0.25, 1.0, 0.5, 0.25, 1.0, 0.5) for x, y in _BOX))


_CLIPPED_SHAPE = Shape(
    Primitive.TRIANGLES,
    tuple((x, y, 0.25, 1.0, 0.5, 0.25, 1.0, 0.5) for x, y in ((-4.0, 6.0), (3.0, 6.5), (11.5, 0.0))),
)


def _draw(
    format: Format,
    samples: int,
    shader: ShaderKind,
    *states: State,
    query: int | None = None,
    shape: Shape = _SHAPE,
) -> Program:
    """Return a program that draws a shape once."""
    draw = Draw(shader, 0, (Part(0, shape.elements),), (8, 8), (CullMode.NONE, *states), query=query)
    step = Pass((Subresource(0),), None, (draw,), ((0.75, -0.5, 0.25, 0.5),))
    return Program((Image((8, 8), format, samples=samples),), (shape,), (step,), 1)


SMALLEST: Final = {
    SPILL: _draw(Format.RGBA8, 4, ShaderKind.FLAT, Scissor(3, 3, 4, 4)),
    RERUN: _draw(Format.RGBA8, 4, ShaderKind.COUNT, shape=_CLIPPED_SHAPE),
    EARLY: _draw(Format.RGBA8, 1, ShaderKind.DISCARD_EARLY, query=0),
    SIGNED: _draw(
        Format.RGBA8_SNORM, 1, ShaderKind.FLAT, BlendFunction(BlendFactor.ONE_MINUS_DESTINATION_COLOR)
    ),
}
"""The smallest program that shows each fault of llvmpipe."""

CL: Final = Tolerances()
"""The OpenCL backend has no known fault."""
