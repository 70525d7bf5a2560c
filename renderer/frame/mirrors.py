"""Buffers and textures that mirror what the CPU has, and are written only where they differ from it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from renderer.shaders.structs import TABLE_WIDTH
from rhi import Device, Format, StorageBuffer, Texture, UniformBuffer
from rhi.shading import Struct


class _Destroyable(Protocol):
    def destroy(self) -> None: ...


class Releasable(_Destroyable, Protocol):
    """An owner of resources that it can destroy, and makes again when they are needed."""

    def release(self) -> None:
        """Destroy them."""


R = TypeVar("R", bound=_Destroyable)
S = TypeVar("S", bound=Struct)
T = TypeVar("T")

_GAP: Final = 128
"""Rows to upload that are at most this many bytes apart are uploaded together with those between them: a write takes as
long as copying 16 KB (llvmpipe, PoCL), but where bytes cross a bus they are scarcer."""


class MirroredArray(Generic[T]):
    """A storage buffer that mirrors an array. There is no buffer while the array is empty."""

    def __init__(self, device: Device, element: type[T], label: str) -> None:
        self.buffer: StorageBuffer[T] | None = None
        self._device = device
        self._element = element
        self._label = label
        self._rows: NDArray[np.uint8] = np.zeros((0, 0), np.uint8)

    def __len__(self) -> int:
        return 0 if self.buffer is None else self.buffer.count

    def write(self, array: NDArray[Any], chosen: NDArray[np.int64] | None = None) -> None:
        """Make the buffer hold `array`, whose dtype must have the element's std430 layout, names aside.

        The rows that differ are uploaded, near ones together. Only the rows `chosen` (k,), ascending, are compared: the
        others must be unchanged.
        """
        if not len(array):
            self.destroy()
            return
        if chosen is not None and not len(chosen) and len(array) == len(self):
            return
        rows = np.ascontiguousarray(array).view(np.uint8).reshape(len(array), -1)
        if self.buffer is None or rows.shape != self._rows.shape:
            self.destroy()
            self.buffer = self._device.storage(self._element, len(array), label=self._label)
            self._upload(self.buffer, rows, 0)
            self._rows = rows.copy()
            return
        if chosen is None:
            changed = (rows != self._rows).any(1).nonzero()[0]
        else:
            changed = chosen[(rows[chosen] != self._rows[chosen]).any(1)]
        if len(changed) == len(rows):  # such as lights, when the eye has moved
            self._upload(self.buffer, rows, 0)
            self._rows[:] = rows
            return
        for first, end in join_runs(changed, 1, _GAP // rows.shape[1]):
            self._upload(self.buffer, rows[first:end], first)
        self._rows[changed] = rows[changed]

    @staticmethod
    def _upload(buffer: StorageBuffer[T], rows: NDArray[np.uint8], first: int) -> None:
        base, shape = buffer.dtype.subdtype or (buffer.dtype, ())
        buffer.write(rows.reshape(-1).view(base).reshape(-1, *shape), first)

    def destroy(self) -> None:
        """Destroy the buffer."""
        if self.buffer is not None:
            self.buffer.destroy()
            self.buffer = None


class MirroredTable:
    """A texture that mirrors an array, `TABLE_WIDTH` rows of it in a line of texels: for shaders that have no storage
    buffer left. There is no texture before the first `write`; it grows by lines."""

    def __init__(self, device: Device, form: Format, label: str) -> None:
        self.texture: Texture | None = None
        self._device = device
        self._form = form
        self._label = label

    def write(self, rows: NDArray[Any]) -> None:
        """Make the texture hold rows (n,), or (n, k) with one of the k channels in each column."""
        height = max(-(-len(rows) // TABLE_WIDTH), 1)
        texels = np.zeros((height * TABLE_WIDTH, *rows.shape[1:]), rows.dtype)
        texels[: len(rows)] = rows
        texels = texels.reshape(height, TABLE_WIDTH, *rows.shape[1:])
        if self.texture is not None and self.texture.size == (TABLE_WIDTH, height):
            self.texture.write(texels)
            return
        self.destroy()
        self.texture = self._device.texture(texels, self._form, label=self._label)

    def destroy(self) -> None:
        """Destroy the texture."""
        if self.texture is not None:
            self.texture.destroy()
            self.texture = None


def join_runs(begins: NDArray[np.int64], sizes: NDArray[np.int64] | int, gap: int = 0) -> list[tuple[int, int]]:
    """Join the ranges from `begins` (k,), ascending, of `sizes` (k,), where they are at most `gap` apart; return the
    begin and the end of each run."""
    if not len(begins):
        return []
    ends = begins + sizes
    cuts = np.flatnonzero(begins[1:] - ends[:-1] > gap)
    firsts = begins[np.concatenate([[0], cuts + 1])]
    return list(zip(firsts.tolist(), ends[np.concatenate([cuts, [-1]])].tolist(), strict=True))


class MirroredValue(Generic[S]):
    """A uniform buffer that mirrors the value of a struct."""

    def __init__(self, device: Device, value: S) -> None:
        self.buffer: UniformBuffer[S] = device.uniform(value)
        self._bytes = value.to_bytes()

    def write(self, value: S) -> None:
        """Make the buffer hold `value`; it is uploaded if its bytes have changed."""
        data = value.to_bytes()
        if data != self._bytes:
            self.buffer.write(value)
            self._bytes = data

    def destroy(self) -> None:
        """Destroy the buffer."""
        self.buffer.destroy()


class Workspaces:
    """The objects that techniques keep between frames, by kinds: each is made when it is first asked for."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._made: dict[Callable[[Device], Any], Any] = {}

    def find(self, kind: Callable[[Device], R]) -> R:
        """Return `kind(device)`, the same one each time."""
        if kind not in self._made:
            self._made[kind] = kind(self._device)
        kept: R = self._made[kind]
        return kept

    def mirror(self, value: S) -> UniformBuffer[S]:
        """Return the uniform buffer of this type of struct; it is written where the value is another one."""
        kept = self._made.get(type(value))
        if kept is None:
            kept = self._made[type(value)] = MirroredValue(self._device, value)
        kept.write(value)
        buffer: UniformBuffer[S] = kept.buffer
        return buffer

    def peek(self, kind: Callable[[Device], R]) -> R | None:
        """Return `kind(device)` if it was made."""
        kept: R | None = self._made.get(kind)
        return kept

    def destroy(self) -> None:
        """Destroy all."""
        for kept in self._made.values():
            kept.destroy()
        self._made.clear()


def split_doubles(positions: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Split doubles into pairs of floats whose sums equal them to 48 bits."""
    high = positions.astype(np.float32)
    return high, (positions - high).astype(np.float32)
