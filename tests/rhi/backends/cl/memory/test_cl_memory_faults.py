"""Every allocation and every command fails in turn. Each failure is a rule's error with a tip and the user's
line, leaves nothing half-made, and the device continues."""

from __future__ import annotations

import gc
import sys
from collections.abc import Callable
from functools import partial
from typing import Any, TypeAlias

import numpy as np
import pyopencl as cl
import pytest
from numpy.typing import NDArray

import rhi
from rhi.backends.cl import cl_context
from rhi.backends.cl.memory import planes, pools
from rhi.backends.cl.memory.in_flight import InFlight
from rhi.backends.cl.raster import cl_queries
from rhi.conformance.shaders import Colored, Corner
from rhi.conformance.shapes import corners, rectangle
from rhi.shading import Shader, StorageRW, Struct, Texture2D, global_id, vec2, vec4

_Buffer: Any = cl.Buffer


class Textured(Struct):
    clip: vec4
    at: vec2


class Painted(Shader):
    """Draws an image over the whole target."""

    image: Texture2D

    def vertex(self, v: Corner) -> Textured:
        return Textured(clip=v.position, at=v.position.xy * 0.5 + 0.5)

    def fragment(self, v: Textured) -> vec4:
        return self.image.sample(v.at)


class Ramp(Shader):
    work_group = (16,)
    values: StorageRW[float]

    def compute(self) -> None:
        i = global_id().x
        if i < len(self.values):
            self.values[i] = float(i)


Results: TypeAlias = list[NDArray[Any]]
Keep: TypeAlias = Callable[[Any], Any]


def with_cleanup(do: Callable[[rhi.Device, Keep], Results]) -> Callable[[rhi.Device], Results]:
    """`do`; what it tells to keep is destroyed in the end. Not by contextlib, whose frames would stand on the
    stack."""

    def run(device: rhi.Device) -> Results:
        resources: list[Any] = []

        def keep(thing: Any) -> Any:
            resources.append(thing)
            return thing

        try:
            return do(device, keep)
        finally:
            for thing in reversed(resources):
                thing.destroy()

    return run


@with_cleanup
def work(device: rhi.Device, keep: Keep) -> Results:
    """Do something of everything that allocates memory; return the results."""
    image = keep(device.texture((64, 64), rhi.Format.RGBA8, levels=None))
    depth = keep(device.texture((64, 64), rhi.Format.D24S8))
    several = keep(device.texture((64, 64), rhi.Format.RGBA8, samples=4))
    target = keep(device.texture((64, 64), rhi.Format.RGBA8))
    strip = keep(device.mesh(rectangle()[[0, 1, 2, 5]], primitive=rhi.Primitive.TRIANGLE_STRIP))
    rng = np.random.default_rng(0)
    positions = np.zeros((3000, 4))
    positions[:, :2] = np.repeat(rng.uniform(-1, 1, (1000, 2)), 3, axis=0) + rng.uniform(-0.1, 0.1, (3000, 2))
    positions[:, 2:] = 0.75, 1.0
    many = keep(device.mesh(corners(positions, (1, 0.5, 0, 1)), np.arange(3000, dtype=np.uint16)))
    values = keep(device.storage(float, 1000))
    query = keep(device.occlusion_query())
    colored, painted = keep(device.program(Colored)), keep(device.program(Painted))
    ramp = keep(device.program(Ramp))
    with (
        device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0.5),
        device.states(rhi.CullMode.NONE, rhi.BlendFunction.ADDITIVE),
        query,
    ):
        device.draw(colored, strip)
        device.draw(colored, many)
    image.generate_mipmaps()
    image.copy_to(image, region=rhi.Region(0, 0, 8, 8), target_level=1)
    with device.render_pass(several, clear=(0, 0, 0, 1), resolve=target), device.states(rhi.CullMode.NONE):
        device.draw(painted, strip, image=image)
    device.dispatch(ramp, 63, values=values)
    return [image.read(), image.read(1), target.read(), values.read(), np.array([query.wait()])]


class Allocations:
    """Counts buffers and pieces of host memory, and lets one fail as OpenCL or NumPy does.

    Attributes:
        count: the number of allocations so far.
        failing: the number of the allocation that fails.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.count = 0
        self.failing = -1
        allocations = self

        class Buffer(_Buffer):  # type: ignore[misc]
            def __init__(
                self, cl_context: cl.Context, flags: int, size: int = 0, hostbuf: Any = None
            ) -> None:
                if allocations._is_failing():
                    flags, size, hostbuf = cl.mem_flags.READ_WRITE, 1 << 60, None
                super().__init__(cl_context, flags, size, hostbuf)

        def allocate_pages(*args: Any) -> NDArray[np.uint8]:
            if allocations._is_failing():
                raise MemoryError
            return cl_context.allocate_pages(*args)

        monkeypatch.setattr(cl, "Buffer", Buffer)
        for module in (planes, pools, cl_queries):
            monkeypatch.setattr(module, "allocate_pages", allocate_pages)

    def _is_failing(self) -> bool:
        self.count += 1
        return self.count - 1 == self.failing


class Devices:
    """Devices to fail on, each for so many failures in a row; only a fresh one makes its first
    allocations."""

    def __init__(self, failures: int, **options: Any) -> None:
        self._failures, self._options = failures, options
        self._left = 0
        self._device: rhi.Device | None = None

    def __enter__(self) -> Devices:
        return self

    def __exit__(self, *_: object) -> None:
        if self._device is not None:
            self._device.close()

    def get(self) -> rhi.Device:
        """Return the device for the next failure."""
        if self._left == 0:
            self.__exit__()
            self._device, self._left = rhi.create_device("cl", **self._options), self._failures
        self._left -= 1
        assert self._device is not None
        return self._device


@pytest.mark.slow
@pytest.mark.parametrize("step", [11, pytest.param(1, marks=pytest.mark.nightly)])
def test_each_allocation_may_fail_and_the_device_goes_on(monkeypatch: pytest.MonkeyPatch, step: int) -> None:
    """Every eleventh in each run, every one nightly."""
    with rhi.create_device("cl") as device:
        expected = work(device)
    allocations = Allocations(monkeypatch)
    errors: list[rhi.DeviceError] = []
    goes_on = True
    with Devices(1) as devices:
        while goes_on:
            device = devices.get()
            allocations.failing = allocations.count + step * len(errors)
            try:
                results = work(device)
                goes_on = False
            except rhi.DeviceError as error:
                errors.append(error)
                results = work(device)
            for image, expected_image in zip(results, expected, strict=True):
                np.testing.assert_array_equal(image, expected_image)
    assert len(errors) > 24 // step
    assert {error.rule.id for error in errors} == {"device-out-of-memory"}
    assert all(error.tip for error in errors)
    assert {error.site.file for error in errors if error.site} == {__file__}


def test_without_memory_no_device_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    allocations = Allocations(monkeypatch)
    errors: list[rhi.DeviceError] = []
    goes_on = True
    while goes_on:
        allocations.failing = allocations.count + len(errors)
        try:
            rhi.create_device("cl").close()
            goes_on = False
        except rhi.DeviceError as error:
            errors.append(error)
    assert len(errors) > 1
    # As a driver's if no device passed the probe for want of memory.
    assert {error.rule.id for error in errors} == {"device-out-of-memory", "device-driver"}
    assert all(error.tip for error in errors)


@with_cleanup
def move(device: rhi.Device, keep: Keep) -> Results:
    """Do something of everything that moves memory or waits for it; return the results."""
    size, texels = (16, 16), np.arange(1024, dtype=np.uint8).reshape(16, 16, 4)
    image, copy = keep(device.texture(size, rhi.Format.RGBA8)), keep(device.texture(size, rhi.Format.RGBA8))
    several, target = (keep(device.texture(size, rhi.Format.RGBA8, samples=n)) for n in (4, 1))
    mesh = keep(device.mesh(rectangle(), np.arange(6, dtype=np.uint32)))
    numbers, others = keep(device.buffer(np.arange(64, dtype=np.uint32))), keep(device.buffer(64, "u4"))
    arguments, groups = keep(device.buffer(mesh.draws())), keep(device.buffer(np.array([4, 1, 1], "u4")))
    values, query = keep(device.storage(float, 64)), keep(device.occlusion_query())
    colored, ramp = keep(device.program(Colored)), keep(device.program(Ramp))
    image.write(texels)
    image.copy_to(copy, region=rhi.Region(0, 0, 8, 16))
    others.clear(7)
    numbers.copy_to(others, size=128)
    device.dispatch_indirect(ramp, groups, values=values)
    with device.event("frame"):
        with device.render_pass(several, clear=(0, 0, 0, 1)), query:
            device.draw_indirect(colored, mesh, rhi.IndirectDraws(arguments, 1))
        with device.render_pass(several), device.conditional(query):
            device.draw(colored, mesh)
        with device.render_pass(target, clear=(0, 1, 0, 1)):
            pass
    several.resolve_to(target)
    device.present(target)
    device.finish()
    return [copy.read(), others.read(), values.read(), target.read(), np.array([query.wait()])]


class Commands:
    """Makes OpenCL's commands, and waits for all of them, fail once for each place that enqueues them,
    identified by the innermost calls.

    Attributes:
        fail: whether the next command fails whose place hasn't failed yet.
    """

    NAMES = ("enqueue_nd_range_kernel", "enqueue_copy", "enqueue_fill_buffer", "enqueue_marker")

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._failed: set[object] = set()
        self.fail = False
        monkeypatch.setattr(planes, "_copy_box", partial(self._call, cl.enqueue_copy))
        for name in self.NAMES:
            monkeypatch.setattr(cl, name, partial(self._call, getattr(cl, name)))
        finish: Callable[[cl.CommandQueue], None] = cl.CommandQueue.finish
        monkeypatch.setattr(cl.CommandQueue, "finish", lambda queue: self._call(finish, queue))

    def _call(
        self, command: Callable[..., Any], queue: cl.CommandQueue, *arguments: Any, **named: Any
    ) -> Any:
        frames = [sys._getframe(depth) for depth in range(1, 5)]
        stack = tuple((frame.f_code.co_qualname, frame.f_lineno) for frame in frames)
        if self.fail and stack not in self._failed:
            self._failed.add(stack)
            self.fail = False
            cl.Buffer(queue.context, cl.mem_flags.READ_WRITE, 1 << 60)  # raises what drivers do
        return command(queue, *arguments, **named)


@pytest.mark.parametrize("failures", [6, pytest.param(1, marks=pytest.mark.nightly)])
def test_each_command_may_fail_and_the_device_goes_on(monkeypatch: pytest.MonkeyPatch, failures: int) -> None:
    commands = Commands(monkeypatch)
    errors: list[rhi.DeviceError] = []
    for do in (work, move):
        with rhi.create_device("cl") as device:
            expected = do(device)
        goes_on = True
        with Devices(failures, timing=True) as devices:
            while goes_on:
                device = devices.get()
                commands.fail = True
                try:
                    results = do(device)
                    goes_on = False
                except rhi.DeviceError as error:
                    errors.append(error)
                    results = do(device)
                commands.fail = False
                for image, expected_image in zip(results, expected, strict=True):
                    np.testing.assert_array_equal(image, expected_image)
    assert {error.call for error in errors} >= {
        "Texture.write",
        "Texture.read",
        "Texture.copy_to",
        "Texture.generate_mipmaps",
        "Buffer.write",
        "Buffer.read",
        "Buffer.copy_to",
        "Buffer.clear",
        "device.dispatch",
        "device.dispatch_indirect",
        "a draw",
        "device.draw",
        "device.render_pass",
        "the end of a pass",
        "device.signal",
        "a timestamp in frame",
    }
    assert {error.rule.id for error in errors} == {"device-out-of-memory"}
    assert all(error.tip for error in errors)
    assert {error.site.file for error in errors if error.site} == {__file__}


@pytest.mark.parametrize(
    "make",
    [
        lambda device: device.storage(float, 1 << 37),
        lambda device: device.texture(
            (8192, 8192), rhi.Format.RGBA32F, kind=rhi.TextureKind.D2_ARRAY, layers=256
        ),
        lambda device: device.texture(
            (8192, 8192), rhi.Format.D32FS8, kind=rhi.TextureKind.D2_ARRAY, layers=1024, levels=None
        ),
    ],
)
def test_too_large_allocations_are_refused_and_the_device_goes_on(make: Callable[[rhi.Device], Any]) -> None:
    with rhi.create_device("cl") as device:
        expected = work(device)
        with pytest.raises(rhi.DeviceError, match=r"^\[device-out-of-memory\]") as caught:
            make(device)
        assert "destroy" in caught.value.tip
        assert caught.value.site is not None
        assert caught.value.site.file == __file__
        for image, expected_image in zip(work(device), expected, strict=True):
            np.testing.assert_array_equal(image, expected_image)


@pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")
def test_indices_for_which_there_is_no_memory_leave_nothing_to_collect(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(*_: Any) -> None:
        raise MemoryError

    in_flight, indices = InFlight(), np.zeros(3, np.uint32)
    with monkeypatch.context() as patched:
        patched.setattr(pools, "allocate_pages", fail)
        with pytest.raises(rhi.DeviceError):
            pools.IndexList(in_flight, indices)
    gc.collect()
    assert in_flight.take() == []
    pools.IndexList(in_flight, indices)
    gc.collect()
    assert len(in_flight.take()) == 1
