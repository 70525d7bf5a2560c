"""Count lines of code by package: `python scripts/count_lines.py [--check] [--deep]`.

A line counts if it holds code: no comment, no docstring, no blank line. Of a clone, only files that git tracks count.
With `--check` it ends with 1 if their sum is above `lines-of-code` in `pyproject.toml`; that number is raised only in a
commit that says why. `--deep` counts the parts of `rhi` and `renderer` one by one.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tokenize
import tomllib
from collections import Counter
from pathlib import Path, PurePosixPath
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[1]
_LAYOUT: Final = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}
"""Tokens that make no line of code by themselves."""


def count_lines(path: Path) -> int:
    """Return how many lines of a Python file hold code."""
    with path.open("rb") as file:
        tokens = [each for each in tokenize.tokenize(file.readline) if each.type not in (tokenize.COMMENT, tokenize.NL)]
    lines: set[int] = set()
    for before, token, after in zip([None, *tokens], tokens, [*tokens[1:], None], strict=False):
        if token.type in _LAYOUT:
            continue
        is_statement = before is None or before.type in _LAYOUT
        is_docstring = (
            token.type == tokenize.STRING and is_statement and after is not None and after.type == tokenize.NEWLINE
        )
        if not is_docstring:
            lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines)


def find_package(file: PurePosixPath, deep: bool) -> str:
    """Return the package that a file is counted in: the conformance kit is one of its own."""
    parts = file.parts
    if deep and parts[0] in ("rhi", "renderer", "tests") and len(parts) > 2:
        return "/".join(parts[: 3 if parts[1] == "backends" and len(parts) > 3 else 2])
    if parts[:2] == ("rhi", "conformance"):
        return "rhi/conformance"
    return parts[0]


def list_programs() -> list[PurePosixPath]:
    """Return the Python files that git tracks, or in a source distribution all that it has."""
    if not (ROOT / ".git").exists():
        found = (path.relative_to(ROOT) for path in ROOT.rglob("*.py"))
        return sorted(PurePosixPath(path) for path in found if path.parts[0] not in (".venv", "build"))
    listed = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True)
    names = listed.stdout.split()
    return [PurePosixPath(name) for name in names if (ROOT / name).exists()]  # not what was just deleted


def count_packages(deep: bool) -> Counter[str]:
    """Return the lines of code of each package."""
    lines: Counter[str] = Counter()
    for path in list_programs():
        lines[find_package(path, deep)] += count_lines(ROOT / path)
    return lines


def main() -> int:
    """Print the table; return 1 if the sum is above what `pyproject.toml` allows."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="end with 1 if there are more than pyproject.toml allows")
    parser.add_argument("--deep", action="store_true", help="count the parts of packages one by one")
    arguments = parser.parse_args()
    lines = count_packages(arguments.deep)
    for package, count in sorted(lines.items()):
        print(f"{package:<28} {count:>8,}")
    total = sum(lines.values())
    allowed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["count-lines"]["lines-of-code"]
    print(f"{'together':<28} {total:>8,}   (at most {allowed:,})")
    if arguments.check and total > allowed:
        print(
            f"{total - allowed:,} lines of code more than `lines-of-code` in pyproject.toml allows: say it shorter, "
            "or raise the number in a commit that says why",
            file=sys.stderr,
        )
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
