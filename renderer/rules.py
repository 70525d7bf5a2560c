"""The renderer's rules: one table, in the order of the floors from the scene upwards.

A rule is an id (stable; tests compare it), a sentence, and a tip; `refuse` of `rhi.errors` raises it.
`refuse_name` is the one way to refuse a name: with what is allowed and the nearest of it.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches
from typing import Final, NoReturn

from rhi.errors import Rule, refuse

__rhi_internal__ = True

# Model files
MISSING_FILE: Final = Rule("scene-missing-file", "The model file does not exist.")
UNKNOWN_FORMAT: Final = Rule("scene-unknown-format", "The model file's extension names no known format.")
UNREADABLE_MODEL: Final = Rule(
    "scene-unreadable-model",
    "The model file can't be read as what its extension says.",
    "open the file in a viewer, or export it again",
)
EMPTY_MODEL: Final = Rule(
    "scene-empty-model",
    "The model holds no triangle.",
    "point clouds and curves have no surface to draw; export triangles",
)

# What a scene is built from
BAD_VERTICES: Final = Rule(
    "scene-bad-vertices", "A mesh needs finite vertices.", "remove what is NaN or infinite, then export again"
)
BAD_MESH: Final = Rule("scene-bad-mesh", "A mesh is triangles: indices in threes, each naming a vertex.")
BAD_TRANSFORM: Final = Rule(
    "scene-bad-transform", "A transform is a finite, affine 4x4 matrix for column vectors: last row 0 0 0 1."
)
BAD_INDEX: Final = Rule("scene-bad-index", "An id must name something that was added before.")
BAD_MATERIAL: Final = Rule("scene-bad-material", "A material's value is out of its range.")
BAD_IMAGE: Final = Rule(
    "scene-bad-image", "An image is an array of shape (height, width, 4), uint8, not empty."
)
BAD_LIGHT: Final = Rule("scene-bad-light", "A light's value is out of its range.")
STATIC_NODE: Final = Rule(
    "scene-static-node",
    "A static node can't be moved.",
    "add the node, or one of its ancestors, with dynamic=True",
)
UNKNOWN_NODE: Final = Rule("scene-unknown-node", "No node has this name.")

# Scene text
UNKNOWN_SCENE: Final = Rule(
    "scene-unknown-scene", "The text names neither a scene generator nor a model file."
)
SPEC_SYNTAX: Final = Rule("scene-spec-syntax", "A scene's options are written name:key=value,key=value.")
UNKNOWN_KEY: Final = Rule("scene-unknown-key", "The scene generator has no option of this name.")
BAD_VALUE: Final = Rule("scene-bad-value", "The value of a scene's option is not allowed.")

# Cameras
BAD_CAMERA: Final = Rule("camera-bad-value", "A camera's value is out of its range.")
UNKNOWN_CAMERA: Final = Rule(
    "camera-unknown-name",
    "The text names no camera of the scene.",
    "give a name, a position x,y,z, or a position and a target x,y,z,x,y,z",
)
FRAME_RANGE: Final = Rule("camera-frame-range", "The camera path has no such frame.")

# Visibility
BAD_BOUNDS: Final = Rule(
    "visibility-bad-bounds", "Bounds are finite arrays of shape (n, 3), with lower at most upper."
)
UNKNOWN_ALGORITHM: Final = Rule("visibility-unknown-name", "No visibility algorithm has this name.")


def refuse_name(rule: Rule, call: str, given: str, allowed: Iterable[str]) -> NoReturn:
    """Refuse `given`, listing `allowed` and, where one is near, the name that may have been meant."""
    names = list(allowed)
    near = get_close_matches(given.lower(), names, n=1)
    refuse(rule, call, given, ", ".join(names), f"did you mean {near[0]!r}?" if near else "")
