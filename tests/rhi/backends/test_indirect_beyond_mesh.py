"""An indirect draw that names more than the mesh has: gl and cl draw the part that is there, wgpu draws nothing.

Validation in wgpu-native drops such draws whole, as WebGPU's specification says of indexed ones. The kit asks only
that no foreign memory is shown (`rhi/conformance/operation/test_draw_bounds.py`), because OpenGL's drivers
differ; those of the tests are held to what docs/meshes.md says.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

import rhi
from rhi import Device, IndirectDraws, Mesh, Primitive
from rhi.conformance.operation.test_draw_bounds import COUNT, OWN, Numbered, make_vertices, show

PARTS: list[tuple[str, dict[str, int], int, int]] = [
    ("indexed", {"count": COUNT + 1}, 0, COUNT),
    ("indexed", {"count": 100_000}, 0, COUNT),
    ("indexed", {"count": (1 << 32) - 1}, 0, COUNT),
    ("indexed", {"first": COUNT - 2, "count": 3}, COUNT - 2, COUNT),
    ("indexed", {"first": COUNT, "count": 1}, 0, 0),
    ("plain", {"count": COUNT + 1}, 0, COUNT),
    ("plain", {"count": 5_000_000}, 0, COUNT),
    ("plain", {"first": COUNT - 2, "count": 4}, COUNT - 2, COUNT),
    ("instanced", {"instances": COUNT + 1}, 0, COUNT),
    ("instanced", {"base_instance": COUNT - 2, "instances": 3}, COUNT - 2, COUNT),
]
"""A mesh, numbers of a draw, and the elements of the mesh that they name: from the first to before the last."""


@pytest.fixture(scope="module", params=["gl", "cl", "wgpu"])
def device(request: pytest.FixtureRequest) -> Iterator[Device]:
    try:
        device = rhi.create_device(request.param)
    except rhi.DeviceError as error:
        pytest.skip(f"{request.param}: {error.given}")
    with device:
        if request.param == "gl" and "llvmpipe" not in device.capabilities.device:
            pytest.skip("the bounds are the driver's own")
        yield device


@pytest.fixture(scope="module")
def meshes(device: Device) -> dict[str, Mesh]:
    points: Any = {"primitive": Primitive.POINTS}
    unused = {"unused": np.zeros((1, 2), np.float32)}
    return {
        "indexed": device.mesh(make_vertices(OWN), np.arange(COUNT, dtype=np.uint32), **points),
        "plain": device.mesh(make_vertices(OWN), **points),
        "instanced": device.mesh(unused, np.zeros(1, np.uint32), instances=make_vertices(OWN), **points),
    }


def draw(device: Device, mesh: Mesh, **numbers: int) -> Any:
    """Return the numbers that an indirect draw of one element, or of others, shows."""
    arguments = mesh.draws(0, 1)
    for name, number in numbers.items():
        arguments[name] = number
    with device.buffer(arguments) as buffer:
        indirect = IndirectDraws(buffer, 1)
        return show(device, lambda: device.draw_indirect(device.program(Numbered), mesh, indirect))


@pytest.mark.parametrize(("name", "numbers", "first", "end"), PARTS)
def test_the_part_that_the_mesh_has_is_drawn_except_on_wgpu(
    device: Device, meshes: dict[str, Mesh], name: str, numbers: dict[str, int], first: int, end: int
) -> None:
    expected = np.zeros(COUNT)
    if device.capabilities.backend != "wgpu":
        expected[first:end] = OWN[first:end]
    np.testing.assert_array_equal(draw(device, meshes[name], **numbers), expected)


@pytest.mark.parametrize("name", ["indexed", "plain"])
def test_a_draw_up_to_the_end_of_the_mesh_is_whole(
    device: Device, meshes: dict[str, Mesh], name: str
) -> None:
    np.testing.assert_array_equal(draw(device, meshes[name], count=COUNT), OWN)


def test_all_instances_of_a_mesh_are_drawn(device: Device, meshes: dict[str, Mesh]) -> None:
    np.testing.assert_array_equal(draw(device, meshes["instanced"], instances=COUNT), OWN)
