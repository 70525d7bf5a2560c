"""Versions of the files that the renderer writes: settings, walk-throughs, scenes.

A file says its version; one without is of version 1. A file of an older version is brought to the current one by a
step for each version in between, before anything else reads it. A file of a newer version is refused by name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from renderer import rules
from rhi.errors import describe_value, refuse
from rhi.errors.arguments import to_integer

KEY: Final = "version"

Fields = dict[str, Any]
Migration = Callable[[Fields], Fields]
"""A step from a version to the next: maps the values of a file, which it may change."""


@dataclass(frozen=True, slots=True)
class FileVersions:
    """The versions of a kind of file: step i leads from version i + 1 to the next."""

    kind: str
    steps: Sequence[Migration]

    @property
    def current(self) -> int:
        """The version that is written."""
        return len(self.steps) + 1

    def migrate(self, values: Mapping[str, Any], call: str) -> Fields:
        """Return the values of a file as those of the current version, without the version.

        Raises:
            ValidationError: `file-version` for a newer version, or one that is no whole number from 1 on.
        """
        version = to_integer(values.get(KEY, 1))
        if version is None or not 1 <= version <= self.current:
            text = f"version {describe_value(values[KEY])} of {self.kind}"
            refuse(rules.FILE_VERSION, call, text, f"1 to {self.current}")
        fields = {name: value for name, value in values.items() if name != KEY}
        for step in self.steps[version - 1 :]:
            fields = step(fields)
        return fields


def rename_fields(fields: Any, names: Mapping[str, str]) -> None:
    """Give fields of a JSON object their new names, in place; those whose new name is taken stay as they are."""
    if isinstance(fields, dict):
        for old, new in names.items():
            if old in fields and new not in fields:
                fields[new] = fields.pop(old)
