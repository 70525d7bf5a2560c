"""Values of Python as members of JavaScript's WebGPU: `mip_level_count` is `mipLevelCount`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any, Final

_VERBATIM: Final = "constants"
"""The member whose keys are names of the user's, not of WebGPU."""


@cache
def to_camel_case(name: str) -> str:
    """Return WebGPU's spelling of a name: `mip_level_count` is `mipLevelCount`."""
    first, *others = name.split("_")
    return first + "".join(part[:1].upper() + part[1:] for part in others)


def prepare(value: Any, unwrap: Callable[[Any], Any]) -> Any:
    """Return a value with the names of JavaScript. What is None in a dictionary is left out.

    Args:
        value: dictionaries, lists and plain values.
        unwrap: is called with each object of WebGPU, and with every other plain value.
    """
    if isinstance(value, Mapping):
        return {
            to_camel_case(key): dict(part) if key == _VERBATIM else prepare(part, unwrap)
            for key, part in value.items()
            if part is not None
        }
    if isinstance(value, (list, tuple)):
        return [prepare(part, unwrap) for part in value]
    if isinstance(value, int) and not isinstance(value, bool):
        return int(value)
    return unwrap(value)
