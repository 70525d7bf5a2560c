"""Mutations of traces, and what may become of them: a process that loads, shows and replays each.

`python trace_fuzz.py BACKEND SEED COUNT FOLDER` prints one JSON line for each mutation: "refused" and the
rule, "replayed", or what went wrong; its seed; and the seconds. A process that dies leaves no line: its last
"begin" says at which seed.
"""

from __future__ import annotations

import json
import random
import sys
import time
import zipfile
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import rhi
from rhi.trace import load, replay

NUMBERS = [0, 1, -1, 2, 3, 7, 255, 256, 65535, 65536, 2**31 - 1, 2**31, 2**32 - 1, 2**32, 2**40, 2**53, 2**63, -(2**31),
           0.5, -0.5, 1e30, 1e308, float("inf"), float("nan")]  # fmt: skip
WORDS = [
    "",
    "NONE",
    "RGBA8",
    "D24S8",
    "QUADS",
    "CUBE",
    "gl.DepthClamp.ON",
    "os:system.X.Y",
    "\0",
    "x" * 1000,
    "../a",
]

EXEMPT_OPS = {"null": (), "gl": ("create_program",), "cl": ("create_program",)}
"""By backend, the operations that stay as they are: the stated interface of a program belongs to the author
of its text, who is trusted."""


def mutate(members: dict[str, bytes], choose: random.Random, exempt: Sequence[str]) -> dict[str, bytes]:
    """Return the members of a trace with one to three changes, but for the lines of the operations in
    `exempt`."""
    members = dict(members)
    for _ in range(choose.choice((1, 1, 1, 2, 3))):
        kind = choose.random()
        if kind < 0.12:
            names = [
                name for name in members if "create_program" not in exempt or not name.startswith("programs/")
            ]
            name = choose.choice([name for name in names if members[name]])
            data = bytearray(members[name])
            for _ in range(choose.choice((1, 1, 4))):
                data[choose.randrange(len(data))] = choose.randrange(256)
            members[name] = bytes(data[: choose.randrange(len(data))] if choose.random() < 0.2 else data)
        else:
            members["commands.jsonl"] = _mutate_lines(members["commands.jsonl"], choose, exempt)
    return members


def _mutate_lines(data: bytes, choose: random.Random, exempt: Sequence[str]) -> bytes:
    try:
        lines = [json.loads(line) for line in data.splitlines()]
    except (ValueError, RecursionError):  # changed before
        return data
    if not lines:
        return data
    at = choose.randrange(len(lines))
    if isinstance(lines[at], dict) and lines[at].get("op") in exempt:
        return data
    kind = choose.random()
    if kind < 0.7:
        lines[at] = _mutate_value(lines[at], choose)
    elif kind < 0.78:
        del lines[at]
    elif kind < 0.86:
        lines.insert(choose.randrange(len(lines) + 1), lines[at])
    elif kind < 0.94:
        lines.insert(choose.randrange(len(lines)), lines.pop(at))
    else:
        other = choose.choice(lines)
        if isinstance(lines[at], dict) and isinstance(other, dict):
            lines[at] = {**lines[at], "arguments": other.get("arguments")}
    return "".join(json.dumps(line) + "\n" for line in lines).encode()


def _mutate_value(value: Any, choose: random.Random) -> Any:
    """Return a value with one leaf of it changed."""
    if isinstance(value, dict) and value and choose.random() < 0.98:
        names = [name for name in value if name not in ("op", "site")] or list(value)
        name = choose.choice(names if choose.random() < 0.95 else list(value))
        return value | {name: _mutate_value(value[name], choose)}
    if isinstance(value, list) and value and choose.random() < 0.9:
        at = choose.randrange(len(value))
        return [*value[:at], _mutate_value(value[at], choose), *value[at + 1 :]]
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        if choose.random() < 0.6:  # close to what was there, which more often is still valid
            return choose.choice([value + 1, value - 1, value * 2, value // 2, choose.randrange(64)])
        return choose.choice([*NUMBERS, -value, "1"])
    if isinstance(value, bool):
        return choose.choice([not value, None, 1])
    return choose.choice([*WORDS, None, 5, [], {}, [value]])


def read_members(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as file:
        return {name: file.read(name) for name in file.namelist()}


def write_members(path: Path, members: dict[str, bytes]) -> None:
    with zipfile.ZipFile(path, "w") as file:
        for name, data in members.items():
            file.writestr(name, data)


def try_trace(path: Path, backend: str) -> str:
    """Load, show and replay a file; return what became of it."""
    try:
        trace = load(path, trusted=True)
        str(trace.stream)
        with rhi.create_device(backend) as device:
            replay(trace, on=device)
            device.wait(device.signal())
    except rhi.RhiError as error:
        return f"refused {error.rule.id}"
    except MemoryError:
        return "no memory"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return "replayed"


def run(backend: str, seed: int, count: int, folder: Path) -> Counter[str]:
    """Try mutations of all traces of a folder, and print what becomes of each."""
    sources = [read_members(path) for path in sorted(folder.glob("*.zip"))]
    results: Counter[str] = Counter()
    for number in range(seed, seed + count):
        choose = random.Random(number)
        print(json.dumps(["begin", number]), flush=True)
        path = folder / f"mutated-{backend}.trace"
        write_members(path, mutate(choose.choice(sources), choose, EXEMPT_OPS[backend]))
        start = time.monotonic()
        result = try_trace(path, backend)
        results[result] += 1
        print(json.dumps([result, number, round(time.monotonic() - start, 2)]), flush=True)
    return results


if __name__ == "__main__":
    run(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), Path(sys.argv[4]))
