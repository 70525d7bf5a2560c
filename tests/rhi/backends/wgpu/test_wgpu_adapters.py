"""Opening a device on wgpu says nothing of its own, and leaves the environment as it was."""

from __future__ import annotations

import os

import pytest

import rhi


@pytest.mark.parametrize("folder", [None, "", "relative", "/run/user/none"])
@pytest.mark.parametrize("display", [None, "wayland-0"])
def test_a_device_opens_quietly_without_a_folder_for_a_session(
    folder: str | None,
    display: str | None,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    for name, value in (("XDG_RUNTIME_DIR", folder), ("WAYLAND_DISPLAY", display)):
        if value is None:
            monkeypatch.delenv(name, raising=False)
        else:
            monkeypatch.setenv(name, value)
    before = dict(os.environ)
    try:
        device = rhi.create_device("wgpu")
    except rhi.DeviceError as error:
        pytest.skip(str(error))
    with device:
        device.texture((4, 4), rhi.Format.RGBA8).read()
    assert dict(os.environ) == before
    assert capfd.readouterr() == ("", "")
