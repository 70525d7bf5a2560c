"""Exchange with other libraries of arrays: NumPy's `__array__` and DLPack.

A resource whose memory the CPU can read where it lies (`SupportsHostMemory`) is shared, read-only: no byte is
copied, and later work of the device shows in the array. All others are copied, as by `read`.
"""

from __future__ import annotations

from typing import Any, Final

from numpy.typing import DTypeLike, NDArray

from rhi.errors.device_objects import DeviceObject

_CPU: Final = (1, 0)
"""DLPack's device of the CPU: its type and number."""


class ArrayExchange(DeviceObject):
    """A resource that other libraries read as an array: `np.asarray(buffer)`, `torch.from_dlpack(texture)`."""

    __slots__ = ()

    def _view(self) -> NDArray[Any] | None:
        """Return the memory itself after all earlier work, read-only; None if the CPU can't read it in place."""
        raise NotImplementedError

    def _read_array(self) -> NDArray[Any]:
        """Return a copy of all elements."""
        raise NotImplementedError

    def __array__(self, dtype: DTypeLike | None = None, copy: bool | None = None) -> NDArray[Any]:
        """Return the elements for NumPy: shared where the memory allows it, unless `copy` is true.

        Raises:
            ValueError: `copy` is False, and the elements must be copied or converted.
        """
        array = None if copy else self._view()
        is_shared = array is not None
        if array is None:
            array = self._read_array()
        if dtype is not None and array.dtype != dtype:
            array, is_shared = array.astype(dtype), False
        if copy is False and not is_shared:
            raise ValueError(
                f"{self!r} can't be read without a copy: its memory isn't the CPU's, or is converted"
            )
        return array

    def __dlpack__(
        self,
        *,
        stream: Any = None,
        max_version: tuple[int, int] | None = None,
        dl_device: tuple[int, int] | None = None,
        copy: bool | None = None,
    ) -> Any:
        """Return the elements as a DLPack capsule in memory of the CPU; shared memory only for consumers that
        know read-only arrays (version 1 of DLPack).

        Raises:
            BufferError: `copy` is False, and the elements must be copied; another device than the CPU is
                requested; or the elements are structs.
        """
        if dl_device not in (None, _CPU):
            raise BufferError(f"{self!r} is given in the memory of the CPU, not of device {dl_device}")
        knows_read_only = max_version is not None and max_version >= (1, 0)
        array = self._view() if not copy and knows_read_only else None
        if array is None:
            if copy is False:
                raise BufferError(f"{self!r} can't be given without a copy: its memory isn't the CPU's")
            array = self._read_array()
        if array.dtype.names is not None:
            raise BufferError(f"DLPack has no structs: give it a field of np.asarray of {self!r}")
        if array.flags.writeable:
            return array.__dlpack__(stream=stream)
        return array.__dlpack__(stream=stream, max_version=max_version)

    def __dlpack_device__(self) -> tuple[int, int]:
        """Return DLPack's device of the CPU."""
        return _CPU
