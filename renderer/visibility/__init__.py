"""Visibility: which objects are drawn.

visibility = make_visibility("chc_plus_plus", scene, device)
statistics = visibility.render(camera, lambda rows: technique.draw(rows))
"""

from collections.abc import Callable
from typing import Final

from renderer import rules
from renderer.scene import Scene
from renderer.visibility.algorithm import DrawObjects, Statistics, VisibilityAlgorithm, find_visible_objects
from renderer.visibility.auto import AutoCulling
from renderer.visibility.chc import Chc
from renderer.visibility.chc_plus_plus import ChcPlusPlus
from renderer.visibility.conditional import ConditionalCulling
from renderer.visibility.culling import Counts, Culler, find_visible
from renderer.visibility.frustum import FrustumCulling, NoCulling
from renderer.visibility.hierarchy import Hierarchy, build_by_area, build_by_median
from renderer.visibility.stop_and_wait import StopAndWait
from rhi import Device

__rhi_internal__ = True

__all__ = [
    "ALGORITHMS",
    "AutoCulling",
    "Chc",
    "ChcPlusPlus",
    "ConditionalCulling",
    "Counts",
    "Culler",
    "DrawObjects",
    "FrustumCulling",
    "Hierarchy",
    "NoCulling",
    "Statistics",
    "StopAndWait",
    "VisibilityAlgorithm",
    "build_by_area",
    "build_by_median",
    "find_visible",
    "find_visible_objects",
    "list_algorithms",
    "make_visibility",
]

ALGORITHMS: Final[dict[str, Callable[[Scene, Device], VisibilityAlgorithm]]] = {
    "none": lambda scene, _: NoCulling(scene),
    "frustum": lambda scene, _: FrustumCulling(scene),
    "stop_and_wait": StopAndWait,
    "chc": Chc,
    "chc_plus_plus": ChcPlusPlus,
    "conditional": ConditionalCulling,
    "auto": AutoCulling,
}
"""Visibility algorithms by the names of the command line."""


def list_algorithms(device: Device) -> list[str]:
    """The names of the algorithms that `device` can run without help; the null device answers no queries."""
    can = device.capabilities
    asked = can.shading and (can.occlusion_queries or can.sample_counter)
    conditional = asked and can.conditional_rendering
    return [
        name
        for name in ALGORITHMS
        if name in ("none", "frustum", "auto") or (conditional if name == "conditional" else asked)
    ]


def make_visibility(name: str, scene: Scene, device: Device) -> VisibilityAlgorithm:
    """The algorithm of this name, made for `scene` and for passes on `device`."""
    if name not in ALGORITHMS:
        rules.refuse_name(rules.UNKNOWN_ALGORITHM, f"make_visibility({name!r})", name, ALGORITHMS)
    return ALGORITHMS[name](scene, device)
