"""Warnings about resources that were collected instead of destroyed, and the memory that comes back with
them."""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections.abc import Callable

import numpy as np
import pytest

import rhi
from rhi import Format
from rhi.backends.null import NullBackend
from rhi.errors.rules import DEVICE_MEMORY

CREATIONS: dict[str, Callable[[rhi.Device], object]] = {
    "Texture": lambda device: device.texture((4, 4), Format.R8, label="it"),
    "Buffer": lambda device: device.buffer(4, label="it"),
    "OcclusionQuery": lambda device: device.occlusion_query(),
}


def collect_warnings(use: Callable[[rhi.Device], object], **options: bool) -> list[warnings.WarningMessage]:
    """Return the warnings about resources that a function leaves behind."""
    with rhi.create_device("null", **options) as device, warnings.catch_warnings(record=True) as collected:
        warnings.simplefilter("always")
        use(device)
    return collected


@pytest.mark.parametrize("kind", CREATIONS)
def test_a_device_with_validation_warns_at_the_line_of_creation(kind: str) -> None:
    (warning,) = collect_warnings(CREATIONS[kind], validation=True)
    assert warning.category is ResourceWarning
    assert (warning.filename, warning.lineno) == (__file__, CREATIONS[kind].__code__.co_firstlineno)
    named = kind + ("('it')" if kind != "OcclusionQuery" else "")
    assert named in str(warning.message)
    assert str(warning.message).endswith("was collected instead of destroyed")


@pytest.mark.parametrize("kind", CREATIONS)
def test_other_devices_do_not_warn(kind: str) -> None:
    assert not collect_warnings(CREATIONS[kind])


def test_a_destroyed_resource_causes_no_warning() -> None:
    assert not collect_warnings(lambda device: device.texture((4, 4), Format.R8).destroy(), validation=True)


def test_a_resource_that_outlives_its_device_causes_no_warning() -> None:
    with warnings.catch_warnings(record=True) as collected:
        warnings.simplefilter("always")
        with rhi.create_device("null", validation=True) as device:
            texture = device.texture((4, 4), Format.R8)
        del texture
    assert not collected


def test_a_refused_creation_leaves_nothing_to_warn_of() -> None:
    def refuse(device: rhi.Device) -> None:
        with pytest.raises(rhi.ValidationError):
            device.texture((0, 4), Format.R8)
        with pytest.raises(rhi.ValidationError):
            device.mesh(np.zeros(3, np.dtype([("position", "f4", 3)])), np.array([3], np.uint32))

    assert not collect_warnings(refuse, validation=True)


@pytest.mark.parametrize(("options", "count"), [((), 0), (("-X", "dev"), 1)])
def test_development_mode_warns_without_validation(options: tuple[str, ...], count: int) -> None:
    source = "import rhi\nwith rhi.create_device('null') as device:\n    device.buffer(4, label='lost')\n"
    done = subprocess.run(
        [sys.executable, *options, "-c", source], capture_output=True, text=True, check=True, encoding="utf-8"
    )
    assert done.stderr.count("ResourceWarning: Buffer('lost') was collected") == count
    assert done.stderr.count("<string>:3") == count


def test_a_creation_that_the_backend_refuses_leaves_no_line_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise rhi.DeviceError(DEVICE_MEMORY, "create_texture")

    with rhi.create_device("null", validation=True) as device:
        monkeypatch.setattr(device.backend_as(NullBackend), "create_texture", fail)
        with pytest.raises(rhi.DeviceError):
            device.texture((4, 4), Format.R8)
        assert not device._core.timeline.sites
