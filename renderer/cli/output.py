"""What commands write: images, progress, and where they go."""

from __future__ import annotations

import logging
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

from numpy.typing import NDArray
from PIL import Image
from tqdm import tqdm

from renderer.scene import Scene

T = TypeVar("T")


class OutputError(Exception):
    """An image can't be written where it should be."""


def show_progress(items: Iterable[T], total: int | None, what: str) -> Iterator[T]:
    """A progress bar on stderr while the items are worked on: on a terminal, and if it takes over a second."""
    bar: Iterator[T] = tqdm(
        items, desc=what, total=total, file=sys.stderr, disable=None, leave=False, delay=1.0
    )
    return bar


class BuildLine(logging.Handler):
    """How far a first run is with building kernels, in a terminal's line; it goes when they are built."""

    def emit(self, record: logging.LogRecord) -> None:
        done = isinstance(record.args, tuple) and record.args[:1] == record.args[1:]
        print("\r\x1b[K" + ("" if done else record.getMessage()), end="", file=sys.stderr, flush=True)


def show_builds() -> None:
    """Let the terminal on stderr, if it is one, show a `BuildLine`."""
    logger = logging.getLogger("rhi.kernels")
    if sys.stderr.isatty() and not logger.handlers:
        logger.addHandler(BuildLine())
        logger.setLevel(logging.INFO)


def name_of(scene: Scene) -> str:
    """A short name for files: the generator's, or the model file's without its ending."""
    name = scene.name.partition(":")[0]
    return Path(name).stem or "scene"


def prepare_image(path: Path) -> Path:
    """`path`, once it is sure that an image can be written there: before any work is done for it."""
    if path.suffix.lower() not in Image.registered_extensions():
        raise OutputError(f"--output: {path.name!r} names no image format; end it with .png")
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.is_dir():
        raise OutputError(f"--output: {path} is a folder; name a file in it")
    return path


def write_image(path: Path, pixels: NDArray[Any]) -> None:
    """Write (height, width, 4) sRGB pixels, without their alpha."""
    Image.fromarray(pixels[:, :, :3]).save(path, optimize=True)


def note(text: str) -> None:
    """Say something that isn't the result."""
    print(text, file=sys.stderr)
