"""What a shader's fields may be, and what may be bound to them.

- A field's annotation is a descriptor for type checkers: reading it (inside a stage) gives the shader's
  view, `Uniform[T]` a `T`; setting it (in the constructor that `dataclass_transform` makes up, and so in
  `device.draw`) wants a handle, `UniformRange[T]`. At run time they are only annotations.
- Handles are slim: what a draw needs, in slots. Resources create or subclass them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Generic, TypeVar

from rhi.shading.language.types import LANGUAGE_NAMES
from rhi.shading.language.vectors import Array, ReadOnlyArray

__rhi_internal__ = True

LANGUAGE_NAMES.update(("Storage", "StorageRW", "Uniform"))

T = TypeVar("T")


class UniformRange(Generic[T]):
    """A part of a buffer that holds one `T` in std140.

    Attributes:
        buffer: the buffer's id. offset, size: in bytes. type: the `Struct` class or value type.
        owner: what keeps the buffer alive.
    """

    __slots__ = ("buffer", "offset", "owner", "size", "type")

    def __init__(self, buffer: int, offset: int, size: int, type: object, owner: object = None) -> None:
        self.buffer = buffer
        self.offset = offset
        self.size = size
        self.type = type
        self.owner = owner


class StorageRange(Generic[T]):
    """A part of a buffer that holds `count` elements of `T` in std430; else as `UniformRange`."""

    __slots__ = ("buffer", "count", "offset", "owner", "size", "type")

    def __init__(
        self, buffer: int, offset: int, size: int, type: object, count: int, owner: object = None
    ) -> None:
        self.buffer = buffer
        self.offset = offset
        self.size = size
        self.type = type
        self.count = count
        self.owner = owner


class TextureBinding:
    """A texture with the sampler that reads it, both by id."""

    __slots__ = ("owner", "sampler", "texture")

    def __init__(self, texture: int, sampler: int, owner: object = None) -> None:
        self.texture = texture
        self.sampler = sampler
        self.owner = owner


class ImageBinding:
    """A level of a texture; `layer` None means all layers."""

    __slots__ = ("layer", "level", "owner", "texture")

    def __init__(self, texture: int, level: int = 0, layer: int | None = None, owner: object = None) -> None:
        self.texture = texture
        self.level = level
        self.layer = layer
        self.owner = owner


class Uniform(Generic[T]):
    """A value that is the same for the whole draw or dispatch; read as a `T`."""

    if TYPE_CHECKING:

        def __get__(self, instance: object, owner: Any = None) -> T: ...
        def __set__(self, instance: object, value: UniformRange[T]) -> None: ...


class Storage(Generic[T]):
    """A buffer of elements that shaders read: `len(self.lights)`, `self.lights[i]`."""

    if TYPE_CHECKING:

        def __get__(self, instance: object, owner: Any = None) -> ReadOnlyArray[T]: ...
        def __set__(self, instance: object, value: StorageRange[T]) -> None: ...


class StorageRW(Generic[T]):
    """A buffer of elements that shaders read and write, atomically too."""

    if TYPE_CHECKING:

        def __get__(self, instance: object, owner: Any = None) -> Array[T]: ...
        def __set__(self, instance: object, value: StorageRange[T]) -> None: ...
