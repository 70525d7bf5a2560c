"""On NumPy, indices outside and operands at the edges have the results that the kit asks of devices."""

import numpy as np
import pytest

from rhi.conformance.operation.test_outside import CASES, GROUPS
from rhi.shading import run_compute


@pytest.mark.parametrize("case", CASES)
def test_numpy_has_the_results_of_devices(case):
    shader, make_values, expected = CASES[case]
    results = run_compute(shader, GROUPS, **make_values())
    for name, values in expected().items():
        for part in values.dtype.names or ("",):
            back = results[name][part] if part else results[name]
            np.testing.assert_array_equal(back, values[part] if part else values)
