"""A run of the exam against each of the faults of `exam_mutations.toml`, one or more for each case.

A mutation replaces a piece of a module's text before the module is imported, so that Python code and shaders
can be broken alike. `python exam_mutations.py` prints a line of JSON for each case and mutation: whether it
was seen. With numbers of cases it tries only those.
"""

from __future__ import annotations

import importlib.util
import json
import multiprocessing
import sys
import tempfile
import tomllib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import Any, Final


@dataclass(frozen=True)
class Mutation:
    """A fault: in `module` the text `old`, which occurs once, is replaced by `new`."""

    cases: tuple[int, ...]
    fault: str
    module: str
    old: str
    new: str
    backend: str = "gl"


MUTATIONS: Final = tuple(
    Mutation(**table | {"cases": tuple(table["cases"])})
    for table in tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))["mutations"]
)


class Mutant(MetaPathFinder):
    """Imports one module with a piece of its text replaced."""

    def __init__(self, mutation: Mutation, folder: Path) -> None:
        self.mutation, self.folder = mutation, folder

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != self.mutation.module:
            return None
        spec = PathFinder.find_spec(fullname, path)
        assert spec is not None
        assert spec.origin is not None
        text = Path(spec.origin).read_text(encoding="utf-8")
        assert text.count(self.mutation.old) == 1, (fullname, self.mutation.old)
        broken = self.folder / Path(spec.origin).name
        broken.write_text(text.replace(self.mutation.old, self.mutation.new), encoding="utf-8")
        return importlib.util.spec_from_file_location(
            fullname, broken, loader=SourceFileLoader(fullname, str(broken))
        )


def examine_mutant(mutation: Mutation) -> dict[int, dict[str, Any]]:
    """Return the failures of a mutation's cases; in a process in which the renderer wasn't imported yet."""
    with tempfile.TemporaryDirectory() as folder:
        sys.meta_path.insert(0, Mutant(mutation, Path(folder)))
        import rhi
        from renderer.lab.exam import CASES, examine

        with rhi.create_device(mutation.backend) as device:
            rows = list(examine(device, [CASES[number] for number in mutation.cases]))
    return {
        row.case: {"seen": row.passed is False, "error": str(row.error), "remark": row.remark} for row in rows
    }


def try_mutations(mutations: Sequence[Mutation]) -> Iterator[dict[str, Any]]:
    """Try each mutation in a process of its own, and yield the results."""
    spawn = multiprocessing.get_context("spawn")
    with spawn.Pool(2, maxtasksperchild=1) as pool:
        for mutation, rows in zip(mutations, pool.imap(examine_mutant, mutations, chunksize=1), strict=True):
            for number, row in rows.items():
                yield {"case": number, "fault": mutation.fault, **row}


if __name__ == "__main__":
    numbers = set(map(int, sys.argv[1:]))
    selected = [mutation for mutation in MUTATIONS if not numbers or numbers & set(mutation.cases)]
    for result in try_mutations(selected):
        print(json.dumps(result), flush=True)
