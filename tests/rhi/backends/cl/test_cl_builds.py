"""Kernels that are built quickly and optimised later: the same images, no waits, nothing lost."""

from __future__ import annotations

import logging
import os
import select
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from nightly_reasons import FEWER_CASES
from numpy.typing import NDArray

import rhi
from rhi import BlendFunction, CullMode, DepthFunction, DepthTest, DepthWrite, Device, Format, Program
from rhi.backends.cl import builds, cl_context
from rhi.backends.cl.cl_backend import ClBackend
from rhi.backends.cl.cl_context import KERNELS_ENVIRONMENT
from rhi.backends.cl.cl_programs import ComputeProgram
from rhi.backends.cl.pocl import compiler, kernel_cache, program_residency
from rhi.backends.cl.pocl.compiler import Compiler, Job
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import corners, rectangle
from rhi.conformance.waiting import wait_until
from rhi.contract.descriptors import ProgramDescriptor, Stage, StageText
from rhi.errors import ShaderError
from rhi.shading import Shader, StorageRW, abs, barrier, exp, global_id, local_id, pow, shared, sin

SIZE = (130, 70)


def draw(
    device: Device,
    program: Program[...],
    *states: Any,
    format: Format = Format.RGBA8,
    color: tuple[float, ...] = (0.2, 0.4, 0.6, 0.5),
) -> NDArray[Any]:
    """Draw many small triangles and a rectangle, which use all kernels; return the image."""
    rng = np.random.default_rng(0)
    positions = np.zeros((1500, 4))
    positions[:, :2] = np.repeat(rng.uniform(-1, 1, (500, 2)), 3, axis=0) + rng.uniform(-0.1, 0.1, (1500, 2))
    positions[:, 2:] = 0.5, 1.0
    with (
        device.texture(SIZE, format) as image,
        device.texture(SIZE, Format.D32F) as depth,
        device.mesh(rectangle(depth=0.25, color=color)) as wall,
        device.mesh(corners(positions, color)) as pieces,
    ):
        with (
            device.render_pass(image, depth, clear=(0, 0, 0, 0), clear_depth=0.4),
            device.states(CullMode.NONE, BlendFunction.ALPHA),
            device.states(*states) if states else nullcontext(),
        ):
            device.draw(program, wall)
            device.draw(program, pieces)
        return image.read()


def get_builds(device: Device) -> builds.Builds:
    backend = device._core.backend
    assert isinstance(backend, ClBackend)
    return backend._builds


def get_compute_kernel(device: Device, program: Program[...]) -> ComputeProgram:
    backend = device._core.backend
    assert isinstance(backend, ClBackend)
    return backend._programs[program.id]


@pytest.fixture
def expected(optimised_kernels: None) -> NDArray[Any]:
    with rhi.create_device("cl") as device:
        return draw(device, device.program(Colored))


@pytest.fixture
def device(monkeypatch: pytest.MonkeyPatch) -> Iterator[Device]:
    """A device that finds no optimised kernels in the cache."""
    monkeypatch.delenv(KERNELS_ENVIRONMENT, raising=False)
    monkeypatch.setattr(builds.Builds, "is_cached", lambda self, *_: False)
    with rhi.create_device("cl") as device:
        yield device


STATES: dict[str, tuple[Any, ...]] = {
    "blended": (),
    "added": (BlendFunction.ADDITIVE,),
    "opaque": (BlendFunction.OFF,),
    "nearest": (DepthTest.ON, DepthWrite.ON, DepthFunction.LESS),
    "farthest": (DepthTest.ON, DepthWrite.ON, DepthFunction.GREATER),
    "equal": (DepthTest.ON, DepthWrite.OFF, DepthFunction.EQUAL),
}
FORMATS = (Format.RGBA8, Format.RGBA8_SRGB, Format.RGBA16F, Format.R32F)


@pytest.mark.parametrize("format", FORMATS, ids=lambda format: format.name)
def test_a_new_combination_of_states_and_formats_builds_nothing(device: Device, format: Format) -> None:
    program = device.program(Colored)
    draw(device, program)
    built = get_builds(device).built
    assert get_builds(device).is_quick
    for states in STATES.values():
        draw(device, program, *states, format=format)
    assert get_builds(device).built == built


@pytest.mark.nightly_cases("added", "blended", "equal", "nearest", "opaque", reason=FEWER_CASES)
@pytest.mark.parametrize("states", STATES.values(), ids=STATES)
def test_quick_and_optimised_kernels_draw_the_same_bits(
    monkeypatch: pytest.MonkeyPatch, states: tuple[Any, ...]
) -> None:
    images = []
    for mode in ("quick", "optimised"):
        monkeypatch.setenv(KERNELS_ENVIRONMENT, mode)
        with rhi.create_device("cl") as device:
            monkeypatch.setattr(builds.Builds, "is_cached", lambda self, *_: not self.is_quick)
            assert get_builds(device).is_quick == (mode == "quick")
            images.append(draw(device, device.program(Colored), *states, format=Format.RGBA16F))
    np.testing.assert_array_equal(*images)


class Waves(Shader):
    """Built-ins of PoCL's library, shared memory, a barrier, a loop and a branch that lanes don't take
    together."""

    work_group = (64,)
    numbers: StorageRW[float]
    beside = shared(float, 64)

    def compute(self) -> None:
        here = int(local_id().x)
        x = self.numbers[global_id().x]
        self.beside[here] = sin(x) * exp(-x) + pow(abs(x), 0.3)
        barrier()
        total = 0.0
        for step in range(5):
            neighbour = self.beside[(here + step) % 64]
            total = total + neighbour * x if x > 0.25 * float(step) else total - neighbour / 3.0
        self.numbers[global_id().x] = total


class Harmful(Waves):
    """Given an address where it takes memory, it ends the process."""

    work_group = (32,)


class Backwards(Waves):
    def compute(self) -> None:
        here = global_id().x
        self.numbers[here] = -self.numbers[here]


def test_quick_and_optimised_compute_programs_compute_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    results, options = [], []
    build = cl_context.build_cached

    def note(opened: Any, cache: Any, request: kernel_cache.Request, stored: Any) -> Any:
        options.append(request.options)
        return build(opened, cache, request, stored)

    for mode in ("quick", "optimised"):
        monkeypatch.setenv(KERNELS_ENVIRONMENT, mode)
        with rhi.create_device("cl") as device:
            for module in (cl_context, builds):
                monkeypatch.setattr(module, "build_cached", note)
            results.append(run_waves(device, device.program(Waves)))
            monkeypatch.undo()
    assert options == [cl_context.QUICK, ()]
    np.testing.assert_array_equal(*results)
    assert len(np.unique(results[0])) > 100


def run_waves(device: Device, program: Program[...]) -> NDArray[Any]:
    numbers = device.storage(float, np.linspace(-2, 2, 128, dtype=np.float32))
    device.dispatch(program, 2, numbers=numbers)
    return numbers.read()


def test_a_compute_program_that_was_prepared_waits_for_no_build(
    monkeypatch: pytest.MonkeyPatch, device: Device
) -> None:
    """Another process optimises it, before it is dispatched for the first time; one that wasn't is built
    there."""
    built: list[kernel_cache.Request] = []
    compile = builds.Builds.compile

    def note(owner: builds.Builds, request: kernel_cache.Request, quick: bool = False) -> Any:
        built.append(request)
        return compile(owner, request, quick)

    monkeypatch.setattr(builds.Builds, "compile", note)
    prepared, other = device.program(Waves), device.program(Backwards)
    end = device.prepare(prepared)
    assert device.is_building
    end.result()
    assert wait_until(lambda: not device.is_building)
    first = run_waves(device, prepared)
    assert not built
    run_waves(device, other)
    assert len(built) == 1
    monkeypatch.setenv(KERNELS_ENVIRONMENT, "quick")
    with rhi.create_device("cl") as quick:
        np.testing.assert_array_equal(run_waves(quick, quick.program(Waves)), first)


def test_hot_compute_programs_are_optimised_and_compute_the_same(
    monkeypatch: pytest.MonkeyPatch, device: Device
) -> None:
    monkeypatch.setattr(builds, "HOT", 0)
    program = device.program(Waves)
    first = run_waves(device, program)
    device.finish()
    run_waves(device, program)  # its own time is known by now
    assert wait_until(lambda: not device.is_building)
    compute = get_compute_kernel(device, program)
    for is_quick in (False, False):
        np.testing.assert_array_equal(run_waves(device, program), first)
        assert compute._kernel is not None
        assert compute._kernel.is_quick is is_quick


def test_a_kernel_that_ends_its_compiler_is_left_as_it_is_and_the_next_is_optimised(
    device: Device,
) -> None:
    program, other = device.program(Harmful), device.program(Backwards)
    launch = builds.Launch(
        ("compute",), ((bytes(8), (0,)), 0)
    )  # an address that isn't memory of the driver's
    get_compute_kernel(device, program)._optimisation.launch = launch  # type: ignore[union-attr]
    device.prepare([rhi.DrawPlan(program), rhi.DrawPlan(other)]).result()
    prepared = [
        get_compute_kernel(device, compute_program)._optimisation.program
        for compute_program in (program, other)
    ]  # type: ignore[union-attr]
    assert prepared[0] is None
    assert prepared[1] is not None
    assert len(np.unique(run_waves(device, program))) > 100


def test_hot_kernels_are_optimised_and_draw_the_same(
    monkeypatch: pytest.MonkeyPatch, device: Device, expected: NDArray[Any], caplog: pytest.LogCaptureFixture
) -> None:
    taken: list[str] = []
    take = builds.Kernel._take

    def note(kernel: builds.Kernel, program: Any) -> None:
        taken.append(kernel._name)
        take(kernel, program)

    monkeypatch.setattr(builds, "HOT", 0)
    monkeypatch.setattr(builds.Kernel, "_take", note)
    program = device.program(Colored)
    with caplog.at_level(logging.INFO, "rhi.kernels"):
        np.testing.assert_array_equal(draw(device, program), expected)
        deadline = time.monotonic() + 120
        while get_builds(device)._waiting and time.monotonic() < deadline:
            time.sleep(0.01)
    for _ in range(2):  # the first takes them
        np.testing.assert_array_equal(draw(device, program), expected)
    assert sorted(taken) == sorted(
        ["measure", "stage", *["prefix", "raster", "scatter", "set_up", "transform"] * 2]
    )
    done, begun = caplog.records[-1].args  # type: ignore[misc]
    assert done == begun
    assert begun >= 6


def test_heat_is_the_time_of_launches(monkeypatch: pytest.MonkeyPatch, device: Device) -> None:
    events: list[Any] = []
    enqueue = builds.cl.enqueue_nd_range_kernel

    def note(queue: Any, kernel: Any, *args: Any) -> Any:
        event = enqueue(queue, kernel, *args)
        events.extend([event] if kernel.function_name == "raster" else [])
        return event

    monkeypatch.setattr(builds.cl, "enqueue_nd_range_kernel", note)
    monkeypatch.setattr(builds, "HOT", float("inf"))
    program = device.program(Colored)
    for _ in range(4):
        draw(device, program)  # and read, so that each launch has ended before the next
    (raster,) = device.backend_as(ClBackend)._rasteriser._programs[program.id]._raster.values()
    assert raster._optimisation is not None
    taken = [1e-9 * (event.profile.end - event.profile.start) for event in events]
    assert raster._optimisation.heat == pytest.approx(sum(taken[:-1]))  # the last hasn't been looked at
    assert raster._optimisation.heat > 0


def test_a_single_launch_in_flight_is_timed_for_all() -> None:
    event = SimpleNamespace(status=3, profile=SimpleNamespace(start=1_000, end=4_000))
    event.get_info = lambda _: event.status
    program, other = (
        SimpleNamespace(prepare=lambda *_: SimpleNamespace(set_args=lambda batch: None)),
        object(),
    )
    seconds: list[float] = []
    optimisation = SimpleNamespace(
        program=None,
        warm=lambda items, more: seconds.append(more),
        progress=SimpleNamespace(note_launch=lambda *_: None),
    )
    kernel = builds.Kernel(program, "raster", optimisation)  # type: ignore[arg-type]
    with pytest.MonkeyPatch.context() as patch:
        launches = iter([event, other, other, event])
        patch.setattr(builds.cl, "enqueue_nd_range_kernel", lambda *args: next(launches))
        for items in (10, 20, 30):
            kernel.launch(None, 0, items)
        event.status = 0
        kernel.launch(None, 0, 10)
        assert seconds == pytest.approx([0, 0, 0, 3e-6 * 6])
        event.status = -5  # that launch failed
        assert kernel._take_time() == 0
        assert kernel._timed is None


def test_the_kernels_that_took_most_time_are_optimised_first(device: Device) -> None:
    owner, request = get_builds(device), get_builds(device).request("", ())
    jobs = [builds.Optimisation(request, builds.Launch((), ()), owner) for _ in range(3)]
    owner._jobs += [(job, Future()) for job in jobs]
    jobs[0].heat, jobs[1].heat, jobs[2].heat = 0.5, 2.0, 1.0  # they get warm while they wait
    assert [owner._wait_for_job()[0] for _ in jobs] == [jobs[1], jobs[2], jobs[0]]  # type: ignore[index]


def test_kernels_that_are_not_hot_stay_as_they_are(device: Device) -> None:
    for _ in range(3):
        draw(device, device.program(Colored))
    assert not get_builds(device)._threads


def test_kernels_from_disk_are_not_reported(
    caplog: pytest.LogCaptureFixture, expected: NDArray[Any], optimised_kernels: None
) -> None:
    with caplog.at_level(logging.INFO, "rhi.kernels"), rhi.create_device("cl") as device:
        np.testing.assert_array_equal(draw(device, device.program(Colored)), expected)
    assert not caplog.records


@pytest.mark.parametrize("limit", [program_residency.LARGE_GRID, 1])
def test_launches_that_there_is_no_machine_code_of_are_compiled(
    monkeypatch: pytest.MonkeyPatch, expected: NDArray[Any], optimised_kernels: None, limit: int
) -> None:
    monkeypatch.setattr(program_residency, "LARGE_GRID", limit)
    with rhi.create_device("cl") as device:
        np.testing.assert_array_equal(draw(device, device.program(Colored)), expected)
        used = [program for program in get_builds(device)._context.programs.list_resident() if program._types]
        assert {program._is_whole for program in used} == {limit == 1}


@pytest.mark.parametrize("error", [OSError("no more processes"), MemoryError(), EOFError()])
def test_without_another_process_the_kernels_at_hand_remain(
    monkeypatch: pytest.MonkeyPatch, device: Device, expected: NDArray[Any], error: Exception
) -> None:
    def fail(*args: Any) -> None:
        raise error

    monkeypatch.setattr(builds, "HOT", 0)
    monkeypatch.setattr(Compiler, "__init__" if isinstance(error, OSError) else "compile", fail)
    monkeypatch.setattr(kernel_cache.KernelCache, "contains", lambda *args: False)
    program = device.program(Colored)
    for _ in range(3):
        np.testing.assert_array_equal(draw(device, program), expected)


def test_closing_a_device_does_not_wait_for_kernels_that_are_optimised(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The other processes are halted once they have their jobs: to wait for them would take until they are
    killed."""
    processes: list[subprocess.Popen[bytes]] = []
    halted: list[subprocess.Popen[bytes]] = []
    start = Compiler.__init__

    def note(self: Compiler, *arguments: Any) -> None:
        start(self, *arguments)
        processes.append(self._process)

    def halt(pipes: list[Any], *arguments: Any) -> Any:
        (process,) = (process for process in processes if process.stdout is pipes[0])
        process.send_signal(signal.SIGSTOP)
        halted.append(process)
        return select.select(pipes, *arguments)

    monkeypatch.setattr(Compiler, "__init__", note)
    monkeypatch.setattr(compiler, "select", SimpleNamespace(select=halt))
    monkeypatch.delenv(KERNELS_ENVIRONMENT, raising=False)
    monkeypatch.setattr(builds, "HOT", 0)
    monkeypatch.setattr(builds.Builds, "is_cached", lambda self, *_: False)
    monkeypatch.setattr(kernel_cache.KernelCache, "contains", lambda *args: False)
    killer = threading.Timer(20.0, lambda: [process.kill() for process in processes])
    killer.start()
    try:
        with rhi.create_device("cl") as device:
            draw(device, device.program(Colored))
            assert get_builds(device)._waiting
            assert wait_until(lambda: bool(halted))
        assert all(process.poll() is None for process in processes)
    finally:
        killer.cancel()
        for process in processes:
            process.kill()


def test_a_process_that_refuses_a_kernel_goes_on_with_others(device: Device) -> None:
    compiler = Compiler(get_builds(device)._context.device)
    job = Job("kernel void k(ulong address) {}", (), ("k",), ((bytes(64), (0,)),), "")
    try:
        with pytest.raises(ValueError, match="refused"):
            compiler.compile(job._replace(source="undeclared"))
        compiler.compile(job)
    finally:
        compiler.close()


@pytest.mark.parametrize("stage", [Stage.VERTEX, Stage.FRAGMENT])
@pytest.mark.parametrize("mode", ["quick", "optimised"])
def test_source_that_the_driver_refuses_raises_at_the_draw_that_uses_it(
    monkeypatch: pytest.MonkeyPatch, stage: Stage, mode: str
) -> None:
    monkeypatch.setenv(KERNELS_ENVIRONMENT, mode)
    with rhi.create_device("cl") as device:
        good = device.program(Colored)
        descriptor = good.descriptor

        def emit(language: str, requested: Stage) -> StageText:
            emitted = descriptor.emit(language, requested)
            if requested is not stage:
                return emitted
            text = "int undeclared(void) {\n    return nothing;\n}\n" + emitted.text
            return StageText(text, tuple(("bad.py", line) for line in (10, 20, 30)))

        bad = device.program(
            ProgramDescriptor(
                "Bad",
                descriptor.stages,
                descriptor.bindings,
                descriptor.attributes,
                descriptor.outputs,
                descriptor.work_group,
                emit,
                varyings=descriptor.varyings,
            )
        )
        image = device.texture(SIZE, Format.RGBA8)
        mesh = device.mesh(rectangle())
        with device.render_pass(image, clear=(0, 1, 0, 1)):
            with pytest.raises(ShaderError, match="nothing") as caught:
                device.draw(bad, mesh)
            device.draw(good, mesh)
        assert caught.value.rule.id == "shader-driver"
        assert f"its {stage.value} stage" in caught.value.call
        assert str(caught.value.site) == "bad.py:20"
        assert image.read().min() == 255  # the good draw
        assert draw(device, good).any()


def test_a_lock_that_is_held_leaves_no_alarm_behind(tmp_path: Path) -> None:
    """It would end the compiler in the middle of a kernel."""
    before = signal.getsignal(signal.SIGALRM)
    try:
        lock = compiler._lock(str(tmp_path / "lock"))
        assert lock is not None
        assert signal.alarm(0) == 0
        lock.close()
    finally:
        signal.signal(signal.SIGALRM, before)


def test_a_build_in_the_calling_thread_is_a_wait_and_a_program_from_the_cache_is_none(
    monkeypatch: pytest.MonkeyPatch, device: Device
) -> None:
    labels: list[str] = []
    owner = get_builds(device)
    waiting = owner.progress.waiting

    def note(label: str) -> Any:
        labels.append(label)
        return waiting(label)

    monkeypatch.setattr(owner.progress, "waiting", note)
    request = owner.request(f"kernel void raster(global int *memory) {{ memory[0] = {os.getpid()}; }}", ())
    for _ in range(2):
        owner.compile(request)
        assert labels == ["a program"]


def test_the_first_launch_of_a_quick_kernel_is_a_wait(
    monkeypatch: pytest.MonkeyPatch, device: Device
) -> None:
    labels: list[str] = []
    monkeypatch.setattr(get_builds(device).progress, "note_launch", lambda label, event: labels.append(label))
    for _ in range(2):
        draw(device, device.program(Colored))
        assert sorted(labels) == ["prefix", "raster", "scatter", "set_up", "transform"]
        labels = labels[:5]
