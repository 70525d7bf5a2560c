"""Visibility: which objects are drawn.

visibility = make_visibility("frustum", scene)
statistics = visibility.render(camera, lambda rows: technique.draw(rows))
"""

from collections.abc import Callable
from typing import Final

from renderer import rules
from renderer.scene import Scene
from renderer.visibility.algorithm import DrawObjects, Statistics, VisibilityAlgorithm, find_visible_objects
from renderer.visibility.culling import Counts, Culler, find_visible
from renderer.visibility.frustum import FrustumCulling, NoCulling
from renderer.visibility.hierarchy import Hierarchy, build_by_area, build_by_median

__rhi_internal__ = True

__all__ = [
    "ALGORITHMS",
    "Counts",
    "Culler",
    "DrawObjects",
    "FrustumCulling",
    "Hierarchy",
    "NoCulling",
    "Statistics",
    "VisibilityAlgorithm",
    "build_by_area",
    "build_by_median",
    "find_visible",
    "find_visible_objects",
    "make_visibility",
]

ALGORITHMS: Final[dict[str, Callable[[Scene], VisibilityAlgorithm]]] = {
    "none": NoCulling,
    "frustum": FrustumCulling,
}
"""Visibility algorithms by the names of the command line."""


def make_visibility(name: str, scene: Scene) -> VisibilityAlgorithm:
    """The algorithm of this name, made for `scene`."""
    if name not in ALGORITHMS:
        rules.refuse_name(rules.UNKNOWN_ALGORITHM, f"make_visibility({name!r})", name, ALGORITHMS)
    return ALGORITHMS[name](scene)
