"""Texture samples as probes: where they are taken, what float64 makes of them, and shaders that take them.

Samples lie anywhere in and around a small texture of random texels, at any of its levels and between them. Errors are
counted in units of 2^-23, float32's step at 1, of values from 0 to 1.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.contract.formats import Format
from rhi.shading import HostTexture, Precision, Shader, Storage, StorageRW, Texture2D, global_id, vec4
from rhi.shading.language.builtins import ErrorBound

__rhi_internal__ = True

Array = NDArray[Any]

WORK_GROUP: Final = 64
TURNS: Final = 64
"""How many samples an invocation takes where they are timed."""
UNIT: Final = 2.0**-23
_SIZE: Final = 64  # texels along an edge


class Once(Shader):
    """A sample for each invocation."""

    work_group = (WORK_GROUP,)
    image: Texture2D
    at: Storage[vec4]
    results: StorageRW[vec4]

    def compute(self) -> None:
        row = global_id().x
        at = self.at[row]
        self.results[row] = self.image.sample_lod(at.xy, at.z)


class Often(Once):
    """The sum of `TURNS` samples for each."""

    def compute(self) -> None:
        row = global_id().x
        total = vec4(0.0)
        for turn in range(TURNS):
            at = self.at[row * TURNS + turn]
            total += self.image.sample_lod(at.xy, at.z)
        self.results[row] = total


class Idle(Once):
    """The same without samples: reading where they would be."""

    def compute(self) -> None:
        row = global_id().x
        total = self.image.sample_lod(vec4(0.0).xy, 0.0)
        for turn in range(TURNS):
            total += self.at[row * TURNS + turn]
        self.results[row] = total


class FastOnce(Once):
    """With shorter curves."""

    precision = Precision.FAST


class FastOften(Often):
    """With shorter curves."""

    precision = Precision.FAST


class FastIdle(Idle):
    """With shorter curves."""

    precision = Precision.FAST


SHADERS: Final = {Precision.EXACT: (Once, Often, Idle), Precision.FAST: (FastOnce, FastOften, FastIdle)}


@dataclass(frozen=True, eq=False)
class SampleProbe:
    """Trilinear samples of a texture of this format; `error` in units as `count_units` counts them."""

    format: Format
    error: ErrorBound

    name = "sample_lod"

    def __str__(self) -> str:
        return f"{self.name}({self.format.name})"

    @cached_property
    def texture(self) -> HostTexture:
        """Random texels, all levels."""
        rng, levels = np.random.default_rng(0), []
        for level in range(_SIZE.bit_length()):
            shape = (_SIZE >> level, _SIZE >> level, self.format.channels)
            if self.format.dtype.kind == "f":
                levels.append(rng.uniform(0, 1, shape).astype(self.format.dtype))
            else:
                levels.append(rng.integers(0, 256, shape, self.format.dtype))
        return HostTexture(levels, self.format)

    def sample(self, count: int) -> Array:
        """(count, 4) float32: u, v and level, the last one unused. Every other sample is of a whole level."""
        rng = np.random.default_rng(1)
        given = np.zeros((count, 4), np.float32)
        given[:, :2] = rng.uniform(-1, 2, (count, 2))
        given[:, 2] = rng.uniform(0, _SIZE.bit_length() - 1, count)
        given[::2, 2] = np.rint(given[::2, 2])
        return given

    def evaluate(self, given: Array, dtype: type[np.floating[Any]]) -> Array:
        """(n, 4) samples on NumPy in float32 or float64."""
        u, v, lod, _ = given.T.astype(dtype)
        return np.stack(np.broadcast_arrays(*self.texture.sample(dtype, u, v, dtype(0), lod)), axis=1)

    def count_units(self, given: Array, results: Array) -> Array:
        """(n,) how far the worst component of each sample lies from float64's."""
        worst: Array = np.abs(results - self.evaluate(given, np.float64)).max(axis=1)
        return worst / UNIT


_WHOLE: Final = ErrorBound(glsl=32, exact=32, fast=32, numpy=32)  # of which the coordinates' own rounding is most
_SRGB_CURVE: Final = 11_000  # within 1.3e-3, a third of a stored step

SAMPLE_PROBES: Final = (
    SampleProbe(Format.RGBA8, replace(_WHOLE, glsl=1 << 16)),  # weights of 8 bits: 2/256
    SampleProbe(Format.RGBA8_SRGB, replace(_WHOLE, glsl=_SRGB_CURVE, fast=_SRGB_CURVE)),
    SampleProbe(Format.RGBA16F, _WHOLE),
    SampleProbe(Format.R32F, _WHOLE),
)
