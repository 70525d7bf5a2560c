"""The base class of the project's enums.

Engine authors type members by hand, so a misspelt member names the closest ones. Python's own message holds
the misspelt name and nothing else.
"""

from __future__ import annotations

import enum
from typing import TYPE_CHECKING, NoReturn


class ChoiceType(enum.EnumMeta):
    """Metaclass of `Choice`. Python asks it only for names that the enum doesn't have."""

    if not TYPE_CHECKING:  # a type checker that sees it takes every misspelt member for an attribute

        def __getattr__(cls, name: str) -> NoReturn:
            if name.startswith("_"):  # `copy`, `pickle` and `inspect` probe for these
                raise AttributeError(name)
            hint = suggest_members(name, cls)
            if not hint:
                members = [f"{cls.__name__}.{member}" for member in cls.__members__]
                more = f", … ({len(members)} in all)" if len(members) > 8 else ""
                hint = f"it has {', '.join(members[:8])}{more}"
            raise AttributeError(f"{cls.__name__} has no member {name}; {hint}")


class Choice(enum.Enum, metaclass=ChoiceType):
    """Base class of enums. Members hash by identity, at the speed of C, as they are looked up often."""

    __hash__ = object.__hash__


def suggest_members(text: str, kind: type[enum.Enum]) -> str:
    """Return "did you mean …?" with the members whose names or values are close to a text, or ""."""
    from difflib import get_close_matches  # which only errors need

    names: dict[str, str] = {}
    for name, member in kind.__members__.items():
        names[name] = name
        if isinstance(member.value, str):
            names.setdefault(member.value.upper(), name)
    spelling = text.rpartition(".")[2].upper()
    close = get_close_matches(spelling, list(names), 3, 0.6)
    members = list(dict.fromkeys(f"{kind.__name__}.{names[match]}" for match in close))
    exact = [member for member in members if member.endswith(f".{spelling}")]
    return f"did you mean {' or '.join(exact or members)}?" if members else ""
