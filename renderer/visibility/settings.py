"""The numbers that visibility algorithms are made with, and the file that keeps them.

`python -m renderer tune` finds the best b and n for a scene and a device (thesis 6.5.1) and writes such a file;
`render` and `compare visibility` read it with `--settings`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Self

from renderer import rules
from rhi import refuse

__rhi_internal__ = True


@dataclass(frozen=True, slots=True)
class Settings:
    """What is given to the algorithms that ask the GPU; each takes what it knows.

    Attributes:
        batch: how many hidden nodes gather before they are asked for, the thesis's b; 1 or more.
        persistence: for how many frames a visible leaf isn't asked for again, its n; 1 or more.
        threshold: a box that passes no more samples than this is taken for hidden; 0 or more, and above 0 images
            may differ.
    """

    batch: int = 50
    persistence: int = 20
    threshold: int = 0

    def __post_init__(self) -> None:
        for field, least in zip(fields(self), (1, 1, 0), strict=True):
            value = getattr(self, field.name)
            if type(value) is not int or value < least:
                refuse(
                    rules.BAD_PARAMETER,
                    f"Settings({field.name}=…)",
                    repr(value),
                    f"a whole number of {least} or more",
                )

    def save(self, path: Path, **found: Any) -> None:
        """Write them as JSON; `found` says how they came about, and isn't read again."""
        path.write_text(json.dumps({"visibility": asdict(self), **found}, indent=2) + "\n")

    @classmethod
    def load(cls, path: Path) -> Self:
        """What `save` wrote; a number that is missing is the default's.

        Raises:
            ValidationError: `visibility-bad-settings` for what is no such file.
            OSError: it can't be read.
        """
        call = f"Settings.load({str(path)!r})"
        try:
            numbers = json.loads(path.read_text())["visibility"]
        except (ValueError, KeyError, TypeError) as error:
            refuse(rules.BAD_SETTINGS, call, f"{type(error).__name__}: {error}")
        if not isinstance(numbers, Mapping):
            refuse(rules.BAD_SETTINGS, call, repr(numbers), "an object of names and numbers")
        known = [field.name for field in fields(cls)]
        for name in numbers:
            if name not in known:
                rules.refuse_name(rules.BAD_SETTINGS, call, name, known)
        return cls(**numbers)
