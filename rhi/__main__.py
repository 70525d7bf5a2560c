"""`python -m rhi` lists the backends that work on this machine, what they support, and what to install for
the others.

`python -m rhi trace` inspects traces, `python -m rhi shading accuracy` measures built-in functions,
`python -m rhi new` starts a project, `python -m rhi new-backend` a port, `python -m rhi warm` builds kernels, and
`python -m rhi docs` shows the documentation.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import inspect
import json
import os
import platform
import pydoc
import re
import sys
import webbrowser
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

import rhi
from rhi.device.registry import BackendReport, default_precision
from rhi.errors import RhiError, pages
from rhi.errors.pipes import run_until_pipe_closes

_MAX_SECTIONS: Final = 8  # that a search lists
_REFERENCE: Final = (
    "rhi",
    "rhi.math",
    "rhi.shading",
    "rhi.testing",
    "rhi_screen",
    "renderer",
    "rhi.trace",
    "rhi.contract",
)
"""Packages whose public names `docs` shows; those that aren't installed are passed over."""
_COMMANDS: Final = """\
commands, each with --help:
  trace             inspect recorded commands: show, replay, page, diff, reduce
  shading accuracy  measure error and time of the shading language's built-in functions
  new               write a small project to start from: a game, a tool, or tests
  new-backend       write a package to start a port from
  warm              build the OpenCL kernels that every program needs
  docs              show a page of the documentation in the terminal, or in a browser

RHI_BACKEND=null python app.py runs a program on the backend of that name, RHI_PRECISION=fast with the faster
functions of OpenCL.
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the report, or run `trace …`, `shading …`, `new …`, `new-backend …`, `docs …` or `warm`. Return 0 if a
    backend that renders works, else 1."""
    command_line = list(sys.argv[1:] if arguments is None else arguments)
    if command_line[:1] == ["trace"]:
        from rhi.trace import cli  # as for all commands: each imports what the others don't need

        return cli.main(command_line[1:])
    if command_line[:1] == ["shading"]:
        from rhi.testing.accuracy import report

        return report.main(command_line[1:])
    if command_line[:1] == ["new"]:
        return _new(command_line[1:])
    if command_line[:1] == ["new-backend"]:
        return _new_backend(command_line[1:])
    if command_line[:1] == ["docs"]:
        return _docs(command_line[1:])
    if command_line[:1] == ["warm"]:
        return _warm(command_line[1:])
    parser = argparse.ArgumentParser(
        prog="python -m rhi",
        usage="%(prog)s [-h] [--json]\n       %(prog)s COMMAND …",
        description="List the backends that work here, what they support, and what the others need.",
        epilog=_COMMANDS,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--json", action="store_true", help="print the report as JSON")
    options = parser.parse_args(command_line)
    reports = rhi.report()
    print(json.dumps(_as_json(reports), indent=2) if options.json else _as_text(reports))
    return 0 if any(r.capabilities and r.capabilities.renders for r in reports) else 1


def _warm(arguments: Sequence[str]) -> int:
    """Build the OpenCL kernels that every program needs. Return 0, or 2 if there is no OpenCL device."""
    argparse.ArgumentParser(
        prog="python -m rhi warm",
        description="Build the OpenCL kernels that every program needs, optimised, into the folder of compiled\n"
        "kernels (RHI_CACHE). The first frame of a program then builds its own stages alone.",
        epilog="example, for an image that tests run in:\n  RUN pip install rhi && python -m rhi warm",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    ).parse_args(arguments)
    try:
        from rhi.backends.cl.warm import warm

        built = warm(_print_progress)
    except (RhiError, ImportError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(f"{built} programs built" if built else "nothing to build")
    return 0


def _print_progress(done: int, count: int) -> None:
    """Show on a terminal how far a build is."""
    if count and sys.stderr.isatty():
        print(
            f"\rbuilding kernels, {done} of {count}",
            end="\n" if done == count else "",
            file=sys.stderr,
            flush=True,
        )


def _new(arguments: Sequence[str]) -> int:
    """Write a project to start from. Return 0, or 2 on an error."""
    from rhi.testing.projects import KINDS, write_project

    kinds = "\n".join(f"  {kind:<8}{words}" for kind, (words, _) in KINDS.items())
    parser = argparse.ArgumentParser(
        prog="python -m rhi new",
        description=f"Write a small project with its tests, which need no GPU:\n\n{kinds}",
        epilog="example:\n  python -m rhi new tool paint\n  cd paint\n  pip install --editable '.[test]'\n"
        "  python -m pytest\n  python paint.py",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("kind", choices=KINDS, help="the kind of project")
    parser.add_argument("name", metavar="NAME", help="name of the project and of its module, such as paint")
    parser.add_argument("--folder", type=Path, default=Path(), help="where to write it (default: here)")
    options = parser.parse_args(arguments)
    return _write(
        lambda: write_project(options.kind, options.name, options.folder), "its README.md says how to begin"
    )


def _write(make: Callable[[], Path], hint: str) -> int:
    """Write what `make` writes, and print where. Return 0, or 2 on an error."""
    try:
        root = make()
    except RhiError as error:
        print(f"error: {error.given} (allowed: {error.allowed})", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(root)
    print(f"next: {hint.format(root=root)}", file=sys.stderr)
    return 0


def _new_backend(arguments: Sequence[str]) -> int:
    """Write a package to start a port from. Return 0, or 2 on an error."""
    from rhi.conformance.template import write_package

    parser = argparse.ArgumentParser(
        prog="python -m rhi new-backend",
        description="Write a package that registers a new backend. Its methods raise NotImplementedError.",
        epilog="example:\n  python -m rhi new-backend vulkan --folder ports\n"
        "  pip install --editable ports/rhi-vulkan\n"
        "  pytest --pyargs rhi.conformance --rhi-backend vulkan -q",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("name", metavar="NAME", help="as in rhi.create_device(NAME)")
    parser.add_argument("--folder", type=Path, default=Path(), help="where to write it (default: here)")
    options = parser.parse_args(arguments)
    hint = "pip install --editable {root}, then let the conformance kit tell what to implement first:\n"
    hint += f"  pytest --pyargs rhi.conformance --rhi-backend {options.name} -q"
    return _write(lambda: write_package(options.name, options.folder), hint)


def _docs(arguments: Sequence[str]) -> int:
    """Show a page of the documentation, or list them. Return 0, or 2 on an error."""
    parser = argparse.ArgumentParser(
        prog="python -m rhi docs",
        description="Show a page of the documentation, as Markdown, the signature and docstring of a public\n"
        "name, or the section that answers some words best. Without a topic, list the pages.",
        epilog='example:\n  python -m rhi docs traces\n  python -m rhi docs "lost device"\n'
        "  python -m rhi docs Device.texture\n"
        "  python -m rhi docs testing --browser",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "topic",
        nargs="*",
        metavar="TOPIC",
        help="such as traces, or the beginning of it; a name such as look_at; or words to search for",
    )
    parser.add_argument("--browser", action="store_true", help="show it in a browser")
    options = parser.parse_args(arguments)
    try:
        if not options.topic:
            topics = pages.list_topics()
            text = "\n".join(f"{topic:<36}{title}" for topic, title in topics.items())
        else:
            text = _read_docs(options.topic)
    except pages.UnknownPageError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    if options.browser:
        address = pages.write_html(text).as_uri()
        print(address)
        return 0 if webbrowser.open(address) else 1
    if sys.stdout.isatty():
        pydoc.pager(text)
    else:
        print(text)
    return 0


def _read_docs(words: Sequence[str]) -> str:
    """Return the page or the public name that a word names, or else what a search of the words returns."""
    if len(words) > 1 or " " in words[0].strip():
        return _search(words)
    try:
        return pages.read_page(words[0])
    except pages.UnknownPageError as error:
        described = _describe(words[0])
        if described:
            return described
        if error.close or not re.fullmatch(r"\w+", words[0]):
            raise
    return _search(words)


def _describe(name: str) -> str:
    """Return signature and docstring of a public name, such as "look_at" or "rhi.Device.texture"; "" if there
    is none."""
    for package in _REFERENCE:
        try:
            value: Any = importlib.import_module(package)
        except ImportError:
            continue
        path = name.removeprefix(f"{package}.").split(".")
        if path[0] not in getattr(value, "__all__", dir(value)):
            continue
        for part in path:
            value = None if part.startswith("_") else getattr(value, part, None)
        if value is not None:
            return _describe_value(f"{package}.{'.'.join(path)}", value)
    return ""


def _describe_value(name: str, value: object) -> str:
    try:
        signature = str(inspect.signature(value)).replace("'", "") if callable(value) else ""
    except ValueError:
        signature = ""  # of a class without one, such as an enumeration
    members = [
        member
        for member in (sorted(vars(value)) if isinstance(value, type) else ())
        if not member.startswith("_")
    ]
    lines = [name + signature, "", inspect.getdoc(value) or ""]
    if members:
        lines += ["", f"{name.rpartition('.')[2]}.NAME describes: {', '.join(members)}"]
    return "\n".join(lines)


def _search(words: Sequence[str]) -> str:
    """Return the section that has most of the words, and where to read on."""
    best, *others = pages.search(words)[:_MAX_SECTIONS]
    lines = [best.text, "", f"This is in: python -m rhi docs {best.topic}"]
    if others:
        lines += ["See also:", *(f"  {section.topic:<24}{section.heading}" for section in others)]
    return "\n".join(lines)


def _as_json(reports: list[BackendReport]) -> dict[str, Any]:
    return {
        "rhi": rhi.__version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "precision": default_precision().value,
        "backends": [
            {
                "name": r.name,
                "usable": r.usable,
                "reason": r.reason,
                "tip": r.tip,
                "capabilities": None
                if r.capabilities is None
                else _plain(dataclasses.asdict(r.capabilities)),
            }
            for r in reports
        ],
    }


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    return {
        name: sorted(member.__name__ if isinstance(member, type) else member.name for member in value)
        if isinstance(value, frozenset)
        else value
        for name, value in values.items()
    }


def _as_text(reports: list[BackendReport]) -> str:
    lines = [f"rhi {rhi.__version__}, Python {platform.python_version()}, NumPy {np.__version__}", ""]
    for r in reports:
        if r.capabilities is None:
            reason = r.reason.replace("\n", "\n" + " " * 11)
            lines += [f"{r.name:<6} not usable: {reason}", f"       {r.tip}", ""]
            continue
        limits = r.capabilities
        flags = {f.name: getattr(limits, f.name) for f in dataclasses.fields(limits)}
        lacking = [name for name, value in flags.items() if value is False]
        lines += [
            f"{r.name:<6} {limits.device}",
            f"       {limits.driver}",
            f"       textures to {limits.max_texture_size}, {limits.max_color_targets} targets, "
            f"{'/'.join(map(str, limits.sample_counts))} samples, work-groups to "
            f"{limits.max_work_group_invocations}",
            f"       lacks: {', '.join(lacking) or 'nothing'}",
            *(f"       disabled: {fault}" for fault in limits.disabled_features),
            *(f"       rejected: {device}" for device in limits.rejected_devices),
            "",
        ]
    choice = f"rhi.create_device() would choose: {_choice_text(reports)}"
    return "\n".join([*lines, f"precision: {_precision_text()}", choice])


def _precision_text() -> str:
    """Describe the default precision of shaders, and whether the environment sets it."""
    precision = default_precision().value
    if os.environ.get("RHI_PRECISION"):
        return f"{precision}, as RHI_PRECISION says"
    return f"{precision}; RHI_PRECISION=fast computes faster on OpenCL, about as exactly as OpenGL"


def _choice_text(reports: list[BackendReport]) -> str:
    """Describe the backend that `create_device` chooses by default, and whether another one is faster."""
    named = os.environ.get("RHI_BACKEND")
    if named:
        usable = ":" in named or any(r.name == named and r.usable for r in reports)
        return (
            f"{named}, as RHI_BACKEND says"
            if usable
            else f"nothing: RHI_BACKEND names {named}, which can't be used"
        )
    renderers = {r.name: r.capabilities.device for r in reports if r.capabilities and r.capabilities.renders}
    backend = next(iter(renderers), "nothing; see the reasons above")
    if "llvmpipe" in renderers.get(backend, "") and "cl" in renderers:
        return f"{backend}\nllvmpipe draws on the CPU; RHI_BACKEND=cl is faster, but for long shaders"
    return backend


def run() -> int:
    """Run `python -m rhi`, or the command `rhi`, and return its exit status."""
    return run_until_pipe_closes(main)


if __name__ == "__main__":
    sys.exit(run())
