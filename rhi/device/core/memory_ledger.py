"""The memory of a device's buffers and textures: what was created and isn't destroyed yet."""

from __future__ import annotations

from collections import defaultdict
from typing import Any, Final

from rhi.contract.descriptors import BufferDescriptor, BufferUsage, Id, TextureDescriptor
from rhi.errors.data_classes import dataclass

KINDS: Final = {
    BufferUsage.STATIC: "buffers",
    BufferUsage.STREAM: "streams",
    BufferUsage.READBACK: "readbacks",
}
"""By a buffer's usage, the kind of memory."""


@dataclass(frozen=True, slots=True)
class MemoryUse:
    """The memory of a device at one time, in bytes.

    Attributes:
        backend: the name of the backend.
        total: of all buffers and textures that exist on the device, those included that are destroyed and
            wait until the device has finished with them.
        peak: the largest `total` since creation, or the last `reset_statistics`.
        retired: the part of `total` that is destroyed and waits.
        kinds: by kind: "textures", "buffers" (STATIC), "streams" (STREAM, such as the rings of transient memory)
            and "readbacks".
        labels: by kind and label, the largest first.
    """

    backend: str
    total: int
    peak: int
    retired: int
    kinds: dict[str, int]
    labels: dict[tuple[str, str], int]

    def __str__(self) -> str:
        lines = [f"{self.backend}: {_show(self.total)}, at most {_show(self.peak)}"]
        if self.retired:
            lines.append(f"  {_show(self.retired):>10}  destroyed, until the device has finished with them")
        for kind, size in self.kinds.items():
            lines.append(f"  {_show(size):>10}  {kind}")
            labels = [(label, part) for (other, label), part in self.labels.items() if other == kind]
            lines += [f"  {_show(part):>14}  {label or 'without a label'}" for label, part in labels]
        return "\n".join(lines)


def _show(size: int) -> str:
    """Return bytes as text with a unit."""
    number, unit = float(size), "bytes"
    for larger in ("KiB", "MiB", "GiB"):
        if number < 1024:
            break
        number, unit = number / 1024, larger
    return f"{number:.0f} {unit}" if unit == "bytes" else f"{number:.1f} {unit}"


class MemoryLedger:
    """The buffers and textures that a device has created on its backend.

    Attributes:
        entries: by id of a buffer or texture, its descriptor and its bytes.
        total, peak: bytes now, and at most.
    """

    __slots__ = ("entries", "peak", "total")

    def __init__(self) -> None:
        self.entries: dict[Id, tuple[Any, int]] = {}
        self.total = self.peak = 0

    def add(self, resource: Id, descriptor: BufferDescriptor) -> None:
        """Note that the device has created a buffer of its own."""
        self.entries[resource] = descriptor, descriptor.size
        self.total += descriptor.size
        self.peak = max(self.peak, self.total)

    def clear(self) -> None:
        """Note that the backend was closed."""
        self.entries.clear()
        self.total = 0

    def size_of(self, resource: Id) -> int:
        """The bytes of a resource; 0 if it has none."""
        entry = self.entries.get(resource)
        return entry[1] if entry is not None else 0

    def report(self, backend: str, retired: int) -> MemoryUse:
        """Return the present use; `retired` bytes of it wait for the device."""
        labels: defaultdict[tuple[str, str], int] = defaultdict(int)
        kinds: defaultdict[str, int] = defaultdict(int)
        for descriptor, size in self.entries.values():
            is_texture = isinstance(descriptor, TextureDescriptor)
            kind = "textures" if is_texture else KINDS[descriptor.usage]
            kinds[kind] += size
            labels[kind, descriptor.label] += size
        by_size = sorted(labels.items(), key=lambda item: -item[1])
        return MemoryUse(
            backend,
            self.total,
            self.peak,
            retired,
            dict(sorted(kinds.items(), key=lambda item: -item[1])),
            dict(by_size),
        )
