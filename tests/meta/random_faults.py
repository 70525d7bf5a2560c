"""Random faults, one at a time, each tried against the tests that are responsible for its module.

    python tests/meta/random_faults.py --faults 20 --seed 7 [rhi.device renderer.lights …] [--after 10]
    [--jobs 2] python tests/meta/random_faults.py --faults 20 --seed 7 --list

A fault is one small change of an operator, a constant, a condition or a call. It is made in a copy of the
tracked files, which is deleted afterwards, so that processes that tests start, shaders that are parsed from
their text and kernels in files see it too, and the working tree is never touched. Tests run in stages until
one fails: first those of the module's folder, then for `rhi` those of its package and the conformance kit on
the backends concerned, and for `renderer` the tests elsewhere that use the module most, the exam, and those
of the package that imports it most, such as techniques for the shaders that they are made of. The test that
fails is run once more without the fault, where it has to pass. One that doesn't end has noticed the fault,
too.

What no stage notices is printed with its line, unless `undetectable_faults` explains it. The last line gives
the fraction that is noticed of what can be seen. The exit status is 1 if there are survivors without an
explanation.

Of the libraries, mutmut puts functions behind others, so that shaders no longer find their text; mutatest
changes bytecode, which shaders aren't made of; Cosmic Ray has one test command for all modules.
"""

from __future__ import annotations

import argparse
import ast
import compileall
import contextlib
import functools
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from py_compile import PycInvalidationMode
from queue import SimpleQueue
from typing import Final

from responsible_tests import ROOT, choose_tests, list_files
from undetectable_faults import explain

PACKAGES: Final = (
    "rhi.backends.cl",
    "rhi.backends.gl",
    "rhi.backends.null",
    "rhi.commands",
    "rhi.contract",
    "rhi.device",
    "rhi.errors",
    "rhi.shading",
    "rhi.testing",
    "rhi.trace",
    "renderer.content.gltf",
    "renderer.frame",
    "renderer.layers",
    "renderer.lights",
    "renderer.scene",
    "renderer.shaders",
    "renderer.shadows",
    "renderer.stereo",
    "renderer.techniques",
    "renderer.tessellation",
    "renderer.visibility",
)
"""Where faults are made unless packages are named: not in tests, the kit, scenes to look at, and what only
measures."""

_PATIENCE: Final = 180.0, 3600.0
"""A test and a stage may take so many seconds."""

_TEST: Final = re.compile(r"^(?:FAILED|ERROR) (\S+\.py(?:::.+?)?)(?: - .*)?$", re.MULTILINE)

_BINARY: Final[dict[type[ast.AST], str]] = {
    ast.Add: "-",
    ast.Sub: "+",
    ast.Mult: "/",
    ast.Div: "*",
    ast.FloorDiv: "*",
    ast.Mod: "//",
    ast.LShift: ">>",
    ast.RShift: "<<",
    ast.BitAnd: "|",
    ast.BitOr: "&",
    ast.BitXor: "&",
    ast.Pow: "*",
    ast.MatMult: "*",
}
_COMPARISON: Final[dict[type[ast.AST], str]] = {
    ast.Lt: "<=",
    ast.LtE: "<",
    ast.Gt: ">=",
    ast.GtE: ">",
    ast.Eq: "!=",
    ast.NotEq: "==",
    ast.Is: "is not",
    ast.IsNot: "is",
    ast.In: "not in",
    ast.NotIn: "in",
}
_SIGNS: Final = re.compile(r"\s*(not\s+in|is\s+not|[-+*/%<>=!&|^@]+|is|in|and|or)\s*")
_KERNEL: Final = re.compile(r" (\+|-|\*|/|<=?|>=?|==|!=|&&|\|\|) |\b(\d+(?:\.\d+)?f?)\b")
_KERNEL_SIGNS: Final = {
    "+": "-",
    "-": "+",
    "*": "/",
    "/": "*",
    "<": "<=",
    "<=": "<",
    ">": ">=",
    ">=": ">",
    "==": "!=",
    "!=": "==",
    "&&": "||",
    "||": "&&",
}


@dataclass(frozen=True, order=True)
class Fault:
    """A change of a file: from `start` on, `old` is replaced by `new`.

    Attributes:
        file: relative to the project.
        line: of `start`, from 1.
        text: that line, without the blanks around it.
    """

    file: str
    line: int
    start: int
    old: str
    new: str
    text: str

    def apply(self, text: str) -> str:
        """Return the file's text with the fault."""
        assert text[self.start :].startswith(self.old)
        return text[: self.start] + self.new + text[self.start + len(self.old) :]

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.old!r} → {self.new!r} in: {self.text}"


# -- which faults there are ----------------------------------------------------------------------------------


def list_faults(file: str, text: str) -> list[Fault]:
    """Return all faults of a Python module, or of a kernel file (`.cl`), by place."""
    lines = text.split("\n")
    replacements = _list_kernel(text) if file.endswith(".cl") else _FaultCollector(text).replacements
    faults = []
    for start, old, new in replacements:
        line = text.count("\n", 0, start) + 1
        faults.append(Fault(file, line, start, old, new, lines[line - 1].strip()))
    return sorted(faults)


def _list_kernel(text: str) -> Iterator[tuple[int, str, str]]:
    """Yield (place, old, new) of a file of OpenCL C; comments and directives are left as they are."""
    start = 0
    for line in text.splitlines(keepends=True):
        code = line.split("//")[0]
        if not code.lstrip().startswith("#"):
            for match in _KERNEL.finditer(code):
                sign, number = match.groups()
                if sign:
                    yield start + match.start(1), sign, _KERNEL_SIGNS[sign]
                else:
                    whole = number.rstrip("f")
                    yield (
                        start + match.start(2),
                        whole,
                        f"{float(whole) + 1}" if "." in whole else str(int(whole) + 1),
                    )
        start += len(line)


class _FaultCollector(ast.NodeVisitor):
    """Finds the faults of a module: (place, old, new). Annotations, docstrings and imports have none."""

    def __init__(self, text: str) -> None:
        self.replacements: list[tuple[int, str, str]] = []
        self._text = text
        self._lines = [0]
        for line in text.split("\n"):
            self._lines.append(self._lines[-1] + len(line) + 1)
        self._bytes = text.split("\n")
        self.visit(ast.parse(text))

    def _offset(self, line: int, column: int) -> int:
        """Return the index of a place; columns count bytes."""
        row = self._bytes[line - 1]
        return self._lines[line - 1] + (column if row.isascii() else len(row.encode()[:column].decode()))

    def _begin(self, node: ast.expr | ast.stmt) -> int:
        return self._offset(node.lineno, node.col_offset)

    def _end(self, node: ast.expr | ast.stmt) -> int:
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return self._offset(node.end_lineno, node.end_col_offset)

    def _replace(self, node: ast.expr | ast.stmt, new: str) -> None:
        begin = self._begin(node)
        self.replacements.append((begin, self._text[begin : self._end(node)], new))

    def _sign(self, left: ast.expr, right: ast.expr, new: str) -> None:
        """Replace the sign between two operands; brackets around them may stand there too."""
        begin, end = self._end(left), self._begin(right)
        between = re.sub(r"#.*", lambda match: " " * len(match[0]), self._text[begin:end])
        match = _SIGNS.search(between.replace(")", " ").replace("(", " ").replace("\\", " "))
        if match is not None:
            self.replacements.append((begin + match.start(1), match[1], new))

    def _negate(self, test: ast.expr) -> None:
        begin = self._begin(test)
        old = self._text[begin : self._end(test)]
        self.replacements.append((begin, old, f"not ({old})"))

    def visit_BinOp(self, node: ast.BinOp) -> None:
        is_text = isinstance(node.left, ast.Constant) and isinstance(node.left.value, str)
        is_type = isinstance(node.op, ast.BitOr) and any(
            isinstance(side, ast.Name | ast.Constant)
            and (getattr(side, "id", "")[:1].isupper() or getattr(side, "value", 0) is None)
            for side in (node.left, node.right)
        )
        if not is_text and not is_type:
            self._sign(node.left, node.right, _BINARY[type(node.op)])
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        begin, end = self._end(node.target), self._begin(node.value)
        match = _SIGNS.search(self._text[begin:end])
        assert match is not None
        self.replacements.append((begin + match.start(1), match[1], _BINARY[type(node.op)] + "="))
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        for left, right in zip(node.values, node.values[1:], strict=False):
            self._sign(left, right, "or" if isinstance(node.op, ast.And) else "and")
        self.generic_visit(node)

    def visit_Compare(self, node: ast.Compare) -> None:
        for left, operator, right in zip(
            [node.left, *node.comparators], node.ops, node.comparators, strict=False
        ):
            self._sign(left, right, _COMPARISON[type(operator)])
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        operand = self._text[self._begin(node.operand) : self._end(node.operand)]
        if isinstance(node.op, ast.Not | ast.USub | ast.Invert):
            self._replace(node, f"({operand})")
        self.generic_visit(node)

    def visit_If(self, node: ast.If) -> None:
        if getattr(node.test, "id", "") != "TYPE_CHECKING":
            self._negate(node.test)
            self.generic_visit(node)

    def visit_IfExp(self, node: ast.IfExp) -> None:
        self._negate(node.test)
        self.generic_visit(node)

    def visit_While(self, node: ast.While) -> None:
        if not isinstance(node.test, ast.Constant):
            self._negate(node.test)
        self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        value = node.value
        if isinstance(value, bool):
            self._replace(node, str(not value))
        elif isinstance(value, int):
            self._replace(node, str(value + 1))
        elif isinstance(value, float):
            self._replace(node, repr(value * 2 if value else 1.0))

    def visit_Expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Call):
            self._replace(node, "pass")
        if not isinstance(node.value, ast.Constant):
            self.generic_visit(node)

    def visit_keyword(self, node: ast.keyword) -> None:
        """`strict=True` of `zip` asserts what is known too."""
        if node.arg != "strict":
            self.generic_visit(node)

    def visit_Assert(self, node: ast.Assert) -> None:
        """An assertion tells a type checker what is known."""

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """Parts of a text have no places of their own."""

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)

    def visit_arg(self, node: ast.arg) -> None:
        """The type of a parameter."""

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        for default in (*node.args.defaults, *filter(None, node.args.kw_defaults), *node.body):
            self.visit(default)

    def visit_Subscript(self, node: ast.Subscript) -> None:
        name = getattr(node.value, "id", getattr(node.value, "attr", ""))
        if not name[:1].isupper():  # that of a type
            self.generic_visit(node)


def choose_faults(root: Path, packages: Iterable[str], count: int, seed: int) -> list[Fault]:
    """Return faults of packages or modules: with one seed always the same ones. Each line is as likely as any
    other."""
    folders = [package.replace(".", "/") for package in packages]
    by_line: dict[tuple[str, int], list[Fault]] = {}
    for file in list_files(root):
        if file.endswith((".py", ".cl")) and any(
            file.startswith((f"{folder}/", f"{folder}.")) for folder in folders
        ):
            for fault in list_faults(file, (root / file).read_text(encoding="utf-8")):
                by_line.setdefault((file, fault.line), []).append(fault)
    generator = random.Random(seed)
    lines = generator.sample(sorted(by_line), min(count, len(by_line)))
    return [generator.choice(by_line[line]) for line in lines]


# -- trials --------------------------------------------------------------------------------------------------


@dataclass
class Copy:
    """A copy of a project in which faults are made."""

    root: Path

    @classmethod
    def make(cls, project: Path, folder: Path) -> Copy:
        """Copy what git tracks to a folder that isn't there yet."""
        for file in list_files(project):
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(project / file, folder / file)
        # The bytecode is valid for a text, not for a time: a fault is often as old and as long as what it
        # replaces.
        for package in ("rhi", "rhi_pytest", "rhi_screen", "renderer", "tests"):
            if (folder / package).is_dir():
                compileall.compile_dir(
                    folder / package, quiet=2, invalidation_mode=PycInvalidationMode.CHECKED_HASH
                )
        return cls(folder)

    def run(self, tests: Sequence[str]) -> tuple[bool, str]:
        """Run tests, and return whether they fail or don't end, and what they say of it."""
        environment = os.environ | {
            "PYTHONPATH": str(self.root),
            "PYTHONDONTWRITEBYTECODE": "1",
            "RHI_KERNELS": "quick",
        }
        command = [
            sys.executable,
            "-m",
            "pytest",
            "-x",
            "-q",
            "-p",
            "no:cacheprovider",
            "-p",
            "no:randomly",
            "--tb=short",
            "-o",
            f"faulthandler_timeout={_PATIENCE[0]}",
            "-o",
            "faulthandler_exit_on_timeout=true",
            *tests,
        ]
        with subprocess.Popen(
            command,
            cwd=self.root,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
            encoding="utf-8",
        ) as process:
            try:
                output, _ = process.communicate(timeout=_PATIENCE[1])
            except subprocess.TimeoutExpired:
                output = f"no end after {_PATIENCE[1]:.0f} s"
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)  # the processes of tests too
        return process.returncode not in (0, 5), output

    def make_fault(self, fault: Fault) -> Callable[[], object]:
        """Write a fault, and return what takes it out again."""
        file = self.root / fault.file
        text = file.read_text(encoding="utf-8")
        file.write_text(fault.apply(text), encoding="utf-8")
        return functools.partial(file.write_text, text)


def attempt_fault(copy: Copy, fault: Fault) -> str:
    """The check that noticed a fault, "" if none did."""
    for stage in choose_tests(copy.root, fault.file):
        undo = copy.make_fault(fault)
        try:
            failed, output = copy.run(stage)
        finally:
            undo()
        if failed:
            options = stage[stage.index("--rhi-backend") :] if "--rhi-backend" in stage else ()
            names = _TEST.findall(output)
            if options:  # the kit's parameters have another order in another run
                names = [name.partition("[")[0] for name in names]
            again, why = copy.run((*names, *options) if names else (*stage, "--collect-only"))
            assert not again, f"without a fault, {' '.join(names or stage)}: {why[-2000:]}"
            lines = [
                line for line in output.splitlines() if line.startswith(("FAILED", "ERROR", "E  ", "Timeout"))
            ]
            return lines[-1] if lines else output[-200:]
    return ""


def attempt_faults(project: Path, faults: Sequence[Fault], jobs: int) -> Iterator[tuple[Fault, str]]:
    """Yield each fault with what noticed it. `jobs`: how many are tried at a time, each in a copy of its
    own."""
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(jobs) as pool:
        free: SimpleQueue[Copy] = SimpleQueue()
        for number in range(jobs):
            free.put(Copy.make(project, Path(folder) / str(number)))

        def attempt(fault: Fault) -> str:
            copy = free.get()
            try:
                return attempt_fault(copy, fault)
            finally:
                free.put(copy)

        yield from zip(faults, pool.map(attempt, faults), strict=True)


def try_faults(project: Path, faults: Sequence[Fault], jobs: int = 1) -> list[Fault]:
    """Try faults, print what becomes of each, and return those that nothing noticed and nothing explains."""
    counts: Counter[str] = Counter()
    survivors = []
    for fault, noticed in attempt_faults(project, faults, jobs):
        reason = "" if noticed else explain(fault.file, fault.text, fault.old, fault.new)
        counts["noticed" if noticed else "unseen" if reason else "escaped"] += 1
        text = (
            f"noticed  {fault}\n         {noticed[:200]}"
            if noticed
            else f"unseen   {fault}\n         {reason}"
        )
        print(text if noticed or reason else f"ESCAPED  {fault}", flush=True)
        if not noticed and not reason:
            survivors.append(fault)
    seen = counts["noticed"] + counts["escaped"]
    print(f"{counts['noticed']} of {seen} that can be seen are noticed; {counts['unseen']} can't be seen")
    return survivors


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command, see this module."""
    parser = argparse.ArgumentParser(
        description="Try random faults against the tests that are responsible for them."
    )
    parser.add_argument(
        "packages", nargs="*", default=PACKAGES, help="where: packages or modules (default: all)"
    )
    parser.add_argument("--faults", type=int, default=20, help="how many (default 20)")
    parser.add_argument("--seed", type=int, default=1, help="which: a seed has always the same (default 1)")
    parser.add_argument("--after", type=int, default=0, help="go on after so many of them (default 0)")
    parser.add_argument("--jobs", type=int, default=1, help="how many at a time (default 1)")
    parser.add_argument("--list", action="store_true", help="only list them")
    options = parser.parse_args(arguments)
    faults = choose_faults(ROOT, options.packages, options.faults, options.seed)[options.after :]
    if options.list:
        print(*faults, sep="\n")
        return 0
    return 1 if try_faults(ROOT, faults, options.jobs) else 0


if __name__ == "__main__":
    sys.exit(main())
