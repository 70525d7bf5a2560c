"""The pytest plugin: fixtures for tests of code that uses `rhi`, and the option `--rhi-backend`.

- `--rhi-update-streams` has `rhi.testing.assert_stream_matches` write the files that differ.
- `null_device`: a null device. `command_stream`: the commands of that device.
- `rhi_device`: a recording device on each backend that `--rhi-backend` names (default: `RHI_BACKEND`, else
  null), so that the same test runs without a GPU and, where there is one, with it.

Pytest loads this module through an entry point in each environment where `rhi` is installed. So it imports
`rhi` only when a test uses a fixture or an option names a backend: other projects' tests pay nothing for it.
That is why it is a package of its own, because importing a module of `rhi` imports `rhi`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

import pytest

if TYPE_CHECKING:
    from rhi import CommandStream, Device

UPDATE_OPTION: Final = "--rhi-update-streams"
UPDATE_VARIABLE: Final = "RHI_UPDATE_STREAMS"
OPTION: Final = "--rhi-backend"


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add `--rhi-backend NAME`, which may be given several times, and `--rhi-update-streams`."""
    parser.getgroup("rhi").addoption(
        UPDATE_OPTION,
        action="store_true",
        help="write the files of rhi.testing.assert_stream_matches that differ",
    )
    parser.getgroup("rhi").addoption(
        OPTION,
        action="append",
        metavar="NAME",
        help="backend for rhi_device and rhi.conformance; repeatable (default: RHI_BACKEND)",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Stop at once, with one line, if `--rhi-backend` names a backend that isn't there. Tell `rhi.testing`
    whether to write files of streams."""
    for name in config.getoption(OPTION) or ():
        _check_name(name, OPTION)
    if config.getoption(UPDATE_OPTION):
        before = os.environ.get(UPDATE_VARIABLE)
        os.environ[UPDATE_VARIABLE] = "1"
        config.add_cleanup(lambda: _restore(before))


def _restore(before: str | None) -> None:
    os.environ.pop(UPDATE_VARIABLE, None)
    if before is not None:
        os.environ[UPDATE_VARIABLE] = before


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Stop with one line if tests are to run on the backend of `RHI_BACKEND`, and it isn't there."""
    name = os.environ.get("RHI_BACKEND")
    if name and not config.getoption(OPTION) and any(_backend_of(item) == name for item in items):
        _check_name(name, "RHI_BACKEND")


def get_backend_names(config: pytest.Config, default: str) -> list[str]:
    """Return the names of the backends to run on, without duplicates."""
    names = config.getoption(OPTION) or [os.environ.get("RHI_BACKEND") or default]
    return list(dict.fromkeys(names))


def _backend_of(item: pytest.Item) -> object:
    parameters = getattr(getattr(item, "callspec", None), "params", {})
    return parameters.get("backend", parameters.get("rhi_device"))


def _check_name(name: str, where: str) -> None:
    from rhi.device.registry import load_backend_factory
    from rhi.errors import DeviceError

    try:
        load_backend_factory(name)
    except DeviceError as error:
        hint = f" (known: {error.allowed})" if error.allowed else ""
        raise pytest.UsageError(f"{where}: there is no backend {error.given}{hint}; {error.tip}") from None


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run each test that takes `rhi_device` once per backend."""
    if "rhi_device" in metafunc.fixturenames:
        metafunc.parametrize("rhi_device", get_backend_names(metafunc.config, "null"), indirect=True)


@pytest.fixture
def null_device() -> Iterator[Device]:
    """A null device for one test."""
    from rhi import create_device

    with create_device("null") as device:
        yield device


@pytest.fixture
def rhi_device(request: pytest.FixtureRequest) -> Iterator[Device]:
    """A recording device for one test, on each of the requested backends."""
    from rhi import create_device

    with create_device(request.param, record=True) as device:
        yield device


@pytest.fixture
def command_stream(null_device: Device) -> CommandStream:
    """The command stream of `null_device`."""
    return null_device.stream
