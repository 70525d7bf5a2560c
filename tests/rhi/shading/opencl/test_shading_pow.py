"""The pow of lanes, which is computed in float64: its error, and C's rules for special arguments."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from opencl_runner import run_opencl

from rhi.shading import Shader, Storage, StorageRW, global_id, pow

COUNT = 1 << 14
SPECIAL = np.array(
    [0, -0.0, 1, -1, 2, -2, 0.5, -0.5, 3, 2.5, 1e-45, -1e-45, 1e-40, 3.4e38, 16777217, np.inf, -np.inf, np.nan], "f4"
)  # fmt: skip


class Power(Shader):
    work_group = (64,)
    base: Storage[float]
    exponent: Storage[float]
    result: StorageRW[float]

    def compute(self) -> None:
        i = global_id().x
        self.result[i] = pow(self.base[i], self.exponent[i])


def powers(width: int, base: NDArray[Any], exponent: NDArray[Any]) -> NDArray[np.float32]:
    """Return base to the power exponent, computed by a kernel of so many lanes."""
    assert len(base) % 64 == 0
    results = run_opencl(Power, width, len(base) // 64, base=base, exponent=exponent, result=len(base))
    return results["result"].view("f4")


def random_arguments(family: str) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return arguments whose powers are normal numbers: bases of all sizes, or next to 1."""
    rng = np.random.default_rng(2)
    if family == "all sizes":
        base = rng.integers(1, 0x7F800000, COUNT).astype("u4").view("f4")
    else:
        base = (1 + rng.uniform(-1, 1, COUNT) * 10 ** rng.uniform(-6.5, -0.5, COUNT)).astype("f4")
    size = np.abs(np.log2(base.astype("f8")))
    return base, (rng.uniform(-125, 125, COUNT) / np.maximum(size, 1e-8)).astype("f4")


@pytest.mark.parametrize("family", ["all sizes", "next to 1"])
def test_pow_of_lanes_is_within_7_tenths_of_an_ulp(family: str) -> None:
    base, exponent = random_arguments(family)
    exact = np.power(base.astype(np.longdouble), exponent.astype(np.longdouble))
    error = np.abs(powers(16, base, exponent) - exact) / np.spacing(exact.astype("f4"))
    assert error.max() < 0.7


@pytest.mark.parametrize("width", [4, 8, 16])
def test_pow_of_special_arguments_follows_c(width: int) -> None:
    base, exponent = (np.resize(grid.ravel(), 384) for grid in np.meshgrid(SPECIAL, SPECIAL))
    with np.errstate(all="ignore"):
        exact = np.power(base.astype("f8"), exponent.astype("f8")).astype("f4")
    np.testing.assert_allclose(powers(width, base, exponent), exact, 1e-7)


def test_special_arguments_leave_the_other_lanes_as_they_are() -> None:
    base, exponent = random_arguments("next to 1")
    alone = powers(16, base, exponent)
    base[::16] = np.resize(SPECIAL, COUNT // 16)
    mixed = powers(16, base, exponent)
    others = np.arange(COUNT) % 16 > 0
    np.testing.assert_array_equal(mixed[others].view("u4"), alone[others].view("u4"))
