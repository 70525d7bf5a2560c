"""Whole numbers of any size, given to every call that takes one: each is refused by name or has its effect.

Drivers take 32 or 64 bits, and NumPy and ctypes raise errors of their own for more.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import nullcontext
from typing import Any

import numpy as np
import pytest

import rhi
from rhi import (
    Access,
    ColorWrite,
    DepthBias,
    Device,
    Format,
    IndirectDraws,
    Region,
    SamplerDescriptor,
    Scissor,
    StencilReadMask,
    StencilReference,
    StencilWriteMask,
    TextureKind,
    Viewport,
)
from rhi.conformance.shaders import Tint
from rhi.shading import FullScreen, Shader, StorageRW, global_id, vec4

EDGES = [2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**34, 2**62, 2**63, 2**64, 10**30, 10**40]
VALUES = [0, 1, 16, 256, *EDGES, *(-edge for edge in EDGES), -1, -(2**63) - 1]
SIZES = [value for value in VALUES if not 256 < value < 2**40]
"""Numbers of elements or bytes: none that memory might hold."""
COUNTS = [value for value in VALUES if not 2**30 < value < 2**32]
"""Numbers of instances and work-groups: none that would be run."""

Call = Callable[[Device, int], object]
CALLS: dict[str, tuple[Call, list[int]]] = {}


class White(FullScreen):
    def fragment(self) -> vec4:
        return vec4(1.0, 1.0, 1.0, 1.0)


class Fill(Shader):
    work_group = (1,)
    out: StorageRW[float]

    def compute(self) -> None:
        self.out[global_id().x % 8] = 1.0


def takes(values: list[int] = VALUES) -> Callable[[Call], Call]:
    """Add a call to the table."""

    def add(call: Call) -> Call:
        CALLS[call.__name__] = call, values
        return call

    return add


def draw(device: Device, *states: Any, instances: int = 1, depth: bool = False) -> None:
    color = None if depth else device.texture((4, 4), Format.RGBA8)
    target = device.texture((4, 4), Format.D24S8) if depth else None
    with device.render_pass(color, target), device.states(*states) if states else nullcontext():
        device.draw(device.program(White), device.mesh(3), instances)


def draw_indirect(device: Device, counted: bool, **numbers: int) -> None:
    mesh = device.mesh(3)
    count = device.buffer(np.ones(1, np.uint32)) if counted and device.capabilities.indirect_count else None
    options: dict[str, Any] = {"draws": 1} | numbers
    arguments = IndirectDraws(device.buffer(mesh.draws([0], 3)), count=count, **options)
    with device.render_pass(device.texture((4, 4), Format.RGBA8)):
        device.draw_indirect(device.program(White), mesh, arguments)


for counted in (False, True):
    for name in ("draws", "offset", "stride", "count_offset"):
        CALLS[f"indirect {name}, {counted}"] = (
            lambda device, n, name=name, counted=counted: draw_indirect(device, counted, **{name: n}),
            VALUES,
        )  # type: ignore[assignment]
for state in (StencilReference, StencilReadMask, StencilWriteMask):
    CALLS[state.__name__] = lambda device, n, state=state: draw(device, state(n, n), depth=True), VALUES  # type: ignore[assignment]
for name in ("x", "y", "width", "height"):
    box = {"x": 0, "y": 0, "width": 1, "height": 1}
    CALLS[f"scissor {name}"] = (lambda d, n, k=name, box=box: draw(d, Scissor(**(box | {k: n}))), VALUES)  # type: ignore[assignment]
    CALLS[f"viewport {name}"] = (lambda d, n, k=name, box=box: draw(d, Viewport(**(box | {k: n}))), VALUES)  # type: ignore[assignment]
for name in ("x", "y", "width", "height", "layer", "layers"):
    box = {"x": 0, "y": 0, "width": 1, "height": 1}

    def read_region(device: Device, n: int, name: str = name, box: dict[str, int] = box) -> None:
        texture = device.texture((4, 4), Format.RGBA8)
        texture.read(region=Region(**(box | {name: n})))

    CALLS[f"region {name}"] = read_region, VALUES
for name in ("x", "y", "layer", "level", "target_level"):

    def copy_texture(device: Device, n: int, name: str = name) -> None:
        target = device.texture((4, 4), Format.RGBA8)
        device.texture((4, 4), Format.RGBA8).copy_to(target, **{name: n})  # type: ignore[arg-type]

    CALLS[f"copy {name}"] = copy_texture, VALUES
for name in ("offset", "row_bytes", "level"):

    def copy_rows(device: Device, n: int, name: str = name) -> None:
        texture, buffer = device.texture((4, 1), Format.RGBA8), device.buffer(1024)
        for copy in (texture.copy_to_buffer, texture.copy_from_buffer):
            copy(buffer, **{name: n})  # type: ignore[arg-type]

    CALLS[f"rows {name}"] = copy_rows, VALUES
for name in ("size", "offset", "target_offset"):
    CALLS[f"buffer copy {name}"] = lambda d, n, k=name: d.buffer(16).copy_to(d.buffer(16), **{k: n}), VALUES  # type: ignore[assignment]
for index in range(4):

    def clip(device: Device, n: int, index: int = index) -> None:
        box, mesh = [0, 0, 1, 1], device.mesh(3)
        box[index] = n
        with device.render_pass(device.texture((4, 4), Format.RGBA8)):
            device.draw_clipped(device.program(White), mesh, mesh.draws([0], 3), [box])

    CALLS[f"clip {index}"] = clip, VALUES


@takes(COUNTS)
def instances(device: Device, n: int) -> None:
    draw(device, instances=n)


@takes()
def depth_bias(device: Device, n: int) -> None:
    draw(device, DepthBias(n), depth=True)


@takes()
def color_write_target(device: Device, n: int) -> None:
    draw(device, ColorWrite(True, True, True, True, n))


@takes()
def draws(device: Device, n: int) -> None:
    device.mesh(3).draws([n], 3)


@takes()
def view(device: Device, n: int) -> None:
    device.mesh(3).view(n, 3)


@takes(SIZES)
def mesh_size(device: Device, n: int) -> None:
    device.mesh(n)


@takes(SIZES)
def buffer_size(device: Device, n: int) -> None:
    device.buffer(n)


@takes(SIZES)
def storage_size(device: Device, n: int) -> None:
    device.storage(float, n)


@takes(SIZES)
def uniform_array_size(device: Device, n: int) -> None:
    device.uniform_array(Tint, n)


@takes(SIZES)
def query_set_size(device: Device, n: int) -> None:
    device.query_set(n)


@takes(SIZES)
def texture_width(device: Device, n: int) -> None:
    device.texture((n, 1), Format.R8)


@takes(SIZES)
def texture_layers(device: Device, n: int) -> None:
    device.texture((1, 1), Format.R8, kind=TextureKind.D2_ARRAY, layers=n)


@takes(SIZES)
def volume_depth(device: Device, n: int) -> None:
    device.texture((1, 1), Format.R8, kind=TextureKind.D3, layers=n)


@takes()
def texture_levels(device: Device, n: int) -> None:
    device.texture((4, 4), Format.R8, levels=n)


@takes()
def texture_samples(device: Device, n: int) -> None:
    device.texture((4, 4), Format.R8, samples=n)


@takes()
def target_level(device: Device, n: int) -> None:
    device.texture((4, 4), Format.R8).at(n, n)


@takes()
def image_level(device: Device, n: int) -> None:
    device.texture((4, 4), Format.R8).image(n, n)


@takes()
def write_texels(device: Device, n: int) -> None:
    device.texture((4, 4), Format.R8).write(np.zeros((1, 1), np.uint8), x=n)


@takes()
def read_elements(device: Device, n: int) -> None:
    device.buffer(16).read(0, n)


@takes()
def write_elements(device: Device, n: int) -> None:
    device.buffer(16).write(np.zeros(1, np.uint8), n)


@takes()
def clear_pattern(device: Device, n: int) -> None:
    device.buffer(16).clear(n)


@takes()
def lock(device: Device, n: int) -> None:
    with device.buffer(16).lock(Access.READ, n, 1):
        pass


@takes(COUNTS)
def dispatch(device: Device, n: int) -> None:
    device.dispatch(device.program(Fill), n, out=device.storage(float, 8))


@takes()
def dispatch_indirect(device: Device, n: int) -> None:
    counts = device.buffer(np.ones(3, np.uint32))
    device.dispatch_indirect(device.program(Fill), counts, n, out=device.storage(float, 8))


@takes()
def clear_stencil(device: Device, n: int) -> None:
    with device.render_pass(depth=device.texture((4, 4), Format.D24S8), clear_stencil=n):
        pass


@takes()
def anisotropy(device: Device, n: int) -> None:
    device.sampler(SamplerDescriptor(max_anisotropy=n))


@takes()
def query_index(device: Device, n: int) -> None:
    mesh = device.mesh(3)
    with device.render_pass(device.texture((4, 4), Format.R8)):
        device.draw_counted(device.program(White), mesh, mesh.draws([0], 3), device.query_set(4), [n])


@pytest.fixture(scope="module", params=["null", "gl", "cl", "wgpu"])
def bounded(request: pytest.FixtureRequest) -> Iterator[Device]:
    try:
        device = rhi.create_device(request.param)
    except rhi.DeviceError as error:
        pytest.skip(str(error))
    yield device
    device.close(quiet=True)


@pytest.mark.filterwarnings("ignore::ResourceWarning")
@pytest.mark.parametrize("call", CALLS)
def test_a_number_is_refused_by_name_or_taken(bounded: Device, call: str) -> None:
    function, values = CALLS[call]
    taken, refusals = 0, []
    for value in values:
        try:
            function(bounded, value)
            taken += 1
        except rhi.ValidationError as error:
            refusals.append(error)
    assert all(error.call and error.given for error in refusals)
    bounded.finish()
    with bounded.render_pass(image := bounded.texture((4, 4), Format.R8), clear=(0, 0, 0, 0)):
        bounded.draw(bounded.program(White), bounded.mesh(3))
    if bounded.capabilities.renders:
        assert (image.read() == 255).all()
    assert taken > 0
    assert refusals, "a call that takes any number proves nothing"
