"""A call that WebGPU refuses at submission is an obstacle that `check_portability` names, with the capability."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from rhi import BlendFactor, BlendFunction, Device, Format, TextureKind
from rhi.backends.null.null_capabilities import get_profile
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle
from rhi.conformance.validation.test_portable_uses import (
    ReadAndWrite,
    Sampled,
    WriteNothing,
)
from rhi.testing.portability import check_portability


def alias(device: Device) -> None:
    values = device.storage(float, 8)
    device.dispatch(device.program(ReadAndWrite), 1, source=values, target=values)


def sample_what_is_resolved(device: Device) -> None:
    target, end = device.texture((4, 4), Format.RGBA8, samples=4), device.texture((4, 4), Format.RGBA8)
    with device.render_pass(target, resolve=end):
        device.draw(device.program(Sampled), device.mesh(3), source=end)


def blend_floats(device: Device) -> None:
    with device.render_pass(device.texture((4, 4), Format.RGBA32F)):
        with device.states(BlendFunction(BlendFactor.ONE, BlendFactor.ONE)):
            device.draw(device.program(Colored), device.mesh(rectangle()))


def read_far_vertices(device: Device) -> None:
    fields = {"names": ["position"], "formats": [("f4", 2)], "offsets": [0], "itemsize": 4096}
    mesh = device.mesh(np.zeros(3, np.dtype(fields)))  # type: ignore[call-overload]
    with device.render_pass(device.texture((4, 4), Format.RGBA8)):
        device.draw(device.program(WriteNothing), mesh)


def make_a_large_volume(device: Device) -> None:
    device.texture((4096, 1), Format.R8, kind=TextureKind.D3, layers=1)


@pytest.mark.parametrize(
    ("frame", "capability"),
    [
        (alias, "aliased_writes"),
        (sample_what_is_resolved, "resolve_feedback"),
        (blend_floats, "unblendable_formats"),
        (read_far_vertices, "max_vertex_stride"),
        (make_a_large_volume, "max_volume_size"),
    ],
)
def test_the_capability_that_a_frame_lacks_is_named(frame: Callable[[Device], None], capability: str) -> None:
    profiles = {name: get_profile(name) for name in ("everything", "webgpu")}
    obstacles = check_portability(frame, profiles).obstacles
    assert obstacles["everything"] == ()
    assert [obstacle.capability for obstacle in obstacles["webgpu"]] == [capability]
