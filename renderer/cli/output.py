"""Output of the commands: images, charts, progress and notes."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

from numpy.typing import NDArray

import rhi
from renderer.scene import Scene

T = TypeVar("T")


class OutputError(Exception):
    """An argument that can't be satisfied, such as an image that can't be written."""


def show_progress(items: Iterable[T], task: str, total: int | None = None) -> Iterator[T]:
    """Yield the items with a progress bar on stderr, shown on a terminal if the work takes more than a
    second. `total` is the number of items that don't know it themselves."""
    from tqdm import tqdm  # optional

    bar: Iterator[T] = tqdm(
        items, desc=task, total=total, file=sys.stderr, disable=None, leave=False, delay=1.0
    )
    return bar


class BuildLine(logging.Handler):
    """Shows how many kernels a first run has built in one line of the terminal, and clears the line at the
    end. A warning stays above it."""

    def emit(self, record: logging.LogRecord) -> None:
        if record.levelno > logging.INFO:
            print(f"\r\x1b[K{record.getMessage()}", file=sys.stderr, flush=True)
            return
        done = isinstance(record.args, tuple) and record.args[:1] == record.args[1:]
        print("\r\x1b[K" + ("" if done else record.getMessage()), end="", file=sys.stderr, flush=True)


def show_builds() -> None:
    """Show a `BuildLine` on stderr if that is a terminal."""
    logger = logging.getLogger("rhi.kernels")
    if sys.stderr.isatty() and not logger.handlers:
        logger.addHandler(BuildLine())
        logger.setLevel(logging.INFO)


def report_omissions(scene: Scene) -> dict[str, list[dict[str, Any]]]:
    """The omissions of a scene's file, as `left_out` of a JSON report; empty if there are none."""
    return {"left_out": [asdict(omission) for omission in scene.omissions]} if scene.omissions else {}


def print_report(report: Mapping[str, Any], scene: Scene) -> None:
    """Print a report about a scene as JSON, with what was left out of its file."""
    print(json.dumps({**report, **report_omissions(scene)}))


def short_name(scene: Scene) -> str:
    """A short name for files: the generator's, or the model file's without its extension."""
    name = scene.name.partition(":")[0]
    return Path(name).stem or "scene"


def prepare_image(path: Path, option: str = "--output") -> Path:
    """Check that an option's image can be written, before any work is done for it; return `path`."""
    from PIL import Image  # optional

    return _prepare(
        path, option, Image.registered_extensions(), "has no known image extension; end it with .png"
    )


def prepare_chart(path: Path) -> Path:
    """Check that the chart that `--plot` names can be written; return `path`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    suffixes = [f".{kind}" for kind in FigureCanvasAgg.get_supported_filetypes()]
    wrong = "is not the name of a chart: it has no known image extension; end it with .svg"
    return _prepare(path, "--plot", suffixes, wrong)


def _prepare(path: Path, option: str, suffixes: Collection[str], wrong: str) -> Path:
    if path.suffix.lower() not in suffixes:
        raise OutputError(f"{option}: {path.name!r} {wrong}")
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.is_dir():
        raise OutputError(f"{option}: {path} is a folder; name a file in it")
    return path


def write_image(path: Path, pixels: NDArray[Any]) -> None:
    """Write (height, width, 3 or 4) sRGB pixels without their alpha."""
    from PIL import Image  # optional

    Image.fromarray(pixels[:, :, :3]).save(path, optimize=True)


@contextmanager
def draw_chart(path: Path, title: str = "", dpi: int = 100) -> Iterator[Any]:
    """Yield an empty matplotlib figure and write it to `path` at the end. matplotlib is imported on first
    use."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4), layout="constrained")
    FigureCanvasAgg(figure)
    if title:
        figure.suptitle(title)
    yield figure
    figure.savefig(path, dpi=dpi)


def note(text: str) -> None:
    """Print a message to stderr; results go to stdout."""
    print(text, file=sys.stderr)


def open_available_devices(stack: ExitStack, names: Iterable[str]) -> list[rhi.Device]:
    """Open a device of each of these backends that works here, and say why the others are left out.

    Raises:
        RhiError: none of them works; it is the first one's.
    """
    devices: list[rhi.Device] = []
    errors: dict[str, rhi.RhiError] = {}
    for name in names:
        try:
            devices.append(stack.enter_context(rhi.create_device(name)))
        except rhi.RhiError as error:
            errors[name] = error
    if not devices:
        raise next(iter(errors.values()))
    for name, reason in errors.items():
        note(f"{name} is left out: {reason.given or reason.rule.sentence}")
    return devices
