"""`python -m rhi trace show|replay|page|diff|reduce`.

Results go to stdout, all other text to stderr. Any fault of the input gives one line, `error: …`, and exit
code 2. `diff` exits with 1 if the traces differ.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import struct
import sys
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rhi
from rhi.errors import RhiError
from rhi.errors.output_paths import check_output_file
from rhi.trace.diff import diff
from rhi.trace.file import Trace, load, save
from rhi.trace.page import make_page
from rhi.trace.reduce import reduce, write_test
from rhi.trace.replay import replay

_EXAMPLES = """\
examples:
  python -m rhi trace show frame.zip --label sun
  python -m rhi trace replay frame.zip --backend gl --trust --output frame.png
  python -m rhi trace page frame.zip frame.html --trust
  python -m rhi trace diff before.zip after.zip
  python -m rhi trace reduce frame.zip fault.py:is_black --output small.zip --test test_black.py
--trust runs the shaders of a file: give it only for files whose author you know."""


def main(arguments: Sequence[str]) -> int:
    """Run a command and return the exit code."""
    options = _make_parser().parse_args(arguments)
    try:
        for name in ("output", "test"):
            if getattr(options, name, None) is not None:
                check_output_file(getattr(options, name), f"--{name}")
        code: int = options.run(options)
    except RhiError as error:
        value = f": {error.given}" if error.given else ""
        allowed = f" (allowed: {error.allowed})" if error.allowed else ""
        tip = f"; {error.tip}" if error.tip else ""
        return _fail(f"{error.rule.sentence}{value}{allowed}{tip} [{error.rule.id}]")
    except BrokenPipeError:
        raise  # whoever reads the output has gone away
    except (OSError, ValueError, ImportError) as error:
        return _fail(str(error))
    return code


def _make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m rhi trace",
        description="Inspect recorded command streams.",
        epilog=_EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(metavar="COMMAND", required=True)
    show_parser = commands.add_parser("show", help="print a trace's commands")
    show_parser.set_defaults(run=_show)
    show_parser.add_argument("file", type=Path, metavar="F.zip")
    show_parser.add_argument("--label", help="only the commands inside this label")
    show_parser.add_argument("--limit", type=int, default=1000, help="lines (default: 1000)")
    replay_parser = commands.add_parser("replay", help="issue a trace's commands on a backend")
    replay_parser.set_defaults(run=_replay)
    replay_parser.add_argument("file", type=Path, metavar="F.zip")
    replay_parser.add_argument(
        "--backend", metavar="NAME", help="default: RHI_BACKEND, or the first that works"
    )
    replay_parser.add_argument("--output", type=Path, metavar="F.png", help="write the last presented image")
    _add_trust(replay_parser)
    page_parser = commands.add_parser("page", help="write a page that replays a trace in a browser")
    page_parser.set_defaults(run=_page)
    page_parser.add_argument("file", type=Path, metavar="F.zip")
    page_parser.add_argument("output", type=Path, metavar="F.html")
    _add_trust(page_parser)
    diff_parser = commands.add_parser("diff", help="print what the second trace does differently")
    diff_parser.set_defaults(run=_diff)
    diff_parser.add_argument("a", type=Path, metavar="A.zip")
    diff_parser.add_argument("b", type=Path, metavar="B.zip")
    reduce_parser = commands.add_parser("reduce", help="shrink a trace that shows a fault")
    reduce_parser.set_defaults(run=_reduce)
    reduce_parser.add_argument("file", type=Path, metavar="F.zip")
    reduce_parser.add_argument(
        "predicate",
        metavar="FILE.py:FUNCTION",
        help="or MODULE:FUNCTION: a function of a trace that returns True if the trace shows the fault",
    )
    reduce_parser.add_argument("--output", type=Path, metavar="F.zip", help="write the small trace")
    reduce_parser.add_argument("--test", type=Path, metavar="test_F.py", help="write it as a pytest file")
    _add_trust(reduce_parser)
    return parser


def _add_trust(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--trust", action="store_true", help="run the shaders of the file; only if you know who made it"
    )


def _show(options: argparse.Namespace) -> int:
    trace = load(options.file)
    commands = trace.stream if options.label is None else trace.stream.filter(label=options.label)
    refusals = [
        refusal for refusal in trace.refusals if options.label is None or options.label in refusal.labels
    ]
    print(commands.format(options.limit, refusals))
    failed, refused = len(trace.stream.failures), len(trace.refusals)
    note = f"{len(trace)} commands, {len(trace.stream.draws())} draws, {failed} failed, {refused} refused"
    print(f"{note}; recorded on {trace.backend or 'an unknown backend'}", file=sys.stderr)
    return 0


def _replay(options: argparse.Namespace) -> int:
    trace = load(options.file, trusted=options.trust)
    with rhi.create_device(options.backend) as device:
        result = replay(trace, on=device)
        print(f"{result.commands} commands replayed on {device.backend_name}", file=sys.stderr)
        for index, failure in result.failures.items():
            now = failure.error if failure is not None else "it didn't fail now"
            print(f"command {index} had failed: {now}", file=sys.stderr)
        for refusal in result.refusals:
            print(f"refused before command {refusal.index}, when it was recorded: {refusal}", file=sys.stderr)
        if options.output is not None:
            if result.image is None:
                return _fail("the trace presents no image")
            options.output.write_bytes(encode_png(result.image))
            print(options.output)
            if not device.capabilities.shading:
                print(
                    f"the {device.backend_name} device draws nothing: the image is as cleared",
                    file=sys.stderr,
                )
    return 0


def _page(options: argparse.Namespace) -> int:
    trace = load(options.file, trusted=options.trust)
    options.output.write_text(make_page(trace, title=options.file.name), encoding="utf-8")
    print(options.output)
    return 0


def _diff(options: argparse.Namespace) -> int:
    differences = diff(load(options.a), load(options.b))
    print(differences)
    return 1 if differences else 0


def _reduce(options: argparse.Namespace) -> int:
    trace, predicate = load(options.file, trusted=options.trust), _import(options.predicate)
    small = reduce(trace, predicate)
    print(f"{len(trace)} commands reduced to {len(small)}", file=sys.stderr)
    if options.output is not None:
        save(small, options.output)
    if options.test is not None:
        write_test(small, options.test, predicate)
    print(small.stream)
    return 0


def _import(text: str) -> Callable[[Trace], bool]:
    """Return the function that `file.py:function` or `module:function` names."""
    module_name, _, name = text.rpartition(":")
    if not module_name or not name.isidentifier():
        raise ValueError(f"{text!r} is no FILE.py:FUNCTION")
    if module_name.endswith(".py"):
        spec = importlib.util.spec_from_file_location(Path(module_name).stem, module_name)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[spec.name] = module
        spec.loader.exec_module(module)
    else:
        module = importlib.import_module(module_name)
    function: Callable[[Trace], bool] | None = getattr(module, name, None)
    if function is None:
        raise ValueError(f"{module_name} has no {name}")
    return function


def _fail(message: str) -> int:
    print(f"error: {' '.join(message.split())}", file=sys.stderr)
    return 2


def encode_png(image: NDArray[Any]) -> bytes:
    """Return (height, width, channels) texels as a PNG: 8 bits, gray or RGB, without alpha (PNG, ISO/IEC
    15948)."""
    if image.dtype.kind == "f":
        values = (np.clip(np.nan_to_num(image), 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)
    elif image.dtype.itemsize > 1:
        values = (image >> (8 * image.dtype.itemsize - 8)).astype(np.uint8)
    else:
        values = image.view(np.uint8)
    values = values[:, :, :1] if values.shape[2] < 3 else values[:, :, :3]
    height, width, channels = values.shape
    rows = np.zeros((height, 1 + width * channels), np.uint8)  # each row begins with its filter: none
    rows[:, 1:] = values.reshape(height, -1)
    header = struct.pack(">IIBBBBB", width, height, 8, 2 if channels == 3 else 0, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), 6)), (b"IEND", b"")]
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )
