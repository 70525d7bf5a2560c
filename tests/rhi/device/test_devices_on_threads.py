"""Devices of one backend or several that work at the same time on threads of their own.

All results are compared bit by bit with those of the same work, done one after another.
"""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
import threading
import warnings
from pathlib import Path
from types import ModuleType
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import pytest
from nightly_reasons import FEWER_CASES, ONLY_KERNELS
from nights import rotate_seed
from threads_kit import WORKS, compare_with_serial, make_shaders, on_threads

import rhi
import rhi.shading as sl
from rhi.contract.descriptors import Stage
from rhi.contract.states import Scissor
from rhi.errors.array_likes import is_masked
from rhi.errors.shared_caches import cache_once
from rhi.shading import compile as compilation

TEAMS = {
    "null": ("null",) * 4,
    "gl": ("gl",) * 3,
    "wgpu": ("wgpu",) * 3,
    "cl": ("cl",) * 2,
    "all": ("gl", "cl", "wgpu", "null"),
}
QUICK = tuple(name for name in WORKS if name != "render")


@pytest.fixture(params=TEAMS)
def team(request: pytest.FixtureRequest) -> tuple[str, ...]:
    """The backends of some threads, all of which work on this machine."""
    team = TEAMS[request.param]
    for name in sorted(set(team)):
        try:
            rhi.create_device(name).close()
        except rhi.DeviceError as error:
            pytest.skip(f"{name}: {error.given}")
    return team


@pytest.mark.nightly_cases("cl", "wgpu", "all", reason=ONLY_KERNELS)
def test_devices_on_threads_compute_and_draw_as_without_threads(team: tuple[str, ...]) -> None:
    compare_with_serial(team, QUICK, trials=2, seed=1)


@pytest.mark.nightly
def test_random_work_on_threads_equals_serial_work(team: tuple[str, ...]) -> None:
    compare_with_serial(team, tuple(WORKS), trials=12, seed=rotate_seed(7))


def test_threads_compile_a_shader_once() -> None:
    for seed in range(5):
        shaders = make_shaders()

        def compile_all(shaders: Any = shaders) -> tuple[Any, ...]:
            descriptor = sl.compile_shader(shaders.Counted)
            texts = (descriptor.emit(language, Stage.COMPUTE) for language in ("numpy", "opencl16", "wgsl"))
            return descriptor, *texts

        results = on_threads([compile_all] * 4, seed, share=0.05)
        assert all(isinstance(result, tuple) for result in results), results
        assert {tuple(map(id, result)) for result in results} == {tuple(map(id, results[0]))}


def test_threads_construct_the_first_value_of_a_struct_at_once() -> None:
    for seed in range(20):
        settings = make_shaders().Settings

        def construct(settings: Any = settings) -> Any:
            return settings(tint=(1, 2, 3, 4), shift=(5, 6), count=7).to_bytes()

        results = on_threads([construct] * 4, seed, share=0.3)
        assert all(isinstance(result, bytes) for result in results), results
        assert len(set(results)) == 1


def test_equal_states_of_threads_are_the_same_object() -> None:
    for seed in range(30):
        states = on_threads([lambda seed=seed: Scissor(seed + 90_001, 2, 3, 4)] * 4, seed, share=0.5)
        assert len(set(map(id, states))) == 1


def test_a_function_that_makes_classes_is_called_once_by_all_threads() -> None:
    calls: list[int] = []

    @cache_once
    def make(number: int, *, name: str = "") -> type:
        calls.append(number)
        return type(f"Made{number}{name}", (), {})

    assert len(set(on_threads([lambda: make(1)] * 8))) == 1
    assert make(1) is not make(2)
    assert make(1, name="a") is make(1, name="a") is not make(1)
    assert calls == [1, 2, 1]
    with pytest.raises(ZeroDivisionError):
        cache_once(lambda: 1 // 0)()


def test_a_module_that_another_thread_imports_has_no_names_yet(monkeypatch: pytest.MonkeyPatch) -> None:
    assert is_masked(np.ma.masked_array([1.0]))
    monkeypatch.setitem(sys.modules, "numpy.ma", ModuleType("numpy.ma"))
    monkeypatch.setitem(sys.modules, "PIL.Image", ModuleType("PIL.Image"))
    monkeypatch.setitem(sys.modules, "asyncio", ModuleType("asyncio"))
    assert not is_masked(np.zeros(3))
    with rhi.create_device("null") as device:
        assert (device.texture(np.ones((2, 2, 4), np.uint8), rhi.Format.RGBA8).read() == 1).all()


def test_threads_leave_the_environment_unchanged(monkeypatch: pytest.MonkeyPatch) -> None:
    adapters = pytest.importorskip("rhi.backends.wgpu.adapters")
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(adapters.wgpu.gpu, "enumerate_adapters_sync", list)
    for seed in range(20):
        results = on_threads([lambda: adapters._list_adapters("")] * 4, seed, share=0.3)
        assert results == [([], "")] * 4
        assert "WAYLAND_DISPLAY" not in os.environ


def test_builds_on_threads_leave_the_filters_of_warnings_unchanged(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    context = pytest.importorskip("rhi.backends.cl.cl_context")
    monkeypatch.setattr(context, "build_again", lambda *arguments: threading.get_ident())
    before = list(warnings.filters)
    for seed in range(20):
        idents = on_threads([lambda: context.build(None, "", [])] * 4, seed, share=0.3)
        assert all(isinstance(ident, int) for ident in idents)
        assert warnings.filters == before


@pytest.mark.nightly_cases(reason=FEWER_CASES)
@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu"])
def test_threads_may_open_the_first_devices_of_a_process_at_once(backend: str) -> None:
    program = f"""
import threading, rhi
start, sizes = threading.Barrier(4), []
def open_device():
    start.wait()
    with rhi.create_device({backend!r}) as device:
        sizes.append(device.buffer(4).size)
threads = [threading.Thread(target=open_device) for _ in range(4)]
for thread in threads: thread.start()
for thread in threads: thread.join()
print(*sizes)
"""
    try:
        rhi.create_device(backend).close()
    except rhi.DeviceError as error:
        pytest.skip(f"{backend}: {error.given}")
    for _ in range(3):
        run = subprocess.run(
            [sys.executable, "-c", program], capture_output=True, text=True, timeout=300, encoding="utf-8"
        )
        assert (run.returncode, run.stdout.split()) == (0, ["4"] * 4), run.stderr


_RELOADED = """
from rhi.shading import FullScreen, function, vec4

@function
def shade(x: float) -> vec4:
    return vec4(x, NUMBER, 0.0, 1.0)

class Plain(FullScreen):
    def fragment(self) -> vec4:
        return shade(NUMBER)
"""


def test_a_thread_that_compiles_during_a_reload_sees_a_whole_text(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def text(number: int) -> str:
        return _RELOADED.replace("NUMBER", f"{number}.125")

    # A reload looks at every shader that this process has compiled: here at none of other tests.
    monkeypatch.setattr(compilation, "_compiled", WeakKeyDictionary())
    (tmp_path / "reloaded_by_a_thread.py").write_text(text(100), encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    module = importlib.import_module("reloaded_by_a_thread")

    def reload() -> set[str]:
        with rhi.create_device("null") as device:
            device.program(module.Plain)
            reloader = rhi.Reloader(device)
            for number in range(101, 120):
                reloader.reload(module, text(number))
        return set()

    def compile_often() -> set[str]:
        texts = (sl.compile_shader(module.Plain).emit("glsl", Stage.FRAGMENT).text for _ in range(60))
        return {" ".join(sorted(set(re.findall(r"1\d\d\.125", text)))) for text in texts}

    for seed in range(3):
        numbers = on_threads([reload, compile_often, compile_often], seed, share=0.03)
        assert all(isinstance(each, set) for each in numbers), numbers
        assert all(len(each) == 7 for each in set.union(*numbers)), numbers
