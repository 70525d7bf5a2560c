"""Writes the stubs from the tables: `python -m rhi.shading.tools.stubs`.

Type checkers need every overload and every swizzle spelled out; people don't, so `vectors.pyi`, `functions.pyi` and
`textures.pyi` are generated from `rhi.shading.language.types`, `builtins` and `textures`. A test keeps them current.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from rhi.contract.descriptors import TextureKind
from rhi.contract.formats import Format
from rhi.contract.layout import BOOL, FLOAT, INT, UINT, ScalarType
from rhi.shading.language import textures
from rhi.shading.language.builtins import BUILTINS, Builtin, Effect, Overload
from rhi.shading.language.types import VECTORS, ImageType
from rhi.shading.language.vectors import __all__ as vector_names

__rhi_internal__ = True

_HEADER: Final = '"""Written by `python -m rhi.shading.tools.stubs`; don\'t edit."""\n\n# ruff: noqa\n'
_TAKES: Final = {FLOAT: "float", INT: "int", UINT: "uint | int", BOOL: "bool"}


def stub_texts() -> dict[Path, str]:
    """Each stub's path and what it should contain."""
    folder = Path(__file__).parents[1] / "language"
    return {
        folder / "vectors.pyi": "\n".join(_vectors()) + "\n",
        folder / "functions.pyi": "\n".join(_functions()) + "\n",
        folder / "textures.pyi": "\n".join(_textures()) + "\n",
    }


# -- vectors -----------------------------------------------------------------------------------------------


def _vectors() -> Iterator[str]:
    yield _HEADER
    yield "from collections.abc import Iterator, Sequence"
    yield "from typing import Any, ClassVar, Generic, TypeVar, overload\n"
    yield "import numpy as np"
    yield "import numpy.typing as npt"
    yield "from rhi.contract.layout import HostType, MatrixType, ScalarType, VectorType\n"
    yield f"__all__ = {sorted(vector_names)!r}\n"
    yield _FIXED
    yield from _uint()
    yield from _swizzles()
    for (scalar, size), type in VECTORS.items():
        yield from _vector(str(type), scalar, size)
    for size in (2, 3, 4):
        yield from _matrix(size)


_FIXED: Final = """T = TypeVar("T")
S = TypeVar("S")
V2 = TypeVar("V2")
V3 = TypeVar("V3")
V4 = TypeVar("V4")

CLASSES: dict[Any, Any]

class Composite:
    components: tuple[Any, ...]
    shape: ClassVar[tuple[int, ...]]
    shading_type: ClassVar[Any]
    def __array__(self, dtype: Any = None, copy: Any = None) -> npt.NDArray[Any]: ...
    def __len__(self) -> int: ...
    def __hash__(self) -> int: ...

class ReadOnlyArray(Generic[T]):
    def __getitem__(self, index: int | uint) -> T: ...
    def __len__(self) -> int: ...

class Array(ReadOnlyArray[T]):
    def __get__(self, instance: object, owner: Any = None) -> Array[T]: ...
    def __set__(self, instance: object, value: Array[T] | Sequence[Any] | npt.NDArray[Any]) -> None: ...
    @overload
    def __setitem__(self: Array[uint], index: int | uint, value: uint | int) -> None: ...
    @overload
    def __setitem__(self, index: int | uint, value: T) -> None: ...

class ArrayLength:
    element: object
    length: int
    def __init__(self, element: object, length: int) -> None: ...

def array(element: type[T], length: int) -> Array[T]: ...
"""


def _uint() -> Iterator[str]:
    yield "class uint:"
    yield "    shading_type: ClassVar[ScalarType]"
    yield "    def __init__(self, value: float | uint | bool = ..., /) -> None: ..."
    yield "    def __get__(self, instance: object, owner: Any = None) -> uint: ..."
    yield "    def __set__(self, instance: object, value: uint | int) -> None: ..."
    for name in ("add", "sub", "mul", "floordiv", "mod", "and", "or", "xor"):
        yield f"    def __{name}__(self, other: uint | int) -> uint: ..."
        yield f"    def __r{name}__(self, other: int) -> uint: ..."
    for name in ("lshift", "rshift", "pow"):
        yield f"    def __{name}__(self, other: uint | int) -> uint: ..."
    yield "    def __truediv__(self, other: uint | int | float) -> float: ..."
    yield "    def __rtruediv__(self, other: int | float) -> float: ..."
    for name in ("lt", "le", "gt", "ge"):
        yield f"    def __{name}__(self, other: uint | int) -> bool: ..."
    for name, result in (
        ("invert", "uint"),
        ("int", "int"),
        ("index", "int"),
        ("float", "float"),
        ("hash", "int"),
    ):
        yield f"    def __{name}__(self) -> {result}: ..."
    yield ""


def _swizzles() -> Iterator[str]:
    """Yield one generic base per vector size. Each adds the swizzles of its last component to those of the smaller.

    The parameters are the types of a swizzle of 1, 2, 3 and 4 components. Swizzles are plain attributes: a type
    checker lets all of them be assigned to, and the parser refuses assignments to repeated components.
    """
    for size in (2, 3, 4):
        base = "Generic" if size == 2 else f"_Swizzles{size - 1}"
        yield f"class _Swizzles{size}({base}[S, V2, V3, V4]):"
        for axes in ("xyzw", "rgba"):
            for count in (1, 2, 3, 4):
                for letters in itertools.product(axes[:size], repeat=count):
                    if size == 2 or axes[size - 1] in letters:
                        yield f"    {''.join(letters)}: {'S' if count == 1 else f'V{count}'}"
        yield ""


def _vector(name: str, scalar: ScalarType, size: int) -> Iterator[str]:
    part, takes = scalar.name, _TAKES[scalar]
    results = ", ".join([part, *(str(VECTORS[scalar, count]) for count in (2, 3, 4))])
    yield f"class {name}(Composite, _Swizzles{size}[{results}]):"
    yield "    shading_type: ClassVar[VectorType]"
    yield from _vector_constructors(scalar, size)
    exact = f"tuple[{', '.join([takes] * size)}]"
    yield f"    def __get__(self, instance: object, owner: Any = None) -> {name}: ..."
    values = f"{name} | {exact} | list[{part}] | npt.NDArray[Any]"
    yield f"    def __set__(self, instance: object, value: {values}) -> None: ..."
    yield f"    def __getitem__(self, index: int | uint) -> {part}: ..."
    yield f"    def __setitem__(self, index: int | uint, value: {takes}) -> None: ..."
    yield f"    def __iter__(self) -> Iterator[{part}]: ..."
    if scalar is not BOOL:
        yield from _vector_operators(name, scalar, size)
    yield ""


def _vector_constructors(scalar: ScalarType, size: int) -> Iterator[str]:
    takes = "bool" if scalar is BOOL else _TAKES[scalar]
    same_size = " | ".join(str(VECTORS[other, size]) for other in (FLOAT, INT, UINT, BOOL))
    forms = [["float | uint | bool" if scalar is BOOL else takes], [same_size]]
    for split in _splits(size):
        if len(split) > 1:
            forms.append([takes if part == 1 else str(VECTORS[scalar, part]) for part in split])
    for form in forms:
        parameters = ", ".join(f"{letter}: {type}" for letter, type in zip("abcd", form, strict=False))
        yield "    @overload"
        yield f"    def __init__(self, {parameters}, /) -> None: ..."


def _splits(size: int) -> Iterator[list[int]]:
    """All ways of writing `size` as a sum of parts, in order."""
    if size == 0:
        yield []
    for first in range(1, size + 1):
        for rest in _splits(size - first):
            yield [first, *rest]


def _vector_operators(name: str, scalar: ScalarType, size: int) -> Iterator[str]:
    takes = _TAKES[scalar]
    reverse = "int" if scalar is UINT else scalar.name
    names = ["add", "sub", "mul", "floordiv", "mod"]
    if scalar is not FLOAT:
        names += ["and", "or", "xor"]
    for operator in names:
        yield f"    def __{operator}__(self, other: {name} | {takes}) -> {name}: ..."
        also = f"uint | {reverse}" if scalar is UINT else reverse
        yield f"    def __r{operator}__(self, other: {also}) -> {name}: ..."
    floats = str(VECTORS[FLOAT, size])
    divisor = f"{name} | {takes}" + ("" if scalar is FLOAT else " | float")
    yield f"    def __truediv__(self, other: {divisor}) -> {floats}: ..."
    yield f"    def __rtruediv__(self, other: {'float' if scalar is not UINT else 'uint | float'}) -> {floats}: ..."
    if scalar is FLOAT:
        yield f"    def __pow__(self, other: {name} | float) -> {name}: ..."
        yield f"    def __matmul__(self, other: mat{size}) -> {name}: ..."
    else:
        yield f"    def __pow__(self, other: int) -> {name}: ..."
        shifts = " | ".join((str(VECTORS[INT, size]), str(VECTORS[UINT, size]), "int", "uint"))
        for operator in ("lshift", "rshift"):
            yield f"    def __{operator}__(self, other: {shifts}) -> {name}: ..."
        yield f"    def __invert__(self) -> {name}: ..."
    yield f"    def __neg__(self) -> {name}: ..."
    yield f"    def __pos__(self) -> {name}: ..."


def _matrix(size: int) -> Iterator[str]:
    name, vector = f"mat{size}", f"vec{size}"
    yield f"class {name}(Composite):"
    yield "    shading_type: ClassVar[MatrixType]"
    for form in (["float"], ["mat2 | mat3 | mat4"], [vector] * size, ["float"] * size**2):
        parameters = ", ".join(f"a{index}: {type}" for index, type in enumerate(form))
        yield "    @overload"
        yield f"    def __init__(self, {parameters}, /) -> None: ..."
    yield f"    def __get__(self, instance: object, owner: Any = None) -> {name}: ..."
    values = f"{name} | npt.NDArray[Any] | Sequence[Sequence[float]]"
    yield f"    def __set__(self, instance: object, value: {values}) -> None: ..."
    yield f"    def __getitem__(self, index: int | uint) -> {vector}: ..."
    for operator in ("add", "sub"):
        yield f"    def __{operator}__(self, other: {name}) -> {name}: ..."
    yield f"    def __mul__(self, other: {name} | float) -> {name}: ..."
    yield f"    def __rmul__(self, other: float) -> {name}: ..."
    yield f"    def __truediv__(self, other: float) -> {name}: ..."
    yield f"    def __neg__(self) -> {name}: ..."
    for other, result in ((name, name), (vector, vector)):
        yield "    @overload"
        yield f"    def __matmul__(self, other: {other}) -> {result}: ..."
    yield ""


# -- functions ---------------------------------------------------------------------------------------------


def _functions() -> Iterator[str]:
    yield _HEADER
    yield "from typing import NoReturn, overload\n"
    yield f"from rhi.shading.language.vectors import {', '.join(_used_types())}\n"
    yield f"__all__ = {list(BUILTINS)!r}\n"
    for row in BUILTINS.values():
        for overload in row.overloads:
            if len(row.overloads) > 1:
                yield "@overload"
            result = "NoReturn" if row.effect is Effect.DISCARD else str(overload.result)
            yield f"def {row.name}({_parameters(overload, 0)}) -> {result}: ..."
        yield ""


def _used_types() -> list[str]:
    names = {
        str(type)
        for row in BUILTINS.values()
        for overload in row.overloads
        for type in (overload.result, *(parameter.type for parameter in overload.parameters))
    }
    return sorted(names - {"float", "int", "bool", "None"})


def _parameters(overload: Overload, skip: int) -> str:
    """Parameters; an int literal is taken for a uint wherever another uint has chosen the overload."""
    parameters, seen = [], False
    for index, parameter in enumerate(overload.parameters[skip:]):
        text = str(parameter.type)
        if parameter.type is UINT:
            text, seen = ("uint | int" if seen else "uint"), True
        parameters.append(f"{parameter.name or 'abcd'[index]}: {text}")
    named = any(parameter.name for parameter in overload.parameters[skip:])
    return ", ".join([*parameters, "/"] if parameters and not named else parameters)


# -- textures ----------------------------------------------------------------------------------------------


def _textures() -> Iterator[str]:
    yield _HEADER
    yield "from typing import Any, overload\n"
    yield "from rhi.contract.descriptors import TextureKind"
    yield "from rhi.contract.formats import Format"
    yield "from rhi.contract.layout import ScalarType"
    yield "from rhi.shading.language.bindings import ImageBinding, TextureBinding"
    yield "from rhi.shading.language.builtins import Builtin"
    yield "from rhi.shading.language.types import ImageType, TextureType"
    vectors = sorted(str(VECTORS[scalar, size]) for scalar in (FLOAT, INT, UINT) for size in (2, 3, 4))
    yield f"from rhi.shading.language.vectors import {', '.join(vectors)}\n"
    yield f"__all__ = {sorted(textures.__all__)!r}\n"
    yield "def methods_of(type: TextureType | ImageType) -> dict[str, Builtin]: ...\n"
    yield "class SampledTexture:\n    shading_type: TextureType\n"
    yield "class StorageImage:\n    kind: TextureKind\n    scalar: ScalarType\n"
    yield "class ImageFormat:\n    format: Format\n    def __init__(self, format: Format) -> None: ...\n"
    yield "def image(format: Format) -> Any: ...\n"
    for name in sorted(textures.__all__):
        cls = getattr(textures, name)
        if isinstance(cls, type) and issubclass(cls, textures.SampledTexture):
            yield from _texture(
                name, "SampledTexture", "TextureBinding", textures.methods_of(cls.shading_type)
            )
        elif isinstance(cls, type):
            yield from _texture(name, "StorageImage", "ImageBinding", textures.methods_of(_image_type(cls)))


def _image_type(cls: type[textures.StorageImage]) -> ImageType:
    formats: dict[ScalarType, Format] = {FLOAT: Format.RGBA8, INT: Format.R32I, UINT: Format.R32UI}
    kind: TextureKind = cls.kind
    return ImageType(kind, formats[cls.scalar])


def _texture(name: str, base: str, handle: str, methods: dict[str, Builtin]) -> Iterator[str]:
    yield f"class {name}({base}):"
    yield f"    def __get__(self, instance: object, owner: Any = None) -> {name}: ..."
    yield f"    def __set__(self, instance: object, value: {handle}) -> None: ..."
    for row in methods.values():
        for overload in row.overloads:
            if len(row.overloads) > 1:
                yield "    @overload"
            rest = _parameters(overload, 1)
            yield f"    def {row.name}(self{', ' if rest else ''}{rest}) -> {overload.result!s}: ..."
    yield ""


if __name__ == "__main__":
    for path, text in stub_texts().items():
        path.write_text(text)
