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
    """An owner of resources that it can destroy and create again on demand."""

    def release(self) -> None:
        """Destroy the resources."""


R = TypeVar("R", bound=_Destroyable)
S = TypeVar("S", bound=Struct)
T = TypeVar("T")

_GAP: Final = 128
"""Rows to upload that are at most this many bytes apart are uploaded together with those between them: a
write takes as long as copying 16 KB (llvmpipe, PoCL), but where bytes cross a bus they are scarcer."""


class MirroredArray(Generic[T]):
    """A storage buffer that mirrors an array. There is no buffer while the array is empty."""

    def __init__(self, device: Device, element: type[T], label: str) -> None:
        self.buffer: StorageBuffer[T] | None = None
        self._device = device
        self._element = element
        self._label = label
        self._rows: NDArray[np.uint8] = np.zeros((0, 0), np.uint8)
        self._is_replaced = False  # whether the buffer holds other values than `_rows`

    def __len__(self) -> int:
        return 0 if self.buffer is None else self.buffer.count

    def write(self, array: NDArray[Any], indices: NDArray[np.int64] | None = None) -> None:
        """Make the buffer equal `array`, whose dtype has the element's std430 layout, names aside.

        The rows that differ are uploaded, near ones together. Only the rows `indices` (k,), ascending, are
        compared: the others must be unchanged.
        """
        if not len(array):
            self.destroy()
            return
        if indices is not None and not len(indices) and len(array) == len(self):
            return
        rows = np.frombuffer(np.ascontiguousarray(array), np.uint8).reshape(len(array), -1)
        if self.buffer is None or rows.shape != self._rows.shape:
            self.destroy()
            buffer = self._device.storage(self._element, len(array), label=self._label)
            self._upload(buffer, rows, 0)
            self._rows, self.buffer = rows.copy(), buffer  # once both are made
            self._is_replaced = False
            return
        if self._is_replaced:
            changed = np.arange(len(rows))
            self._is_replaced = False
        elif indices is None:
            changed = np.logical_or.reduce(rows != self._rows, axis=1).nonzero()[0]
        else:
            changed = indices[(rows[indices] != self._rows[indices]).any(1)]
        for first, end in join_runs(changed, 1, _GAP // rows.shape[1]):
            self._upload(self.buffer, rows[first:end], first)
        self._rows[changed] = rows[changed]

    def replace(self, array: NDArray[Any]) -> None:
        """As `write`, for an array of structs all of whose elements differ, such as lights when the eye has moved:
        all are uploaded without a comparison."""
        buffer = self.buffer
        if buffer is None or len(array) != len(self._rows):
            self.write(array)
            return
        self._is_replaced = True
        buffer.owner.write(array if array.dtype == buffer.dtype else array.view(buffer.dtype))

    @staticmethod
    def _upload(buffer: StorageBuffer[T], rows: NDArray[np.uint8], first: int) -> None:
        base, shape = buffer.dtype.subdtype or (buffer.dtype, ())
        buffer.write(np.frombuffer(rows, base).reshape(-1, *shape), first)

    def destroy(self) -> None:
        """Destroy the buffer."""
        if self.buffer is not None:
            self.buffer.destroy()
            self.buffer = None


class MirroredTable:
    """A texture that mirrors an array, `TABLE_WIDTH` elements per row of texels: for shaders with no
    storage buffer left. Created by the first `write`; it grows row by row."""

    def __init__(self, device: Device, form: Format, label: str) -> None:
        self.texture: Texture | None = None
        self._device = device
        self._form = form
        self._label = label

    def write(self, rows: NDArray[Any]) -> None:
        """Make the texture equal an array (n,), or (n, k) with one channel per column."""
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


def join_runs(
    begins: NDArray[np.int64], sizes: NDArray[np.int64] | int, gap: int = 0
) -> list[tuple[int, int]]:
    """Join ascending ranges that are at most `gap` apart, and return the begin and end of each run.
    `begins` is (k,); `sizes` is (k,) or one size."""
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
        """Make the buffer equal `value`; it is uploaded if its bytes have changed."""
        data = value.to_bytes()
        if data != self._bytes:
            self.buffer.write(value)
            self._bytes = data

    def destroy(self) -> None:
        """Destroy the buffer."""
        self.buffer.destroy()


class Workspaces:
    """The objects that techniques keep between frames, by their factory; each is created on first use."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._workspaces: dict[Callable[[Device], Any], Any] = {}

    def get_or_create(self, kind: Callable[[Device], R]) -> R:
        """The object that `kind(device)` created on first use."""
        workspace: R | None = self._workspaces.get(kind)
        if workspace is None:
            workspace = self._workspaces[kind] = kind(self._device)
        return workspace

    def mirror(self, value: S) -> UniformBuffer[S]:
        """The uniform buffer for this type of struct, written if the value has changed."""
        mirrored = self._workspaces.get(type(value))
        if mirrored is None:
            mirrored = self._workspaces[type(value)] = MirroredValue(self._device, value)
        mirrored.write(value)
        buffer: UniformBuffer[S] = mirrored.buffer
        return buffer

    def get(self, kind: Callable[[Device], R]) -> R | None:
        """The object of `kind`, if it was created."""
        workspace: R | None = self._workspaces.get(kind)
        return workspace

    def release(self, kind: Callable[[Device], Releasable]) -> None:
        """Release the object of `kind`, if it was created: it destroys what it can create again."""
        workspace = self._workspaces.get(kind)
        if workspace is not None:
            workspace.release()

    def destroy(self) -> None:
        """Destroy all objects."""
        for workspace in self._workspaces.values():
            workspace.destroy()
        self._workspaces.clear()


def split_doubles(positions: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Split doubles into pairs of floats whose sums equal them to 48 bits."""
    high = positions.astype(np.float32)
    return high, (positions - high).astype(np.float32)
