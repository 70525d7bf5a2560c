"""Films: frames that any number of workers draw, as images or a video.

    def render(frame):
        return draw(frame / 60)             # a texture, or an array of pixels

    film(render, range(600), "processes:4", "turn.mp4")

- A frame is a **pure function of its number**: `render` must draw the same whoever calls it, and whatever was
  drawn before. So the bytes of a film don't depend on the number of workers, on their order or on
  interruptions.
- `render` travels to each worker once, and each has a copy of its own; only plain functions are shared by
  threads. If it is a context manager, a worker enters its copy before its first frame, to open a device, and
  leaves it after the last.
- Workers return image files as bytes, and only the calling process writes: workers need no common folder.
- Frames that exist aren't drawn again. So what was interrupted goes on where it stopped.
- A worker that dies gives its frame to another. A frame that ends three is reported by its number.
"""

from __future__ import annotations

import copy
import pickle
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor
from concurrent.futures import wait as wait_for
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType
from typing import Any, Final, Protocol
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

import rhi
from rhi.errors import DeviceError, RhiError, ValidationError, refuse
from rhi.errors.arguments import to_integer
from rhi_screen.executors import (
    MAX_DEATHS,
    SerialExecutor,
    WorkerProcesses,
    WorkerWatch,
    get_client,
    is_lost,
    make_executor,
    replace_dask_executor,
)
from rhi_screen.frame_files import FAST, SMALL, FrameFiles, decode, encode, parse_output
from rhi_screen.rules import (
    EXECUTOR_ENDED,
    FILM_FRAME,
    FILM_FRAMES,
    FILM_KILLED,
    FILM_OTHER,
    FILM_PICKLE,
)
from rhi_screen.video import VideoWriter, read_colors, read_comment

_CALL: Final = "rhi_screen.film"
_CHECK_SECONDS: Final = 1.0
_LISTED: Final = 8  # numbers of frames in a message

FrameFunction = Callable[[int], rhi.Texture | NDArray[np.uint8]]
"""Draws the frame of a number: a texture of 8-bit colors, or (height, width, 3 or 4) uint8."""


@dataclass(frozen=True, eq=False, slots=True)
class FilmResult:
    """The outcome of a film.

    Attributes:
        output: the video, or the name of the images; None if there is none.
        frames: the number of frames.
        drawn: the number of frames drawn now.
        reused: the number of frames that existed before.
        images: without an output all frames in order, (height, width, 3 or 4) uint8.
        sources: the different `description`s of what has drawn frames now.
    """

    output: Path | None
    frames: int
    drawn: int
    reused: int
    images: list[NDArray[np.uint8]] = field(default_factory=list)
    sources: tuple[str, ...] = ()


def film(
    render: FrameFunction,
    frames: Iterable[int],
    executor: str | Executor = "serial",
    output: str | Path | None = None,
    *,
    fps: float = 60.0,
    identity: str = "",
    progress: bool | None = None,
) -> FilmResult:
    """Draw the frames of a film on the workers of an executor.

    Args:
        render: draws a frame. It is called on a worker. For threads it must be copyable (`copy.deepcopy`), for
            processes and clusters picklable. If it is a context manager, each worker enters a copy, and calls
            what that returns. An attribute `description` of it, such as the device's name, is collected in
            the result.
        frames: the numbers of the frames, 0 or more, in the order of the video.
        executor: one of `rhi_screen.executors.KINDS`, an open executor, or a client of Dask.
        output: the file of a video (`turn.mp4`), or the name of images with the number's place in it
            (`turn/%05d.png`); their folder is made. None returns the images.
        fps: frames a second of the video.
        identity: a text that differs if the frames do. It is stored in PNGs and videos. A frame of another
            identity is refused, and a video of the same one isn't made again.
        progress: whether to show a bar with the time left on stderr; None: if that is a terminal.

    Raises:
        ValidationError: `film-frames`, `film-output`, `film-pickle`, `film-other`; `film-frame` if `render`
            raises an exception, from that; `video-file`, `video-image`, `video-size`, `executor-name`.
        DeviceError: `film-killed` if a frame ends each process that draws it; `executor-ended` if no worker
            is left; `screen-missing`, `executor-missing`, `executor-scheduler`.

    Examples:
        >>> def render(frame):
        ...     return np.full((36, 64, 3), frame, np.uint8)
        >>> [int(array.max()) for array in film(render, range(3)).images]
        [0, 1, 2]
    """
    numbers = _check_numbers(frames)
    files, video = (None, None) if output is None else parse_output(Path(output), _CALL)
    if video is not None:
        VideoWriter.check(video, fps)
        if identity and read_comment(video) == _identify_video(identity, numbers, fps):
            return FilmResult(video, len(numbers), 0, len(numbers))
    missing = list(dict.fromkeys(numbers))
    if files is not None:
        files.folder.mkdir(parents=True, exist_ok=True)
        missing = _select_missing(files, missing, identity)
    images: dict[int, NDArray[np.uint8]] = {}
    sources: dict[str, None] = {}
    form = FrameForm("" if files is None else files.suffix, identity, SMALL if video is None else FAST)
    with ExitStack() as stack:
        count = len(set(numbers))
        bar = stack.enter_context(show_bar("film", count, count - len(missing), progress))
        if video is not None and files is not None:
            stack.callback(_remove_empty, files.folder)
        if missing:
            pool = stack.enter_context(_open_executor(executor))
            for number, frame in stack.enter_context(_Drawing(render, missing, pool, form)):
                if files is None:
                    images[number] = pickle.loads(frame.content)
                else:
                    files.write(number, frame.content)
                sources[frame.source] = None
                bar.update()
    if files is not None and video is not None:
        _write_video(files, video, numbers, fps, identity)
    return FilmResult(
        None if output is None else Path(output),
        len(numbers),
        len(missing),
        len(set(numbers)) - len(missing),
        [images[number] for number in numbers] if files is None else [],
        tuple(source for source in sources if source),
    )


def _check_numbers(frames: Iterable[int]) -> list[int]:
    try:
        values = list(frames)
    except TypeError:
        values = []
    numbers = [to_integer(value) for value in values]
    if not numbers or any(number is None or number < 0 for number in numbers):
        refuse(FILM_FRAMES, f"{_CALL}(frames=...)", repr(frames), "whole numbers of 0 or more, at least one")
    return [number for number in numbers if number is not None]


def _select_missing(files: FrameFiles, numbers: list[int], identity: str) -> list[int]:
    """Return the frames that have no complete file; refuse files of another film."""
    identities = {number: files.read_identity(number) for number in numbers}
    others = [number for number, other in identities.items() if other and identity and other != identity]
    if others:
        refuse(
            FILM_OTHER,
            _CALL,
            f"{files.path(others[0])}, and {len(others) - 1} more"
            if others[1:]
            else str(files.path(others[0])),
        )
    return [number for number, other in identities.items() if other is None]


def _identify_video(identity: str, numbers: list[int], fps: float) -> str:
    return sha256(repr((identity, numbers, fps)).encode()).hexdigest()[:24]


def _write_video(files: FrameFiles, video: Path, numbers: list[int], fps: float, identity: str) -> None:
    """Make a video of the files of its frames, completely or not at all, and delete them."""
    part = video.with_name(f"{video.stem}.part{video.suffix}")
    comment = _identify_video(identity, numbers, fps) if identity else ""
    with VideoWriter(part, fps, comment=comment) as writer:
        for number in numbers:
            writer.add(decode(files.path(number).read_bytes()))
    part.replace(video)
    for number in set(numbers):
        files.path(number).unlink()
    _remove_empty(files.folder)


def _remove_empty(folder: Path) -> None:
    """Remove a folder unless it holds frames."""
    with suppress(OSError):
        folder.rmdir()


@contextmanager
def _open_executor(executor: Any) -> Iterator[Executor]:
    """Yield the executor that a text names; close it at the end if it was opened here."""
    if isinstance(executor, str):
        with make_executor(executor, f"{_CALL}(executor=...)") as pool:
            yield pool
    else:
        yield replace_dask_executor(executor)


class ProgressBar(Protocol):
    """A bar that shows how many frames are finished."""

    def update(self) -> object:
        """Count one more."""


class _NoBar:
    def update(self) -> None:
        """Show nothing."""


@contextmanager
def show_bar(what: str, total: int, initial: int, progress: bool | None) -> Iterator[ProgressBar]:
    """Yield a bar of tqdm on stderr, with the time left; without tqdm a line says what is missing."""
    is_shown = sys.stderr is not None and sys.stderr.isatty() if progress is None else progress
    if not is_shown:
        yield _NoBar()
        return
    try:
        tqdm: Any = import_module("tqdm").tqdm
    except ModuleNotFoundError:
        print('tqdm is missing, so no progress is shown: pip install "rhi[film]"', file=sys.stderr)
        yield _NoBar()
        return
    with tqdm(total=total, initial=initial, desc=what, unit="frame", file=sys.stderr) as bar:
        yield bar


@dataclass(frozen=True, slots=True)
class FrameForm:
    """The form in which workers return frames.

    Attributes:
        suffix: the ending of the image files; "" returns pixels.
        identity, compression: those of `encode`.
    """

    suffix: str
    identity: str
    compression: int


@dataclass(frozen=True, slots=True)
class DrawnFrame:
    """A frame as a worker returns it: the content of its file, and the description of what has drawn it."""

    content: bytes
    source: str


@dataclass(frozen=True, slots=True)
class FilmTask:
    """The part of each call that is the same for all frames of a film.

    Attributes:
        token: the film's name among all others of a worker.
        path: a file with the pickled function, for workers that share a disk; "" if it was sent otherwise.
        is_shared: whether the function of this process is called itself, instead of a copy.
    """

    token: str
    form: FrameForm
    path: str = ""
    is_shared: bool = False


class _Drawing:
    """Draws frames on an executor, and yields each one when it is finished. Leaving its block cancels what is
    left, and closes what workers have opened."""

    def __init__(
        self, render: FrameFunction, numbers: list[int], executor: Executor, form: FrameForm
    ) -> None:
        self._render, self._executor = render, executor
        self._queue = deque(numbers)
        self._form = form
        self._running: dict[Future[DrawnFrame], int] = {}
        self._lost: list[int] = []
        self._stack = ExitStack()

    def __enter__(self) -> Iterator[tuple[int, DrawnFrame]]:
        with self._stack as stack:
            self._task = self._share(stack)
            self._stack = stack.pop_all()
        return self._draw()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for future in self._running:
            future.cancel()
        self._stack.__exit__(kind, error, trace)

    def _share(self, stack: ExitStack) -> FilmTask:
        """Bring the function to the workers, once for each; at the end of the stack it is forgotten."""
        token = uuid4().hex
        executor = self._executor
        client = get_client(executor)
        if client is not None:
            plugin: Any = import_module("rhi_screen.dask_films")
            stack.enter_context(plugin.send(client, token, _pickle(self._render, is_remote=True)))
            return FilmTask(token, self._form)
        if isinstance(executor, SerialExecutor | ThreadPoolExecutor):
            _functions[token] = self._render
            stack.callback(_functions.pop, token)
            if isinstance(executor, SerialExecutor):
                stack.callback(close_film, token)
            else:
                stack.callback(close_on_threads, executor, token)
            return FilmTask(token, self._form, is_shared=isinstance(executor, SerialExecutor))
        path = Path(stack.enter_context(TemporaryDirectory(prefix="film-"))) / "render"
        path.write_bytes(_pickle(self._render, is_remote=False))
        stack.callback(close_film, token)  # if the executor runs calls on this thread
        return FilmTask(token, self._form, str(path))

    def _draw(self) -> Iterator[tuple[int, DrawnFrame]]:
        watch = WorkerWatch(self._executor, _CALL)
        is_queueing = not isinstance(self._executor, SerialExecutor)
        drawn = 0
        while self._queue or self._running:
            while self._queue and len(self._running) < max(watch.count, 1) * (1 + is_queueing):
                self._submit(self._queue.popleft())
            done, _ = wait_for(self._running, timeout=_CHECK_SECONDS, return_when=FIRST_COMPLETED)
            watch.ask()
            # Frames that are drawn come before errors, which end the film: so they are stored.
            for future in sorted(done, key=lambda future: future.exception() is not None):
                number = self._running.pop(future)
                frame = self._receive(future, number)
                if frame is not None:
                    drawn += 1
                    yield number, frame
            if not drawn and len(self._lost) >= MAX_DEATHS:
                break
        yield from self._draw_alone()
        if self._lost:
            others = f", and {len(self._lost) - _LISTED} more" if len(self._lost) > _LISTED else ""
            numbers = ", ".join(str(number) for number in sorted(self._lost)[:_LISTED])
            noun = "frame" if len(self._lost) == 1 else "frames"
            raise DeviceError(FILM_KILLED, _CALL, f"{noun} {numbers}{others}")

    def _draw_alone(self) -> Iterator[tuple[int, DrawnFrame]]:
        """Draw lost frames again, one at a time: Dask doesn't tell which of a worker's frames has ended it."""
        if get_client(self._executor) is None or self._queue or self._running:
            return
        lost, self._lost = self._lost, []
        for number in lost:
            watch = WorkerWatch(self._executor, _CALL)
            self._submit(number)
            (future,) = self._running
            while not wait_for(self._running, timeout=_CHECK_SECONDS).done:
                watch.ask()
            del self._running[future]
            frame = self._receive(future, number)
            if frame is not None:
                yield number, frame

    def _submit(self, number: int) -> None:
        try:
            self._running[self._executor.submit(draw_frame, self._task, number)] = number
        except Exception as error:
            if is_lost(error):
                raise DeviceError(
                    EXECUTOR_ENDED, _CALL, f"{type(self._executor).__name__}: {error}"
                ) from None
            raise

    def _receive(self, future: Future[DrawnFrame], number: int) -> DrawnFrame | None:
        """Return a finished frame, or None if it has ended the processes that drew it."""
        error = future.exception()
        if error is None:
            return future.result()
        if is_lost(error):
            if get_client(self._executor) is None and not isinstance(self._executor, WorkerProcesses):
                # The standard library's pool ends with its first process.
                raise DeviceError(
                    EXECUTOR_ENDED, _CALL, f"{type(self._executor).__name__}: {error}"
                ) from None
            self._lost.append(number)
            return None
        if isinstance(error, RhiError) and not isinstance(error, ValidationError):
            raise type(error)(
                error.rule, error.call, f"frame {number}: {error.given}", error.allowed, error.tip
            ) from error
        raise ValidationError(FILM_FRAME, _CALL, f"frame {number}: {_describe(error)}") from error


def _describe(error: BaseException) -> str:
    """Return an error of a worker as one line."""
    if isinstance(error, RhiError):
        return f"[{error.rule.id}] {error.rule.sentence}: {error.given}"
    return f"{type(error).__name__}: {error}"


def _pickle(render: FrameFunction, *, is_remote: bool) -> bytes:
    """Return the function for other processes.

    Functions of the main program are sent by name to processes that this one spawns, which import it.
    Processes elsewhere, and those of a notebook, get their code (cloudpickle, which Dask brings).
    """
    main = sys.modules.get("__main__")
    is_script = getattr(main, "__file__", None) is not None
    try:
        if is_script and not is_remote:
            return pickle.dumps(render, pickle.HIGHEST_PROTOCOL)
        try:
            cloudpickle: Any = import_module("cloudpickle")
        except ModuleNotFoundError:
            return pickle.dumps(render, pickle.HIGHEST_PROTOCOL)
        content: bytes = cloudpickle.dumps(render)
    except Exception as error:
        raise ValidationError(
            FILM_PICKLE, f"{_CALL}(render=...)", f"{type(error).__name__}: {error}"
        ) from error
    return content


# On workers

_functions: Final[dict[str, FrameFunction]] = {}
"""By token, the functions of films in this process."""
_contents: Final[dict[str, bytes]] = {}
"""By token, the pickled functions that were sent to this process."""
_opened: Final[dict[tuple[str, int], tuple[Any, Any]]] = {}
"""By token and thread, what draws frames here: the function, and what entering it has returned."""


def draw_frame(task: FilmTask, number: int) -> DrawnFrame:
    """Draw a frame, on a worker."""
    render = _open(task)
    pixels = read_colors(render(number), "the frame that render returns")
    form = task.form
    content = (
        encode(pixels, form.suffix, form.identity, form.compression)
        if form.suffix
        else pickle.dumps(pixels, pickle.HIGHEST_PROTOCOL)
    )
    return DrawnFrame(content, str(getattr(render, "description", "")))


def _open(task: FilmTask) -> Any:
    """Return the function that draws the frames of a film on this thread."""
    key = task.token, threading.get_ident()
    if key not in _opened:
        for token, thread in list(_opened):
            if thread == key[1] and token not in _functions:  # a film that another process has ended
                close_film(token)
        render: Any = _functions.get(task.token)
        if render is None:
            render = pickle.loads(_contents.get(task.token) or Path(task.path).read_bytes())
        elif not task.is_shared:
            render = _copy(render)
        opened = render.__enter__() if hasattr(type(render), "__enter__") else render
        _opened[key] = render, opened
    return _opened[key][1]


def _copy(render: FrameFunction) -> FrameFunction:
    """Return a copy for a thread that shares nothing with others: scenes, for one, change with each frame."""
    try:
        return copy.deepcopy(render)
    except Exception as error:
        raise ValidationError(
            FILM_PICKLE, f"{_CALL}(render=...)", f"{type(error).__name__}: {error}"
        ) from error


def close_film(token: str) -> None:
    """Leave the function of a film on this thread, if it was entered."""
    render, _ = _opened.pop((token, threading.get_ident()), (None, None))
    if hasattr(type(render), "__exit__"):
        render.__exit__(None, None, None)


def close_on_threads(pool: ThreadPoolExecutor, token: str, timeout: float = 30.0) -> None:
    """Leave the function of a film on each thread of a pool. Threads that are busy for longer keep it."""
    threads = len({thread for name, thread in _opened if name == token})
    if not threads:
        return
    barrier = threading.Barrier(len(getattr(pool, "_threads", ())))

    def close() -> None:
        close_film(token)
        with suppress(threading.BrokenBarrierError):
            barrier.wait(timeout)  # so that each thread takes one call

    wait_for([pool.submit(close) for _ in range(barrier.parties)], timeout=timeout)


def receive(token: str, content: bytes) -> None:
    """Store the pickled function of a film in this process."""
    _contents[token] = content


def forget(token: str) -> None:
    """Forget the function of a film in this process."""
    _contents.pop(token, None)
