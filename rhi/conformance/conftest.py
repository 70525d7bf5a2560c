"""Fixtures of the kit.

- `device`: one device per backend and session. Tests leave it as they found it; after a failed test the next
  one gets a new device, so that a fault of one command doesn't show in the tests of others.
- `fresh_device`: a device for tests that change it permanently.
- `mesh`: a rectangle of `device` over the whole target.
- `recording`: a device for tests that read the command stream.
"""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import rhi
from rhi.conformance import plugin
from rhi.conformance.plugin import FAILED, PROPERTY, has_threads
from rhi.conformance.shapes import rectangle
from rhi_pytest import get_backend_names


def pytest_configure(config: pytest.Config) -> None:
    """Register the kit's plugin, unless an option or another conftest has done so.

    It is imported above, so `import_plugin` would warn, where the tree isn't the installed one, that pytest
    can't rewrite it.
    """
    if not config.pluginmanager.has_plugin(plugin.__name__):
        config.pluginmanager.register(plugin, plugin.__name__)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run every test once per requested backend, and those marked `recorded_too` also through a recorder."""
    if "backend" in metafunc.fixturenames:
        metafunc.parametrize("backend", get_backend_names(metafunc.config, "gl"), scope="session")
    if "route" in metafunc.fixturenames:
        twice = metafunc.definition.get_closest_marker("recorded_too") is not None
        metafunc.parametrize("route", ["direct", "recorded"] if twice else ["direct"], scope="session")


def pytest_itemcollected(item: pytest.Item) -> None:
    """Attach the test's place on the scoreboard: its backend, and a group such as "operation · depth".

    The kit's devices validate, and warn of what tests drop.
    """
    item.add_marker(
        pytest.mark.filterwarnings("ignore:.* was collected instead of destroyed:ResourceWarning")
    )
    parameters = getattr(item, "callspec", None)
    backend = parameters.params.get("backend", "any") if parameters is not None else "any"
    group = f"{item.path.parent.name} · {item.path.stem.removeprefix('test_').replace('_', ' ')}"
    item.user_properties.append((PROPERTY, (backend, group)))


class SharedDevices:
    """The session's devices on one backend, created on first use and again after `renew`.

    Attributes:
        backend: the name of the backend.
    """

    def __init__(self, backend: str) -> None:
        self.backend = backend
        self._devices: dict[bool, rhi.Device] = {}

    def get(self, record: bool) -> rhi.Device:
        """Return the device that records its commands, or the other one, which has timers.

        Both validate: a driver's message fails the test that caused it.
        """
        device = self._devices.get(record)
        if device is None:
            device = rhi.create_device(self.backend, validation=True, record=record, timing=not record)
            self._devices[record] = device
        return device

    def lend(self, test: pytest.Item, record: bool) -> Iterator[rhi.Device]:
        """Yield a device for one test, and renew the devices if the test has failed."""
        yield self.get(record)
        if FAILED in test.stash:
            self.renew()

    def renew(self) -> None:
        """Close the devices; the next test creates new ones."""
        while self._devices:
            self._devices.popitem()[1].close()


@pytest.fixture(scope="session")
def shared_devices(backend: str) -> Iterator[SharedDevices]:
    """The devices that the tests of a session share. A backend that can't create one ends the session."""
    devices = SharedDevices(backend)
    try:
        devices.get(record=False)
    except rhi.DeviceError as error:
        pytest.exit(f"no device can be created on {backend!r}: {error}", pytest.ExitCode.TESTS_FAILED)
    yield devices
    devices.renew()


@pytest.fixture
def shared_device(request: pytest.FixtureRequest, shared_devices: SharedDevices) -> Iterator[rhi.Device]:
    """The session's device, with timers."""
    yield from shared_devices.lend(request.node, record=False)


@pytest.fixture
def recording_device(request: pytest.FixtureRequest, shared_devices: SharedDevices) -> Iterator[rhi.Device]:
    """A second device, which records its commands."""
    yield from shared_devices.lend(request.node, record=True)


@pytest.fixture
def device(shared_device: rhi.Device, recording_device: rhi.Device, route: str) -> rhi.Device:
    """The shared device of this test's route.

    Where a backend prepares draws, a device without a recorder calls other backend methods than a device with
    one. Both must give the same pixels.
    """
    device = shared_device if route == "direct" else recording_device
    if route == "recorded":
        device.stream.clear()
    return device


@pytest.fixture
def mesh(device: rhi.Device) -> Iterator[rhi.Mesh]:
    """A white rectangle over the whole target."""
    with device.mesh(rectangle()) as mesh:
        yield mesh


@pytest.fixture
def recording(recording_device: rhi.Device) -> rhi.Device:
    """The shared recording device; its stream continues from test to test."""
    return recording_device


@pytest.fixture
def fresh_device(backend: str) -> Iterator[rhi.Device]:
    """A device for this test alone."""
    with rhi.create_device(backend, validation=True) as device:
        yield device


@pytest.fixture(autouse=True)
def capable(request: pytest.FixtureRequest) -> None:
    """Skip a test marked `requires` if the backend declares the capability missing, or the limit 0; and one marked
    `threads` where Python has none."""
    if request.node.get_closest_marker("threads") and not has_threads():
        pytest.skip("Python can't start threads here")
    required = [capability for marker in request.node.iter_markers("requires") for capability in marker.args]
    if not required or "backend" not in request.fixturenames:
        return
    device: rhi.Device = request.getfixturevalue("shared_device")
    for capability in required:
        if not getattr(device.capabilities, capability):
            pytest.skip(f"{device.backend_name} declares no {capability}")
