"""Devices for the renderer's tests."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from tested_devices import open_device

import rhi
from renderer.content import load_scene
from renderer.scene import Scene


def run_with_quick_kernels(cache: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run `compare` in a process of its own, whose cache has no optimised kernels: PoCL asks once where it
    is."""
    environment = {name: value for name, value in os.environ.items() if name != "POCL_CACHE_DIR"}
    environment |= {"RHI_CACHE": str(cache), "RHI_KERNELS": "quick"}
    command = [sys.executable, "-m", "renderer", "compare", *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, check=True, env=environment, encoding="utf-8"
    )


@pytest.fixture
def null() -> Iterator[rhi.Device]:
    with rhi.create_device("null") as device:
        yield device


@pytest.fixture
def gl() -> Iterator[rhi.Device]:
    """A GL device that records; tests that look at pixels are skipped where there is none."""
    with open_device("gl", record=True) as device:
        yield device


_DRAWING = ["gl", "cl", pytest.param("wgpu", marks=pytest.mark.nightly)]


@pytest.fixture(scope="module", params=_DRAWING)
def drawing_device(request: pytest.FixtureRequest) -> Iterator[rhi.Device]:
    """A device of each backend that draws, one per module; tests of a backend that isn't here are skipped."""
    with open_device(request.param) as device:
        if not device.capabilities.renders:
            pytest.skip(f"the {request.param} device draws nothing")
        yield device


@pytest.fixture(scope="module")
def device(drawing_device: rhi.Device) -> rhi.Device:
    """A device of each backend that draws and computes, one per module."""
    if not drawing_device.capabilities.compute:
        pytest.skip(f"the {drawing_device.backend_name} device computes nothing")
    return drawing_device


@pytest.fixture(scope="module")
def city() -> Scene:
    return load_scene("city:blocks=6")
