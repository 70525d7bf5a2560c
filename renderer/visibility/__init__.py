"""Visibility algorithms: they decide which objects are drawn.

visibility = make_visibility("chc_plus_plus", scene, device)
statistics = visibility.render(camera, scene_drawer)      # `scene_drawer`: a `SceneDrawer`
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
    list_visible_objects,
)
from renderer.visibility.auto import AutoCulling
from renderer.visibility.boxes.culling import CullingCounts, HierarchyCuller, select_visible
from renderer.visibility.boxes.hierarchy import Hierarchy, build_by_area, build_by_middle
from renderer.visibility.frustum import FrustumCulling, NoCulling
from renderer.visibility.gpu.depth_pyramid import DepthPyramidCulling, prepare_depth_pyramid
from renderer.visibility.gpu.device_culling import DeviceCulling
from renderer.visibility.gpu.two_pass import TwoPassCulling
from renderer.visibility.queries.chc import Chc
from renderer.visibility.queries.chc_plus_plus import ChcPlusPlus
from renderer.visibility.queries.conditional import ConditionalCulling
from renderer.visibility.queries.stop_and_wait import StopAndWait
from renderer.visibility.scene_drawer import CallbackDrawer, DeviceDrawList, SceneArrays, SceneDrawer
from renderer.visibility.settings import DEFAULTS, VisibilitySettings
from renderer.visibility.software_depth import SoftwareDepth
from renderer.visibility.traversal import CullingTraversal, TraversalOutcome, compute_traversal
from rhi import Device, refuse

__all__ = [
    "ALGORITHMS",
    "AUTO_CANDIDATES",
    "AutoCulling",
    "CallbackDrawer",
    "Chc",
    "ChcPlusPlus",
    "ConditionalCulling",
    "CullingCounts",
    "CullingTraversal",
    "DepthPyramidCulling",
    "DeviceCulling",
    "DeviceDrawList",
    "FrustumCulling",
    "Hierarchy",
    "HierarchyCuller",
    "NoCulling",
    "SceneArrays",
    "SceneDrawer",
    "SoftwareDepth",
    "StopAndWait",
    "TraversalOutcome",
    "TwoPassCulling",
    "VisibilityAlgorithm",
    "VisibilitySettings",
    "VisibilityStatistics",
    "build_by_area",
    "build_by_middle",
    "check_algorithm",
    "compute_traversal",
    "find_missing_feature",
    "list_algorithms",
    "list_visible_objects",
    "make_visibility",
    "select_visible",
    "to_visibility",
]

AUTO_CANDIDATES: Final[tuple[str, ...]] = (
    "chc_plus_plus",
    "conditional",
    "frustum",
    "depth_pyramid",
    "two_pass",
    "none",
)
"""The algorithms that `auto` tries, in this order. Each is the fastest for some scene, view and device; no
other is."""
_CL_AUTO_CANDIDATES: Final = "frustum", "none", "depth_pyramid"
"""Those on cl, whose rasteriser drops instances that are hidden: what asks for the sake of that costs more
than it spares once kernels are optimised. Last, since it builds kernels, comes what culls on the device."""


def _create_auto_culling(scene: Scene, device: Device, settings: VisibilitySettings) -> AutoCulling:
    can = device.capabilities
    names = (_CL_AUTO_CANDIDATES if can.backend == "cl" else AUTO_CANDIDATES) if can.renders else ("frustum",)
    able = [name for name in names if find_missing_feature(name, device) is None]
    factories = {name: partial(make_visibility, name, scene, device, settings) for name in able}
    prepare = partial(prepare_depth_pyramid, scene, device) if "depth_pyramid" in able else None
    return AutoCulling(scene, device, factories, prepare=prepare)


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
    "auto": _create_auto_culling,
}
"""All visibility algorithms, by the names of the command line."""


def list_algorithms(device: Device) -> list[str]:
    """Return the names of the algorithms that `device` can run. The null device answers no queries and runs
    no shaders, unless it is told how (see `count_samples` and `run_shaders`)."""
    return [name for name in ALGORITHMS if find_missing_feature(name, device) is None]


def find_missing_feature(name: str, device: Device) -> str | None:
    """Name the feature that a device lacks for an algorithm, in a few words, or None if it can run it."""
    return (
        _LISTED[name].find_missing_feature(device) if name in _LISTED else None
    )  # `auto` tries those that can run


def check_algorithm(name: str, device: Device, call: str) -> None:
    """Refuse an algorithm that a device can't run: `visibility-cannot-run`."""
    obstacle = find_missing_feature(name, device)
    if obstacle is not None:
        request = f"{name!r} on a {device.backend_name} device, which lacks {obstacle}"
        refuse(rules.CANNOT_RUN, call, request, f"one of {', '.join(list_algorithms(device))}")


def make_visibility(
    name: str, scene: Scene, device: Device, settings: VisibilitySettings = DEFAULTS
) -> VisibilityAlgorithm:
    """Create the algorithm of this name for `scene` and for passes on `device`, with these settings."""
    if name not in ALGORITHMS:
        rules.refuse_name(rules.UNKNOWN_ALGORITHM, f"make_visibility({name!r})", name, ALGORITHMS)
    return ALGORITHMS[name](scene, device, settings)


def to_visibility(
    call: str, value: VisibilityAlgorithm | str, scene: Scene, device: Device
) -> VisibilityAlgorithm:
    """Return a visibility algorithm, or a new one of a name for a scene and a device. Refuses anything
    else."""
    if isinstance(value, str):
        return make_visibility(value, scene, device)
    if isinstance(value, type) or not hasattr(value, "opens_pass"):
        rules.refuse_object(call, value, "a visibility algorithm, or the name of one")
    return value
