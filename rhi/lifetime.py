"""How long resources live: until they are destroyed, at the latest at the end of their `with`."""

from __future__ import annotations

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
