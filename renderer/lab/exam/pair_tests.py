"""Makes all tests of light culling for pairs of a light and a cell on a device, at once."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.lights.culling.cells import CellGrid
from rhi import Device
from rhi.shading import Shader, Struct, uint

GROUP: Final = 64
"""The work-group of a shader of tests."""


def run_tests(
    device: Device, shader: type[Shader], tests: Iterable[str], grid: CellGrid, pair: type[Struct], rows: NDArray[Any]
) -> dict[str, NDArray[np.bool_]]:
    """Return what each of `tests` keeps of rows (n,) of `pair`.

    Args:
        shader: stores in `kept` a bit for each test, in their order, for each of `pairs`.
    """
    buffers = (device.uniform(grid), device.storage(pair, rows), device.storage(uint, len(rows)))
    uniform, pairs, kept = buffers
    program: Any = device.program(shader)
    device.dispatch(program, -(-len(rows) // GROUP), grid=uniform, pairs=pairs, kept=kept)
    bits = kept.read()
    for buffer in buffers:
        buffer.destroy()
    return {name: (bits >> index & 1).astype(bool) for index, name in enumerate(tests)}
