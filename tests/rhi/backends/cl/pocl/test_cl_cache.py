"""The folder of compiled kernels: chosen, shared by processes, checked for damage, bounded; and nothing is
printed."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from nightly_reasons import CHEAPER_TEST

from rhi.backends.cl.pocl import kernel_cache
from rhi.backends.cl.pocl.kernel_cache import KernelCache
from rhi.contract import trust

PROGRAMS = 4
"""Set-up, vertices, the raster kernel of all programs and the fragment stage, compiled quickly."""
DRAW = """
import hashlib, logging, os, sys, threading, warnings
import numpy as np
import pyopencl as cl
import rhi
from rhi.backends.cl import cl_context
from rhi.backends.cl import builds
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle
logging.getLogger("rhi.kernels").setLevel(logging.ERROR)  # a busy machine waits longer than a second

warnings.simplefilter("always")
builds.HOT = int(sys.argv[1])
build, given = cl_context.build_again, []

def note(opened, text, options):
    given.append(type(text) if text[:7] != b"poclbin" else "machine code")
    if isinstance(text, bytes) and "refuse" in sys.argv:
        raise cl.LogicError("clBuildProgram failed: INVALID_BINARY")
    return build(opened, text, options)

cl_context.build_again = note
if "second" in sys.argv:
    os.environ["POCL_CACHE_DIR"] = sys.argv[-1]
    [platform.get_devices() for platform in cl.get_platforms()]
with rhi.create_device("cl") as device:
    image = device.texture((64, 48), rhi.Format.RGBA8)
    program, mesh = device.program(Colored), device.mesh(rectangle(color=(0.2, 0.4, 0.6, 0.8)))
    for _ in range(2):
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw(program, mesh)
        if builds.HOT == 0:
            device.prepare(program, mesh, targets=(image,)).result(120)
    programs = device.backend_as(object)._builds.built
    print(hashlib.sha256(image.read().tobytes()).hexdigest(), programs, given.count(str), given.count("machine code"))
"""
"""Draws, and prints an image's checksum, the number of programs that were compiled, and how many the driver
was given as source code, and as machine code alone. The arguments: `HOT`, `refuse` for a driver that takes
nothing else, and `second` for one that another library has begun, with a folder of its own."""


def start(folder: Path, hot: int = 1 << 30, *arguments: str, **variables: str) -> subprocess.Popen[str]:
    environment = {name: value for name, value in os.environ.items() if name != "POCL_CACHE_DIR"}
    return subprocess.Popen(
        [sys.executable, "-c", DRAW, str(hot), *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment | {"RHI_CACHE": str(folder)} | variables,
        encoding="utf-8",
    )


def draw(folder: Path, hot: int = 1 << 30) -> tuple[str, int]:
    """Draw in a new process; return the image's checksum and the number of programs that were compiled."""
    return finish(start(folder, hot))


def finish(process: subprocess.Popen[str]) -> tuple[str, int]:
    image, builds, *_ = finish_counting(process)
    return image, builds


def finish_counting(process: subprocess.Popen[str]) -> tuple[str, int, int, int]:
    output, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    assert errors == ""
    image, builds, sources, bare = output.split()
    return image, int(builds), int(sources), int(bare)


def records(folder: Path) -> list[Path]:
    return [path for path in (folder / "pocl" / "rhi").iterdir() if not path.suffix]


def codes(folder: Path) -> list[Path]:
    """Return the files of LLVM code, the smallest first, which is the probe's."""
    return sorted((folder / "pocl" / "rhi").glob("*.code"), key=lambda path: path.stat().st_size)


def list_records(folder: Path) -> list[str]:
    """The names of the files in a folder, without fresh locks."""
    return sorted(
        path.name for path in folder.iterdir() if path.suffix != ".lock" or path.stat().st_mtime <= 1e9
    )


def test_a_first_run_and_its_optimisation_print_nothing(tmp_path: Path) -> None:
    """Neither the driver's count of warnings nor Python's warnings appear, from no thread and no process."""
    image, builds = draw(tmp_path, hot=0)
    assert builds == PROGRAMS
    assert draw(tmp_path) == (image, 0)


@pytest.fixture(scope="module")
def first_run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A folder that a first run has filled, not to be written, and the checksum of its image."""
    folder = tmp_path_factory.mktemp("kernels")
    image, builds = draw(folder)
    assert builds == PROGRAMS
    return folder, image


@pytest.fixture
def filled(first_run: tuple[Path, str], tmp_path: Path) -> tuple[Path, str]:
    """A copy of the folder that a first run has filled, and the checksum of its image."""
    return shutil.copytree(first_run[0], tmp_path / "copy"), first_run[1]


def test_a_folder_may_be_moved_and_shipped(filled: tuple[Path, str]) -> None:
    folder, image = filled
    assert draw(folder) == (image, 0)


@pytest.mark.nightly_cases("of another version", "damaged", reason=CHEAPER_TEST)
@pytest.mark.parametrize(
    ("change", "bare"),
    [
        pytest.param(None, PROGRAMS, id="as it was"),
        pytest.param(lambda header: header[:-1], 0, id="damaged"),
        pytest.param(lambda header: b"", 0, id="empty"),
        pytest.param(lambda header: header[32:-4] + b"\x08\0\0\0", 0, id="of another version"),
    ],
)
def test_programs_with_machine_code_are_made_without_llvm_code(
    filled: tuple[Path, str], change: Callable[[bytes], bytes] | None, bare: int
) -> None:
    folder, image = filled
    (header,) = (folder / "pocl" / "rhi").glob("*.header")
    content = header.read_bytes()
    assert content[32:40] == b"poclbin\0"
    if change is not None:
        fresh = change(content)
        signed = trust.sign(trust.read_key(), fresh, "", ".header").encode() if fresh[:1] == b"p" else b""
        header.write_bytes(signed + fresh)
    assert finish_counting(start(folder)) == (image, 0, 0, bare)


def test_machine_code_is_used_only_where_it_was_checked(filled: tuple[Path, str]) -> None:
    folder, image = filled
    assert draw(folder) == (image, 0)
    (link,) = (folder / "pocl" / "RH").rglob("raster.so")
    link.unlink()
    link.write_bytes(b"foreign")
    assert finish_counting(start(folder)) == (image, 0, 0, PROGRAMS)


def test_a_driver_that_another_library_has_started_gets_nothing_from_the_cache(
    filled: tuple[Path, str], tmp_path: Path
) -> None:
    """It doesn't look there, and ends the process where machine code that it is told of isn't in its own
    folder."""
    folder, image = filled
    (tmp_path / "its own").mkdir()
    assert finish_counting(start(folder, 1 << 30, "second", str(tmp_path / "its own"))) == (image, 3, 3, 0)
    assert finish_counting(start(folder)) == (image, 0, 0, PROGRAMS)


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_processes_that_begin_together_share_the_work(tmp_path: Path) -> None:
    images = {finish(process)[0] for process in [start(tmp_path) for _ in range(3)]}
    assert len(images) == 1
    assert draw(tmp_path) == (*images, 0)


def seal(path: Path, code: bytes) -> bytes:
    """Return code as the user's own, for the program of a file of code."""
    return KernelCache(path.parent.parent, "driver").seal(path.stem, code)


def truncate(content: bytes) -> bytes:
    return content[:100]


def empty(content: bytes) -> bytes:
    return b""


@pytest.mark.nightly_cases("[*].so-truncate", "program.bc-upper", reason=CHEAPER_TEST)
@pytest.mark.parametrize(
    ("name", "damage"),
    [
        pytest.param(name, damage, marks=() if damage in by_day else pytest.mark.nightly)
        for name, by_day in (("program.bc", (bytes.upper,)), ("*.so", (truncate,)))
        for damage in (bytes.upper, truncate, empty)
    ],
)
def test_a_damaged_file_is_built_again(
    filled: tuple[Path, str], name: str, damage: Callable[[bytes], bytes]
) -> None:
    folder, image = filled
    (kernel,) = folder.rglob("raster.so")
    assert draw(folder) == (image, 0)  # links to what is damaged
    damaged = list(kernel.parents[2].rglob(name))
    assert damaged
    for path in damaged:
        path.write_bytes(damage(path.read_bytes()))
    assert draw(folder) == (image, 1)
    assert draw(folder) == (image, 0)


@pytest.mark.nightly_cases("upper", "None", reason=CHEAPER_TEST)
@pytest.mark.parametrize(
    "damage",
    [
        bytes.upper,
        None,
        *(pytest.param(damage_function, marks=pytest.mark.nightly) for damage_function in (truncate, empty)),
    ],
)
def test_damaged_or_foreign_code_is_made_again(
    filled: tuple[Path, str], damage: Callable[[bytes], bytes] | None
) -> None:
    """Its checksum may be right and the record's another, as that of a file from elsewhere."""
    folder, image = filled
    _, vertices, *_ = codes(folder)
    vertices.write_bytes(seal(vertices, b"other") if damage is None else damage(vertices.read_bytes()))
    assert draw(folder) == (image, 1)
    assert len(codes(folder)) == 4
    assert draw(folder) == (image, 0)


def test_code_that_the_driver_refuses_is_made_again(filled: tuple[Path, str]) -> None:
    """Code and record agree, but it is no code. It is taken where it isn't known how to do without."""
    folder, image = filled
    next((folder / "pocl" / "rhi").glob("*.header")).unlink()
    _, vertices, *_ = codes(folder)
    vertices.write_bytes(seal(vertices, b"other"))
    record = vertices.with_suffix("")
    signed = trust.sign(trust.read_key(), b"other", record.name, ".code")
    record.write_text(
        json.dumps(json.loads(record.read_text(encoding="utf-8")) | {"code": signed}), encoding="utf-8"
    )
    assert draw(folder)[0] == image
    assert len(vertices.read_bytes()) > 1000
    assert draw(folder) == (image, 0)


def test_cached_programs_are_not_passed_to_the_driver_as_source(first_run: tuple[Path, str]) -> None:
    folder, image = first_run
    assert finish_counting(start(folder)) == (image, 0, 0, PROGRAMS)


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_a_driver_that_refuses_machine_code_gets_source(filled: tuple[Path, str]) -> None:
    folder, image = filled
    for _ in range(2):
        assert finish_counting(start(folder, 1 << 30, "refuse"))[::2] == (image, 4)
    assert not codes(folder)
    assert draw(folder) == (image, 0)  # which another driver goes on with


def test_code_without_a_record_is_used(filled: tuple[Path, str]) -> None:
    """As a process left it that ended before it had recorded a program."""
    folder, image = filled
    for record in records(folder):
        record.unlink()
    whole = [path.read_bytes() for path in codes(folder)]
    assert finish_counting(start(folder)) == (image, PROGRAMS, 0, 0)
    assert [path.read_bytes() for path in codes(folder)] == whole
    assert draw(folder) == (image, 0)


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
def test_a_damaged_record_is_made_again(filled: tuple[Path, str]) -> None:
    folder, image = filled
    for path, content in zip(
        records(folder), [b"", b"{}", b"[1]", b'{"folder": 1, "files": 2}'], strict=False
    ):
        path.write_bytes(content)
    assert draw(folder)[0] == image
    assert draw(folder) == (image, 0)


@pytest.mark.parametrize(
    "path", ["", ".", "..", "AB", "AB/..", "../mine", "AB/key/more", "x/AB/key", "ab/key", "{outside}"]
)
def test_a_record_that_names_another_folder_removes_nothing_there(tmp_path: Path, path: str) -> None:
    """Records may come from elsewhere, and what they name may be removed."""
    folder, outside = tmp_path / "kernels", tmp_path / "mine"
    folders = [outside, folder, *(folder / name for name in ("rhi", "AB/key", "x/AB/key", "ab/key"))]
    for name in folders:
        name.mkdir(parents=True, exist_ok=True)
        (name / "kept").write_bytes(b"kept")
    record = folder / "rhi" / "evil"
    record.write_text(
        json.dumps({"folder": path.format(outside=outside), "files": {"kept": 0}}), encoding="utf-8"
    )
    assert not KernelCache(folder, "driver").contains("evil")
    assert not record.exists()
    for name in folders:
        assert (name / "kept").read_bytes() == b"kept"


def make(folder: Path, key: str, size: int, since: float) -> None:
    """Write a program of some bytes that was last used some seconds ago, with its record."""
    kernels = KernelCache(folder, "driver")
    program = folder / "AB" / key
    program.mkdir(parents=True)
    (program / "program.bc").write_bytes(f"rhi_built_{key}".encode() + bytes(size))
    kernels.record(key)
    record = folder / "rhi" / key
    used = record.stat().st_mtime - since
    os.utime(record, (used, used))


def test_the_programs_used_least_recently_are_removed_beyond_the_limit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "rhi").mkdir()
    for number, key in enumerate(("oldest", "older", "newer", "newest")):
        make(tmp_path, key, 1000, 100.0 - number)
    kernels = KernelCache(tmp_path, "driver")
    assert kernels.contains("oldest")  # which uses it
    for limit, left in ((4300, ["newer", "newest", "older", "oldest"]), (2500, ["newest", "oldest"])):
        monkeypatch.setattr(kernel_cache, "LIMIT", limit)
        kernels.record("newest")
        kernels.finish()
        for part in ("AB", "rhi"):
            assert list_records(tmp_path / part) == left


def test_unused_files_of_the_kernel_cache_are_removed_after_a_day(tmp_path: Path) -> None:
    """Code, locks and programs without records, and the empty files that PoCL leaves."""
    (tmp_path / "rhi").mkdir()
    make(tmp_path, "key", 10, 0.0)
    remaining = {"AB/key", "AB/new", "AB/used", "RH/BEGINNING"}
    for name in (*remaining, "AB/gone", "RH/OLDER_VERSION"):
        (tmp_path / name).mkdir(parents=True, exist_ok=True)
        if name == "AB/used":
            (tmp_path / name / "last_accessed").touch()
        if name not in ("AB/new", "RH/BEGINNING"):
            os.utime(tmp_path / name, (1e9, 1e9))
    old, new = (
        ("rhi/key.code", "rhi/key.1.2", "rhi/gone.code", "rhi/gone.lock", "tempfile_a", "tempfile_full"),
        ("tempfile_b",),
    )
    for name in (*old, *new):
        unfinished = (tmp_path / "rhi" / "key").read_bytes()
        (tmp_path / name).write_bytes({"tempfile_full": b"full", "rhi/key.1.2": unfinished}.get(name, b""))
    for name in old:
        os.utime(tmp_path / name, (1e9, 1e9))
    kernels = KernelCache(tmp_path, "driver")
    (tmp_path / "rhi" / "key.code").write_bytes(kernels.seal("key", b"code"))
    os.utime(tmp_path / "rhi" / "key.code", (1e9, 1e9))
    kernels.record("key")
    kernels.finish()
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "AB",
        "RH",
        "rhi",
        "tempfile_b",
        "tempfile_full",
    ]
    assert {str(path.relative_to(tmp_path)) for path in tmp_path.glob("[A-Z][A-Z]/*")} == remaining
    assert list_records(tmp_path / "rhi") == ["key", "key.code"]
    assert kernels.find("key") == (b"code", frozenset())


def test_code_counts_to_the_size_of_a_program_and_goes_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "rhi").mkdir()
    kernels = KernelCache(tmp_path, "driver")
    (tmp_path / "rhi" / "key.code").write_bytes(kernels.seal("key", bytes([1]) * 1000))
    make(tmp_path, "key", 1000, 0.0)
    for limit, left in ((2100, ["key", "key.code"]), (2000, [])):
        monkeypatch.setattr(kernel_cache, "LIMIT", limit)
        kernels.record("key")
        kernels.finish()
        assert list_records(tmp_path / "rhi") == left


def test_a_cached_program_is_loaded_however_many_are_newer(tmp_path: Path) -> None:
    (tmp_path / "rhi").mkdir()
    cache = KernelCache(tmp_path, "driver")
    for age, (name, key) in enumerate(
        (("AB/newest", "b"), ("CD/beside", "c"), ("CD/wanted", "a"), ("EF/oldest", "d"))
    ):
        folder = tmp_path / name
        folder.mkdir(parents=True)
        (folder / "program.bc").write_bytes(f"rhi_built_{key}".encode())
        for path in (folder, folder.parent):
            os.utime(path, (1e9 - age, 1e9 - age))
    cache.record("a")
    assert json.loads((tmp_path / "rhi" / "a").read_bytes())["folder"] == "CD/wanted"


def test_another_driver_source_or_option_is_another_program(tmp_path: Path) -> None:
    mine, other = KernelCache(tmp_path, "driver 1"), KernelCache(tmp_path, "driver 2")
    requests = [
        mine.request("a", ()),
        mine.request("b", ()),
        mine.request("a", ["-w"]),
        other.request("a", ()),
    ]
    assert len({request.key for request in requests}) == 4
    assert mine.request("a", ()) == requests[0]


def test_missing_machine_code_of_a_kernel_is_detected(tmp_path: Path) -> None:
    (tmp_path / "rhi").mkdir()
    make(tmp_path, "key", 10, 0.0)
    kernels = KernelCache(tmp_path, "driver")
    assert kernels.contains("key")
    assert not kernels.contains("key", ["draw"])
    (tmp_path / "AB" / "key" / "draw" / "1-1-1").mkdir(parents=True)
    (tmp_path / "AB" / "key" / "draw" / "1-1-1" / "draw.so").write_bytes(b"code")
    assert not kernels.contains("key", ["draw"])  # it isn't known to be complete
    kernels.record("key")
    assert kernels.contains("key", ["draw"])


def test_a_folder_that_cannot_be_made_leaves_the_driver_s(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    monkeypatch.delenv("POCL_CACHE_DIR", raising=False)
    monkeypatch.setenv("RHI_CACHE", str(tmp_path / "file"))
    assert kernel_cache.choose_folder() is None
    assert "POCL_CACHE_DIR" not in os.environ
    kernels = KernelCache(None, "driver")
    assert not kernels.works
    assert not kernels.contains("key")
    with kernels.writing("key"):
        kernels.record("key")
    kernels.finish()


@pytest.fixture
def environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for kernels, beside a cache of the user's own."""
    monkeypatch.setattr(kernel_cache, "_replaced", {})
    monkeypatch.setattr(trust, "MIN_FREE_BYTES", 0)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "user"))
    monkeypatch.delenv("POCL_CACHE_DIR", raising=False)
    monkeypatch.setenv("RHI_CACHE", str(tmp_path / "kernels"))
    return tmp_path / "kernels" / "pocl"


def test_files_of_the_kernel_cache_are_readable_by_their_user_only(environment: Path, tmp_path: Path) -> None:
    assert kernel_cache.choose_folder() == environment
    folders = (environment.parent, environment, environment / "rhi", tmp_path / "user" / "rhi")
    assert {folder.stat().st_mode & 0o777 for folder in folders} == {0o700}
    assert (tmp_path / "user" / "rhi" / "key").stat().st_mode & 0o777 == 0o600
    assert kernel_cache.choose_folder() == environment


@pytest.mark.parametrize("path", ["", "rhi"])
@pytest.mark.parametrize(
    ("mode", "is_used"), [(0o755, True), (0o775, False), (0o707, False), (0o1777, False)]
)
def test_a_folder_that_others_may_write_is_not_used(
    environment: Path, path: str, mode: int, is_used: bool
) -> None:
    (environment / "rhi").mkdir(parents=True)
    (environment / path).chmod(mode)
    if is_used:
        assert kernel_cache.choose_folder() == environment
        return
    with pytest.warns(RuntimeWarning, match="other users may write"):
        instead = kernel_cache.choose_folder()
    assert instead not in (None, environment)
    assert os.environ["POCL_CACHE_DIR"] == str(instead)
    assert kernel_cache.choose_folder() == instead  # and says it once


def test_a_folder_of_another_user_is_not_used(environment: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (environment / "rhi").mkdir(parents=True)
    monkeypatch.setattr(os, "geteuid", lambda: environment.stat().st_uid + 1)
    for path in (environment, environment / "rhi"):  # which may be root's
        monkeypatch.setattr(path.__class__, "stat", _stat_of(12345))
    with pytest.warns(RuntimeWarning, match="belongs to another user"):
        assert kernel_cache.choose_folder() != environment


def _stat_of(user: int) -> Callable[..., os.stat_result]:
    def stat(path: Path, **_: object) -> os.stat_result:
        fields = list(os.stat(path))
        fields[4] = user
        return os.stat_result(fields)

    return stat


def test_a_full_disk_is_not_used(environment: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trust, "MIN_FREE_BYTES", 1 << 60)
    with pytest.warns(RuntimeWarning, match=r"only [\d.]+ MB are free"):
        assert kernel_cache.choose_folder() != environment


def test_programs_of_another_user_are_built_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their checksums are right, but for another key: theirs, or none."""
    folder = tmp_path / "kernels"
    (folder / "rhi").mkdir(parents=True)
    for key, secret in (("mine", ""), ("theirs", "stranger"), ("shipped", "program")):
        monkeypatch.setenv("RHI_CACHE_KEY", secret)
        make(folder, key, 10, 0.0)
    monkeypatch.setenv("RHI_CACHE_KEY", "")
    assert KernelCache(folder, "driver").contains("mine")
    assert not KernelCache(folder, "driver").contains("theirs")
    assert not (folder / "AB" / "theirs").exists()
    monkeypatch.setenv("RHI_CACHE_KEY", "program")
    assert KernelCache(folder, "driver").contains("shipped")


def test_a_program_does_not_pass_for_another(tmp_path: Path) -> None:
    (tmp_path / "rhi").mkdir()
    make(tmp_path, "one", 10, 0.0)
    shutil.copy(tmp_path / "rhi" / "one", tmp_path / "rhi" / "two")
    assert KernelCache(tmp_path, "driver").contains("one")
    assert not KernelCache(tmp_path, "driver").contains("two")
    assert trust.sign(b"key", b"bc", "a") != trust.sign(b"key", b"c", "ab")


def test_a_key_that_others_can_read_is_none(
    environment: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert kernel_cache.choose_folder() == environment
    key = tmp_path / "user" / "rhi" / "key"
    with monkeypatch.context() as another:
        another.setattr(os, "geteuid", lambda: key.stat().st_uid + 1)
        assert trust.read_key() == b""
    assert trust.read_key() == key.read_bytes()
    key.chmod(0o644)
    with pytest.warns(RuntimeWarning, match="no key can be stored"):
        assert kernel_cache.choose_folder() != environment
    key.chmod(0o600)
    key.write_bytes(b"short")
    assert trust.read_key() == b""


def test_a_lock_of_a_stopped_process_is_released(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And the program is built under a name of its own, so that nothing is written that the other one
    writes."""
    fcntl = pytest.importorskip("fcntl")
    (tmp_path / "rhi").mkdir()
    monkeypatch.setattr(kernel_cache, "PATIENCE", 0.05)
    kernels = KernelCache(tmp_path, "driver")
    with open(kernels.lock_path("key"), "wb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with kernels.writing("key") as is_safe:
            assert not is_safe
    with kernels.writing("key") as is_safe:
        assert is_safe


@pytest.mark.nightly
def test_locks_of_a_stopped_process_hold_nobody_up(filled: tuple[Path, str]) -> None:
    fcntl = pytest.importorskip("fcntl")
    folder, image = filled
    for record in (*records(folder), *codes(folder)):
        record.unlink()
    locks = [path.open("wb") for path in (folder / "pocl" / "rhi").glob("*.lock")]
    assert len(locks) >= 3
    for file in locks:
        fcntl.flock(file, fcntl.LOCK_EX)
    begun = time.monotonic()
    assert draw(folder)[0] == image
    assert 19.0 < time.monotonic() - begun < 120.0
    for file in locks:
        file.close()
    assert draw(folder)[0] == image
    assert draw(folder) == (image, 0)


@pytest.mark.nightly
@pytest.mark.parametrize("left", [0, 4096, 100_000, 1_000_000])
def test_a_full_disk_below_the_folder_means_no_cache_and_says_so(
    first_run: tuple[Path, str], tmp_path: Path, left: int
) -> None:
    disk = tmp_path / "disk"
    disk.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(disk)]
    if subprocess.run(command, capture_output=True, check=False).returncode:
        pytest.skip("only an administrator can mount a small disk")
    try:
        (disk / "full").write_bytes(bytes((2 << 20) - 8192 - left))
        process = start(disk)
        output, errors = process.communicate(timeout=300)
        assert process.returncode == 0, errors
        assert output.split()[0] == first_run[1]
        assert "kernels aren't kept" in errors
        assert "free there" in errors
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)


def test_the_driver_s_own_variable_is_respected(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RHI_CACHE", raising=False)
    monkeypatch.setenv("POCL_CACHE_DIR", str(tmp_path))
    assert kernel_cache.choose_folder() == tmp_path
    monkeypatch.setenv("RHI_CACHE", str(tmp_path / "mine"))
    assert kernel_cache.choose_folder() == tmp_path / "mine" / "pocl"


def test_two_processes_that_look_for_the_driver_s_mark_take_turns(tmp_path: Path) -> None:
    """The second removes the mark only when the first has seen it."""
    (tmp_path / "rhi").mkdir()
    first, second = KernelCache(tmp_path, "driver"), KernelCache(tmp_path, "driver")
    has_looked, ends = threading.Event(), threading.Event()

    def look() -> None:
        with second.watch_use("key"):
            has_looked.set()
            ends.wait(20)
            (tmp_path / "last_accessed").touch()

    thread = threading.Thread(target=look)
    with first.watch_use("key"):
        (tmp_path / "last_accessed").touch()
        thread.start()
        has_looked.wait(0.5)
    ends.set()
    thread.join()
    assert (first.works, second.works) == (True, True)


def test_a_driver_that_leaves_no_mark_uses_another_folder(tmp_path: Path) -> None:
    (tmp_path / "rhi").mkdir()
    kernels = KernelCache(tmp_path, "driver")
    with kernels.watch_use("key"):
        pass
    assert not kernels.works


def test_a_program_that_another_process_writes_is_not_recorded(tmp_path: Path) -> None:
    """Its files may be half written. Closing the device doesn't wait for it."""
    (tmp_path / "rhi").mkdir()
    make(tmp_path, "key", 10, 0.0)
    kernels = KernelCache(tmp_path, "driver")
    kernels.record("key")
    record = tmp_path / "rhi" / "key"
    before = record.read_bytes()
    (tmp_path / "AB" / "key" / "program.bc").write_bytes(b"rhi_built_key half")
    lock = trust.lock(kernels.lock_path("key"), 0.0)
    assert lock is not None
    with lock:
        kernels.finish()
        assert record.read_bytes() == before
    kernels.record("key")
    kernels.finish()
    assert record.read_bytes() != before
