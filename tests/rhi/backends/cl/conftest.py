"""Fixtures of the OpenCL backend's tests. Creating a backend takes 2 ms if PoCL has cached the probe
kernel."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest
from cl_kit import ClKit

import rhi
from rhi import Device
from rhi.backends.cl import create_backend
from rhi.backends.cl.builds import Kernel
from rhi.backends.cl.cl_context import KERNELS_ENVIRONMENT


@pytest.fixture
def cl_kit() -> Iterator[ClKit]:
    kit = ClKit(create_backend())
    yield kit
    kit.close()


@pytest.fixture(scope="module")
def device() -> Iterator[Device]:
    with rhi.create_device("cl") as created:
        yield created


@pytest.fixture
def optimised_kernels(monkeypatch: pytest.MonkeyPatch) -> None:
    """Devices that build optimised kernels at once, which keep bounds of depth."""
    monkeypatch.setenv(KERNELS_ENVIRONMENT, "optimised")


@pytest.fixture
def launches(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of the kernels that draws launch, in order."""
    names: list[str] = []
    launch = Kernel.launch

    def note(kernel: Any, queue: Any, batch: int, items: int) -> Any:
        names.append(kernel._name)
        return launch(kernel, queue, batch, items)

    monkeypatch.setattr(Kernel, "launch", note)
    return names
