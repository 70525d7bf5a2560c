"""A kind of lights, as the leaves describe theirs to the rest of the renderer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.math import Floats
from rhi.shading import Shader, Struct
from rhi.shading.language.function import ShadingFunction

LOCAL_FIELDS: Final = (
    ("position", "<f8", 3),
    ("range", "<f4"),
    ("color", "<f4", 3),
    ("intensity", "<f4"),
    ("casts_shadow", "?"),
    ("source_radius", "<f4"),
)
"""The fields that the arrays of all kinds with a position begin with."""

Lights = NDArray[Any]
"""The lights (k,) of one kind, of its `dtype`."""


@dataclass(frozen=True, slots=True)
class GltfMapping:
    """The place of a kind in glTF's KHR_lights_punctual.

    Attributes:
        type: the value of `type`.
        read: the kind's own fields of the array from the JSON object of a light (`renderer.content.gltf`).
        write: the kind's own members of that JSON object, from a light.
        is_allowed: whether glTF allows the kind's own values of a light. If not, `omission` says what is
            lost.
    """

    type: str
    read: Callable[[Any], dict[str, Any]] = lambda fields: {}
    write: Callable[[Any], dict[str, Any]] = lambda light: {}
    is_allowed: Callable[[Any], bool] = lambda light: True
    omission: str = ""


@dataclass(frozen=True, eq=False, slots=True)
class LightKind:
    """A kind of lights.

    Attributes:
        name: a word, which is that of the array in `Lights` and part of the names of bindings and switches.
        noun: the name in explanations, singular.
        dtype: the array in a scene.
        element: the struct that shaders read.
        incidence: a shader function, the light that arrives at a position: of `(position, light)`, or of
            `(light)` for lights without a position.
        gltf: the place in glTF; None if it has none, and files leave such lights out.
    """

    name: str
    noun: str
    dtype: np.dtype[Any]
    element: type[Struct]
    incidence: ShadingFunction[..., Any]
    gltf: GltfMapping | None

    @property
    def has_direction(self) -> bool:
        """True if the lights have a direction in which they shine."""
        return "direction" in (self.dtype.names or ())

    @property
    def has_shapes(self) -> bool:
        """True if the sources of the lights may be rectangles and tubes."""
        return "source_right" in (self.dtype.names or ())

    @property
    def has_range(self) -> bool:
        """True if the lights have a position and end at their range from it."""
        return "range" in (self.dtype.names or ())


FARTHEST_RANGE: Final = 1e18
"""The range in metres that shaders read of lights which reach farther.

Their float32 can't square longer distances, and projects corners of longer volumes to infinity."""


@dataclass(frozen=True, eq=False, slots=True)
class LocalLightKind(LightKind):
    """A kind of lights with a position and a range, beyond which they light nothing.

    Attributes:
        packed: the array that shaders read, laid out as `element`.
        pack: sets the fields of `packed` (k,) that aren't fields of `dtype` of the same name.
        bounds: the smallest spheres around what lights may light: centres (k, 3) and radii (k,), in the
            world.
        cones: the same volumes as cones, where they are narrower than spheres: the values of the struct
            `Cone` in the world, in float64; None for kinds whose volumes are spheres.
        cone_versine: 1 - cos (k,) of the half angles of the cones that lights are within; 3 for all
            directions.
        volume: the vertex stage that moves the corners of a sphere or a cone around a light (`VolumeCorner`).
        fits_cone: which lights (k,) have a volume that is smaller as a cone than as a sphere.
        half_angle: of lights (k,), or of one, the half angle in radians of its single shadow map; NaN for
            lights that have the six faces of a cube instead.
    """

    packed: np.dtype[Any]
    bounds: Callable[[Lights], tuple[Floats, Floats]]
    volume: type[Shader]
    pack: Callable[[Lights, Lights], None] = lambda packed, lights: None
    cones: Callable[[Lights], Mapping[str, NDArray[Any]]] | None = None
    cone_versine: Callable[[Lights], NDArray[Any]] = lambda lights: np.full(np.shape(lights), 3.0)
    fits_cone: Callable[[Lights], NDArray[np.bool_]] = lambda lights: np.zeros(len(lights), bool)
    half_angle: Callable[[Lights], NDArray[np.floating[Any]]] = lambda lights: np.full(
        np.shape(lights), np.nan, np.float32
    )

    def bound_lights(self, lights: Lights) -> tuple[Floats, Floats]:
        """Spheres around what lights may light, centres (k, 3) and radii (k,), with room for what directions and
        angles in float32 are off."""
        centers, radii = self.bounds(lights)
        return np.asarray(centers, np.float64), radii * (1.0 + 2.0**-20)

    def pack_lights(self, lights: Lights, eye: Floats) -> NDArray[Any]:
        """The lights as shaders read them, with positions relative to `eye` (3,), subtracted in float64."""
        packed = np.zeros(len(lights), self.packed)
        for name in self.packed.names or ():
            if name == "position":
                packed[name] = lights[name] - np.asarray(eye, np.float64)
            elif name in (self.dtype.names or ()):
                packed[name] = lights[name]
        packed["range"] = np.minimum(packed["range"], FARTHEST_RANGE)
        self.pack(packed, lights)
        return packed
