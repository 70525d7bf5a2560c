"""Programs that aren't used for long leave memory, and draw and compute the same when they are needed
again."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pyopencl as cl
import pytest

import rhi
from rhi import Device, Format
from rhi.backends.cl.cl_backend import ClBackend
from rhi.backends.cl.pocl import program_residency
from rhi.backends.cl.pocl.kernel_cache import Request
from rhi.backends.cl.pocl.program_residency import ProgramResidency
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle
from rhi.shading import Shader, StorageRW, Struct, Uniform, global_id


class Step(Struct):
    size: float


class AddStep(Shader):
    work_group = (16, 1, 1)
    step: Uniform[Step]
    numbers: StorageRW[float]

    def compute(self) -> None:
        self.numbers[global_id().x] = self.numbers[global_id().x] + self.step.size


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> Iterator[Device]:
    """A device that looks for programs to release at each signal, and keeps those of the last three."""
    monkeypatch.setattr(program_residency, "LIMIT", 0)
    monkeypatch.setattr(program_residency, "AGE", 3)
    monkeypatch.setattr(program_residency, "_OFTEN", 1)
    with rhi.create_device("cl") as device:
        yield device


def residency(device: Device) -> ProgramResidency:
    backend = device._core.backend
    assert isinstance(backend, ClBackend)
    return backend._residency


def wait(device: Device, signals: int) -> None:
    for _ in range(signals):
        device.signal()


def draw(device: Device) -> Any:
    image = device.texture((16, 8), Format.RGBA8)
    with device.render_pass(image, clear=(0, 0, 0, 0)):
        device.draw(device.program(Colored), device.mesh(rectangle(color=(0.2, 0.4, 0.6, 0.8))))
    return image.read()


def test_programs_that_draw_are_released_and_draw_the_same_again(device: Device) -> None:
    image = draw(device)
    assert image.any()
    assert len(residency(device).list_resident()) == 3
    wait(device, 3)
    assert residency(device).list_resident() == []
    np.testing.assert_array_equal(draw(device), image)
    assert {program.builds for program in residency(device).list_resident()} == {2}


def test_a_compute_program_that_was_released_uses_its_earlier_bindings(device: Device) -> None:
    program = device.program(AddStep)
    numbers, step = device.storage(float, np.zeros(16, np.float32)), device.uniform(Step(size=1.5))
    for count in (1, 2):
        device.dispatch(program, 1, numbers=numbers, step=step)
        assert {resident.builds for resident in residency(device).list_resident()} == {count}
        assert numbers.read().tolist() == [1.5 * count] * 16
        wait(device, 3)
        assert residency(device).list_resident() == []


def test_mip_levels_are_made_by_a_program_that_was_released(device: Device) -> None:
    texels = np.arange(64, dtype=np.uint8).reshape(4, 4, 4)
    images = [device.texture((4, 4), Format.RGBA8, levels=3) for _ in range(2)]
    for image in images:
        image.write(texels)
        image.generate_mipmaps()
        wait(device, 3)
    assert residency(device).list_resident() == []
    np.testing.assert_array_equal(*[image.read(level=2) for image in images])
    assert images[0].read(level=2).any()


def test_programs_of_the_latest_signals_are_kept(device: Device) -> None:
    draw(device)
    wait(device, 2)
    draw(device)
    wait(device, 2)
    assert {resident.builds for resident in residency(device).list_resident()} == {1}
    wait(device, 1)
    assert residency(device).list_resident() == []


def test_as_many_programs_as_the_limit_are_kept_however_old_those_used_last(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(program_residency, "LIMIT", 3)
    numbers, step = device.storage(float, np.zeros(16, np.float32)), device.uniform(Step(size=1.0))
    device.dispatch(device.program(AddStep), 1, numbers=numbers, step=step)
    (oldest,) = residency(device).list_resident()
    wait(device, 100)
    assert oldest.is_resident
    draw(device)
    wait(device, 3)
    assert len(residency(device).list_resident()) == 3
    assert not oldest.is_resident


def test_memory_is_handed_back_when_programs_were_released_and_only_then(
    device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    times: list[int] = []
    monkeypatch.setattr(program_residency, "trim_heap", lambda: times.append(residency(device).now))
    draw(device)
    last = residency(device).now
    wait(device, 10)
    assert times == [last + 3]


def test_without_a_folder_of_kernels_programs_stay(device: Device) -> None:
    """They would be built from their source again."""
    residency(device)._releases = False
    draw(device)
    wait(device, 10)
    assert len(residency(device).list_resident()) == 3


def test_programs_that_are_destroyed_are_forgotten(device: Device) -> None:
    before = len(residency(device)._programs)
    program = device.program(AddStep)
    numbers, step = device.storage(float, np.zeros(16, np.float32)), device.uniform(Step(size=1.0))
    device.dispatch(program, 1, numbers=numbers, step=step)  # which builds it, unless the cache has it
    assert len(residency(device)._programs) == before + 1
    program.destroy()
    wait(device, 1)
    device.finish()
    assert len(residency(device)._programs) == before


def test_a_kernel_without_machine_code_has_its_program_built_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    def make(program: tuple[str, ...], name: str) -> str:
        if name not in program:
            raise cl.LogicError("clCreateKernel failed: INVALID_KERNEL_NAME")
        return name

    request, whole = Request("key", (), "source", ("draw", "rare"), False, True), []

    def build(request: Request) -> tuple[str, ...]:
        whole.append(not request.kernels)
        return ("draw", "rare") if whole[-1] else ("draw",)

    monkeypatch.setattr(program_residency.cl, "Kernel", make)
    program = ProgramResidency(releases=True).add(("draw",), request, build)  # type: ignore[arg-type]
    assert (program.find("draw"), whole) == ("draw", [])
    assert (program.find("rare"), program.find("draw"), whole, program.builds) == ("rare", "draw", [True], 2)
    with pytest.raises(cl.Error, match="INVALID_KERNEL_NAME"):
        program.find("unknown")
    assert whole == [True]
