"""A built-in that only a row of the table defines runs on every device that compiles texts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from new_builtins import VALUES, UsesNewRows, add_new_rows, expected_results

import rhi
from rhi.shading import vec3


@pytest.fixture(params=["gl", "cl", "wgpu"])
def computing_device(request: pytest.FixtureRequest) -> Iterator[rhi.Device]:
    """A device of each backend that compiles texts: GLSL, OpenCL C, and WGSL through naga."""
    if request.param not in [backend.name for backend in rhi.report() if backend.usable]:
        pytest.skip(f"{request.param} doesn't work here")
    with rhi.create_device(request.param) as device:
        yield device


def test_every_device_computes_a_builtin_from_its_row(
    computing_device: rhi.Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    add_new_rows(monkeypatch)
    device = computing_device
    program: Any = device.program(UsesNewRows)
    results = device.storage(vec3, 32)
    device.dispatch(program, 1, a=device.storage(float, VALUES), out=results)
    np.testing.assert_allclose(results.read()[:, :3], expected_results(), rtol=1e-6)
