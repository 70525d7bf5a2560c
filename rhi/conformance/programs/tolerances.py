"""The choices that a device has, and the known faults of a driver."""

from __future__ import annotations

import enum
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from rhi.conformance.programs.model import Draw, Pass, Program


class Effect(enum.Flag):
    """The part of a draw's results that a driver's fault makes unknown: the colors of one target, the answer
    of its query, what it covers, the depths it writes, whether it reaches a texel further to the left and
    upwards than it may (SPILL), or how often the fragments of points, and of triangles that the view cuts,
    run (RERUN)."""

    COLOR = enum.auto()
    COUNT = enum.auto()
    COVERAGE = enum.auto()
    DEPTH = enum.auto()
    SPILL = enum.auto()
    RERUN = enum.auto()


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault of a driver, by name: the draws that meet it, and what it makes unknown.

    `meets` takes the program, the pass, the draw and the number of a color target; an effect on coverage,
    depth or counts is asked for with target 0.
    """

    name: str
    effect: Effect
    meets: Callable[[Program, Pass, Draw, int], bool]


@dataclass(frozen=True, slots=True)
class Tolerances:
    """The choices that a device has.

    Attributes:
        blends_in_format: whether the operands and products of blending may be rounded to the target's
            precision, and those of float targets to 2^-22.
        signed_steps: how many stored numbers an operand of blending of a signed target may be off, beside
            rounding.
        encode_srgb: how many stored numbers the curve to sRGB may be off, beside rounding.
        decode_srgb: how much the linear value of a stored sRGB number may be off.
        clip_margin: by how many subtexels an edge of a primitive that reaches beyond the viewport may move.
        depth_steps: how many steps of a fixed-point depth format a conversion may be off, beside rounding.
        mip_steps: how many stored numbers a generated mip level may be off, beside rounding.
        faults: known faults of the driver.
    """

    blends_in_format: bool = False
    signed_steps: float = 0.0
    encode_srgb: float = 0.01
    decode_srgb: float = 4e-6
    clip_margin: float = 0.0
    depth_steps: float = 0.0
    mip_steps: float = 0.0
    faults: tuple[Fault, ...] = ()


EXACT: Final = Tolerances()
