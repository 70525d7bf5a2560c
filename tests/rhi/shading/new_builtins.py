"""Two built-ins that only a row of the table defines, and a shader that calls them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rhi.shading import Shader, Storage, StorageRW, global_id, vec3
from rhi.shading.language.builtins import BUILTINS, _row

hermite: Any = _row(
    "hermite",
    "F(F)",
    glsl="({0} * {0} * (3.0 - 2.0 * {0}))",
    wgsl="({0} * {0} * (3.0 - 2.0 * {0}))",
    lanes="(t := a * a) * (3.0 - 2.0 * a)",
)
hypotenuse: Any = _row(
    "hypotenuse",
    "F(F,F)",
    glsl="sqrt({0} * {0} + {1} * {1})",
    wgsl="sqrt({0} * {0} + {1} * {1})",
    opencl="hypot({0}, {1})",
    numpy="np.hypot({0}, {1})",
)
VALUES = np.linspace(0, 1, 32).astype("f4")


class UsesNewRows(Shader):
    work_group = (32,)
    a: Storage[float]
    out: StorageRW[vec3]

    def compute(self) -> None:
        i = global_id().x
        v = vec3(self.a[i], self.a[31 - i], 0.5)
        self.out[i] = hermite(v) + hypotenuse(v, v.yzx)


def add_new_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    """Add the two rows to the table until the test ends."""
    for row in (hermite, hypotenuse):
        monkeypatch.setitem(BUILTINS, row.name, row)


def expected_results() -> np.ndarray[Any, Any]:
    v = np.stack([VALUES, VALUES[::-1], np.full(32, 0.5)], axis=1)
    results: np.ndarray[Any, Any] = v * v * (3 - 2 * v) + np.hypot(v, np.roll(v, -1, axis=1))
    return results
