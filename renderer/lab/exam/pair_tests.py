"""Runs all tests of light culling for pairs of a light and a cell on a device, at once."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.lights.culling.cells import ClusterGrid
from rhi import Device
from rhi.shading import Shader, Struct, uint

GROUP: Final = 64
"""The work-group size of test shaders."""


def run_tests(
    device: Device,
    shader: type[Shader],
    tests: Iterable[str],
    grid: ClusterGrid,
    pair: type[Struct],
    pair_rows: NDArray[Any],
) -> dict[str, NDArray[np.bool_]]:
    """The pairs `rows` (n,) of type `pair` that pass each of `tests`.

    Args:
        shader: stores in `passed` a bit for each test, in their order, for each of `pairs`.
    """
    buffers = (device.uniform(grid), device.storage(pair, pair_rows), device.storage(uint, len(pair_rows)))
    uniform, pairs, passed = buffers
    program: Any = device.program(shader)
    device.dispatch(program, -(-len(pair_rows) // GROUP), grid=uniform, pairs=pairs, passed=passed)
    bits = passed.read()
    for buffer in buffers:
        buffer.destroy()
    return {name: (bits >> index & 1).astype(bool) for index, name in enumerate(tests)}
