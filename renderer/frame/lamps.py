"""Point and spot lights on a device, with positions relative to each eye of a frame.

Positions are uploaded once for all eyes, as pairs of floats, and only when lights change. A kernel subtracts each eye's
from them, when it has moved: so neither a camera that walks nor a second eye uploads lights. Shaders of light read what
the kernel has written. A device that can't run it is given relative positions by the CPU.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.frame.mirrors import MirroredArray, MirroredValue, split_doubles
from renderer.scene.arrays import Floats
from renderer.scene.lights import Lights
from renderer.shaders import PointLight, SpotLight
from renderer.visibility.repeated import RepeatedCommands
from rhi import Device, Encoder
from rhi.shading import Shader, Storage, StorageRW, Struct, Uniform, function, global_id, vec3

__rhi_internal__ = True

EYES: Final = 2
"""The largest number of eyes of a frame."""

_GROUP: Final = 64


class ExactPlace(Struct):
    """A position in the world: a double as the sum of two floats."""

    high: vec3
    low: vec3


@function
def subtract_exactly(place: ExactPlace, eye: ExactPlace) -> vec3:
    """Return a position relative to an eye."""
    return (place.high - eye.high) + (place.low - eye.low)


class PlacePoints(Shader):
    """Makes the positions of point lights relative to an eye."""

    work_group = (_GROUP,)
    eye: Uniform[ExactPlace]
    places: Storage[ExactPlace]
    lights: StorageRW[PointLight]

    def compute(self) -> None:
        i = global_id().x
        if i < len(self.places):
            self.lights[i].position = subtract_exactly(self.places[i], self.eye)


class PlaceSpots(Shader):
    """Makes the positions of spot lights relative to an eye."""

    work_group = (_GROUP,)
    eye: Uniform[ExactPlace]
    places: Storage[ExactPlace]
    lights: StorageRW[SpotLight]

    def compute(self) -> None:
        i = global_id().x
        if i < len(self.places):
            self.lights[i].position = subtract_exactly(self.places[i], self.eye)


class _Kind:
    """The lights of one kind: their places, and what each eye sees of them."""

    def __init__(self, device: Device, element: type[Any], shader: type[Shader], label: str) -> None:
        self.places = MirroredArray(device, ExactPlace, f"places of {label}")
        self.seen = tuple(MirroredArray(device, element, label) for _ in range(EYES))
        self.shader = shader
        self.packed: NDArray[Any] = np.zeros(0)

    def destroy(self) -> None:
        for array in (self.places, *self.seen):
            array.destroy()


class Lamps:
    """All lights of a scene that have a position, on a device."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._runs = device.capabilities.compute
        self._kinds = (
            _Kind(device, PointLight, PlacePoints, "point lights"),
            _Kind(device, SpotLight, PlaceSpots, "spot lights"),
        )
        with ExitStack() as made:
            for kind in self._kinds:
                made.callback(kind.destroy)
            self._eyes: list[MirroredValue[ExactPlace]] = []
            for _ in range(EYES):
                self._eyes.append(MirroredValue(device, _place(np.zeros(3))))
                made.callback(self._eyes[-1].destroy)
            self._made = made.pop_all()
        self._commands = tuple(RepeatedCommands(device, "") for _ in range(EYES))
        self._state: tuple[object, ...] = ()  # what the lights were packed from
        self._version = 0
        self._placed: list[tuple[int, bytes] | None] = [None] * EYES  # by eye: the version, and where it was

    def find(self, eye: int) -> tuple[MirroredArray[PointLight], MirroredArray[SpotLight]]:
        """Return the point and the spot lights relative to an eye."""
        point, spot = self._kinds
        return point.seen[eye], spot.seen[eye]

    def update(self, lights: Lights, reaching: tuple[bool, bool], eyes: Sequence[Floats]) -> None:
        """Make the lights relative to the positions (3,) of `eyes`.

        Args:
            reaching: whether any point light is needed, and whether any spot light is.
        """
        kinds = tuple(
            some if is_needed else some[:0]
            for some, is_needed in zip((lights.point, lights.spot), reaching, strict=True)
        )
        state = tuple(some.tobytes() for some in kinds)
        if state != self._state:
            self._pack(lights, kinds)
            self._state = state
            self._version += 1
        for eye, position in enumerate(eyes):
            placed = self._version, position.tobytes()
            if placed != self._placed[eye]:
                self._place(eye, position, kinds)
                self._placed[eye] = placed

    def _pack(self, lights: Lights, kinds: tuple[NDArray[Any], ...]) -> None:
        """Upload the places of all lights, and pack the rest."""
        packed = lights.relative_to(np.zeros(3))
        for kind, rows, some in zip(self._kinds, (packed.point, packed.spot), kinds, strict=True):
            kind.packed = rows[: len(some)]
            if self._runs:
                kind.packed["position"] = 0.0  # which the kernel writes
                places = np.zeros(len(some), ExactPlace.dtype)
                places["high"], places["low"] = split_doubles(some["position"])
                kind.places.write(places)

    def _place(self, eye: int, position: Floats, kinds: tuple[NDArray[Any], ...]) -> None:
        """Make the lights relative to an eye."""
        for kind, some in zip(self._kinds, kinds, strict=True):
            if not self._runs:
                kind.packed["position"] = some["position"] - position
            kind.seen[eye].write(kind.packed)
        lit = [kind for kind in self._kinds if len(kind.packed)]
        if not self._runs or not lit:
            return
        self._eyes[eye].write(_place(position))
        work: list[tuple[Any, int, dict[str, Any]]] = [
            (
                self._device.program(kind.shader),
                -(-len(kind.packed) // _GROUP),
                {
                    "eye": self._eyes[eye].buffer,
                    "places": kind.places.buffer,
                    "lights": kind.seen[eye].buffer,
                },
            )
            for kind in lit
        ]

        def issue(encoder: Encoder) -> None:
            for program, groups, bindings in work:
                encoder.dispatch(program, groups, **bindings)

        self._commands[eye].execute(tuple(one for _, _, bindings in work for one in bindings.values()), issue)

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        for commands in self._commands:
            commands.forget()
        self._made.close()


def _place(position: Floats) -> ExactPlace:
    high, low = split_doubles(position)
    return ExactPlace(high=high, low=low)
