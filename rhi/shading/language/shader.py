"""Shaders as classes: fields are bindings, methods are stages and helpers.

- The class is never instantiated. Its constructor exists for type checkers only: `dataclass_transform` gives
  it one parameter for each binding's handle, and `Device.draw` takes over that signature.
- Bindings are collected when the class is created, those of its bases first, so that a derived shader keeps
  the slots of its base.
- Numbers on the class without annotation are constants. Shaders read them as `self.name`, and a subclass may
  override them: a variant of a shader is a subclass.
"""

from __future__ import annotations

import inspect
import math
import os
import sys
from collections.abc import Mapping
from types import FunctionType, MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, TypeVar, get_args, get_origin, overload

from typing_extensions import dataclass_transform

from rhi.contract.descriptors import TextureKind
from rhi.contract.formats import ChannelKind
from rhi.contract.layout import INT, ArrayType, HostType, is_host_shareable
from rhi.errors import ShaderError, ShaderErrors, refuse
from rhi.errors.call_sites import find_call_site
from rhi.errors.choices import Choice
from rhi.errors.data_classes import dataclass
from rhi.shading.language import rules
from rhi.shading.language.annotations import value_type
from rhi.shading.language.bindings import Storage, StorageRW, Uniform
from rhi.shading.language.builtins import Precision
from rhi.shading.language.source import globals_of, keep_sources, locals_of, resolve_annotations, suggest_name
from rhi.shading.language.textures import ImageFormat, SampledTexture, StorageImage, image
from rhi.shading.language.types import LANGUAGE_NAMES, ImageType, StorageType, TextureType, Type
from rhi.shading.language.vectors import Array

LANGUAGE_NAMES.update(("Shader", "shared"))

T = TypeVar("T")


class StorageClass(Choice):
    """The kind of resource or memory that a shader's field stands for."""

    UNIFORM = "uniform"
    STORAGE = "storage"
    TEXTURE = "texture"
    IMAGE = "image"
    SHARED = "shared"


@dataclass(frozen=True, slots=True)
class Declaration:
    """A binding or shared variable of a shader. `host` is its type on the CPU: a `Struct` class, `float`,
    `vec3`… `table` is the name of the texture table whose images a texture describes, "" for others."""

    name: str
    storage_class: StorageClass
    type: Type
    host: Any = None
    table: str = ""

    @property
    def is_table(self) -> bool:
        """True for the pages of a texture table."""
        return isinstance(self.type, TextureType) and self.type.table


class SharedMemory:
    """Marker that `shared(…)` returns: the element type and length of a shared variable."""

    __slots__ = ("element", "length")

    def __init__(self, element: Any, length: int | None) -> None:
        self.element = element
        self.length = length


@overload
def shared(element: type[T]) -> T: ...
@overload
def shared(element: type[T], length: int) -> Array[T]: ...
def shared(element: Any, length: int | None = None) -> Any:
    """Declare memory that a work-group shares: `partial = shared(float, 256)`; without a length, a single
    value.

    The result is assigned to a field of a shader with a `compute` stage. The memory's initial contents are
    undefined.
    """
    return SharedMemory(element, length)


@dataclass_transform(kw_only_default=True, field_specifiers=(image,))
class Shader:
    """Base class of shaders.

    Attributes:
        work_group: size of a work-group in 1 to 3 dimensions, for a `compute` stage.
        precision: accuracy of some functions on OpenCL, and of sums of several operations in GLSL.
        checked: test every index and every `uniform(x)` on the device where it is used, and raise an error
            with the Python line for a fault. Works on NumPy and on OpenCL, where it waits for each dispatch
            and each batch of draws. Costs nothing when off. `RHI_SHADING_CHECKED=1` in the environment turns
            it on for all shaders that don't set it.
        early_depth: test depth and stencil before the fragment stage, which then can't change them.
        lean: leave out bindings and vertex attributes that no stage reads once constant conditions are
            decided, so that a variant binds only what it reads. Branches that aren't taken, and what follows
            a return, aren't checked either.
    """

    work_group: ClassVar[tuple[int, ...]] = (1,)
    early_depth: ClassVar[bool] = False
    precision: ClassVar[Precision] = Precision.EXACT
    lean: ClassVar[bool] = False
    checked: ClassVar[bool] = os.environ.get("RHI_SHADING_CHECKED") == "1"
    _declared: ClassVar[Mapping[str, Declaration]] = {}

    def __init_subclass__(cls) -> None:
        names = {**locals_of(sys._getframe(1)), cls.__name__: cls}
        collect_bindings(cls, globals_of(cls, sys._getframe(1)), names)
        for base in cls.__mro__[:-1]:
            if base is cls or not issubclass(base, Shader):  # a shader kept those of its own methods before
                keep_sources(base.__dict__)

    if not TYPE_CHECKING:  # type checkers see the constructor that dataclass_transform synthesises

        def __new__(cls, *arguments: Any, **bindings: Any) -> Any:
            refuse(
                rules.DEVICE_ONLY,
                f"{cls.__name__}(…)",
                tip="pass the class itself: device.program(TheShader)",
            )


def work_group_size(shader: type[Shader]) -> tuple[int, int, int]:
    """Return the size of a shader's work-groups; `shading-out-of-range` if it isn't 1 to 3 numbers of at most
    1024 together."""
    size: Any = shader.work_group
    valid = isinstance(size, tuple) and 1 <= len(size) <= 3 and all(type(n) is int and n > 0 for n in size)
    if not valid or math.prod(size) > 1024:
        call, allowed = (
            f"class {shader.__name__}: work_group",
            "1 to 3 positive numbers whose product is at most 1024",
        )
        raise ShaderError(rules.OUT_OF_RANGE, call, repr(size), allowed, site=find_call_site())
    x, y, z = (*size, 1, 1)[:3]
    return x, y, z


def list_bindings(shader: type[Shader]) -> list[str]:
    """Return the names of all bindings that a shader and its bases declare."""
    return [
        name
        for name, declared in shader._declared.items()
        if declared.storage_class is not StorageClass.SHARED and not declared.table
    ]


def find_element(shader: type[Shader], name: str) -> Any:
    """Return the type of the elements of a shader's buffer, such as a `Struct` class; None if it has no such
    buffer."""
    declared = shader._declared.get(name)
    return None if declared is None else declared.host


def collect_bindings(
    cls: type[Shader], module: dict[str, Any], names: Mapping[str, Any] = MappingProxyType({})
) -> None:
    """Collect the bindings of a class from its annotations and those of its bases, and evaluate its methods'
    ones.

    Args:
        module: the globals of the class's module.
        names: the local variables where the class is defined.
    """
    declared: dict[str, Declaration] = {}
    for base in reversed(cls.__mro__[1:]):
        declared.update(base.__dict__.get("_declared", {}))
    inherited, errors = dict(declared), ShaderErrors()
    for name, annotation in inspect.get_annotations(cls).items():
        with errors.collect():
            if isinstance(annotation, str):
                if annotation.startswith(("ClassVar", "typing.ClassVar")):
                    continue
                try:
                    annotation = eval(annotation, module, dict(names))
                except NameError as error:
                    _refuse(cls, name, annotation, suggest_name(error.name or "", [*names, *module]))
            origin: Any = get_origin(annotation)
            if origin is ClassVar:
                continue
            if hasattr(Shader, name):
                _refuse(cls, name, "a name that Shader itself uses", "choose another name")
            declared[name] = _declare(cls, name, annotation, cls.__dict__.get(name))
            if declared[name].is_table:
                words = words_of_table(name)
                if words in inspect.get_annotations(cls) or (words in inherited and name not in inherited):
                    _refuse(cls, words, f"the name of the words of {name}", "choose another name")
                type = TextureType(TextureKind.D2, INT)
                declared[words] = Declaration(words, StorageClass.TEXTURE, type, table=name)
    errors.check()
    for name, value in cls.__dict__.items():
        if isinstance(value, FunctionType):
            resolve_annotations(value, names)
        elif isinstance(value, SharedMemory):
            declared[name] = Declaration(name, StorageClass.SHARED, _shared_type(cls, name, value))
    for name, before in inherited.items():
        after = declared[name]
        if (before.storage_class, before.type) != (after.storage_class, after.type):
            _refuse_shadow(cls, before, str(after.type))
        if name in cls.__dict__ and name not in inspect.get_annotations(cls) and before is after:
            _refuse_shadow(cls, before, f"{name} = {cls.__dict__[name]!r}")
    cls._declared = declared


def words_of_table(name: str) -> str:
    """Return the name of the texture that describes the images of a texture table."""
    return f"{name}_words"


def _declare(cls: type[Shader], name: str, annotation: Any, default: object) -> Declaration:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin in (Uniform, Storage, StorageRW):
        host = arguments[0]
        value = value_type(host, default)
        if value is None or not is_host_shareable(value):
            tip = "bools have no layout in memory; use a uint" if value is not None else ""
            _refuse(cls, name, repr(annotation), tip)
        if origin is Uniform:
            return Declaration(name, StorageClass.UNIFORM, value, host)
        return Declaration(name, StorageClass.STORAGE, StorageType(value, origin is StorageRW), host)
    if isinstance(annotation, type) and issubclass(annotation, SampledTexture):
        return Declaration(name, StorageClass.TEXTURE, annotation.shading_type)
    if isinstance(annotation, type) and issubclass(annotation, StorageImage):
        if not isinstance(default, ImageFormat):
            tip = f"`{name}: {annotation.__name__} = image(Format.RGBA8)`"
            _refuse(cls, name, "an image without a format", tip)
        image_type = ImageType(annotation.kind, default.format)
        wrong = default.format.kind in (ChannelKind.SRGB, ChannelKind.DEPTH, ChannelKind.DEPTH_STENCIL)
        if wrong or image_type.scalar is not annotation.scalar:
            _refuse(cls, name, f"{annotation.__name__} of {default.format}", "")
        return Declaration(name, StorageClass.IMAGE, image_type)
    if value_type(annotation) is not None:
        type_name = annotation.__name__
        _refuse(cls, name, type_name, f"`{name}: Uniform[{type_name}]`, or a constant: `{name} = …`")
    _refuse(cls, name, repr(annotation), "")


def _shared_type(cls: type[Shader], name: str, value: SharedMemory) -> HostType:
    element = value_type(value.element)
    if element is None:
        _refuse(cls, name, f"shared({value.element!r})", "")
    if value.length is None:
        return element
    if not isinstance(value.length, int) or value.length < 1:
        _refuse(cls, name, f"a length of {value.length!r}", "")
    return ArrayType(element, value.length)


def _refuse_shadow(cls: type, before: Declaration, actual: str) -> NoReturn:
    call, allowed = f"class {cls.__name__}: {before.name}", f"{before.type}, as in the base class"
    raise ShaderError(rules.SHADOWED_BINDING, call, actual, allowed, site=find_call_site())


def _refuse(cls: type, name: str, actual: str, tip: str) -> NoReturn:
    allowed = "Uniform[T], Storage[T], StorageRW[T], textures, images; numbers without annotation; shared(…)"
    raise ShaderError(rules.BINDING, f"class {cls.__name__}: {name}", actual, allowed, tip, find_call_site())
