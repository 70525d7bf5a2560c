"""Decals: images that boxes project on the opaque surfaces inside them, before these are lit.

A decal is a box at a node: `size` metres wide, high and deep in the node's space, around its origin. It projects along
the node's -z axis: what faces +z shows the image upright, with u along +x.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from renderer import rules
from renderer.scene.arrays import Floats, Indices
from renderer.scene.nodes import Nodes
from rhi import SamplerDescriptor, Wrap
from rhi.errors import refuse
from rhi.math.arguments import read_floats

DECAL: Final = np.dtype(
    [
        ("node", np.int32),
        ("texture", np.int32),
        ("order", np.int32),
        ("size", np.float64, 3),
        ("color", np.float64, 3),
        ("strength", np.float64),
        ("inner_angle", np.float64),
        ("outer_angle", np.float64),
    ]
)
"""A decal: the row of its node and of its texture, and the arguments of `SceneBuilder.add_decal`."""

CLAMPED: Final = SamplerDescriptor(wrap_u=Wrap.CLAMP, wrap_v=Wrap.CLAMP)
"""The sampler of decals: an image's edges don't mix with those on its other side."""

_MAX_SIZE: Final = 1e6
_CORNERS: Final = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_NOWHERE: Final = np.zeros((0, 4, 4))


def make_decal(call: str, values: dict[str, ArrayLike]) -> NDArray[Any]:
    """Create one decal, () of `DECAL`, of the numbers in `values`.

    Raises:
        ValidationError: `scene-bad-decal`, in the name of `call`.
    """
    decal = np.zeros((), DECAL)
    for name, value in values.items():
        number = read_floats(f"{call}({name}=...)", value, rule=rules.BAD_DECAL)
        if number.shape != DECAL[name].shape:
            shape = f"{DECAL[name].shape}"
            refuse(rules.BAD_DECAL, f"{call}({name}=...)", f"shape {number.shape}", f"shape {shape}")
        decal[name] = number
    check_decals(call, decal[None])
    return decal


def check_decals(call: str, decals: NDArray[Any]) -> None:
    """Refuse decals (k,) of which a number is out of its range: `scene-bad-decal`."""
    for name, low, high in (("size", 0.0, _MAX_SIZE), ("color", 0.0, 1.0), ("strength", 0.0, 1.0)):
        values = decals[name]
        if not ((values >= low) & (values <= high)).all():
            refuse(rules.BAD_DECAL, f"{call}: {name}", values, f"{low:g} to {high:g}")
    inner, outer = decals["inner_angle"], decals["outer_angle"]
    if not ((inner >= 0.0) & (inner <= outer) & (outer <= np.pi)).all():
        refuse(
            rules.BAD_DECAL, f"{call}: inner_angle, outer_angle", (inner, outer), "0 <= inner <= outer <= π"
        )


class Decals(Sequence[Any]):
    """The decals of a scene.

    Attributes:
        array: (k,) of `DECAL`; all but nodes and textures may be written to between frames.
        nodes: the rows of their nodes, ascending.
        version: a number that grows when a decal has changed, moved, or was hidden or shown.
        seen: (s,) the indices of the decals that may cover something, in the order in which they are projected.
        centers, radii: (s, 3) and (s,) of spheres around these.
        to_boxes: (s, 3, 3) the matrices from offsets from the centers to boxes from -0.5 to 0.5.
        extents: (s, 3) how far these reach from the centers along each axis.
    """

    def __init__(self, array: NDArray[Any] | None = None) -> None:
        self.array: NDArray[Any] = np.zeros(0, DECAL) if array is None else array
        self.nodes: Indices = np.unique(self.array["node"].astype(np.int64))
        self.version = 0
        self._state: tuple[bytes, ...] = ()
        self._select(_NOWHERE, np.zeros(0, bool))

    def __len__(self) -> int:
        return len(self.array)

    def __getitem__(self, index: Any) -> Any:
        return self.array[index]

    @classmethod
    def make(cls, decals: Sequence[NDArray[Any]], index_of_id: Indices) -> Self:
        """Create the decals whose nodes are those of these ids."""
        array = np.array(decals, DECAL) if decals else np.zeros(0, DECAL)
        array["node"] = index_of_id[array["node"]]
        return cls(array)

    def follow(self, nodes: Nodes) -> None:
        """Bring the decals to where their nodes are as of their last update."""
        if not len(self.array):
            return
        worlds, hidden = nodes.world[self.array["node"]], nodes.hidden[self.array["node"]]
        state = self.array.tobytes(), worlds.tobytes(), hidden.tobytes()
        if state != self._state:
            self._state = state
            self.version += 1
            self._select(worlds, ~hidden)

    def _select(self, worlds: Floats, is_shown: NDArray[np.bool_]) -> None:
        """Compute the boxes of the decals that cover something, given the transforms (k, 4, 4) of all."""
        array = self.array[: len(worlds)]
        boxes = worlds[:, :3, :3] * array["size"][:, None, :]
        with np.errstate(all="ignore"):
            volumes = np.linalg.det(boxes)
        is_seen = is_shown & (array["strength"] > 0.0) & np.isfinite(volumes) & (volumes != 0.0)
        rows = np.flatnonzero(is_seen)
        self.seen: Indices = rows[np.argsort(array["order"][rows], kind="stable")]
        boxes = boxes[self.seen]
        self.centers: Floats = worlds[self.seen, :3, 3]
        self.to_boxes: Floats = np.linalg.inv(boxes)
        corners = np.einsum("kij,cj->kci", boxes, _CORNERS)
        self.extents: Floats = np.abs(corners).max(axis=1, initial=0.0)
        self.radii: Floats = np.sqrt((corners**2).sum(axis=2)).max(axis=1, initial=0.0)
