"""The lifetime of resources: it ends with `destroy`, with their `with` block, or with the last reference to
them.

Python finalizes an object on any thread and between any two steps, also of a driver's call. So a finalizer
(`drop`) only queues the resource's id; the timeline retires what is queued at its next signal or creation.
"""

from __future__ import annotations

import warnings
from typing import Protocol, Self

from rhi.contract.descriptors import Id
from rhi.device.core.core import Core, Owner, describe_object
from rhi.errors.device_objects import DeviceObject


class Resource(DeviceObject):
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


def retire(resource: Retirable) -> None:
    """Mark a resource as destroyed and retire it. After an interrupt both or none is done."""
    timeline = resource.core.timeline
    resource.destroyed = True
    try:
        timeline.retire(resource.id)
    except BaseException:
        resource.destroyed = resource.id not in timeline.living
        raise


def drop(owner: Owner, *ids: Id) -> None:
    """Queue the ids of an unreferenced resource for retirement.

    With validation or `python -X dev`, it also issues a ResourceWarning at the line that created the
    resource.
    """
    core = owner.core
    sites = [site for resource in ids if (site := core.timeline.sites.get(resource)) is not None]
    for resource in ids:
        core.timeline.drop(resource)
    if sites and not core.closed:
        message = f"{describe_object(owner)} was collected instead of destroyed"
        warnings.warn_explicit(message, ResourceWarning, sites[0].file, sites[0].line)
