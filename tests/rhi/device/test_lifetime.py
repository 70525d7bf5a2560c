"""Resources that are created with contents: if the upload fails, nothing is left behind."""

from __future__ import annotations

import contextlib
from collections.abc import Callable

import numpy as np
import pytest
from null_kit import Camera, Kit

import rhi
from rhi import Device, Format, Op
from rhi.backends.null import NullBackend
from rhi.errors.rules import DEVICE_MEMORY

TEXELS = np.zeros((4, 4, 4), "u1")
FILLED: list[tuple[str, Callable[[Device], object]]] = [
    ("write_buffer", lambda device: device.buffer(np.arange(4))),
    ("write_buffer", lambda device: device.storage(float, np.zeros(4, "f4"))),
    ("write_buffer", lambda device: device.uniform(Camera(tint=(1, 1, 1, 1)))),
    ("write_buffer", lambda device: device.mesh({"position": np.zeros((3, 2))})),
    ("write_texture", lambda device: device.texture(TEXELS, Format.RGBA8)),
    ("generate_mipmaps", lambda device: device.texture(TEXELS, Format.RGBA8, levels=None)),
]


@pytest.mark.parametrize(("method", "make"), FILLED)
def test_a_resource_that_cannot_be_filled_is_destroyed(
    kit: Kit, monkeypatch: pytest.MonkeyPatch, method: str, make: Callable[[Device], object]
) -> None:
    device = kit.device

    def fail(*arguments: object) -> None:
        raise rhi.DeviceError(DEVICE_MEMORY, method)

    def count(op: Op) -> int:
        return sum(command.op is op for command in device.stream)

    created, destroyed = count(Op.CREATE_BUFFER) + count(Op.CREATE_TEXTURE), count(Op.DESTROY)
    with monkeypatch.context() as patch:
        patch.setattr(device.backend_as(NullBackend), method, fail)
        with pytest.raises(rhi.DeviceError):
            make(device)
    device.finish()
    created = count(Op.CREATE_BUFFER) + count(Op.CREATE_TEXTURE) - created
    assert created == 1
    assert count(Op.DESTROY) - destroyed == created
    resource = make(device)
    device.finish()
    assert count(Op.DESTROY) - destroyed == created
    del resource


def test_destroying_a_view_leaves_the_mesh(kit: Kit) -> None:
    mesh = kit.device.mesh({"position": np.zeros((6, 2))})
    with mesh.view(0, 3) as part:
        part.view(0, 1).destroy()
    assert mesh.vertices is not None
    assert not mesh.vertices.destroyed
    mesh.destroy()
    assert mesh.vertices.destroyed


@pytest.mark.parametrize("fails", [False, True])
def test_a_creation_inside_another_is_a_part_of_it(kit: Kit, fails: bool) -> None:
    with contextlib.suppress(KeyError), kit.device._core.creation():
        resources = [kit.device.buffer(16), kit.device.texture((4, 4), Format.R8)]
        if fails:
            raise KeyError
    kit.device.finish()
    destroyed = {command.arguments["resource"] for command in kit.device.stream.filter(Op.DESTROY)}
    assert [resource.id in destroyed for resource in resources] == [fails, fails]
