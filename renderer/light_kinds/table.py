"""The table of the kinds of lights.

A row is a base of `AllLightArrays`. Kinds without a position come first. Kinds whose lights are within a cone
come last, behind those that light a sphere: a device then tests the cones of the last lights of each list.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from renderer.light_kinds import directional, point, spot
from renderer.light_kinds.arrays import LightArrays
from renderer.light_kinds.kind import LightKind, LocalLightKind


@dataclass(eq=False)
class AllLightArrays(
    directional.DirectionalLights,
    point.PointLights,
    spot.SpotLights,
):
    """The arrays of a scene's lights, one for each kind, and the methods that add lights to them."""


LIGHT_KINDS: Final[tuple[LightKind, ...]] = tuple(
    row.kind for row in AllLightArrays.__bases__ if issubclass(row, LightArrays)
)
"""All kinds, in the order of the table."""

LOCAL_LIGHT_KINDS: Final[tuple[LocalLightKind, ...]] = tuple(
    kind for kind in LIGHT_KINDS if isinstance(kind, LocalLightKind)
)
"""The kinds whose lights have a position and a range, in the order in which lists of lights have them."""

assert LIGHT_KINDS[-len(LOCAL_LIGHT_KINDS) :] == LOCAL_LIGHT_KINDS, "kinds without a position come first"
