"""The console: a line that is edited, the lines before it, and their messages. It draws nothing.

Keys are named as the events of rendercanvas name them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Final

from renderer.viewer.command_table import CommandTable, common_start

_HISTORY_LENGTH: Final = 200  # lines of text, and of history
_MAX_LENGTH: Final = 1000  # characters of a line


class Console:
    """Edits a line, completes it from a table of commands, and hands it to `run` when Enter is pressed.

    Attributes:
        is_open: whether keys are for the console.
        text, cursor: the line, and where it is edited.
        lines: typed lines and messages, the latest last, each with whether it is an error.
        choices: the words that could follow, after Tab.
    """

    def __init__(self, commands: CommandTable, run: Callable[[str], object]) -> None:
        self.is_open = False
        self.text = ""
        self.cursor = 0
        self.lines: deque[tuple[str, bool]] = deque(maxlen=_HISTORY_LENGTH)
        self.choices: list[str] = []
        self._history: deque[str] = deque(maxlen=_HISTORY_LENGTH)
        self._history_index = 0  # into the history; its length stands for the new line
        self._draft = ""  # the new line, while an older one is shown
        self._commands = commands
        self._run = run

    def show_message(self, text: str, *, is_error: bool = False) -> None:
        """Add lines of text."""
        self.lines.extend((line, is_error) for line in text.splitlines())

    def insert(self, text: str) -> None:
        """Insert typed characters at the cursor; control characters are dropped."""
        text = "".join(character for character in text if character.isprintable())[
            : _MAX_LENGTH - len(self.text)
        ]
        self.text = self.text[: self.cursor] + text + self.text[self.cursor :]
        self.cursor += len(text)
        self.choices = []

    def press(self, key: str) -> bool:
        """Edit by a key; return whether the key has a meaning here."""
        edit = {
            "Enter": self._enter,
            "Tab": self._complete,
            "Backspace": lambda: self._cut(self.cursor - 1, self.cursor),
            "Delete": lambda: self._cut(self.cursor, self.cursor + 1),
            "ArrowLeft": lambda: self._move(self.cursor - 1),
            "ArrowRight": lambda: self._move(self.cursor + 1),
            "Home": lambda: self._move(0),
            "End": lambda: self._move(len(self.text)),
            "ArrowUp": lambda: self._recall(self._history_index - 1),
            "ArrowDown": lambda: self._recall(self._history_index + 1),
            "Escape": self._close,
        }.get(key)
        if edit is None:
            return False
        edit()
        return True

    def _enter(self) -> None:
        line = self.text.strip()
        self._set("")
        if line:
            if not self._history or self._history[-1] != line:
                self._history.append(line)
            self._run(line)
        self._history_index = len(self._history)

    def _complete(self) -> None:
        before = self.text[: self.cursor]
        words = self._commands.complete(before)
        typed = before.rpartition(" ")[2]
        if not words:
            return
        ending = common_start(words)[len(typed) :] + (" " if len(words) == 1 else "")
        self.insert(ending)
        self.choices = words if len(words) > 1 else []

    def _cut(self, first: int, end: int) -> None:
        first, end = max(first, 0), min(end, len(self.text))
        self.text = self.text[:first] + self.text[end:]
        self._move(first)

    def _move(self, cursor: int) -> None:
        self.cursor = min(max(cursor, 0), len(self.text))
        self.choices = []

    def _recall(self, index: int) -> None:
        if not 0 <= index <= len(self._history):
            return
        if self._history_index == len(self._history):
            self._draft = self.text
        self._history_index = index
        self._set(self._history[index] if index < len(self._history) else self._draft)

    def _close(self) -> None:
        if self.text:
            self._set("")
        else:
            self.is_open = False

    def _set(self, text: str) -> None:
        self.text, self.cursor, self.choices = text, len(text), []
