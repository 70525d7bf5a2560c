"""Visibility algorithms: they decide which objects are drawn.

visibility = make_visibility("chc_plus_plus", scene, device)
statistics = visibility.render(camera, scene_pass)      # `scene_pass`: a `ScenePass`
"""

from collections.abc import Callable
from functools import partial
from typing import Final

from renderer import rules
from renderer.scene import Scene
from renderer.visibility.algorithm import (
    ListedAlgorithm,
    VisibilityAlgorithm,
    VisibilityStatistics,
    find_visible_objects,
)
from renderer.visibility.auto import AutoCulling
from renderer.visibility.boxes.culling import Culler, CullingCounts, find_visible
from renderer.visibility.boxes.hierarchy import Hierarchy, build_by_area, build_by_middle
from renderer.visibility.frustum import FrustumCulling, NoCulling
from renderer.visibility.gpu.depth_pyramid import DepthPyramidCulling, prepare_depth_pyramid
from renderer.visibility.gpu.device_culling import DeviceCulling
from renderer.visibility.gpu.two_pass import TwoPassCulling
from renderer.visibility.queries.chc import Chc
from renderer.visibility.queries.chc_plus_plus import ChcPlusPlus
from renderer.visibility.queries.conditional import ConditionalCulling
from renderer.visibility.queries.stop_and_wait import StopAndWait
from renderer.visibility.scene_pass import CallbackPass, DeviceList, SceneArrays, ScenePass
from renderer.visibility.settings import DEFAULTS, VisibilitySettings
from renderer.visibility.software_depth import SoftwareDepth
from renderer.visibility.walk import CullingWalk, WalkOutcome, find_walk
from rhi import Device, refuse

__all__ = [
    "ALGORITHMS",
    "CANDIDATES",
    "AutoCulling",
    "CallbackPass",
    "Chc",
    "ChcPlusPlus",
    "ConditionalCulling",
    "Culler",
    "CullingCounts",
    "CullingWalk",
    "DepthPyramidCulling",
    "DeviceCulling",
    "DeviceList",
    "FrustumCulling",
    "Hierarchy",
    "NoCulling",
    "SceneArrays",
    "ScenePass",
    "SoftwareDepth",
    "StopAndWait",
    "TwoPassCulling",
    "VisibilityAlgorithm",
    "VisibilitySettings",
    "VisibilityStatistics",
    "WalkOutcome",
    "build_by_area",
    "build_by_middle",
    "check_algorithm",
    "find_obstacle",
    "find_visible",
    "find_visible_objects",
    "find_walk",
    "list_algorithms",
    "make_visibility",
]

CANDIDATES: Final[tuple[str, ...]] = (
    "chc_plus_plus",
    "conditional",
    "frustum",
    "depth_pyramid",
    "two_pass",
    "none",
)
"""The algorithms that `auto` tries, in this order. Each is the fastest for some scene, view and device; no other
is."""
_CL_CANDIDATES: Final = "frustum", "none", "depth_pyramid"
"""Those on cl, whose rasteriser drops instances that are hidden: what asks for the sake of that costs more than it
spares once kernels are optimised. Last, since it builds kernels, comes what culls on the device."""


def _make_auto(scene: Scene, device: Device, settings: VisibilitySettings) -> AutoCulling:
    can = device.capabilities
    names = (_CL_CANDIDATES if can.backend == "cl" else CANDIDATES) if can.renders else ("frustum",)
    able = [name for name in names if find_obstacle(name, device) is None]
    makers = {name: partial(make_visibility, name, scene, device, settings) for name in able}
    prepare = partial(prepare_depth_pyramid, scene, device) if "depth_pyramid" in able else None
    return AutoCulling(scene, device, makers, prepare=prepare)


_LISTED: Final[dict[str, type[ListedAlgorithm]]] = {
    "none": NoCulling,
    "frustum": FrustumCulling,
    "stop_and_wait": StopAndWait,
    "chc": Chc,
    "chc_plus_plus": ChcPlusPlus,
    "conditional": ConditionalCulling,
    "software_depth": SoftwareDepth,
    "depth_pyramid": DepthPyramidCulling,
    "two_pass": TwoPassCulling,
}
ALGORITHMS: Final[dict[str, Callable[[Scene, Device, VisibilitySettings], VisibilityAlgorithm]]] = {
    **_LISTED,
    "auto": _make_auto,
}
"""All visibility algorithms, by the names of the command line."""


def list_algorithms(device: Device) -> list[str]:
    """Return the names of the algorithms that `device` can run. The null device answers no queries and runs no
    shaders, unless it is told how (see `count_samples` and `run_shaders`)."""
    return [name for name in ALGORITHMS if find_obstacle(name, device) is None]


def find_obstacle(name: str, device: Device) -> str | None:
    """Return what a device lacks for an algorithm, in a few words, or None if it can run it."""
    return _LISTED[name].find_obstacle(device) if name in _LISTED else None  # `auto` tries those that can run


def check_algorithm(name: str, device: Device, call: str) -> None:
    """Refuse an algorithm that a device can't run: `visibility-cannot-run`."""
    obstacle = find_obstacle(name, device)
    if obstacle is not None:
        given = f"{name!r} on a {device.backend_name} device, which lacks {obstacle}"
        refuse(rules.CANNOT_RUN, call, given, f"one of {', '.join(list_algorithms(device))}")


def make_visibility(
    name: str, scene: Scene, device: Device, settings: VisibilitySettings = DEFAULTS
) -> VisibilityAlgorithm:
    """Create the algorithm of this name for `scene` and for passes on `device`, with these settings."""
    if name not in ALGORITHMS:
        rules.refuse_name(rules.UNKNOWN_ALGORITHM, f"make_visibility({name!r})", name, ALGORITHMS)
    return ALGORITHMS[name](scene, device, settings)
