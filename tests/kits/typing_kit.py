"""Correct code and its mistakes under mypy --strict."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

Mistakes = list[tuple[str, str, str]]
"""What to replace, by what, and the error that mypy must give."""


def check_mistakes(
    mypy: Callable[..., tuple[str, int]], folder: Path, right: Path, mistakes: Mistakes
) -> None:
    """Assert, in one run of mypy, that a program passes and that it refuses each mistake in it on its
    line."""
    source, paths = right.read_text(encoding="utf-8"), []
    for number, (old, new, _) in enumerate(mistakes):
        assert source.count(old) >= 1, old
        paths.append(folder / f"mistake_{number}.py")
        paths[-1].write_text(source.replace(old, new, 1), encoding="utf-8")
    rows = mypy("--hide-error-context", right, *paths)[0].splitlines()
    assert [row for row in rows if "mistake_" not in row] == []
    for number, (old, new, says) in enumerate(mistakes):
        line = source[: source.index(old)].count("\n") + 1
        errors = [row for row in rows if re.search(rf"mistake_{number}.py:{line}: error", row)]
        assert any(says in row for row in errors), (new, errors or "accepted")
