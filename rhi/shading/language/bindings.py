"""Annotations for a shader's buffer bindings, and the handles that draws and dispatches bind to a shader's
fields.

- For type checkers an annotation is a descriptor. Reading the field inside a stage gives the shader's view of
  it: `Uniform[T]` reads as a `T`. Assigning to it takes a handle, here a `UniformRange[T]` or a value; the
  constructor that `dataclass_transform` synthesises assigns, and `device.draw` has that constructor's
  parameters. At run time these classes are only annotations.
- A handle has slots for what a draw needs and nothing else. Resources create handles or derive from them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Generic, TypeVar

from rhi.errors.device_objects import DeviceObject
from rhi.shading.language.types import LANGUAGE_NAMES
from rhi.shading.language.vectors import Array, ReadOnlyArray

LANGUAGE_NAMES.update(("Storage", "StorageRW", "Uniform"))

T = TypeVar("T")


class UniformRange(DeviceObject, Generic[T]):
    """A range of a buffer that holds one `T` in std140 layout.

    Attributes:
        buffer: the buffer's id.
        offset, size: the range, in bytes.
        type: the `Struct` class or value type.
        owner: an object that keeps the buffer alive.
    """

    __slots__ = ("buffer", "offset", "owner", "size", "type")

    def __init__(self, buffer: int, offset: int, size: int, type: object, owner: object = None) -> None:
        self.buffer = buffer
        self.offset = offset
        self.size = size
        self.type = type
        self.owner = owner

    def __repr__(self) -> str:
        text = f"bytes {self.offset} to {self.offset + self.size} of buffer {self.buffer}"
        return f"UniformRange({getattr(self.type, '__name__', self.type)}, {text})"


class StorageRange(DeviceObject, Generic[T]):
    """A range of a buffer that holds `count` elements of type `T` in std430 layout; otherwise like
    `UniformRange`."""

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

    def __repr__(self) -> str:
        text = f"bytes {self.offset} to {self.offset + self.size} of buffer {self.buffer}"
        return f"StorageRange({self.count} × {getattr(self.type, '__name__', self.type)}, {text})"


class TextureBinding(DeviceObject):
    """The ids of a texture and of the sampler that reads it."""

    __slots__ = ("__weakref__", "_owner", "sampler", "texture")

    def __init__(self, texture: int, sampler: int, owner: object = None) -> None:
        self.texture = texture
        self.sampler = sampler
        self._owner = owner

    @property
    def owner(self) -> object:
        """An object that keeps the texture alive.

        A texture is a binding, too, and returns itself here without storing a reference, so that it can be
        freed."""
        return self if self._owner is None else self._owner

    def __repr__(self) -> str:
        return f"TextureBinding({self._owner!r}, sampler {self.sampler})"


class TableBinding(TextureBinding):
    """A texture table as a binding: its pages with their sampler, and the texture that describes its images.

    Attributes:
        words: a texture of `RGBA32I` (see `rhi.shading.ir.texture_pages`).
    """

    __slots__ = ("words",)

    def __init__(self, texture: int, sampler: int, owner: object, words: TextureBinding) -> None:
        super().__init__(texture, sampler, owner)
        self.words = words


class ImageBinding(DeviceObject):
    """A mip level of a texture, bound as an image: one layer of it, or all layers if `layer` is None."""

    __slots__ = ("__weakref__", "layer", "level", "owner", "texture")

    def __init__(self, texture: int, level: int = 0, layer: int | None = None, owner: object = None) -> None:
        self.texture = texture
        self.level = level
        self.layer = layer
        self.owner = owner

    def __repr__(self) -> str:
        return f"ImageBinding({self.owner!r}, level={self.level}, layer={self.layer})"


class Uniform(Generic[T]):
    """Annotation of a value in a uniform buffer, the same for the whole draw or dispatch; shaders read it as
    a `T`."""

    if TYPE_CHECKING:

        def __get__(self, instance: object, owner: Any = None) -> T: ...
        def __set__(self, instance: object, value: UniformRange[T] | T | dict[str, Any]) -> None: ...


class Storage(Generic[T]):
    """Annotation of a storage buffer that shaders read: `len(self.lights)`, `self.lights[i]`."""

    if TYPE_CHECKING:

        def __get__(self, instance: object, owner: Any = None) -> ReadOnlyArray[T]: ...
        def __set__(self, instance: object, value: StorageRange[T]) -> None: ...


class StorageRW(Generic[T]):
    """Annotation of a storage buffer that shaders read and write, also with atomics."""

    if TYPE_CHECKING:

        def __get__(self, instance: object, owner: Any = None) -> Array[T]: ...
        def __set__(self, instance: object, value: StorageRange[T]) -> None: ...
