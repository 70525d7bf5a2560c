"""Lights on a device, of all kinds with a position, with positions relative to each eye of a frame.

One eye is given relative positions by the CPU, whenever it has moved. For two eyes positions are uploaded
once, as pairs of floats, and only when lights change; a kernel subtracts both eyes' from them, which it takes
from the constants of their views, and shaders of light read what it has written. For one eye a kernel would
save an upload, but llvmpipe waits with it for the frame before, so the CPU could no longer record a frame
while the last one is drawn. A device without kernels is given relative positions for both.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.frame.mirrors import MirroredArray, MirroredTable, split_doubles
from renderer.light_kinds.generation import define, for_kind
from renderer.light_kinds.kind import LocalLightKind
from renderer.light_kinds.shapes import flag_areas, flag_spheres, pack_shapes
from renderer.light_kinds.table import LOCAL_LIGHT_KINDS
from renderer.scene.arrays import Floats
from renderer.scene.lights import Lights
from renderer.shaders import ViewConstants
from renderer.visibility.command_cache import CommandCache, Dispatch
from rhi import Device, Format
from rhi.shading import Shader, Storage, StorageRW, Struct, Uniform, UniformRange, function, global_id, vec3

MAX_EYES: Final = 2
"""The largest number of eyes of a frame."""

_GROUP: Final = 64

Views = Sequence[UniformRange[ViewConstants]]
"""The constants of views on a device."""
Split = tuple[NDArray[np.float32], NDArray[np.float32]]
"""Doubles as pairs of floats, see `split_doubles`."""


class SplitPosition(Struct):
    """A position in the world: a double as the sum of two floats."""

    high: vec3
    low: vec3


@function
def relative_to_eye(position: SplitPosition, eye: SplitPosition) -> vec3:
    """Return a position relative to an eye."""
    return (position.high - eye.high) + (position.low - eye.low)


@function
def relative_to_view(position: SplitPosition, view: ViewConstants) -> vec3:
    """Return a position relative to the eye of a view."""
    return relative_to_eye(position, SplitPosition(high=view.eye_high, low=view.eye_low))


class PositionReader(Shader):
    """The base of the kernels that make the positions of lights relative to both eyes."""

    work_group = (_GROUP,)
    left_view: Uniform[ViewConstants]
    right_view: Uniform[ViewConstants]
    positions: Storage[SplitPosition]


def _define_kernel(kind: LocalLightKind) -> type[Shader]:
    """Return the kernel that makes the positions of the lights of a kind relative to both eyes."""
    text = for_kind(
        """
class Relative${Element}s(PositionReader):
    left: StorageRW[$Element]
    right: StorageRW[$Element]

    def compute(self) -> None:
        i = global_id().x
        if i < len(self.positions):
            self.left[i].position = relative_to_view(self.positions[i], self.left_view)
            self.right[i].position = relative_to_view(self.positions[i], self.right_view)
""",
        kind,
    )
    kernel: type[Shader] = define(
        text,
        f"Relative{kind.element.__name__}s",
        __name__,
        PositionReader=PositionReader,
        StorageRW=StorageRW,
        global_id=global_id,
        relative_to_view=relative_to_view,
    )
    return kernel


KERNELS: Final = {kind.name: _define_kernel(kind) for kind in LOCAL_LIGHT_KINDS}
"""The kernel of each kind of lights."""

_CHANNELS: Final = (Format.R32F, Format.RG32F, Format.RGBA32F, Format.RGBA32F)
"""The formats of textures with a channel for each of up to 4 kinds of lights."""


class _KindBuffers:
    """The lights of one kind: their positions, and what each eye sees of them."""

    def __init__(self, device: Device, kind: LocalLightKind) -> None:
        self.kind = kind
        label = f"{kind.noun}s"
        self.positions = MirroredArray(device, SplitPosition, f"positions of {label}")
        self.by_eye: tuple[MirroredArray[Any], ...] = tuple(
            MirroredArray(device, kind.element, label) for _ in range(MAX_EYES)
        )
        self.shader = KERNELS[kind.name]
        self.packed: NDArray[Any] = np.zeros(0)

    def destroy(self) -> None:
        for array in (self.positions, *self.by_eye):
            array.destroy()


class LocalLightBuffers:
    """The lights of a scene that have a position, on a device; `radii` and `shapes` have those of sources, if
    there are any."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._channels = {Format.R32F: 1, Format.RG32F: 2}.get(_CHANNELS[len(LOCAL_LIGHT_KINDS) - 1], 4)
        self._runs = False  # whether kernels place the lights
        self._work: list[Dispatch] = []
        self._kinds = tuple(_KindBuffers(device, kind) for kind in LOCAL_LIGHT_KINDS)
        with ExitStack() as resources:
            for kind in self._kinds:
                resources.callback(kind.destroy)
            self.radii = MirroredTable(device, _CHANNELS[len(LOCAL_LIGHT_KINDS) - 1], "source radii")
            resources.callback(self.radii.destroy)
            self.shapes = MirroredTable(device, Format.RGBA32F, "source shapes")
            resources.callback(self.shapes.destroy)
            self._commands = CommandCache(device, "")
            resources.callback(self._stop_kernels)
            self._resources = resources.pop_all()
        self._state: tuple[object, ...] = ()  # what the lights were packed from
        self._split: Split = split_doubles(
            np.zeros((0, 3))
        )  # the positions of all kinds, one after the other
        self._placed: dict[int, bytes] = {}  # where each eye was that they were placed for

    def for_eye(self, eye: int) -> dict[str, MirroredArray[Any]]:
        """Return the lights relative to an eye, by the names of their kinds."""
        return {buffers.kind.name: buffers.by_eye[eye] for buffers in self._kinds}

    def update(
        self, lights: Lights, reaching: Sequence[bool], eyes: Sequence[Floats], views: Views = ()
    ) -> None:
        """Make the lights relative to the positions (3,) of `eyes`.

        Args:
            reaching: for each kind, whether any of its lights is needed.
            views: the constants of two eyes on the device.
        """
        runs = self._device.capabilities.compute and len(eyes) > 1
        state = runs, reaching, lights.local_snapshot, *(views if runs else ())
        is_new = state != self._state
        if is_new:
            if self._runs and not runs:
                self._stop_kernels()
            self._runs = runs
            needed = [
                lights.of_kind(kind) if is_needed else lights.of_kind(kind)[:0]
                for kind, is_needed in zip(LOCAL_LIGHT_KINDS, reaching, strict=True)
            ]
            self._pack(needed)
            self._write_radii(needed)
            self._write_shapes(needed)
            self._state = state
            self._placed.clear()
        moved = [eye for eye, position in enumerate(eyes) if self._placed.get(eye) != position.tobytes()]
        self._placed |= {eye: eyes[eye].tobytes() for eye in moved}
        if self._runs:
            if moved:
                self._run(views, is_new=is_new)
        else:
            for eye in moved:
                self._move(eye, split_doubles(eyes[eye]), is_new=is_new)

    def follow(self, position: Floats, split: Split) -> None:
        """Make the lights relative to the position (3,) of the only eye, which is also `split`, all else being as in
        the last `update`."""
        if self._placed.get(0) != position.tobytes():
            self._placed[0] = position.tobytes()
            self._move(0, split)

    def _move(self, eye: int, position: Split, *, is_new: bool = False) -> None:
        """Upload the lights relative to the position of an eye, to the bit as `relative_to_eye` on a device: so a
        light has the same position for one eye and for that eye of two."""
        eye_high, eye_low = position
        high, low = self._split
        relative, begin = (high - eye_high) + (low - eye_low), 0
        for kind in self._kinds:
            if count := len(kind.packed):
                kind.packed["position"] = relative[begin : begin + count]
                begin += count
            if is_new:
                kind.by_eye[eye].write(kind.packed)
            elif count:
                kind.by_eye[eye].replace(kind.packed)

    def _stop_kernels(self) -> None:
        """Destroy what two eyes need and one doesn't."""
        self._commands.forget()
        self._work = []
        for kind in self._kinds:
            kind.positions.destroy()
            for by_eye in kind.by_eye[1:]:
                by_eye.destroy()

    def _pack(self, needed: Sequence[NDArray[Any]]) -> None:
        """Upload the positions of the lights of each kind that are needed, and pack the rest."""
        self._split = split_doubles(np.concatenate([lights["position"] for lights in needed]))
        for buffers, lights in zip(self._kinds, needed, strict=True):
            buffers.packed = buffers.kind.pack_lights(lights, np.zeros(3))
            if self._runs:
                buffers.packed["position"] = 0.0  # which the kernel writes
                positions = np.zeros(len(lights), SplitPosition.dtype)
                positions["high"], positions["low"] = split_doubles(lights["position"])
                buffers.positions.write(positions)

    def _write_radii(self, needed: Sequence[NDArray[Any]]) -> None:
        """Upload the radii of sources: the lights of all kinds with the same index share a texel."""
        radii = np.zeros((max(map(len, needed)), self._channels), np.float32)
        for channel, (kind, lights) in enumerate(zip(LOCAL_LIGHT_KINDS, needed, strict=True)):
            radii[: len(lights), channel] = np.where(flag_spheres(lights), lights["source_radius"], 0.0)
            if kind.has_shapes:
                radii[: len(lights), channel][flag_areas(lights)] = 0.0
        if radii.any():
            self.radii.write(radii)
        else:
            self.radii.destroy()

    def _write_shapes(self, needed: Sequence[NDArray[Any]]) -> None:
        """Upload the shapes of sources, two texels for each light of the kind that has them."""
        for kind, lights in zip(LOCAL_LIGHT_KINDS, needed, strict=True):
            if kind.has_shapes:
                if flag_areas(lights).any():
                    self.shapes.write(pack_shapes(lights).reshape(-1, 4))
                else:
                    self.shapes.destroy()

    def _run(self, views: Views, *, is_new: bool) -> None:
        """Run the kernels that place the lights for both eyes. What `is_new` is uploaded first."""
        if is_new:
            for kind in self._kinds:
                for by_eye in kind.by_eye:
                    by_eye.write(kind.packed)
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
                    "positions": kind.positions.buffer,
                    "left": kind.by_eye[0].buffer,
                    "right": kind.by_eye[1].buffer,
                },
            )
            for kind in self._kinds
            if len(kind.packed)
        ]

    def destroy(self) -> None:
        """Destroy the resources on the device."""
        self._resources.close()
