"""Saves of a module of shaders as editors make them, whole and faulty, for tests of hot reload."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from typing import Any

Damage = Callable[[str, random.Random], str]


def _cut_at(text: str, pick: random.Random) -> str:
    return text[: pick.randrange(len(text))]


def _cut_lines(text: str, pick: random.Random) -> str:
    lines = text.splitlines(keepends=True)
    return "".join(lines[: pick.randrange(len(lines))])


def _drop_line(text: str, pick: random.Random) -> str:
    lines = text.splitlines(keepends=True)
    del lines[pick.randrange(len(lines))]
    return "".join(lines)


DAMAGES: dict[str, Damage] = {
    "empty": lambda text, pick: "",
    "an empty line": lambda text, pick: "\n",
    "only a comment": lambda text, pick: "# to do\n",
    "only zeros": lambda text, pick: "\0" * 40,
    "cut off anywhere": _cut_at,
    "cut off after a line": _cut_lines,
    "without a line": _drop_line,
    "without the class": lambda text, pick: text[: text.index("class Mine")],
    "another name": lambda text, pick: text.replace("class Mine", "class Yours"),
    "None instead": lambda text, pick: f"{text}\nMine = None\n",
    "a number instead": lambda text, pick: f"{text}\nMine = 3\n",
    "a plain class instead": lambda text, pick: f"{text}\nclass Mine: pass\n",
    "a function instead": lambda text, pick: f"{text}\ndef Mine(): pass\n",
    "deleted": lambda text, pick: f"{text}\ndel Mine\n",
    "an exception": lambda text, pick: f"{text}\n1 / 0\n",
    "an exit": lambda text, pick: f"raise SystemExit(2)\n{text}",
    "no syntax": lambda text, pick: text.replace("class Mine", "class class Mine"),
    "an unknown name": lambda text, pick: text.replace("return", "return nothing_of_that_name +"),
}
"""What may be wrong with a saved text."""


def make_saves(
    make_text: Callable[[tuple[float, float, float]], str], seed: int
) -> Iterator[tuple[str, str]]:
    """Yield names and texts of saves without end: every second one is damaged, each damage in its turn."""
    pick = random.Random(seed)
    while True:
        for name in pick.sample(sorted(DAMAGES), len(DAMAGES)):
            text = make_text(tuple(pick.choice((0.0, 0.2, 0.4, 0.6, 0.8, 1.0)) for _ in range(3)))  # type: ignore[arg-type]
            if pick.random() < 0.5:
                yield "whole", text
            yield name, DAMAGES[name](text, pick)


def replay(
    saves: Iterator[tuple[str, str]],
    count: int,
    show: Callable[[], Any],
    save: Callable[[str], bool],
    draw_afresh: Callable[[str], Any],
) -> list[str]:
    """Save `count` texts; return what was wrong: the last good text isn't shown, or was refused.

    Args:
        show: the image that the running program shows.
        save: saves a text; whether it was accepted.
        draw_afresh: what a program that begins with a text shows, or None if it can't begin.
    """
    wrong: list[str] = []
    expected = show()
    for number in range(count):
        name, text = next(saves)
        accepted, fresh = save(text), draw_afresh(text)
        expected = expected if fresh is None else fresh
        if accepted != (fresh is not None):
            wrong.append(f"{number}, {name}: {'accepted' if accepted else 'refused'}\n{text}")
        if (image := show()) != expected:
            wrong.append(f"{number}, {name}: {image} is shown instead of {expected}\n{text}")
    return wrong
