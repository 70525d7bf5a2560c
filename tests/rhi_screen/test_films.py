"""Films: the same bytes from any number of workers, frames that aren't drawn again, and workers that die."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from threading import Lock
from time import sleep
from typing import Any, Self

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

import rhi
from rhi import DeviceError, ValidationError
from rhi_screen import FilmResult, film
from rhi_screen.executors import MAX_DEATHS, SerialExecutor, make_executor
from rhi_screen.frame_files import PNG, SMALL, FrameFiles, encode

SIZE = (10, 8)


def paint(frame: int) -> np.ndarray:
    """Return an image that differs from frame to frame."""
    return np.random.default_rng(frame).integers(0, 256, (SIZE[1], SIZE[0], 4), np.uint8)


def paint_or_die(frame: int, *, fatal: tuple[int, ...], once: Path | None = None) -> np.ndarray:
    """Paint a frame; end the process at some, in each attempt or only the first one."""
    if frame in fatal:
        mark = None if once is None else once / f"{frame}.died"
        if mark is None or not mark.exists():
            if mark is not None:
                mark.touch()
            os._exit(1)
    return paint(frame)


class SharedLog(list[str]):
    """A list that all copies of a painter write into."""

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self


class Painter:
    """Paints frames inside its block only, and counts what happens to it."""

    description = "a painter"

    def __init__(self, log: list[str] | None = None) -> None:
        self.log = log
        self.is_open = False

    def __enter__(self) -> Self:
        assert not self.is_open
        self.is_open = True
        self.note("enter")
        return self

    def __call__(self, frame: int) -> np.ndarray:
        assert self.is_open
        self.note(f"draw {frame}")
        return paint(frame)

    def __exit__(self, *_: object) -> None:
        assert self.is_open
        self.is_open = False
        self.note("exit")

    def note(self, text: str) -> None:
        if self.log is not None:
            self.log.append(text)


def read_all(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@given(
    st.lists(st.integers(0, 30), min_size=1, max_size=8),
    st.sampled_from(["serial", "threads:1", "threads:3"]),
)
def test_images_are_those_of_the_function_in_the_order_of_the_frames(
    frames: list[int], executor: str
) -> None:
    result = film(paint, frames, executor)
    assert (result.output, result.frames, result.drawn) == (None, len(frames), len(set(frames)))
    assert len(result.images) == len(frames)
    assert all(
        np.array_equal(image, paint(frame)) for image, frame in zip(result.images, frames, strict=True)
    )


@pytest.mark.parametrize("name", ["%d.png", "image-%04d.png", "%03d.webp"])
def test_the_bytes_of_images_dont_depend_on_the_workers(tmp_path: Path, name: str) -> None:
    contents = []
    for executor in ("serial", "threads:3", "processes:2"):
        folder = tmp_path / executor.partition(":")[0]
        film(paint, range(7), executor, folder / name, identity="this film")
        contents.append(read_all(folder))
    assert list(contents[0]) == sorted(name % frame for frame in range(7))
    assert contents[0] == contents[1] == contents[2]


def test_the_bytes_of_a_video_dont_depend_on_the_workers(tmp_path: Path) -> None:
    pytest.importorskip("av", reason="no PyAV: pip install rhi[video]")
    for executor in ("serial", "threads:3", "processes:2"):
        film(paint, range(9), executor, tmp_path / f"{executor.partition(':')[0]}.mp4", fps=30.0)
    contents = read_all(tmp_path)
    assert list(contents) == ["processes.mp4", "serial.mp4", "threads.mp4"]
    assert len(set(contents.values())) == 1
    assert count_video_frames(tmp_path / "serial.mp4") == (9, 30)


def count_video_frames(path: Path) -> tuple[int, float]:
    import av

    with av.open(str(path)) as file:
        stream = file.streams.video[0]
        return sum(1 for _ in file.decode(stream)), float(stream.average_rate)


def test_a_png_shows_the_colors_of_its_frame_without_alpha(tmp_path: Path) -> None:
    film(paint, [4], output=tmp_path / "%d.png", identity="a film")
    with Image.open(tmp_path / "4.png") as image:
        assert np.array_equal(np.array(image), paint(4)[..., :3])
        assert image.text == {"film": "a film"}


@pytest.mark.parametrize(
    ("damage", "is_drawn"),
    [
        (lambda path: None, False),
        (lambda path: path.unlink(), True),
        (lambda path: path.write_bytes(b""), True),
        (lambda path: path.write_bytes(path.read_bytes()[:-1]), True),
        (lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]), True),
        (lambda path: path.with_name(path.name + ".part").write_bytes(b"unfinished"), False),
    ],
    ids=["complete", "missing", "empty", "without its last byte", "half", "beside an unfinished one"],
)
def test_only_frames_without_a_complete_file_are_drawn(
    tmp_path: Path, damage: Callable[[Path], object], is_drawn: bool
) -> None:
    output = tmp_path / "%d.png"
    film(paint, range(5), output=output)
    complete = read_all(tmp_path)
    damage(tmp_path / "3.png")
    log = SharedLog()
    result = film(Painter(log), range(5), output=output)
    assert [text for text in log if text.startswith("draw")] == ["draw 3"] * is_drawn
    assert (result.drawn, result.reused) == (is_drawn, 5 - is_drawn)
    assert {name: content for name, content in read_all(tmp_path).items() if name in complete} == complete


def test_frames_of_another_film_are_refused_and_left_alone(tmp_path: Path) -> None:
    output = tmp_path / "%d.png"
    film(paint, range(3), output=output, identity="bright")
    before = read_all(tmp_path)
    with pytest.raises(ValidationError, match=r"film-other.*\n.*\n.*0\.png, and 2 more") as error:
        film(paint, range(5), output=output, identity="dark")
    assert error.value.rule.id == "film-other"
    assert read_all(tmp_path) == before
    assert film(paint, range(5), output=output, identity="bright").drawn == 2
    Image.new("RGB", SIZE).save(tmp_path / "7.png")  # says nothing of a film
    assert film(paint, [7], output=output, identity="bright").reused == 1


def test_an_interrupted_film_goes_on_where_it_stopped(tmp_path: Path) -> None:
    pytest.importorskip("av", reason="no PyAV: pip install rhi[video]")
    whole, output = tmp_path / "whole.mp4", tmp_path / "film.mp4"
    film(paint, range(6), output=whole)

    def interrupt(frame: int) -> np.ndarray:
        if frame == 4:
            raise KeyboardInterrupt
        return paint(frame)

    with pytest.raises(KeyboardInterrupt):
        film(interrupt, range(6), output=output)
    assert not output.exists()
    assert len(read_all(tmp_path / "film.mp4.frames")) == 4
    result = film(paint, range(6), output=output)
    assert (result.drawn, result.reused) == (2, 4)
    assert output.read_bytes() == whole.read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["film.mp4", "whole.mp4"]


def test_a_complete_video_of_the_same_film_is_not_made_again(tmp_path: Path) -> None:
    pytest.importorskip("av", reason="no PyAV: pip install rhi[video]")
    output = tmp_path / "film.mp4"
    first = film(paint, range(4), output=output, identity="bright")
    assert (first.drawn, first.reused) == (4, 0)
    again = film(paint, range(4), output=output, identity="bright")
    assert (again.drawn, again.reused) == (0, 4)
    for frames, identity in ((range(5), "bright"), (range(4), "dark"), (range(4), "")):
        assert film(paint, frames, output=output, identity=identity).drawn == len(frames)


def test_a_file_is_complete_or_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    files = FrameFiles(tmp_path, "%d.png")
    monkeypatch.setattr(Path, "replace", lambda self, target: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        files.write(3, encode(paint(3), PNG, "", SMALL))
    assert not files.path(3).exists()


@pytest.mark.parametrize("executor", ["serial", "threads:1", "threads:3"])
def test_each_worker_enters_a_context_manager_once(executor: str) -> None:
    log = SharedLog()
    result = film(Painter(log), range(12), executor)
    counts = Counter(text.partition(" ")[0] for text in log)
    workers = int(executor.partition(":")[2] or 1)
    assert 1 <= counts["enter"] == counts["exit"] <= workers
    assert counts["draw"] == 12
    assert result.sources == ("a painter",)


class Flicker:
    """Draws the number that it stored a moment before: of two threads that shared it, one would be wrong."""

    def __init__(self) -> None:
        self.state = np.zeros(1, np.int64)

    def __call__(self, frame: int) -> np.ndarray:
        self.state[0] = frame
        sleep(0.002)
        return np.full((2, 2, 3), self.state[0], np.uint8)


def test_threads_share_no_state_of_the_object_that_draws() -> None:
    images = film(Flicker(), range(60), "threads:4").images
    assert [int(image[0, 0, 0]) for image in images] == list(range(60))


class LockedPainter:
    """A painter that can't be copied."""

    def __init__(self) -> None:
        self.lock = Lock()

    def __call__(self, frame: int) -> np.ndarray:
        with self.lock:
            return paint(frame)


def test_an_object_that_cant_be_copied_is_refused_on_threads_and_drawn_by_one_worker() -> None:
    assert len(film(LockedPainter(), range(2)).images) == 2
    with pytest.raises(ValidationError, match=r"film-pickle.*lock"):
        film(LockedPainter(), range(2), "threads:2")


def test_a_context_manager_is_left_after_an_error() -> None:
    log = SharedLog()

    class Clumsy(Painter):
        def __call__(self, frame: int) -> np.ndarray:
            return super().__call__(frame)[0] if frame == 2 else super().__call__(frame)

    with pytest.raises(ValidationError, match=r"frame 2: .*video-image"):
        film(Clumsy(log), range(5))
    assert log == ["enter", "draw 0", "draw 1", "draw 2", "exit"]


def test_textures_of_a_device_are_frames() -> None:
    with rhi.create_device("gl") as device:
        images = {frame: device.texture(paint(frame), rhi.Format.RGBA8) for frame in range(3)}
        result = film(images.__getitem__, range(3))
    assert all(np.array_equal(image, paint(frame)) for frame, image in enumerate(result.images))


def test_a_frame_that_cant_be_drawn_is_named_and_others_are_stored(tmp_path: Path) -> None:
    def fail(frame: int) -> np.ndarray:
        return paint(frame) if frame != 3 else np.zeros(1 // 0)

    for executor in ("serial", "threads:1"):
        folder = tmp_path / executor.partition(":")[0]
        with pytest.raises(ValidationError, match="frame 3: ZeroDivisionError") as error:
            film(fail, range(9), executor, folder / "%d.png")
        assert error.value.rule.id == "film-frame"
        assert isinstance(error.value.__cause__, ZeroDivisionError)
        assert {"0.png", "1.png", "2.png"} <= set(read_all(folder))


def test_a_process_that_dies_gives_its_frame_to_another(tmp_path: Path) -> None:
    film(paint, range(8), output=tmp_path / "serial" / "%d.png")
    dies_once = partial(paint_or_die, fatal=(2, 5), once=tmp_path)
    result = film(dies_once, range(8), "processes:2", tmp_path / "films" / "%d.png")
    assert (tmp_path / "2.died").exists()
    assert (tmp_path / "5.died").exists()
    assert result.drawn == 8
    assert read_all(tmp_path / "films") == read_all(tmp_path / "serial")


def test_frames_that_end_each_process_are_named_and_all_others_are_drawn(tmp_path: Path) -> None:
    deadly = partial(paint_or_die, fatal=(1, 4))
    with pytest.raises(DeviceError, match="frames 1, 4") as error:
        film(deadly, range(6), "processes:2", tmp_path / "%d.png")
    assert error.value.rule.id == "film-killed"
    assert sorted(read_all(tmp_path)) == ["0.png", "2.png", "3.png", "5.png"]


@pytest.mark.nightly
def test_a_film_whose_frames_all_end_processes_is_abandoned(tmp_path: Path) -> None:
    with pytest.raises(DeviceError, match="film-killed"):
        film(partial(paint_or_die, fatal=tuple(range(100))), range(100), "processes:1", tmp_path / "%d.png")
    assert MAX_DEATHS**2 < 100
    assert read_all(tmp_path) == {}


def test_a_pool_of_the_standard_library_draws_films_until_a_process_dies(tmp_path: Path) -> None:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        assert film(paint, range(3), pool, tmp_path / "%d.png").drawn == 3
        with pytest.raises(DeviceError, match="ProcessPoolExecutor") as error:
            film(partial(paint_or_die, fatal=(4,)), range(6), pool, tmp_path / "%d.png")
    assert error.value.rule.id == "executor-ended"
    assert film(paint, range(6), output=tmp_path / "%d.png").reused >= 3


def test_any_executor_draws_films() -> None:
    class Own(SerialExecutor):
        """No class that `film` knows of."""

    assert film(Painter(), range(3), Own()).sources == ("a painter",)


def test_functions_that_cant_be_pickled_are_refused_for_processes() -> None:
    lock = (frame for frame in range(3))
    with pytest.raises(ValidationError) as error:
        film(partial(map, lock), range(3), "processes:1")  # type: ignore[arg-type]
    assert error.value.rule.id == "film-pickle"


@pytest.mark.parametrize("frames", [[], range(0), [1.5], [-1], ["1"], [True], 5, None, [float("nan")]])
def test_frames_that_are_none_are_refused(frames: Any) -> None:
    with pytest.raises(ValidationError, match="film-frames"):
        film(paint, frames)


@pytest.mark.parametrize(
    ("name", "rule"),
    [
        ("film", "film-output"),
        ("film.png", "film-output"),
        ("%d", "film-output"),
        ("%d.nothing", "film-output"),
        ("%d-%d.png", "film-output"),
        ("%s.png", "film-output"),
        ("100%-%d.png", "film-output"),
        ("film.nothing", "video-file"),
    ],
)
def test_outputs_that_cant_be_written_are_refused_before_a_frame_is_drawn(
    tmp_path: Path, name: str, rule: str
) -> None:
    log = SharedLog()
    with pytest.raises(ValidationError) as error:
        film(Painter(log), range(3), output=tmp_path / name)
    assert error.value.rule.id == rule
    assert log == []
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("fps", [0.0, float("nan"), -1.0])
def test_a_rate_that_is_none_is_refused(tmp_path: Path, fps: float) -> None:
    pytest.importorskip("av", reason="no PyAV: pip install rhi[video]")
    with pytest.raises(ValidationError, match="fps"):
        film(paint, range(3), output=tmp_path / "film.mp4", fps=fps)


def test_an_executor_of_no_known_kind_is_refused_by_name() -> None:
    with pytest.raises(ValidationError, match="executor-name"):
        film(paint, range(3), "process:2")


@pytest.fixture
def without(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    def hide(name: str) -> None:
        monkeypatch.setitem(sys.modules, name, None)

    return hide


def test_a_bar_shows_the_progress_and_the_time_left(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    film(paint, range(3), output=tmp_path / "%d.png", progress=False)
    assert capsys.readouterr().err == ""
    film(paint, range(5), output=tmp_path / "%d.png", progress=True)
    error = capsys.readouterr().err
    assert "film:  60%" in error  # the three that exist
    assert "5/5" in error


@pytest.mark.parametrize(
    ("module", "extra", "make"),
    [
        ("PIL.Image", "images", lambda folder: film(paint, range(2), output=folder / "%d.png")),
        ("av", "video", lambda folder: film(paint, range(2), output=folder / "film.mp4")),
        ("distributed", "dask", lambda folder: film(paint, range(2), "dask:tcp://nowhere:1")),
    ],
)
def test_missing_libraries_are_named_with_what_to_install(
    without: Callable[[str], None],
    tmp_path: Path,
    module: str,
    extra: str,
    make: Callable[[Path], FilmResult],
) -> None:
    without(module)
    with pytest.raises(DeviceError) as error:
        make(tmp_path)
    assert f"rhi[{extra}]" in error.value.tip
    assert list(tmp_path.iterdir()) == []


def test_without_tqdm_a_line_says_so_and_the_film_is_drawn(
    without: Callable[[str], None], capsys: pytest.CaptureFixture[str]
) -> None:
    without("tqdm")
    assert film(paint, range(3), progress=True).drawn == 3
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "rhi[film]" in error


def test_an_executor_ends_a_call_that_dies_each_time_and_no_other() -> None:
    with make_executor("processes:2") as executor:
        futures = [executor.submit(paint_or_die, frame, fatal=(1,)) for frame in range(4)]
        assert futures[1].exception() is not None
        assert [bool(future.exception()) for future in futures] == [False, True, False, False]
        assert executor.submit(abs, -1).result() == 1


CLUSTER = """
import os, signal, sys, threading, time
from pathlib import Path
import numpy as np
import dask.config
from distributed import LocalCluster
import rhi_screen
import rhi_screen.executors

def render(frame):
    time.sleep(0.02)
    return np.random.default_rng(frame).integers(0, 256, (8, 10, 4), np.uint8)

def deadly(frame):
    return render(frame) if frame != 7 else os._exit(1)

if __name__ == "__main__":
    # A busy machine takes minutes to start a worker again. Dask gives it up after 15 seconds.
    dask.config.set({"distributed.deploy.lost-worker-timeout": "900s"})
    rhi_screen.executors.NO_WORKER_SECONDS = 900.0
    folder = Path(sys.argv[1])
    rhi_screen.film(render, range(60), output=folder / "serial" / "%d.png")
    with LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster:
        address = f"dask:{cluster.scheduler_address}"

        def kill():
            while len(list((folder / "dask").glob("*.png"))) < 10:
                time.sleep(0.01)
            os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)

        threading.Thread(target=kill).start()
        result = rhi_screen.film(render, range(60), address, folder / "dask" / "%d.png")
        print(result.drawn)
        try:
            rhi_screen.film(deadly, range(10), address, folder / "deadly" / "%d.png")
        except rhi_screen.films.DeviceError as error:
            print(error.rule.id, error.given)
"""


@pytest.mark.nightly
def test_a_dask_cluster_whose_worker_is_killed_draws_the_same_film(tmp_path: Path) -> None:
    """Runs in a process of its own, so that warnings of dask on a slow machine don't fail the test."""
    pytest.importorskip("distributed")
    program = tmp_path / "cluster.py"
    program.write_text(CLUSTER, encoding="utf-8")
    command = [sys.executable, str(program), str(tmp_path)]
    run = subprocess.run(command, capture_output=True, text=True, check=False, encoding="utf-8")
    assert run.returncode == 0, run.stderr
    assert run.stdout.splitlines() == ["60", "film-killed frame 7"]
    assert read_all(tmp_path / "dask") == read_all(tmp_path / "serial")
    assert len(read_all(tmp_path / "deadly")) == 9
