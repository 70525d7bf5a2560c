"""How long resources live: until they are destroyed, at the latest at the end of their `with`, or where they can't be
filled."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Self

__rhi_internal__ = True


class Resource:
    """What is given back by `destroy`, or at the end of a `with` block."""

    __slots__ = ()

    def destroy(self) -> None:
        """Give it back once the GPU is done with it. A second call does nothing."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.destroy()


@contextmanager
def destroy_on_error(resource: Resource) -> Iterator[None]:
    """What is filled inside stays; if that fails, nobody else has a name for it, and it is given back."""
    try:
        yield
    except BaseException:
        resource.destroy()
        raise
