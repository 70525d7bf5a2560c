"""ctypes prototypes made from annotations, and the C heap's setting."""

from __future__ import annotations

import ctypes
import threading
import typing
from concurrent.futures import ThreadPoolExecutor

import pytest

from rhi.backends.gl import entry_points, llvmpipe
from rhi.backends.gl.entry_points import EntryPoints, _prototypes


def _no_function(name: str) -> int:
    return ctypes.cast(ctypes.pythonapi.Py_IsInitialized, ctypes.c_void_p).value or 0


def test_only_entry_points_with_numbers_beyond_32_bits_have_their_arguments_converted() -> None:
    gl = EntryPoints(_no_function)
    assert not gl.BindTextureUnit.argtypes  # type: ignore[attr-defined]
    assert not gl.GetQueryObjectui64v.argtypes  # type: ignore[attr-defined]
    assert gl.DepthRangef.argtypes == (ctypes.c_float, ctypes.c_float)  # type: ignore[attr-defined]
    copy = gl.CopyNamedBufferSubData.argtypes  # type: ignore[attr-defined]
    assert copy == (ctypes.c_int, ctypes.c_int, *[ctypes.c_ssize_t] * 3)


def test_addresses_come_back_whole() -> None:
    gl = EntryPoints(_no_function)
    assert gl.MapNamedBufferRange.restype is ctypes.c_void_p  # type: ignore[attr-defined]
    assert gl.FenceSync.restype is ctypes.c_void_p  # type: ignore[attr-defined]
    assert gl.Enable.restype is None  # type: ignore[attr-defined]


def test_prototypes_are_made_once() -> None:
    assert _prototypes() is _prototypes()


class FakeLibrary:
    def __init__(self) -> None:
        self.calls: list[tuple[int, int]] = []

    def mallopt(self, parameter: int, value: int) -> None:
        self.calls.append((parameter, value))


def test_freed_memory_is_kept_unless_the_user_has_set_it_up(monkeypatch: pytest.MonkeyPatch) -> None:
    library = FakeLibrary()
    monkeypatch.setattr(llvmpipe.ctypes, "CDLL", lambda name: library)
    monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", "1000")
    llvmpipe.keep_freed_memory()
    assert library.calls == []
    monkeypatch.delenv("MALLOC_TRIM_THRESHOLD_")
    llvmpipe.keep_freed_memory()
    assert library.calls == [(-1, 64 << 20), (-3, 32 << 20)]


def test_threads_that_ask_for_the_types_at_once_get_all_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    together = threading.Barrier(2, timeout=20)
    make, begun = entry_points._make_prototype, threading.local()

    def wait_once(hint: object) -> object:
        if not hasattr(begun, "it"):
            begun.it = True
            together.wait()  # the other thread has begun as well, and neither is done
        return make(hint)

    monkeypatch.setattr(entry_points, "_make_prototype", wait_once)
    entry_points._prototypes.cache_clear()
    with ThreadPoolExecutor(2) as threads:
        counts = list(threads.map(lambda _: len(entry_points._prototypes()), range(2)))
    assert counts == [len(typing.get_type_hints(entry_points.EntryPoints))] * 2
