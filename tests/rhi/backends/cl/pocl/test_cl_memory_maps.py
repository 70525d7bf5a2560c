"""Memory maps: a warning comes before the system's limit, and kernels are refused just below it."""

from __future__ import annotations

import mmap
import time
import warnings

import pytest

import rhi
from rhi.backends.cl.pocl import memory_maps
from rhi.backends.cl.pocl.memory_maps import MapCounter
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle


def load_kernels(first: int, count: int, maps_of_each: int, limit: int) -> tuple[int, int]:
    """Load kernels until one is refused; return the maps at the first warning and at the refusal, 0 for
    none."""
    maps = first
    counter = MapCounter(lambda: maps, lambda: limit)
    warned = 0
    refusal: rhi.DeviceError | None = None
    with warnings.catch_warnings(record=True) as messages:
        warnings.simplefilter("always")
        for _ in range(count):
            try:
                counter.note_kernel()
            except rhi.DeviceError as error:
                refusal = error
                break
            if messages and not warned:
                warned = maps
            maps += maps_of_each
        assert len(messages) <= 1
    if refusal is None:
        return warned, 0
    assert refusal.rule.id == "device-out-of-memory"
    assert str(maps) in str(refusal.given)
    return warned, maps


@pytest.mark.parametrize("first", [300, 20_000, 60_000])
@pytest.mark.parametrize("limit", [65_530, 262_144])
def test_kernels_are_refused_before_the_limit_and_warned_of_before(first: int, limit: int) -> None:
    warned, refused = load_kernels(first, 60_000, 5, limit)
    assert 0.95 * limit <= refused < 0.99 * limit
    assert max(first, 0.8 * limit) <= warned < max(first + 5 * 300, 0.85 * limit)


def test_few_kernels_and_unknown_limits_are_left_alone() -> None:
    assert load_kernels(300, 5_000, 5, 65_530) == (0, 0)
    assert load_kernels(300, 60_000, 5, 0) == (0, 0)


def test_maps_that_others_take_are_counted_too() -> None:
    """However few kernels have come: the first one may be too many, and one after a while."""
    maps = 64_000
    counter = MapCounter(lambda: maps, lambda: 65_530)
    with pytest.raises(rhi.DeviceError):
        counter.note_kernel()
    maps = 300
    counter.note_kernel()
    maps = 64_000
    time.sleep(2 * memory_maps._LEAST_SECONDS)
    with pytest.raises(rhi.DeviceError):
        counter.note_kernel()


def test_counting_takes_little_of_the_time() -> None:
    """With maps that take 10 ms to count, 2,000 kernels in half a second are counted only now and then."""
    counts = 0

    def count() -> int:
        nonlocal counts
        counts += 1
        time.sleep(0.01)
        return 300

    counter = MapCounter(count, lambda: 65_530)
    for _ in range(2_000):
        counter.note_kernel()
    assert 1 <= counts <= 10


def test_maps_are_counted() -> None:
    before = memory_maps.count_maps()
    mappings = [mmap.mmap(-1, 4096, prot=mmap.PROT_READ | (mmap.PROT_WRITE * (i % 2))) for i in range(40)]
    assert 20 <= memory_maps.count_maps() - before <= 60
    for each in mappings:
        each.close()
    assert memory_maps.read_limit() > 1000


def test_a_device_refuses_kernels_by_name_and_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    with rhi.create_device("cl") as device, device.texture((8, 8), rhi.Format.RGBA8) as image:
        program, mesh = device.program(Colored), device.mesh(rectangle(color=(1, 1, 1, 1)))

        def draw() -> int:
            with device.render_pass(image, clear=(0, 0, 0, 0)):
                device.draw(program, mesh)
            return int((image.read()[..., 0] == 255).sum())

        with monkeypatch.context() as patch:
            patch.setattr(memory_maps.COUNTER, "_count", lambda: 64_000)
            patch.setattr(memory_maps.COUNTER, "_limit", lambda: 65_530)
            patch.setattr(memory_maps.COUNTER, "_until_count", 1)
            with pytest.raises(rhi.DeviceError) as refusal:
                draw()
            assert refusal.value.rule.id == "device-out-of-memory"
        memory_maps.COUNTER._until_count = 256
        assert draw() == 64
