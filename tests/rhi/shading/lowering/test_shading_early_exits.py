"""Methods that end early give Python's values and stores in each stage: on NumPy, on gl, cl and wgpu."""

from __future__ import annotations

import numpy as np
import pytest
from early_exits import STAGES, Results, expected, run_on_device, run_on_numpy, write_stage
from nightly_reasons import ONLY_KERNELS
from nights import rotate_seed

import rhi


def compare(actual: Results, text: str, seed: int) -> None:
    values, stores = expected(text)
    np.testing.assert_array_equal(actual[0], values, f"values, {seed}")
    if actual[1] is not None:
        np.testing.assert_array_equal(actual[1], stores, f"stores, {seed}")


@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize(
    "seeds",
    [
        pytest.param(range(2), id="few"),
        *(
            pytest.param(range(start, start + 12), id=f"from {start}", marks=pytest.mark.nightly)
            for start in range(100, 148, 12)
        ),
    ],
)
def test_methods_that_end_early_give_python_s_values_on_numpy(stage: str, seeds: range) -> None:
    for seed in seeds if len(seeds) < 10 else map(rotate_seed, seeds):
        text = write_stage(seed, stage)
        compare(run_on_numpy(text, stage), text, seed)


@pytest.mark.nightly_cases("*-cl", "*-wgpu", reason=ONLY_KERNELS)
@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu"])
@pytest.mark.parametrize("stage", STAGES)
@pytest.mark.parametrize(
    "seeds",
    [
        pytest.param(range(200, 201), id="first"),
        *(
            pytest.param(range(start, start + 6), id=f"from {start}", marks=pytest.mark.nightly)
            for start in range(300, 324, 6)
        ),
    ],
)
def test_methods_that_end_early_give_python_s_values_on_a_device(
    backend: str, stage: str, seeds: range
) -> None:
    try:
        device = rhi.create_device(backend)
    except rhi.DeviceError as error:
        pytest.skip(f"{backend}: {error.given}")
    with device:
        for seed in seeds if len(seeds) == 1 else map(rotate_seed, seeds):
            text = write_stage(seed, stage)
            compare(run_on_device(device, text, stage), text, seed)


def test_the_programs_discard_and_store() -> None:
    """Among the first programs are fragments that are discarded, before and after they have stored."""
    results = [expected(write_stage(seed, "fragment")) for seed in range(12)]
    values, stores = (np.concatenate([result[part] for result in results]) for part in (0, 1))
    for is_discarded in (values == -1, values != -1):
        assert (is_discarded & (stores == 0)).any()
        assert (is_discarded & (stores != 0)).any()
