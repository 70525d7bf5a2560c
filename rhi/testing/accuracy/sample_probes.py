"""Probes of texture sampling: coordinates, reference results in float64, and shaders that sample.

Samples lie anywhere in and around a small texture of random texels, at its mip levels and between them.
Values are from 0 to 1; errors are counted in units of 2^-23, the spacing of float32 at 1.
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
from rhi.testing.accuracy.probes import WORK_GROUP, with_precision

Array = NDArray[Any]

ITERATIONS: Final = 64
"""Number of samples per invocation in the timed shaders."""
UNIT: Final = 2.0**-23
"""The unit of errors."""
_SIZE: Final = 64  # texels along an edge


class Single(Shader):
    """A shader that takes one sample per invocation."""

    work_group = (WORK_GROUP,)
    image: Texture2D
    coordinates: Storage[vec4]
    results: StorageRW[vec4]

    def compute(self) -> None:
        row = global_id().x
        coordinates = self.coordinates[row]
        self.results[row] = self.image.sample_lod(coordinates.xy, coordinates.z)


class Repeated(Single):
    """A shader that sums `ITERATIONS` samples per invocation."""

    def compute(self) -> None:
        row = global_id().x
        total = vec4(0.0)
        for turn in range(ITERATIONS):
            coordinates = self.coordinates[row * ITERATIONS + turn]
            total += self.image.sample_lod(coordinates.xy, coordinates.z)
        self.results[row] = total


class Baseline(Single):
    """A shader that sums the coordinates of `ITERATIONS` samples instead, to measure the time of reading
    them."""

    def compute(self) -> None:
        row = global_id().x
        total = self.image.sample_lod(vec4(0.0).xy, 0.0)
        for turn in range(ITERATIONS):
            total += self.coordinates[row * ITERATIONS + turn]
        self.results[row] = total


SHADERS: Final = {
    precision: tuple(with_precision(shader, precision) for shader in (Single, Repeated, Baseline))
    for precision in Precision
}
"""`Single`, `Repeated` and `Baseline` by their precision."""


@dataclass(frozen=True, eq=False)
class SampleProbe:
    """Trilinear samples of a texture of one format; `error` is in the units of `count_units`."""

    format: Format
    error: ErrorBound

    name = "sample_lod"

    def __str__(self) -> str:
        return f"{self.name}({self.format.name})"

    @cached_property
    def texture(self) -> HostTexture:
        """A texture of random texels with all mip levels."""
        rng, levels = np.random.default_rng(0), []
        for level in range(_SIZE.bit_length()):
            shape = (_SIZE >> level, _SIZE >> level, self.format.channels)
            if self.format.dtype.kind == "f":
                levels.append(rng.uniform(0, 1, shape).astype(self.format.dtype))
            else:
                levels.append(rng.integers(0, 256, shape, self.format.dtype))
        return HostTexture(levels, self.format)

    def sample(self, count: int) -> Array:
        """Generate coordinates (count, 4) float32: u, v, level, and an unused one; every other level is
        whole."""
        rng = np.random.default_rng(1)
        inputs = np.zeros((count, 4), np.float32)
        inputs[:, :2] = rng.uniform(-1, 2, (count, 2))
        inputs[:, 2] = rng.uniform(0, _SIZE.bit_length() - 1, count)
        inputs[::2, 2] = np.rint(inputs[::2, 2])
        return inputs

    def evaluate(self, inputs: Array, dtype: type[np.floating[Any]]) -> Array:
        """Sample on NumPy in float32 or float64; returns (n, 4)."""
        u, v, lod, _ = inputs.T.astype(dtype)
        return np.stack(np.broadcast_arrays(*self.texture.sample(dtype, u, v, dtype(0), lod)), axis=1)

    def count_units(self, inputs: Array, results: Array) -> Array:
        """Return the largest error of each sample's components, (n,), relative to float64."""
        worst: Array = np.abs(results - self.evaluate(inputs, np.float64)).max(axis=1)
        return worst / UNIT


_FILTER_BOUND: Final = ErrorBound(
    glsl=32, exact=32, fast=32, numpy=32
)  # mostly the rounding of the coordinates
_SRGB_CURVE: Final = 11_000  # within 1.3e-3, a third of a stored step

SAMPLE_PROBES: Final = (
    SampleProbe(Format.RGBA8, replace(_FILTER_BOUND, glsl=1 << 16)),  # weights of 8 bits: 2/256
    SampleProbe(Format.RGBA8_SRGB, replace(_FILTER_BOUND, glsl=_SRGB_CURVE, fast=_SRGB_CURVE)),
    SampleProbe(Format.RGBA16F, _FILTER_BOUND),
    SampleProbe(Format.R32F, _FILTER_BOUND),
)
