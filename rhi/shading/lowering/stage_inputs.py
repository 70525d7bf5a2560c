"""The built-in inputs of vertex and fragment stages, such as `vertex_index()`, as arguments of lane code."""

from __future__ import annotations

from typing import Final

from rhi.contract.descriptors import Stage
from rhi.contract.layout import BOOL, FLOAT, INT, ScalarType
from rhi.shading.ir import lanes


def stage_argument(
    name: str, kind: ScalarType = INT, uniformity: lanes.Uniformity = lanes.Uniformity.LANES
) -> lanes.Argument:
    return lanes.Argument(kind, uniformity, name)


STAGE_INPUTS: Final[dict[Stage, dict[str, tuple[lanes.Value, ...]]]] = {
    Stage.VERTEX: {
        "vertex_index": (stage_argument(lanes.FIRST_VERTEX, uniformity=lanes.Uniformity.VARYING),),
        "instance_index": (stage_argument("instance"),),
        "draw_index": (stage_argument("draw"),),
    },
    Stage.FRAGMENT: {
        "fragment_coordinate": tuple(
            stage_argument(axis, FLOAT, lanes.Uniformity.VARYING) for axis in "xyzw"
        ),
        "front_facing": (stage_argument("front", BOOL),),
        "primitive_index": (stage_argument("primitive"),),
        "point_coordinate": tuple(
            stage_argument(axis, FLOAT, lanes.Uniformity.VARYING) for axis in ("across", "down")
        ),
    },
}
"""The components of each input, by the name of its built-in."""
