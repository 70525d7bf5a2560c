"""The lifetime of resources: until they are destroyed, explicitly or at the end of their `with` block."""

from __future__ import annotations

from typing import Protocol, Self

from rhi.contract.descriptors import Id
from rhi.device.core.core import Core


class Resource:
    """A resource of the device, destroyed by `destroy` or at the end of a `with` block."""

    __slots__ = ()

    def destroy(self) -> None:
        """Destroy the resource once the GPU no longer uses it. A second call does nothing."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.destroy()


class Retirable(Protocol):
    """A resource with an id of its own, as `retire` sees it."""

    core: Core
    destroyed: bool

    @property
    def id(self) -> Id: ...


def retire(resource: Retirable, size: int = 0) -> None:
    """Mark a resource as destroyed and retire it; `size` in bytes. After an interrupt both or none is done."""
    timeline = resource.core.timeline
    resource.destroyed = True
    try:
        timeline.retire(resource.id, size)
    except BaseException:
        resource.destroyed = timeline.is_retired(resource.id)
        raise
