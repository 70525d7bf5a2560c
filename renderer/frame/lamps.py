"""Point and spot lights on a device, with positions relative to each eye of a frame.

One eye is given relative positions by the CPU, whenever it has moved. For two eyes positions are uploaded once, as
pairs of floats, and only when lights change; a kernel subtracts both eyes' from them, which it takes from the constants
of their views, and shaders of light read what it has written. For one eye a kernel would save an upload, but llvmpipe
waits with it for the frame before, so the CPU could no longer record a frame while the last one is drawn. A device
without kernels is given relative positions for both.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.frame.mirrors import MirroredArray, MirroredTable, split_doubles
from renderer.scene.arrays import Floats
from renderer.scene.lights import Lights
from renderer.shaders import PointLight, SpotLight, ViewConstants
from renderer.visibility.repeated import Dispatch, RepeatedCommands
from rhi import Device, Format
from rhi.shading import Shader, Storage, StorageRW, Struct, Uniform, UniformRange, function, global_id, vec3

EYES: Final = 2
"""The largest number of eyes of a frame."""

_GROUP: Final = 64

Views = Sequence[UniformRange[ViewConstants]]
"""The constants of views on a device."""
Split = tuple[NDArray[np.float32], NDArray[np.float32]]
"""Doubles as pairs of floats, see `split_doubles`."""


class ExactPlace(Struct):
    """A position in the world: a double as the sum of two floats."""

    high: vec3
    low: vec3


@function
def subtract_exactly(place: ExactPlace, eye: ExactPlace) -> vec3:
    """Return a position relative to an eye."""
    return (place.high - eye.high) + (place.low - eye.low)


@function
def place_for(place: ExactPlace, view: ViewConstants) -> vec3:
    """Return a position relative to the eye of a view."""
    return subtract_exactly(place, ExactPlace(high=view.eye_high, low=view.eye_low))


class PlacePoints(Shader):
    """Makes the positions of point lights relative to both eyes."""

    work_group = (_GROUP,)
    left_view: Uniform[ViewConstants]
    right_view: Uniform[ViewConstants]
    places: Storage[ExactPlace]
    left: StorageRW[PointLight]
    right: StorageRW[PointLight]

    def compute(self) -> None:
        i = global_id().x
        if i < len(self.places):
            self.left[i].position = place_for(self.places[i], self.left_view)
            self.right[i].position = place_for(self.places[i], self.right_view)


class PlaceSpots(Shader):
    """Makes the positions of spot lights relative to both eyes."""

    work_group = (_GROUP,)
    left_view: Uniform[ViewConstants]
    right_view: Uniform[ViewConstants]
    places: Storage[ExactPlace]
    left: StorageRW[SpotLight]
    right: StorageRW[SpotLight]

    def compute(self) -> None:
        i = global_id().x
        if i < len(self.places):
            self.left[i].position = place_for(self.places[i], self.left_view)
            self.right[i].position = place_for(self.places[i], self.right_view)


class _Kind:
    """The lights of one kind: their places, and what each eye sees of them."""

    def __init__(self, device: Device, element: type[Any], shader: type[Shader], label: str) -> None:
        self.places = MirroredArray(device, ExactPlace, f"places of {label}")
        self.seen = tuple(MirroredArray(device, element, label) for _ in range(EYES))
        self.shader = shader
        self.packed: NDArray[Any] = np.zeros(0)
        self.split: Split = split_doubles(np.zeros((0, 3)))  # the positions of `packed`

    def destroy(self) -> None:
        for array in (self.places, *self.seen):
            array.destroy()


class Lamps:
    """The lights of a scene that have a position, on a device; `radii` has those of sources, if there are any."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._runs = False  # whether kernels place the lights
        self._work: list[Dispatch] = []
        self._kinds = (
            _Kind(device, PointLight, PlacePoints, "point lights"),
            _Kind(device, SpotLight, PlaceSpots, "spot lights"),
        )
        with ExitStack() as made:
            for kind in self._kinds:
                made.callback(kind.destroy)
            self.radii = MirroredTable(device, Format.RG32F, "source radii")
            made.callback(self.radii.destroy)
            self._commands = RepeatedCommands(device, "")
            made.callback(self._stop_kernels)
            self._made = made.pop_all()
        self._state: tuple[object, ...] = ()  # what the lights were packed from
        self._placed: dict[int, bytes] = {}  # where each eye was that they were placed for

    def find(self, eye: int) -> tuple[MirroredArray[PointLight], MirroredArray[SpotLight]]:
        """Return the point and the spot lights relative to an eye."""
        point, spot = self._kinds
        return point.seen[eye], spot.seen[eye]

    def update(self, lights: Lights, reaching: tuple[bool, bool], eyes: Sequence[Floats], views: Views = ()) -> None:
        """Make the lights relative to the positions (3,) of `eyes`.

        Args:
            reaching: whether any point light is needed, and whether any spot light is.
            views: the constants of two eyes on the device.
        """
        kinds = tuple(
            some if is_needed else some[:0]
            for some, is_needed in zip((lights.point, lights.spot), reaching, strict=True)
        )
        runs = self._device.capabilities.compute and len(eyes) > 1
        state = runs, reaching, lights.contents[1:], *(views if runs else ())
        is_new = state != self._state
        if is_new:
            if self._runs and not runs:
                self._stop_kernels()
            self._runs = runs
            self._pack(lights, kinds)
            self._write_radii(kinds)
            self._state = state
            self._placed.clear()
        moved = [eye for eye, place in enumerate(eyes) if self._placed.get(eye) != place.tobytes()]
        self._placed |= {eye: eyes[eye].tobytes() for eye in moved}
        if self._runs:
            if moved:
                self._run(views, is_new=is_new)
        else:
            for eye in moved:
                for kind in self._kinds:
                    if len(kind.packed) or is_new:
                        kind.packed["position"] = subtract_places(kind.split, eyes[eye])
                        kind.seen[eye].write(kind.packed)

    def _stop_kernels(self) -> None:
        """Destroy what two eyes need and one doesn't."""
        self._commands.forget()
        self._work = []
        for kind in self._kinds:
            kind.places.destroy()
            for seen in kind.seen[1:]:
                seen.destroy()

    def _pack(self, lights: Lights, kinds: tuple[NDArray[Any], ...]) -> None:
        """Upload the places of all lights, and pack the rest."""
        packed = lights.relative_to(np.zeros(3))
        for kind, rows, some in zip(self._kinds, (packed.point, packed.spot), kinds, strict=True):
            kind.packed, kind.split = rows[: len(some)], split_doubles(some["position"])
            if self._runs:
                kind.packed["position"] = 0.0  # which the kernel writes
                places = np.zeros(len(some), ExactPlace.dtype)
                places["high"], places["low"] = kind.split
                kind.places.write(places)

    def _write_radii(self, kinds: tuple[NDArray[Any], ...]) -> None:
        """Upload the radii of sources: rows of points and spots share texels."""
        radii = np.zeros((max(map(len, kinds)), len(kinds)), np.float32)
        for column, some in enumerate(kinds):
            radii[: len(some), column] = some["source_radius"]
        if radii.any():
            self.radii.write(radii)
        else:
            self.radii.destroy()

    def _run(self, views: Views, *, is_new: bool) -> None:
        """Run the kernels that place the lights for both eyes. What `is_new` is uploaded first."""
        if is_new:
            for kind in self._kinds:
                for seen in kind.seen:
                    seen.write(kind.packed)
            self._work = self._list_work(views)
        if self._work:
            self._commands.dispatch(self._work)

    def _list_work(self, views: Views) -> list[Dispatch]:
        """Return the kernels that place the lights: programs, numbers of groups, and bindings."""
        return [
            (
                self._device.program(kind.shader),
                -(-len(kind.packed) // _GROUP),
                {
                    "left_view": views[0],
                    "right_view": views[1],
                    "places": kind.places.buffer,
                    "left": kind.seen[0].buffer,
                    "right": kind.seen[1].buffer,
                },
            )
            for kind in self._kinds
            if len(kind.packed)
        ]

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._made.close()


def subtract_places(places: Split, eye: Floats) -> NDArray[np.float32]:
    """Return positions (n, 3), split, relative to an eye (3,), to the bit as `subtract_exactly` on a device.

    So a lamp is at the same place for one eye and for the same one of two."""
    high, low = places
    eye_high, eye_low = split_doubles(eye)
    relative: NDArray[np.float32] = (high - eye_high) + (low - eye_low)
    return relative
