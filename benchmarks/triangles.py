"""Exactness of triangles: coverage, depth and varyings of random triangles against float64.

Run `python benchmarks/triangles.py`; `--triangles 1000000` takes some minutes. The families are those of
`rhi.conformance.triangles`, drawn in the whole view and, where they are cut, in the middle of a viewport as large
as the device's textures may be, at most 16,384 texels. For each family: the triangles, the texels drawn, the texels
that are wrong (farther than 1/256 texel from every edge and cut), and the worst errors: of depth against float64 and
beyond the corners' depths, of weights likewise.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Final

import numpy as np

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.lab.comparison import Record
from rhi.conformance.triangles import BATCH, CELL, CUT, WHOLE, examine

_MAX_VIEWPORT: Final = 16384


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the row of each family in each viewport."""
    with rhi.create_device(arguments.backend) as device:
        largest = float(min(_MAX_VIEWPORT, device.capabilities.max_texture_size))
        cases = [(family, float(CELL)) for family in (*CUT, *WHOLE)] + [(family, largest) for family in CUT]
        batches = -(-arguments.triangles // (BATCH * len(cases)))
        for family, wide in cases:
            results = [examine(device, family, arguments.seed + number, wide) for number in range(batches)]
            errors = ("depth_error", "depth_beyond", "weight_error", "weight_beyond")
            yield {
                "family": family.__name__,
                "viewport": round(wide),
                "triangles": batches * BATCH,
                "texels": sum(result.drawn for result in results),
                "wrong": sum(int(np.sum(result.wrong)) for result in results),
                **{name: f"{max(getattr(result, name) for result in results):.1e}" for name in errors},
            }


OPTIONS: Final = (
    options.option("--backend", "the device", "cl"),
    options.count("--triangles", "number of triangles", 100_000),
    options.count("--seed", "first seed", 0, minimum=0),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
