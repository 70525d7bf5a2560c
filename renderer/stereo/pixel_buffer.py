"""Images as words: buffers of four bytes a pixel, which compute shaders move and mix without decoding
them."""

from __future__ import annotations

from typing import Generic, TypeVar

from rhi import Device, StorageBuffer

T = TypeVar("T")


class PixelBuffer(Generic[T]):
    """A storage buffer with an element for each pixel of an image."""

    def __init__(self, device: Device, element: type[T]) -> None:
        self._device = device
        self._element = element
        self._buffer: StorageBuffer[T] | None = None

    @property
    def buffer(self) -> StorageBuffer[T]:
        """The buffer, after `fit`."""
        assert self._buffer is not None, "a buffer must be fitted before it is used"
        return self._buffer

    def fit(self, size: tuple[int, int]) -> StorageBuffer[T]:
        """Return the buffer for images of `size`, of rows that are `row_pitch` apart; one of another size is
        replaced."""
        count = row_pitch(self._device, size[0]) * size[1]
        if self._buffer is None or len(self._buffer) != count:
            self.destroy()
            self._buffer = self._device.storage(self._element, count, label="pixels")
        return self._buffer

    def destroy(self) -> None:
        """Destroy the buffer."""
        if self._buffer is not None:
            self._buffer.destroy()
            self._buffer = None


def row_pitch(device: Device, width: int) -> int:
    """Return the elements from row to row of an image that is copied to a buffer and back: more than `width`
    where rows have to be aligned."""
    step = max(device.capabilities.copy_row_alignment // 4, 1)
    return -(-width // step) * step
