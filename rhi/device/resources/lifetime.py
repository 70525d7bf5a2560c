"""The lifetime of resources: until they are destroyed, explicitly or at the end of their `with` block."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Self

__rhi_internal__ = True


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


@contextmanager
def destroy_on_error(resource: Resource) -> Iterator[None]:
    """Destroy a new resource if the block that fills it raises, since the caller never receives it."""
    try:
        yield
    except BaseException:
        resource.destroy()
        raise
