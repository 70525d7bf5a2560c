"""Lists of lights of all kinds with a position: where those of each kind begin and end.

A list has the lights of the first kind, then those of the second, and so on. Its bounds are the index of its
first light, and for each kind the index behind its last light.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

from renderer.light_kinds.table import LOCAL_LIGHT_KINDS
from rhi.shading import ivec3, ivec4

MAX_LOCAL_KINDS: Final = 3
"""The kinds with a position whose bounds fit in a vector."""

assert 2 <= len(LOCAL_LIGHT_KINDS) <= MAX_LOCAL_KINDS

if TYPE_CHECKING:
    LightBounds = ivec3
else:
    LightBounds = (ivec3, ivec4)[len(LOCAL_LIGHT_KINDS) - 2]

BOUND_FIELDS: Final = (
    "lights_begin",
    *(f"{kind.name}_lights_end" for kind in LOCAL_LIGHT_KINDS[:-1]),
    "lights_end",
)
"""The fields of an object that are the bounds of its list."""

KIND_COUNT: Final = len(LOCAL_LIGHT_KINDS)

_CONES: Final = [kind.cones is not None for kind in LOCAL_LIGHT_KINDS]

assert sorted(_CONES) == _CONES, "kinds whose lights are within a cone come last"

WORD_FIELDS: Final = tuple(
    "first_cone_word" if _CONES[number + 1] > _CONES[number] else f"{kind.name}_words_end"
    for number, kind in enumerate(LOCAL_LIGHT_KINDS[:-1])
)
"""The fields that say behind which word of 32 lights those of each kind but the last end, if words are
counted through all kinds."""


def index_in_kind(index: str, ends: Sequence[str]) -> str:
    """The text of an index among the lights of its kind, from one that counts through all kinds.

    Args:
        ends: the texts of the index behind the last light of each kind but the last.
    """
    result = f"{index} - {ends[-1]}"
    for number in reversed(range(len(ends))):
        position = f"{index} - {ends[number - 1]}" if number else index
        result = f"({position} if {index} < {ends[number]} else {result})"
    return result
