"""Count lines of code by package and language: `python scripts/count_lines.py [--deep]`.

Python, OpenCL C and shell scripts are counted. A line counts if it holds code: comments, docstrings and blank
lines don't. In a clone, only the files that git tracks count. The numbers are a report, and limit nothing.
`--deep` counts the parts of `rhi` and `renderer` one by one.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tokenize
from collections import Counter
from collections.abc import Callable
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


def count_python_lines(path: Path) -> int:
    """Return the number of lines of code in a Python file."""
    with path.open("rb") as file:
        tokens = [
            token_info
            for token_info in tokenize.tokenize(file.readline)
            if token_info.type not in (tokenize.COMMENT, tokenize.NL)
        ]
    lines: set[int] = set()
    for before, token, after in zip([None, *tokens], tokens, [*tokens[1:], None], strict=False):
        if token.type in _LAYOUT:
            continue
        is_statement = before is None or before.type in _LAYOUT
        is_docstring = (
            token.type == tokenize.STRING
            and is_statement
            and after is not None
            and after.type == tokenize.NEWLINE
        )
        if not is_docstring:
            lines.update(range(token.start[0], token.end[0] + 1))
    return len(lines)


def count_opencl_lines(path: Path) -> int:
    """Return the number of lines of code in a file of OpenCL C."""
    text = re.sub(
        r"/\*.*?\*/",
        lambda comment: "\n" * comment[0].count("\n"),
        path.read_text(encoding="utf-8"),
        flags=re.DOTALL,
    )
    return sum(bool(line.partition("//")[0].strip()) for line in text.splitlines())


def count_shell_lines(path: Path) -> int:
    """Return the number of lines of code in a shell script."""
    return sum(
        bool(line.strip()) and not line.lstrip().startswith("#")
        for line in path.read_text(encoding="utf-8").splitlines()
    )


LANGUAGES: Final[dict[str, tuple[str, Callable[[Path], int]]]] = {
    ".py": ("Python", count_python_lines),
    ".pyi": ("Python stubs", count_python_lines),
    ".cl": ("OpenCL C", count_opencl_lines),
    ".sh": ("shell", count_shell_lines),
}
"""By the ending of a file's name: its language, and the function that counts its lines."""


def package_of(file: PurePosixPath, deep: bool) -> str:
    """Return the package that a file is counted in: the conformance kit is one of its own."""
    parts = file.parts
    if deep and parts[0] in ("rhi", "renderer", "tests") and len(parts) > 2:
        return "/".join(parts[: 3 if parts[1] == "backends" and len(parts) > 3 else 2])
    if parts[:2] == ("rhi", "conformance"):
        return "rhi/conformance"
    return parts[0] if len(parts) > 1 else "."


def list_programs(*suffixes: str) -> list[PurePosixPath]:
    """Return the files with these endings that git tracks, or in a source distribution all that it has."""
    if not (ROOT / ".git").exists():
        paths = (path.relative_to(ROOT) for suffix in suffixes for path in ROOT.rglob(f"*{suffix}"))
        return sorted(PurePosixPath(path) for path in paths if path.parts[0] not in (".venv", "build"))
    patterns = [f"*{suffix}" for suffix in suffixes]
    listed = subprocess.run(
        ["git", "ls-files", *patterns], cwd=ROOT, capture_output=True, text=True, check=True, encoding="utf-8"
    )
    names = listed.stdout.split()
    return [PurePosixPath(name) for name in names if (ROOT / name).exists()]  # not what was just deleted


def count_packages(deep: bool) -> dict[str, Counter[str]]:
    """Return the lines of code of each package by language."""
    lines: dict[str, Counter[str]] = {}
    for path in list_programs(*LANGUAGES):
        language, count = LANGUAGES[path.suffix]
        lines.setdefault(package_of(path, deep), Counter())[language] += count(ROOT / path)
    return lines


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--deep", action="store_true", help="count the parts of packages one by one")
    packages = count_packages(parser.parse_args().deep)
    languages = [language for language, _ in LANGUAGES.values()]
    print(f"{'':<28}" + "".join(f"{language:>14}" for language in languages))
    for package, lines in [*sorted(packages.items()), ("together", sum(packages.values(), Counter()))]:
        print(f"{package:<28}" + "".join(f"{lines[language]:>14,}" for language in languages))


if __name__ == "__main__":
    main()
