"""`reduce`: find a small trace that still shows a fault, by delta debugging (Zeller, Hildebrandt 2002).

- Commands are removed, first half of them and finally single ones, as long as the predicate stays true.
- After each removal the rest is made valid before it is tried: with a resource go all commands that use it, a
  label, pass or query loses both of its ends, and draws need their pass and program.
- Refused calls are removed first, unless the fault can't be seen without them.
- `write_test` writes the result as a pytest file that depends on this package only.
"""

from __future__ import annotations

import ast
import base64
import inspect
import textwrap
from collections.abc import Callable
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FunctionType
from typing import Final

from rhi.commands.ops import CREATIONS, DISPATCHES, DRAWS, END_OPS, Op
from rhi.commands.stream import CommandStream
from rhi.contract.descriptors import Stage
from rhi.errors import RhiError, refuse
from rhi.trace.file import Trace, save
from rhi.trace.ids import ids_of
from rhi.trace.rules import TRACE_PREDICATE

ATTEMPTS: Final = 2000
_OPENS: Final = {end: begin for begin, end in END_OPS.items()}


def reduce(trace: Trace, predicate: Callable[[Trace], bool], *, attempts: int = ATTEMPTS) -> Trace:
    """Return the smallest part of a trace for which `predicate` is true, as far as it is found in `attempts`
    tries.

    `predicate(trace)` returns whether the fault is present. It inspects the commands, or replays them on a
    device of its own. If it raises an error of this package, the fault counts as absent.

    Raises:
        ValidationError: `trace-predicate` if the predicate is false for the whole trace.
    """

    refusals = True

    def holds(indices: list[int]) -> bool:
        try:
            return bool(predicate(trace.select(indices, refusals=refusals)))
        except RhiError:
            return False

    parts = _Parts(trace.stream)
    remaining = list(range(len(trace)))
    if not holds(remaining):
        refuse(
            TRACE_PREDICATE,
            "rhi.trace.reduce",
            f"a trace of {len(trace)} commands",
            "one that shows the fault",
        )
    if trace.refusals:
        refusals = False
        refusals = not holds(remaining)
    size = max(1, len(remaining) // 2)
    while attempts > 0:
        start, shrunk = 0, False
        while start < len(remaining) and attempts > 0:
            candidate = parts.complete(remaining[:start] + remaining[start + size :])
            if len(candidate) < len(remaining):
                attempts -= 1
                if holds(candidate):
                    remaining, shrunk = candidate, True
                    continue  # the commands that follow have moved to `start`
            start += size
        if size == 1 and not shrunk:
            break
        size = max(1, size // 2)
    return trace.select(remaining, refusals=refusals)


class _Parts:
    """The dependencies between the commands of a stream."""

    def __init__(self, stream: CommandStream) -> None:
        entries = [stream.entry(index)[:2] for index in range(len(stream))]
        self.ops = [op for op, _ in entries]
        self.values = [values for _, values in entries]
        self.ids = [frozenset(ids_of(op, values)) for op, values in entries]
        self.failed = stream.failures.keys()
        self.partners: dict[int, int] = {}
        opened: dict[Op, list[int]] = {op: [] for op in END_OPS}
        for index, op in enumerate(self.ops):
            if index in self.failed:
                continue
            if op in opened:
                opened[op].append(index)
            elif op in _OPENS and opened[_OPENS[op]]:
                begin = opened[_OPENS[op]].pop()
                self.partners[begin], self.partners[index] = index, begin

    def complete(self, indices: list[int]) -> list[int]:
        """Return those of the commands that are still valid, in order."""
        while True:
            fitting = self._drop_invalid(indices)
            if len(fitting) == len(indices):
                return fitting
            indices = fitting  # a removed command may have been one end of a pair

    def _drop_invalid(self, indices: list[int]) -> list[int]:
        selected = set(indices)
        alive: set[int] = set()
        stages: dict[int, frozenset[Stage]] = {}
        signalled = {0}
        in_pass, program = False, 0
        result = []
        for index in indices:
            op, values, ids = self.ops[index], self.values[index], self.ids[index]
            if index in self.partners and self.partners[index] not in selected:
                continue
            creates = op in CREATIONS
            if not (ids - {values[0]} if creates else ids) <= alive:
                continue
            stage = Stage.VERTEX if op in DRAWS else Stage.COMPUTE if op in DISPATCHES else None
            if stage and not (program in alive and stage in stages[program] and in_pass is (op in DRAWS)):
                continue
            if op is Op.WAIT and values[0] not in signalled:
                continue
            result.append(index)
            if index in self.failed:
                continue
            if creates:
                alive.add(values[0])
                stages[values[0]] = getattr(values[1], "stages", frozenset())
            elif op is Op.DESTROY:
                alive.discard(values[0])
            elif op is Op.BIND_PROGRAM:
                program = values[0]
            elif op is Op.SIGNAL:
                signalled.add(values[0])
            in_pass = op is Op.BEGIN_PASS or (in_pass and op is not Op.END_PASS)
        return result


def write_test(trace: Trace, path: str | PathLike[str], predicate: Callable[[Trace], bool]) -> None:
    """Write a pytest file that contains the trace and fails as long as the predicate is true.

    `predicate` must be defined with `def`. The imports of its module that it uses are copied.

    Raises:
        ValidationError: `trace-predicate` if the source of the predicate isn't available.
    """
    source, imports = _source_of(predicate)
    name = predicate.__name__
    with TemporaryDirectory() as folder:
        file = Path(folder) / "trace.zip"
        save(trace, file)
        text = base64.b85encode(file.read_bytes()).decode()
    listing = str(trace.stream).replace("\\", "\\\\").replace('"""', "'''")
    packed = "\n".join(f'    "{text[start : start + 100]}"' for start in range(0, len(text), 100))
    lines = [
        f'"""A trace of {len(trace)} commands that shows the fault that `{name}` looks '
        f'for.\n\n{listing}\n"""',
        "\n".join(["import base64", "", *imports, "", "from rhi.trace import load"]),
        f"TRACE = (\n{packed}\n)",
        source.rstrip(),
        f"def test_{name}(tmp_path):\n"
        '    file = tmp_path / "trace.zip"\n'
        "    file.write_bytes(base64.b85decode(TRACE))\n"
        f"    assert not {name}(load(file{', trusted=True' if trace.trusted else ''}))",
    ]
    Path(path).write_text("\n\n\n".join(lines) + "\n", encoding="utf-8")


def _source_of(predicate: Callable[[Trace], bool]) -> tuple[str, list[str]]:
    """Return the source of a function, and the imports of its module whose names it uses."""
    try:
        if not isinstance(predicate, FunctionType) or predicate.__name__ == "<lambda>":
            raise OSError("a function with a def is needed")
        source = textwrap.dedent(inspect.getsource(predicate))
        module = inspect.getmodule(predicate)
        whole = ast.parse(inspect.getsource(module)) if module is not None else ast.parse("")
    except (OSError, TypeError) as error:
        refuse(
            TRACE_PREDICATE, "rhi.trace.write_test", f"{predicate!r}: {error}", "a function defined in a file"
        )
    used = {node.id for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Name)}
    imports = [
        ast.unparse(node)
        for node in whole.body
        if isinstance(node, (ast.Import, ast.ImportFrom))
        and any((alias.asname or alias.name.partition(".")[0]) in used for alias in node.names)
    ]
    return source, imports
