"""The Python part of the output merger: which states are compiled into a pipeline, and which are data of a
draw.

- `make_key` collects everything that affects the generated code; equal keys share a compiled pipeline. It
  normalises: targets that aren't written, tests that always pass and the like leave no trace, so few
  pipelines are built.
- `make_state` packs the other states into `STATE_WORDS` words: factors, references and masks may change from
  draw to draw.
- `MergerKey.defines` is the text in front of `kernels/merger.cl` for one key, whose comments document the use
  of its functions. `general_defines` is that for kernels which read the key as data, `MergerKey.words`.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, Final

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from numpy.typing import NDArray

from rhi.backends.cl.raster.kernel_text import declare_struct
from rhi.contract import states
from rhi.contract.backend import SAMPLE_COUNTS
from rhi.contract.descriptors import ProgramDescriptor
from rhi.contract.formats import ChannelKind, Format

_COMPARISONS: Final = {
    "never": 0,
    "less": 1,
    "equal": 2,
    "less_equal": 3,
    "greater": 4,
    "not_equal": 5,
    "greater_equal": 6,
    "always": 7,
}
"""Comparisons as bits: 1 passes less, 2 equal, 4 greater."""
_ALWAYS: Final = _COMPARISONS["always"]
_ORDERED: Final = [_COMPARISONS[name] for name in ("less", "less_equal", "greater", "greater_equal")]
_FLOAT_BITS: Final = 32
_KINDS: Final = {kind: number for number, kind in enumerate(ChannelKind)}
_STENCIL_OPERATIONS: Final = {operation: number for number, operation in enumerate(states.StencilOperation)}
_BLEND_OPERATIONS: Final = {operation: number for number, operation in enumerate(states.BlendOperation)}
_FACTORS: Final = {
    states.BlendFactor.ZERO: 0,
    states.BlendFactor.SOURCE_COLOR: 1,
    states.BlendFactor.SOURCE_ALPHA: 2,
    states.BlendFactor.DESTINATION_COLOR: 3,
    states.BlendFactor.DESTINATION_ALPHA: 4,
    states.BlendFactor.CONSTANT: 5,
    states.BlendFactor.SOURCE_ALPHA_SATURATE: 6,
    states.BlendFactor.ONE: 8,
    states.BlendFactor.ONE_MINUS_SOURCE_COLOR: 9,
    states.BlendFactor.ONE_MINUS_SOURCE_ALPHA: 10,
    states.BlendFactor.ONE_MINUS_DESTINATION_COLOR: 11,
    states.BlendFactor.ONE_MINUS_DESTINATION_ALPHA: 12,
    states.BlendFactor.ONE_MINUS_CONSTANT: 13,
}
"""Blend factors as numbers. Adding 8 means one minus the factor."""

_ALPHA_STATE: Final = 0  # comparison, reference
_BLEND_STATE: Final = 2  # the constant color
_STENCIL_STATE: Final = 6  # two words for the front, two for the back
_COLOR_STATE: Final = 10  # for each target: blend function, write mask of a texel's 4 words
_COLOR_WORDS: Final = 5
STATE_WORDS: Final = _COLOR_STATE + _COLOR_WORDS * states.MAX_TARGETS
MAX_SAMPLES: Final = max(SAMPLE_COUNTS)
_MERGER_FIELDS: Final = (
    "samples",
    "color_count",
    "has_depth",
    "depth_bits",
    "depth_comparison",
    "depth_writes",
    "has_stencil",
    "alpha_test",
    "alpha_to_coverage",
    "test_order",
    "shades",
    "gives_depth",
)
MERGER_STRUCT: Final = np.dtype(
    [(name, "i4") for name in _MERGER_FIELDS] + [("colors", "i4", (states.MAX_TARGETS, 6))]
)
"""The states of a batch that kernels are compiled for, as data. A color: location, components, channels,
bits, kind, blends."""


class TestOrder(enum.Enum):
    """The moment at which depth and stencil are tested and written.

    EARLY: before shading. SPLIT: tested before shading, so that hidden fragments aren't shaded, and written
    after it for the fragments that it didn't discard. LATE: tested and written after shading, since shading
    computes the depth or has effects for fragments that fail.
    """

    EARLY = 0
    SPLIT = 1
    LATE = 2

    __test__ = False  # else pytest would collect it


@dataclass(frozen=True, slots=True)
class ColorKey:
    """A color target that is written.

    Attributes:
        location: number of the attachment.
        components: number of components that the fragment stage outputs.
        channels, bits, kind: number of channels of a texel; size and kind of each.
        blends: whether blending is on.
    """

    location: int
    components: int
    channels: int
    bits: int
    kind: ChannelKind
    blends: bool


@dataclass(frozen=True)
class MergerKey:
    """The output merger's part of a pipeline's key.

    Attributes:
        colors: the color targets that are written.
        depth_bits: 16 or 24, 32 for floats; 0 if depth is neither tested nor written.
        depth_comparison: the depth comparison, as a number of `_COMPARISONS`.
        depth_writes: whether the depth of fragments that pass is written.
        has_stencil: whether the kernel takes the stencil plane.
        order: when the tests are executed.
        shades: whether the fragment stage has to be executed.
        gives_depth: whether the stage outputs a depth.
        output_words: number of words of the stage's outputs, four for each location.
    """

    colors: tuple[ColorKey, ...]
    depth_bits: int
    depth_comparison: int
    depth_writes: bool
    has_stencil: bool
    alpha_test: bool
    alpha_to_coverage: bool
    samples: int
    order: TestOrder
    shades: bool
    gives_depth: bool
    output_words: int

    @property
    def has_depth(self) -> bool:
        """True if the kernel takes the depth plane."""
        return self.depth_bits > 0

    @property
    def caches_depth(self) -> bool:
        """True if the raster kernel stages a tile's depth: with one sample and no stencil."""
        return self.has_depth and not self.has_stencil and self.samples == 1

    @property
    def bounds_depth(self) -> bool:
        """True if the raster kernel also has bounds of depth, behind which the test fails.

        The test has to come before any shading."""
        comes_first = self.order is not TestOrder.LATE or not self.shades
        return self.caches_depth and self.depth_comparison in _ORDERED and comes_first

    @property
    def depth_step(self) -> float:
        """Difference between consecutive depths of the target's format; 0 for floats."""
        return 1 / ((1 << self.depth_bits) - 1) if 0 < self.depth_bits < _FLOAT_BITS else 0.0

    @cached_property
    def fields(self) -> NDArray[Any]:
        """The key as a `MERGER_STRUCT`, shape ()."""
        fields = np.zeros((), MERGER_STRUCT)
        for name in _MERGER_FIELDS:
            fields[name] = getattr(self, name, 0)
        fields["color_count"], fields["test_order"] = len(self.colors), self.order.value
        for index, color in enumerate(self.colors):
            fields["colors"][index] = (
                color.location,
                color.components,
                color.channels,
                color.bits,
                _KINDS[color.kind],
                color.blends,
            )
        return fields

    @property
    def words(self) -> bytes:
        """The key as data; every batch is given it."""
        return self.fields.tobytes()

    def defines(self) -> str:
        """Return the macros that `kernels/merger.cl` is compiled with."""
        rows = " ".join(
            f"X({index}, {', '.join(map(str, color))})"
            for index, color in enumerate(self.fields["colors"][: len(self.colors)].tolist())
        )
        fields = {name.upper(): self.fields[name] for name in _MERGER_FIELDS}
        return _define(fields, self.samples, len(self.colors), self.output_words, rows)


def general_defines(output_words: int) -> str:
    """Return the macros that `kernels/merger.cl` is compiled with for all keys of a program.

    `output_words`: as in a key.
    """
    colors = ", ".join(f"targets->merger->colors[place][{field}]" for field in range(6))
    fields = {name.upper(): f"(targets->merger->{name})" for name in _MERGER_FIELDS}
    rows = f"for (int place = 0; place < COLOR_COUNT; ++place) {{ X(place, {colors}) }}"
    return _define(fields, MAX_SAMPLES, states.MAX_TARGETS, output_words, rows)


def _define(fields: Mapping[str, object], samples: int, colors: int, output_words: int, rows: str) -> str:
    sizes = {
        "MAX_SAMPLES": samples,
        "MAX_COLORS": colors,
        "OUTPUT_WORDS": output_words,
        "COLOR_TARGETS(X)": rows,
    }
    defines = "".join(f"#define {name} {value}\n" for name, value in {**fields, **sizes}.items())
    return declare_struct("Merger", MERGER_STRUCT) + _constants() + defines


def make_key(
    program: ProgramDescriptor,
    values: Mapping[type, Any],
    colors: Sequence[Format],
    depth: Format | None,
    samples: int,
) -> MergerKey:
    """Return the key of a program's pipeline for these states and targets.

    Args:
        program: a program that draws.
        values: the value of each state type; a tuple of `MAX_TARGETS` for those of `PER_TARGET`.
        colors: the formats of the color targets, by location.
        depth: the format of the depth target, if there is one.
        samples: number of samples of all targets.
    """
    outputs = {output.location: output for output in program.outputs}
    first = outputs.get(0)
    has_alpha = first is not None and first.kind == "float" and first.components == 4
    alpha_test = has_alpha and values[states.AlphaTest] is states.AlphaTest.ON
    alpha_to_coverage = (
        has_alpha and samples > 1 and values[states.AlphaToCoverage] is states.AlphaToCoverage.ON
    )
    keys = tuple(
        ColorKey(
            location,
            outputs[location].components,
            format.channels,
            format.channel_bits[0],
            format.kind,
            not format.is_integer and not values[states.BlendFunction][location].is_off,
        )
        for location, format in enumerate(colors)
        if location in outputs
        and any(_written_channels(values[states.ColorWrite][location])[: format.channels])
    )
    tests = values[states.DepthTest] is states.DepthTest.ON
    passes = _COMPARISONS[values[states.DepthFunction].value] if tests else _ALWAYS
    writes = depth is not None and values[states.DepthWrite] is states.DepthWrite.ON
    if depth is None or (passes == _ALWAYS and not writes):
        depth_bits = 0
        passes = _ALWAYS
        writes = False
    else:
        depth_bits = depth.depth_steps.bit_length() or _FLOAT_BITS
    stencil = depth is not None and depth.has_stencil and values[states.StencilTest] is states.StencilTest.ON
    drops = program.discards or alpha_test or alpha_to_coverage
    gives_depth = program.writes_depth and not program.early_depth
    order = TestOrder.EARLY
    if not program.early_depth:
        if gives_depth or program.writes_memory or (drops and stencil):
            order = TestOrder.LATE
        elif drops:
            order = TestOrder.SPLIT
    return MergerKey(
        colors=keys,
        depth_bits=depth_bits,
        depth_comparison=passes,
        depth_writes=writes,
        has_stencil=stencil,
        alpha_test=alpha_test,
        alpha_to_coverage=alpha_to_coverage,
        samples=samples,
        order=order,
        shades=bool(keys) or drops or program.writes_memory or (gives_depth and depth_bits > 0),
        gives_depth=program.writes_depth,
        output_words=4 * max([0, *outputs]) + 4,
    )


def make_state(values: Mapping[type, Any], colors: Sequence[Format]) -> NDArray[np.uint32]:
    """Return a draw's state block, (STATE_WORDS,). Arguments as for `make_key`."""
    state = np.zeros(STATE_WORDS, np.uint32)
    numbers = state.view(np.float32)
    state[_ALPHA_STATE] = _COMPARISONS[values[states.AlphaFunction].value]
    numbers[_ALPHA_STATE + 1] = values[states.AlphaReference].value
    constant = values[states.BlendColor]
    numbers[_BLEND_STATE : _BLEND_STATE + 4] = constant.red, constant.green, constant.blue, constant.alpha
    for index, side in enumerate((values[states.StencilFront], values[states.StencilBack])):
        codes = [
            _STENCIL_OPERATIONS[operation]
            for operation in (side.stencil_fail, side.depth_fail, side.both_pass)
        ]
        state[_STENCIL_STATE + 2 * index] = (
            _COMPARISONS[side.function.value] | codes[0] << 4 | codes[1] << 8 | codes[2] << 12
        )
        masks = (
            values[states.StencilReference],
            values[states.StencilReadMask],
            values[states.StencilWriteMask],
        )
        reference, read, write = ((mask.front, mask.back)[index] for mask in masks)
        state[_STENCIL_STATE + 2 * index + 1] = reference | read << 8 | write << 16
    for location, format in enumerate(colors):
        index = _COLOR_STATE + _COLOR_WORDS * location
        state[index] = _pack_function(values[states.BlendFunction][location])
        mask, start = 0, 0
        for bits, written in zip(
            format.channel_bits, _written_channels(values[states.ColorWrite][location]), strict=False
        ):
            mask |= ((1 << bits) - 1) << start if written else 0
            start += bits
        state[index + 1 : index + 5] = np.frombuffer(mask.to_bytes(16, "little"), np.uint32)
    return state


def _written_channels(write: states.ColorWrite) -> tuple[bool, bool, bool, bool]:
    return write.red, write.green, write.blue, write.alpha


def _pack_function(function: states.BlendFunction) -> int:
    """Pack source factor, destination factor and operation of color, then of alpha, in 4 bits each."""
    parts = (
        _FACTORS[function.source],
        _FACTORS[function.destination],
        _BLEND_OPERATIONS[function.operation],
        _FACTORS[function.source_alpha or function.source],
        _FACTORS[function.destination_alpha or function.destination],
        _BLEND_OPERATIONS[function.operation_alpha or function.operation],
    )
    return sum(part << 4 * index for index, part in enumerate(parts))


@cache
def _constants() -> str:
    """Return the macros that all keys share: the tables above under the kernels' names."""
    numbers: dict[str, object] = {f"KIND_{kind.name}": number for kind, number in _KINDS.items()}
    numbers |= {f"STENCIL_{operation.name}": number for operation, number in _STENCIL_OPERATIONS.items()}
    numbers |= {f"OPERATION_{operation.name}": number for operation, number in _BLEND_OPERATIONS.items()}
    numbers |= {f"FACTOR_{factor.name}": number for factor, number in _FACTORS.items()}
    numbers |= {f"TEST_{order.name}": order.value for order in TestOrder}
    numbers |= {
        "ALPHA_STATE": _ALPHA_STATE,
        "BLEND_STATE": _BLEND_STATE,
        "STENCIL_STATE": _STENCIL_STATE,
        "COLOR_STATE(location)": f"({_COLOR_STATE} + {_COLOR_WORDS} * (location))",
        # The powers of sRGB's curve: x^(5/12) as a polynomial in x^(1/4), u^0.4 as one in u^(1/2). Near 0,
        # where no polynomial approximates them, the curve is linear.
        "ENCODE_SRGB(x)": _fit(lambda q: q ** (5 / 3), 0.0031308**0.25, 7),
        "DECODE_SRGB(x)": _fit(lambda root: root**0.8, ((0.04045 + 0.055) / 1.055) ** 0.5, 7),
    }
    return "".join(f"#define {name} {value}\n" for name, value in numbers.items())


def _fit(function: Callable[[NDArray[Any]], NDArray[Any]], start: float, degree: int) -> str:
    """Return OpenCL C of a polynomial in x that approximates `function` between `start` and 1."""
    chebyshev = Chebyshev.interpolate(function, degree, domain=[start, 1.0])
    *lower, highest = chebyshev.convert(kind=Polynomial, domain=[-1, 1], window=[-1, 1]).coef.tolist()
    text = f"(float16)({highest!r}f)"
    for coefficient in reversed(lower):
        text = f"fma({text}, x, (float16)({coefficient!r}f))"
    return text
