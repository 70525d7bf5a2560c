"""Runs the text of a program in a page; live.mjs calls it. Python waits for the page where the engine has
JSPI."""

from __future__ import annotations

import contextlib
import gc
import json
import linecache
import sys
import traceback
from pathlib import Path
from types import ModuleType
from typing import Any

from pyodide.code import eval_code_async

FOLDER = Path("/home/pyodide")


async def run(source: str, name: str, uses_gpu: bool) -> str:
    """Run a program as `__main__`, in a namespace of its own.

    Args:
        source: its text.
        name: its file's name, such as "triangle.py".
        uses_gpu: whether it opens a device of the page.

    Returns:
        JSON: `error` and `text` (its traceback), `line` of the program (0: none) if it failed; `tables`.
    """
    file = FOLDER / name
    file.write_text(source, encoding="utf-8")  # shaders are compiled from files
    linecache.clearcache()
    module, before = ModuleType("__main__"), sys.modules["__main__"]
    module.__dict__["__file__"] = str(file)
    sys.argv, sys.modules["__main__"] = [name], module
    result: dict[str, Any] = {"error": "", "text": "", "line": 0}
    try:
        if uses_gpu:
            from rhi.backends.web import prepare_device

            await prepare_device()
        await eval_code_async(source, module.__dict__, filename=str(file))
    except SystemExit as error:
        if error.code:
            result |= {"error": str(error.code), "text": str(error.code)}
    except BaseException as error:
        result |= describe_error(error, str(file))
    finally:
        sys.modules["__main__"] = before
    result["tables"] = [table for value in module.__dict__.values() for table in list_commands(value)]
    close_devices(module)
    return json.dumps(result)


def describe_error(error: BaseException, file: str) -> dict[str, Any]:
    """Return an error's message, its traceback from the program on, and its line there."""
    entries = traceback.extract_tb(error.__traceback__)
    lines = [entry.lineno or 0 for entry in entries if entry.filename == file]
    if isinstance(error, SyntaxError) and error.filename == file:
        lines.append(error.lineno or 0)
    site = getattr(error, "site", None)
    if getattr(site, "file", None) == file:
        lines.append(int(getattr(site, "line", 0)))
    program = [entry for entry in entries if entry.filename == file]
    text = traceback.format_list(program or entries) + traceback.format_exception_only(error)
    message = str(error).strip().splitlines() or [type(error).__name__]
    line = lines[-1] if lines else 0
    return {"error": f"{type(error).__name__}: {message[0]}", "text": "".join(text), "line": line}


def list_commands(value: object) -> list[dict[str, Any]]:
    """Return the commands of a recording device as a table: rows of a number, a call and a line of the
    program."""
    import rhi

    if not isinstance(value, rhi.Device) or value.backend_name != "null":
        return []
    rows = []
    for index, command in enumerate(value.stream):
        site = command.site
        line = site.line if site is not None and Path(site.file).parent == FOLDER else 0
        rows.append([index, str(command).split("  ")[0], line])
    return [{"device": value.backend_name, "rows": rows}]


def close_devices(module: ModuleType) -> None:
    """Close what a program has left open, if none of its canvases is shown."""
    if list_canvases():
        return
    module.__dict__.clear()
    gc.collect()


def list_canvases() -> list[Any]:
    """Return the canvases that are open."""
    canvases = sys.modules.get("rhi_screen.html_canvas")
    return list(canvases.HtmlCanvas._rc_canvas_group.get_canvases()) if canvases else []


def stop() -> None:
    """Close the canvases of the program that runs, which ends it."""
    for canvas in list_canvases():
        with contextlib.suppress(Exception):
            canvas.close()
