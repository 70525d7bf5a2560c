"""cl without all its culling and caching gives the same bits: what it leaves out is not seen.

That they are the right bits, `test_programs_against_float64` shows.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from nights import rotate_seed

import rhi
from rhi import Device
from rhi.backends.cl.cl_backend import ClBackend
from rhi.backends.cl.raster import batches, draw_tables, launcher
from rhi.backends.cl.raster.draw_state import DrawState
from rhi.backends.cl.raster.merger import MergerKey
from rhi.conformance.programs.generator import make_program, make_theme
from rhi.conformance.programs.runner import run

SEEDS = [
    pytest.param(range(24), id="few"),
    pytest.param(range(24, 1000), id="many", marks=pytest.mark.nightly),
]


@pytest.fixture(scope="module")
def cl() -> Iterator[Device]:
    with rhi.create_device("cl") as device:
        yield device


@pytest.mark.parametrize("seeds", SEEDS)
def test_cl_draws_the_same_bits_without_its_culling_and_caches(
    cl: Device, monkeypatch: pytest.MonkeyPatch, seeds: range
) -> None:
    """Without bounds of depth, pieces, deferred clears and cached tables, results are the same bits."""
    hidden = 0
    with rhi.create_device("cl") as plain:
        for seed in map(rotate_seed, seeds):
            program = make_program(seed, make_theme(seed // 8, cl.capabilities))
            with monkeypatch.context() as patch:
                begin_pass, gather = DrawState.begin_pass, batches.Batch.gather

                def begin_cleared(self: Any, descriptor: Any, begin: Any = begin_pass) -> None:
                    begin(self, descriptor)
                    self.fill_cleared(plain.backend_as(ClBackend).context.queue)

                def gather_mixed(self: Any, *actual: Any, gather: Any = gather) -> None:
                    gather(self, *actual)
                    self.spread()

                patch.setattr(MergerKey, "bounds_depth", property(lambda _: False))
                patch.setattr(DrawState, "begin_pass", begin_cleared)
                patch.setattr(batches.Batch, "gather", gather_mixed)
                expected = run(plain, program)
            with monkeypatch.context() as patch:
                if seed % 2:
                    patch.setattr(draw_tables, "_FIRST_PIECE_GROUPS", 2)
                    patch.setattr(draw_tables, "_PIECE_GROUPS", 8)
                    patch.setattr(launcher, "_SLICE_GROUPS", 16)
                    patch.setattr(launcher, "_FEW_GROUPS", 1)
                actual = run(cl, program)
            for (name, expected_output), (_, output) in zip(expected, actual, strict=True):
                np.testing.assert_array_equal(expected_output, output, name)
                hidden += int((expected_output == 0).sum()) if "quer" in name else 0
    assert hidden > len(seeds) / 4
