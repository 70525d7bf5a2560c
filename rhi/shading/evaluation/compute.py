"""Execution of shading functions and compute shaders on NumPy, for tests and as the reference of accuracy.

`evaluate` calls a `@function` on whole arrays, `run_compute` runs a compute shader over a grid of
work-groups. Floats are float32 or float64.
"""

from __future__ import annotations

import weakref
from types import FunctionType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from rhi.contract import layout
from rhi.contract.descriptors import Stage
from rhi.errors import refuse
from rhi.errors.arguments import to_little_endian
from rhi.errors.shared_caches import SHARED
from rhi.shading.compile import compile_shader
from rhi.shading.ir import tree
from rhi.shading.language import rules
from rhi.shading.language.function import ShadingFunction
from rhi.shading.language.shader import Shader, StorageClass, words_of_table
from rhi.shading.language.source import INVALIDATION_CALLBACKS
from rhi.shading.language.structs import Struct
from rhi.shading.language.types import ImageType, StorageType, TextureType, stored_kind
from rhi.shading.lowering.components import all_kinds, words_of
from rhi.shading.lowering.functions import lower_function
from rhi.shading.numpy.host_tables import HostTextureTable
from rhi.shading.numpy.host_textures import HostTexture
from rhi.shading.numpy.kernel import LaneFunction, NumpyKernel, load_module
from rhi.shading.numpy.numpy_writer import write_numpy_function
from rhi.shading.parser.stage import parse_function

Array = NDArray[Any]

_DTYPES: Final = {layout.INT: np.int32, layout.UINT: np.uint32, layout.BOOL: np.bool_}
_functions: weakref.WeakKeyDictionary[FunctionType, tuple[tree.Function, LaneFunction]] = (
    weakref.WeakKeyDictionary()
)
_shaders: weakref.WeakKeyDictionary[type[Shader], NumpyKernel] = weakref.WeakKeyDictionary()
INVALIDATION_CALLBACKS.extend((_functions.clear, _shaders.clear))


# -- functions ---------------------------------------------------------------------------------------------


def evaluate(
    function: ShadingFunction[..., Any],
    *arguments: Any,
    dtype: type[np.float32] | type[np.float64] = np.float32,
    **named: Any,
) -> Any:
    """Run a `@function` on whole arrays with NumPy.

    Args:
        *arguments: an array for each parameter: `(…)` for a number, `(…, 3)` for a `vec3`, `(…, 3, 3)`
            for a `mat3`, a structured array or `Struct` for a struct. The axes `…` broadcast.
        **named: arguments by the names of their parameters.
        dtype: the type of floats, and of the result.

    Returns:
        The results in the same form; a structured array for a struct.

    Raises:
        ValidationError `shading-arguments`: an argument is missing, unknown or has the wrong shape.
        ShaderError: the function breaks a rule of the language.

    Examples:
        >>> sl.evaluate(falloff, np.array([0.0, 1.0, 2.0]), 2.0).tolist()
        [1.0, 0.5, 0.0]
    """
    call = f"evaluate({getattr(function, '__name__', repr(function))}, …)"
    if not isinstance(function, ShadingFunction):
        refuse(rules.WRONG_ARGUMENTS, call, repr(function), "a function decorated with @function")
    tree_function, run = _compiled_function(function.python)
    values = _by_name(tree_function, arguments, named, call, dtype)
    scalars = []
    for parameter, value in zip(tree_function.parameters, values, strict=True):
        scalars.extend(scalars_of(parameter.type, value, dtype, f"{call}: {parameter.name}"))  # type: ignore[arg-type]
    shape = np.broadcast_shapes(*(np.shape(scalar) for scalar in scalars))
    with np.errstate(all="ignore"):
        results = run(dtype, {}, None, scalars)
    return assemble(tree_function.result, list(results), shape, dtype)  # type: ignore[arg-type]


def _compiled_function(function: FunctionType) -> tuple[tree.Function, LaneFunction]:
    compiled = _functions.get(function)
    if compiled is None:
        with SHARED:
            compiled = _functions.get(function)
            if compiled is None:
                parsed = parse_function(function)
                code = lower_function(parsed)
                run = load_module(write_numpy_function(code), code.name)["run"]
                compiled = _functions[function] = parsed, run
    return compiled


def _by_name(
    function: tree.Function, arguments: tuple[Any, ...], named: dict[str, Any], call: str, dtype: Any
) -> list[Any]:
    names = [parameter.name for parameter in function.parameters]
    values = dict(zip(names, arguments, strict=False)) | named
    if len(arguments) + len(named) != len(names) or set(values) != set(names):
        refuse(rules.WRONG_ARGUMENTS, call, ", ".join(values) or "nothing", ", ".join(names))
    if dtype not in (np.float32, np.float64):
        refuse(rules.WRONG_ARGUMENTS, call, f"dtype={dtype!r}", "np.float32, np.float64")
    return [values[name] for name in names]


def scalars_of(type: layout.HostType, value: Any, dtype: Any, call: str) -> list[Any]:
    """Split an argument into its components, each an array over all evaluations."""
    if isinstance(type, layout.StructType):
        if isinstance(value, Struct):
            value = {field.name: getattr(value, field.name) for field in type.fields}
        parts = []
        for field in type.fields:
            try:
                inner = value[field.name]
            except (KeyError, ValueError, TypeError, IndexError):
                refuse(
                    rules.WRONG_ARGUMENTS,
                    call,
                    f"no {field.name!r}",
                    f"a {type.name} or an array with its fields",
                )
            parts.extend(scalars_of(field.type, inner, dtype, f"{call}.{field.name}"))
        return parts
    kinds, shape = all_kinds(type), layout.shape_of(type)
    if isinstance(type, layout.ArrayType) and isinstance(type.element, layout.StructType):
        refuse(rules.WRONG_ARGUMENTS, call, str(type), "arrays of numbers and vectors")
    array = np.asarray(value, _DTYPES.get(kinds[0], dtype))
    if array.shape[array.ndim - len(shape) :] != shape or array.ndim < len(shape):
        refuse(
            rules.WRONG_ARGUMENTS,
            call,
            f"an array of shape {array.shape}",
            f"(…, {', '.join(map(str, shape))})",
        )
    if not shape:
        return [array[()]]
    flat = array.reshape(*array.shape[: array.ndim - len(shape)], len(kinds))
    return [flat[..., i] for i in range(len(kinds))]


def assemble(type: layout.HostType, scalars: list[Any], shape: tuple[int, ...], dtype: Any) -> Any:
    """Join the components of a result into one array, a structured one for a struct."""
    if isinstance(type, layout.StructType):
        formats = [(field.name, _field_dtype(field.type, dtype)) for field in type.fields]
        result = np.zeros(shape, np.dtype(formats))
        start = 0
        for field in type.fields:
            size = words_of(field.type)
            result[field.name] = assemble(field.type, scalars[start : start + size], shape, dtype)
            start += size
        return result
    arrays = [np.broadcast_to(scalar, shape) for scalar in scalars]
    if not layout.shape_of(type):
        return np.array(arrays[0], _DTYPES.get(all_kinds(type)[0], dtype))[()]
    whole = np.stack(arrays, axis=-1).astype(_DTYPES.get(all_kinds(type)[0], dtype))
    return whole.reshape(*shape, *layout.shape_of(type))


def _field_dtype(type: layout.HostType, dtype: Any) -> Any:
    if isinstance(type, layout.StructType):
        return np.dtype([(field.name, _field_dtype(field.type, dtype)) for field in type.fields])
    return np.dtype((_DTYPES.get(all_kinds(type)[0], dtype), layout.shape_of(type)))


# -- compute -----------------------------------------------------------------------------------------------


def run_compute(
    shader: type[Shader],
    groups: int | tuple[int, ...] = 1,
    *,
    dtype: type[np.float32] | type[np.float64] = np.float32,
    **bindings: Any,
) -> dict[str, Array]:
    """Run a compute shader on NumPy.

    Args:
        groups: numbers of work-groups in 1 to 3 dimensions.
        dtype: the type of floats in variables and shared memory; buffers hold float32.
        bindings: a `Struct`, number or array for each `Uniform`; for each `Storage` and `StorageRW` an array
            of the element's dtype (`Light.dtype`; a `vec3` is float32 (n, 4)), or a number of elements of
            zeros; a `HostTexture` for each texture and image, a `HostTextureTable` for each `TextureTable`.

    Returns:
        The contents of each `StorageRW` and image afterwards; the given arrays aren't modified.

    Raises:
        ValidationError `shading-arguments`: a binding is missing, unknown or has another layout.
        ShaderError: the shader breaks a rule.

    Examples:
        >>> sl.run_compute(Double, 1, numbers=np.ones(3, np.float32))["numbers"].tolist()
        [2.0, 2.0, 2.0]
    """
    call = f"run_compute({shader.__name__}, …)"
    kernel = _compiled_shader(shader)
    x, y, z = counts = (*((groups,) if isinstance(groups, int) else groups), 1, 1)[:3]
    if any(count < 0 for count in counts) or dtype not in (np.float32, np.float64):
        refuse(
            rules.WRONG_ARGUMENTS,
            call,
            f"groups={groups}, dtype={dtype!r}",
            "counts, np.float32 or np.float64",
        )
    memory, results = bound_words(shader, bindings, call)
    kernel.launch((x, y, z), memory, dtype)
    return results


def bound_words(
    shader: type[Shader], bindings: dict[str, Any], call: str
) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return the words of all bindings by name, and the arrays among them that the shader writes.

    Raises:
        ValidationError `shading-arguments`: a binding is missing, unknown or has another layout.
    """
    names = {binding.name for binding in compile_shader(shader).bindings if not binding.table}
    if set(bindings) != names:
        refuse(
            rules.WRONG_ARGUMENTS,
            call,
            ", ".join(bindings) or "nothing",
            ", ".join(sorted(names)) or "nothing",
        )
    bindings, names = _expand_tables(shader, bindings, names, call)
    memory: dict[str, Any] = {}
    results: dict[str, Array] = {}
    for declaration in shader._declared.values():
        name = declaration.name
        if name not in names:  # a lean shader's binding that no stage reads
            continue
        if declaration.storage_class is StorageClass.STORAGE:
            assert isinstance(declaration.type, StorageType)
            whole, words = storage_words(declaration.type.element, bindings[name], f"{call}: {name}")
            memory[name] = words
            if declaration.type.writable:
                results[name] = whole
        elif declaration.storage_class is StorageClass.UNIFORM:
            memory[name] = uniform_words(declaration.type, bindings[name], f"{call}: {name}")  # type: ignore[arg-type]
        elif declaration.storage_class in (StorageClass.TEXTURE, StorageClass.IMAGE):
            texture = memory[name] = host_texture(declaration.type, bindings[name], f"{call}: {name}")  # type: ignore[arg-type]
            if declaration.storage_class is StorageClass.IMAGE:
                results[name] = texture.levels[0]
    return memory, results


def _expand_tables(
    shader: type[Shader], bindings: dict[str, Any], names: set[str], call: str
) -> tuple[dict[str, Any], set[str]]:
    """Return bindings and their names with each texture table as its pages and words."""
    expanded = dict(bindings)
    for name in bindings:
        if shader._declared[name].is_table:
            table = bindings[name]
            if not isinstance(table, HostTextureTable):
                refuse(rules.WRONG_ARGUMENTS, f"{call}: {name}", repr(table), "a HostTextureTable")
            expanded[name], expanded[words_of_table(name)] = table.pages, table.words
    return expanded, names | expanded.keys()


def _compiled_shader(shader: type[Shader]) -> NumpyKernel:
    kernel = _shaders.get(shader)
    if kernel is None:
        with SHARED:
            kernel = _compile_kernel(shader)
    return kernel


def _compile_kernel(shader: type[Shader]) -> NumpyKernel:
    kernel = _shaders.get(shader)
    if kernel is None:
        descriptor = compile_shader(shader)
        if Stage.COMPUTE not in descriptor.stages:
            refuse(
                rules.STAGES,
                f"run_compute({shader.__name__}, …)",
                "no compute stage",
                "compute(self) -> None",
            )
        kernel = _shaders[shader] = NumpyKernel(descriptor.emit("numpy", Stage.COMPUTE).text, descriptor.name)
    return kernel


def storage_words(element: layout.HostType, value: Any, call: str) -> tuple[Array, Array]:
    """Return a copy of a storage buffer's contents, and a view of it as words.

    Raises:
        ValidationError `shading-arguments`: `value` is not an array of the element's std430 dtype.
    """
    dtype = layout.element_dtype(element, layout.Layout.STD430)
    base, shape = dtype.subdtype if dtype.subdtype is not None else (dtype, ())
    if isinstance(value, int):
        whole = np.zeros((value, *shape), base)
    else:
        whole = np.array(to_little_endian(np.asarray(value)), order="C")
        if whole.dtype != base and (repacked := layout.repack(base, whole)) is not None:
            whole = repacked
        if whole.dtype != base or whole.shape[1:] != shape or whole.ndim < 1:
            refuse(
                rules.WRONG_ARGUMENTS,
                call,
                f"{whole.dtype} {whole.shape}",
                f"{base} (n{', ' + str(shape) if shape else ''})",
            )
    return whole, whole.reshape(-1).view(np.uint32)


def host_texture(type: TextureType | ImageType, value: Any, call: str) -> HostTexture:
    """Return a texture, or a copy of an image, since shaders write into it.

    Raises:
        ValidationError `shading-arguments`: `value` is not a `HostTexture` of the binding's kind and format.
    """
    if not isinstance(value, HostTexture) or value.kind is not stored_kind(type):
        refuse(rules.WRONG_ARGUMENTS, call, repr(value), f"a HostTexture for a {type}")
    if isinstance(type, ImageType):
        if value.format is not type.format:
            refuse(rules.WRONG_ARGUMENTS, call, value.format.name, type.format.name)
        return HostTexture(value.levels[0], value.format, value.kind)
    return value


def uniform_words(type: layout.HostType, value: Any, call: str) -> Array:
    """Return the contents of a uniform block as words.

    Raises:
        ValidationError `shading-arguments`: the value doesn't fit.
    """
    if isinstance(value, Struct) and value.shading_type == type:
        return np.frombuffer(value.to_bytes(), np.uint32)
    dtype = layout.dtype_of(type, layout.Layout.STD140)
    base, shape = dtype.subdtype if dtype.subdtype is not None else (dtype, ())
    array = np.zeros(shape, base)
    try:
        natural = np.asarray(value, base)
        if natural.shape not in (layout.shape_of(type), array.shape) or isinstance(type, layout.StructType):
            raise ValueError
        array[tuple(slice(0, n) for n in natural.shape)] = natural
    except (ValueError, TypeError):
        refuse(rules.WRONG_ARGUMENTS, call, repr(value), f"a {type}")
    return array.reshape(-1).view(np.uint32)
