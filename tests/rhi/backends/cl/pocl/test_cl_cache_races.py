"""Two processes that share a folder of compiled kernels, interleaved at every step of the first.

The steps are the calls that touch files. At one of them, the other process does something as a whole: it trims,
builds, or finds damage. A model of PoCL says what would end the first process. So no test depends on timing.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pyopencl as cl
import pytest
from nightly_reasons import FEWER_CASES

from rhi.backends.cl import cl_context
from rhi.backends.cl.pocl import binaries, compiler, kernel_cache, leases, program_residency
from rhi.backends.cl.pocl.kernel_cache import KernelCache, Request
from rhi.backends.cl.pocl.memory_maps import MapCounter
from rhi.contract import trust

fcntl = pytest.importorskip("fcntl")

STEPS: Final = (
    *(
        (Path, name)
        for name in ("read_bytes", "write_bytes", "unlink", "mkdir", "exists", "is_file", "replace")
    ),
    *((Path, name) for name in ("hardlink_to", "glob", "rglob", "touch", "iterdir", "samefile")),
    (shutil, "rmtree"),
    (os, "utime"),
    (os, "scandir"),
)
"""The calls at which the other process may act before."""
HEADER: Final = b"poclbin\0" + bytes(8) + b"\x09\0\0\0"
KERNEL: Final = "draw"
SO: Final = f"{KERNEL}/{binaries.SMALL_GRID}/{KERNEL}.so"


class DriverDeathError(AssertionError):
    """The driver would have ended the process."""


@dataclass
class Program:
    """A program of the model: of LLVM code in a folder of its own, or a bare binary of kernels in a folder."""

    folder: Path
    is_bare: bool
    has_code: bool = False


class Driver:
    """A model of PoCL: what it writes, and where it ends the process."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def build(self, _: object, text: str | bytes, options: object) -> Program:
        content = text.encode() if isinstance(text, str) else text
        if content.startswith(HEADER[:7]):
            name = content[len(HEADER) + 16 :].partition(b"\0")[0].decode()
            return Program(self.root / name, True)
        folder = self.root / "AB" / hashlib.sha256(content).hexdigest()[:20]
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if not (folder / "program.bc").exists():
                (folder / "program.bc").write_bytes(b"bc " + content)
            (folder / "last_accessed").touch()
        except OSError as error:
            raise DriverDeathError(f"the folder vanished while a program was built: {error}") from error
        return Program(folder, False)

    def compile(self, context: object, source: str, options: object) -> Any:
        program = self.build(context, source, options)

        class Compiled:
            def get_info(self, _: object) -> list[bytes]:
                return [HEADER + b"rest"]

        assert program
        return Compiled()

    def launch(self, program: Program) -> None:
        """Launch with more items than ever before: machine code is looked for, or generated."""
        path = program.folder / SO
        if path.is_file():
            return
        if program.is_bare:
            raise DriverDeathError("Generic WG function binary does not exist")
        if not program.folder.exists():
            raise DriverDeathError("the folder vanished before machine code was written")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary = program.folder / f"tempfile_{os.urandom(4).hex()}"
            temporary.write_bytes(b"machine code")
            temporary.replace(path)
        except OSError as error:
            raise DriverDeathError(f"the folder vanished while machine code was written: {error}") from error


class Process:
    """A process that uses the folder: its cache, its driver, and its leases."""

    def __init__(self, root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.cache = KernelCache(root, "driver")
        self.driver = Driver(root)
        self._leases: dict[Path, tuple[int, str, int]] = {}
        self._patch = monkeypatch

    @contextmanager
    def running(self) -> Iterator[None]:
        with self._patch.context() as patch:
            patch.setattr(leases, "_leases", self._leases)
            patch.setattr(cl_context, "build_again", self.driver.build)
            patch.setattr(cl_context, "build", self.driver.build)
            patch.setattr(cl_context, "compile_only", self.driver.compile)
            yield

    def end(self) -> None:
        """End as processes do: the system releases the locks."""
        for _, _, descriptor in self._leases.values():
            os.close(descriptor)
        self._leases.clear()

    def request(self) -> Request:
        return self.cache.request("source", (), (KERNEL,))

    def build(self) -> Program:
        request = self.request()
        stored = self.cache.find(request.key)
        program: Any = cl_context.build_cached(None, self.cache, request, stored)  # type: ignore[arg-type]
        return program

    def live(self) -> None:
        """Build a program, or take it from the folder, launch it, and close the device."""
        assert self.cache._folder
        (self.cache._folder / "rhi").mkdir(parents=True, exist_ok=True)  # as `choose_folder` does
        program = self.build()
        for _ in range(2):
            if program.is_bare and not self.cache.has_code(self.request().key, KERNEL):
                program = cl_context.build_cached(None, self.cache, self.request(), None)  # type: ignore
            self.driver.launch(program)
        self.cache.finish()


def trim(other: Process) -> None:
    """Remove all programs that nobody uses."""
    other.cache._written.add("nothing")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kernel_cache, "LIMIT", 0)
        other.cache.finish()


def trim_after_a_day(other: Process) -> None:
    """Remove locks that are as old as a day, too."""
    for lock in other.cache._folder.glob("rhi/*.lock") if other.cache._folder else ():
        with suppress(OSError):
            os.utime(lock, (1e9, 1e9))
    trim(other)


def build_and_end(other: Process) -> None:
    """Use the program for a while, and end."""
    other.live()
    other.end()


def find_damage(other: Process) -> None:
    """Find that machine code is damaged, which a disk has done."""
    assert other.cache._folder
    for path in other.cache._folder.glob(f"AB/*/{SO}"):
        path.unlink()
        path.write_bytes(b"damaged")
    other.cache.find(other.request().key)


def refuse(other: Process) -> None:
    """Have the driver refuse the program, as one without memory does."""
    other.cache.forget(other.request().key)


ACTIONS: Final = (trim, trim_after_a_day, build_and_end, find_damage, refuse)


class Steps:
    """Counts the calls that touch files, and acts before one of them."""

    def __init__(self, number: int, act: Callable[[], None]) -> None:
        self.count = 0
        self._number = number
        self._act = act
        self._inside = False

    def note(self) -> None:
        if self._inside:
            return
        self.count += 1
        if self.count == self._number:
            self._inside = True
            try:
                self._act()
            finally:
                self._inside = False


@contextmanager
def stepping(steps: Steps) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        for owner, name in STEPS:
            patch.setattr(owner, name, _watch(getattr(owner, name), steps))
        yield


def _watch(original: Callable[..., Any], steps: Steps) -> Callable[..., Any]:
    def call(*arguments: Any, **named: Any) -> Any:
        steps.note()
        return original(*arguments, **named)

    return call


def interleave(
    root: Path, monkeypatch: pytest.MonkeyPatch, action: Callable[[Process], None], number: int, filled: bool
) -> int:
    """Run a process with the other's action before one of its steps; return the number of its steps.

    Afterwards the folder must be sound: a third process builds and launches, and the next finds the program.
    """
    root.mkdir()
    first, other, *later = (Process(root, monkeypatch) for _ in range(4))
    if filled:
        with later[0].running():
            later[0].live()
        later[0].end()

    def act() -> None:
        with other.running():
            action(other)

    steps = Steps(number, act)
    with first.running(), stepping(steps):
        first.live()
    first.end()
    other.end()
    for process in later:
        with process.running():
            process.live()
            if process is later[-1]:
                assert process.cache.contains(process.request().key, [KERNEL])
        process.end()
    assert not [path for path in (root / "rhi").iterdir() if path.suffix.isdecimal()], "half written"
    return steps.count


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A process that waits for a lock of the other, which is stopped, gives it up soon."""
    monkeypatch.setattr(kernel_cache, "PATIENCE", 0.0)
    monkeypatch.setattr(kernel_cache, "_IMPATIENCE", 0.0)
    monkeypatch.setattr(trust, "read_key", lambda: b"key")


@pytest.mark.usefixtures("impatient")
@pytest.mark.nightly_cases(
    "trim-*",
    "trim_after_a_day-empty",
    "build_and_end-*",
    "find_damage-empty",
    "refuse-filled",
    reason=FEWER_CASES,
)
@pytest.mark.parametrize("filled", [False, True], ids=["empty", "filled"])
@pytest.mark.parametrize("action", ACTIONS, ids=lambda action: action.__name__)
def test_no_interleaving_ends_a_process_or_harms_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, action: Callable[[Process], None], filled: bool
) -> None:
    count = interleave(tmp_path / "0", monkeypatch, action, 0, filled)
    assert count > 20
    failures = []
    for number in range(1, count + 1):
        try:
            interleave(tmp_path / str(number), monkeypatch, action, number, filled)
        except Exception as error:
            failures.append(f"before step {number} of {count}: {error!r}")
        shutil.rmtree(tmp_path / str(number))
    assert failures == []


@pytest.mark.usefixtures("impatient")
@pytest.mark.nightly_cases("empty", reason=FEWER_CASES)
@pytest.mark.parametrize("filled", [False, True], ids=["empty", "filled"])
def test_a_folder_emptied_by_hand_raises_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, filled: bool
) -> None:
    """PoCL itself may end the process then, but rhi's own steps don't raise."""

    def empty(other: Process) -> None:
        assert other.cache._folder
        for path in other.cache._folder.iterdir():
            shutil.rmtree(path, ignore_errors=True)

    count = interleave(tmp_path / "0", monkeypatch, trim, 0, filled)
    failures = []
    for number in range(1, count + 1):
        try:
            interleave(tmp_path / str(number), monkeypatch, empty, number, filled)
        except DriverDeathError:
            pass
        except Exception as error:
            failures.append(f"before step {number} of {count}: {error!r}")
        shutil.rmtree(tmp_path / str(number))
    assert failures == []


@pytest.mark.usefixtures("impatient")
def test_the_model_sees_a_folder_that_vanishes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The control: without leases, trimming ends the other process."""
    monkeypatch.setattr(leases, "list_held", lambda folder: set())
    deaths = 0
    for number in range(1, 60):
        try:
            interleave(tmp_path / str(number), monkeypatch, trim, number, False)
        except DriverDeathError:
            deaths += 1
    assert deaths > 0


@pytest.mark.usefixtures("impatient")
def test_a_device_whose_probe_another_process_trims_keeps_its_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Between the look-up of the program by which a device is tried, and its build."""
    (tmp_path / "rhi").mkdir()
    first, other = (Process(tmp_path, monkeypatch) for _ in range(2))
    with other.running():
        other.live()
    other.end()
    with first.running():
        request = first.request()
        stored = first.cache.find(request.key)
        assert stored is not None
        trim(other)
        assert not first.cache.is_recorded(request.key)
        with first.cache.watch_use(request.key):
            cl_context.build_cached(None, first.cache, request, stored)  # type: ignore[arg-type]
        assert first.cache.works
        assert first.cache.is_recorded(request.key)
    first.end()


# -- locks and leases ----------------------------------------------------------------------------------------


def remove_at_first_lock(path: Path, monkeypatch: pytest.MonkeyPatch, module: Any) -> None:
    """Remove the file once, between being opened and being locked."""
    original, removed = module.flock, []

    def flock(file: Any, operation: int) -> None:
        if not removed:
            removed.append(path)
            path.unlink()
        original(file, operation)

    monkeypatch.setattr(module, "flock", flock)


def test_a_lock_of_a_file_that_is_removed_meanwhile_keeps_others_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "key.lock"
    remove_at_first_lock(path, monkeypatch, fcntl)
    lock = trust.lock(str(path), 0.5)
    assert lock is not None
    with lock, pytest.raises(TimeoutError):
        trust.lock(str(path), 0.0)
    again = trust.lock(str(path), 0.0)  # the control: it is free now
    assert again is not None
    again.close()


def test_so_does_that_of_the_process_that_compiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "key.lock"
    remove_at_first_lock(path, monkeypatch, fcntl)
    lock = compiler._lock(str(path))
    assert lock is not None
    with lock, pytest.raises(TimeoutError):
        trust.lock(str(path), 0.0)
    assert compiler._lock(str(tmp_path / "no folder" / "key.lock")) is None


def test_a_name_that_is_taken_for_stale_just_now_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another process removes the folder between its creation and its lock, once."""
    original, removed = trust.lock, []

    def lock(path: str, patience: float) -> Any:
        if not removed:
            removed.append(path)
            shutil.rmtree(Path(path).parent)
        return original(path, patience)

    monkeypatch.setattr(trust, "lock", lock)
    monkeypatch.setattr(leases, "_leases", {})
    name = leases.take(tmp_path)
    assert name is not None
    assert Path(removed[0]).parent.name != name
    assert (tmp_path / binaries.LINKS / name / "begun").exists()


def test_threads_take_one_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second comes when the first has seen that there is none."""
    original, looked, names = leases.remove_stale, threading.Event(), []

    def remove_stale(folder: Path) -> None:
        original(folder)
        if not looked.is_set():
            looked.set()
            time.sleep(0.2)

    monkeypatch.setattr(leases, "remove_stale", remove_stale)
    monkeypatch.setattr(leases, "_leases", {})
    threads = [threading.Thread(target=lambda: names.append(leases.take(tmp_path))) for _ in range(2)]
    threads[0].start()
    assert looked.wait(20)
    threads[1].start()
    for thread in threads:
        thread.join()
    assert len(set(names)) == 1
    assert len(list((tmp_path / binaries.LINKS).iterdir())) == 1


# -- records -------------------------------------------------------------------------------------------------


def test_a_program_of_other_code_is_not_recorded_for_this_one(tmp_path: Path) -> None:
    """The code was lost, and another process made it again under another mark."""
    (tmp_path / "rhi").mkdir()
    cache = KernelCache(tmp_path, "driver")
    for name, mark in (("old", "aa"), ("new", "bb")):
        (tmp_path / "AB" / name).mkdir(parents=True)
        (tmp_path / "AB" / name / "program.bc").write_bytes(f"linked rhi_{mark}_key".encode())
        (tmp_path / "rhi" / "key.code").write_bytes(cache.seal("key", f"rhi_{mark}_key".encode()))
        cache.record("key")
        assert cache.find("key") is not None
        program, *_ = kernel_cache._read_record(tmp_path, tmp_path / "rhi" / "key")
        assert program == tmp_path / "AB" / name


@pytest.mark.parametrize("name", ["../../mine/kept", "a/../../../mine/kept", "/kept"])
def test_a_damaged_file_outside_of_the_program_is_left_alone(tmp_path: Path, name: str) -> None:
    folder = tmp_path / "kernels"
    for path in (folder / "rhi", folder / "AB/key", tmp_path / "mine"):
        path.mkdir(parents=True)
    (tmp_path / "mine" / "kept").write_bytes(b"kept")
    (folder / "rhi" / "key").write_text(
        f'{{"folder": "AB/key", "files": {{"{name}": "0"}}}}', encoding="utf-8"
    )
    cache = KernelCache(folder, "driver")
    cache.hold("key")
    assert not cache.contains("key")
    assert (tmp_path / "mine" / "kept").read_bytes() == b"kept"


def test_of_a_program_in_use_only_damaged_files_are_removed(tmp_path: Path) -> None:
    """Its process may be writing in the folder. One that nobody uses goes as a whole."""
    for key, stays in (("used", True), ("unused", False)):
        (tmp_path / "rhi").mkdir(exist_ok=True)
        cache = KernelCache(tmp_path, "driver")
        program = tmp_path / "AB" / key
        (program / SO).parent.mkdir(parents=True)
        (program / "program.bc").write_bytes(f"rhi_built_{key}".encode())
        (program / SO).write_bytes(b"machine code")
        cache.record(key)
        assert cache.contains(key, [KERNEL])
        if stays:
            cache.hold(key)
        (program / SO).write_bytes(b"damaged")
        assert not cache.contains(key)
        assert (program / "program.bc").exists() == stays
        assert not (program / SO).exists()


# -- launches ------------------------------------------------------------------------------------------------


def test_machine_code_is_looked_for_as_soon_as_any_device_has_many_kernels(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """PoCL's table is one for the process, so a device that makes nothing new is concerned, too."""
    counter = MapCounter(lambda: 300, lambda: 65_530)
    monkeypatch.setattr(program_residency, "COUNTER", counter)
    monkeypatch.setattr(program_residency.cl, "Kernel", lambda program, name: name)
    looks = []

    def has_code(name: str) -> bool:
        looks.append(name)
        return True

    request = Request("key", (), "source", (KERNEL,), False, True)

    def build(request: Request) -> cl.Program:
        raise AssertionError(request)

    owner = program_residency.ProgramResidency(releases=True)
    program = owner.add("program", request, build, has_code=has_code)  # type: ignore[arg-type]
    for _ in range(3):
        program.prepare(KERNEL, 10)
    assert len(looks) == 1
    for _ in range(program_residency._REMEMBERED):  # of another device
        counter.note_kernel()
    for _ in range(3):
        program.prepare(KERNEL, 10)
    assert len(looks) == 4
