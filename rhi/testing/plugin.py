"""The pytest plugin: fixtures for tests of code that uses `rhi`, and the option `--rhi-backend`.

- `null_device`: a null device. `command_stream`: the commands of that device.
- `rhi_device`: a recording device on each backend that `--rhi-backend` names (default: `RHI_BACKEND`, else null), so
  that the same test runs without a GPU and, where there is one, with it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Final

import pytest

from rhi import CommandStream, Device, create_device

OPTION: Final = "--rhi-backend"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add `--rhi-backend NAME`, which may be given several times."""
    parser.getgroup("rhi").addoption(
        OPTION,
        action="append",
        metavar="NAME",
        help="backend for rhi_device and rhi.conformance; repeatable (default: RHI_BACKEND)",
    )


def get_backend_names(config: pytest.Config, default: str) -> list[str]:
    """Return the names of the backends to run on, without duplicates."""
    names = config.getoption(OPTION) or [os.environ.get("RHI_BACKEND") or default]
    return list(dict.fromkeys(names))


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run each test that takes `rhi_device` once per backend."""
    if "rhi_device" in metafunc.fixturenames:
        metafunc.parametrize("rhi_device", get_backend_names(metafunc.config, "null"), indirect=True)


@pytest.fixture
def null_device() -> Iterator[Device]:
    """A null device for one test."""
    with create_device("null") as device:
        yield device


@pytest.fixture
def rhi_device(request: pytest.FixtureRequest) -> Iterator[Device]:
    """A recording device for one test, on each of the requested backends."""
    with create_device(request.param, record=True) as device:
        yield device


@pytest.fixture
def command_stream(null_device: Device) -> CommandStream:
    """The command stream of `null_device`."""
    return null_device.stream
