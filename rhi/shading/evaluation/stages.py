"""Execution of vertex and fragment stages on NumPy, for tests and as the reference of a rasteriser.

Stages run from the same lane code as on OpenCL, in float32 or float64, on arrays of any size: vertices of any
shape, fragments in rows and columns. The quads for `ddx` and `ddy` are 2 by 2 fragments, from the first row
and column on.
"""

from __future__ import annotations

import weakref
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rhi.contract.descriptors import Stage
from rhi.contract.layout import FLOAT, HostType, StructType
from rhi.errors import refuse
from rhi.errors.data_classes import dataclass
from rhi.errors.shared_caches import SHARED
from rhi.shading.compile import compiled_code
from rhi.shading.evaluation.compute import assemble, bound_words, scalars_of
from rhi.shading.ir import tree
from rhi.shading.ir.interface import Interface
from rhi.shading.ir.lanes import StageCode
from rhi.shading.language import rules
from rhi.shading.language.shader import Shader
from rhi.shading.language.source import INVALIDATION_CALLBACKS
from rhi.shading.language.types import VEC4, VECTORS
from rhi.shading.lowering.components import words_of
from rhi.shading.lowering.stages import lower_stage, takes_differences
from rhi.shading.numpy.kernel import LaneFunction, load_module
from rhi.shading.numpy.numpy_writer import write_numpy_function
from rhi.shading.numpy.runtime import Invocations
from rhi.shading.parser.interface import varyings_read, words_of_varyings

Array = NDArray[Any]
Dtype = type[np.float32] | type[np.float64]


@dataclass(frozen=True, slots=True)
class VertexRun:
    """The results of a vertex stage.

    Attributes:
        position: clip positions (…, 4).
        varyings: the varyings by name.
        memory: the contents of each `StorageRW` by name.
    """

    position: Array
    varyings: dict[str, Array]
    memory: dict[str, Array]


@dataclass(frozen=True, slots=True)
class FragmentRun:
    """The results of a fragment stage.

    Attributes:
        outputs: the outputs by name, (…, rows, columns, components); undefined outside `coverage`.
        depth: the depth, if the stage writes it; undefined outside `coverage`.
        coverage: whether each fragment is covered and not discarded.
        memory: the contents of each `StorageRW` by name.
    """

    outputs: dict[str, Array]
    depth: Array | None
    coverage: Array
    memory: dict[str, Array]


@dataclass(frozen=True, slots=True)
class _CompiledStage:
    stage: tree.StageTree
    interface: Interface
    code: StageCode
    run: LaneFunction


_stages: weakref.WeakKeyDictionary[type[Shader], dict[Stage, _CompiledStage]] = weakref.WeakKeyDictionary()
INVALIDATION_CALLBACKS.append(_stages.clear)


def run_vertex(
    shader: type[Shader],
    attributes: Mapping[str, Any] | Array | None = None,
    /,
    *,
    vertex_index: Any = None,
    instance_index: Any = 0,
    draw_index: Any = 0,
    dtype: Dtype = np.float32,
    **bindings: Any,
) -> VertexRun:
    """Run a shader's vertex stage on NumPy.

    Args:
        attributes: an array for each attribute, or a structured one: `(…)` for a number, `(…, 3)` for a
            `vec3`. All broadcast. Those that a lean shader doesn't read may be left out.
        vertex_index: the index of each vertex; counts from 0 by default.
        instance_index: a number, or one for each vertex.
        draw_index: a number, or one for each vertex.
        dtype: the type of floats in variables; buffers hold float32.
        bindings: as for `run_compute`.

    Raises:
        ValidationError `shading-arguments`: an attribute or binding is missing, unknown or has another shape.
        ShaderError: the shader has no vertex stage, or breaks a rule.

    Examples:
        >>> sl.run_vertex(Flat, {"position": np.array([(1, 2)])}, tint=(1, 0, 0, 1)).position.tolist()
        [[1.0, 2.0, 0.5, 1.0]]
    """
    call = f"run_vertex({shader.__name__}, …)"
    compiled = _compiled_stage(shader, Stage.VERTEX, call)
    read = {attribute.name for attribute in compiled.interface.attributes}
    values = _inputs(compiled.stage, attributes, read, dtype, call)
    indices = [np.asarray(index, np.int32) for index in (instance_index, draw_index)]
    shapes = [np.shape(value) for value in (*values, *indices, 0 if vertex_index is None else vertex_index)]
    shape = _broadcast(shapes, call)
    if vertex_index is None:
        vertex_index = np.arange(np.prod(shape, dtype=int)).reshape(shape)
    values += [np.asarray(vertex_index, np.int32), *indices, np.ones(shape, np.bool_)]
    memory, written = bound_words(shader, bindings, call)
    with np.errstate(all="ignore"):
        results = list(compiled.run(dtype, memory, Invocations(shape), values))
    outputs = _fields(compiled.stage.entry.result, compiled.interface.position, results, shape, dtype)
    return VertexRun(outputs[compiled.interface.position], outputs, written)


def run_fragment(
    shader: type[Shader],
    varyings: Mapping[str, Any] | Array | None = None,
    /,
    *,
    covered: Any = True,
    fragment_coordinate: Any = None,
    front_facing: Any = True,
    primitive_index: Any = 0,
    point_coordinate: Any = (0.5, 0.5),
    dtype: Dtype = np.float32,
    **bindings: Any,
) -> FragmentRun:
    """Run a shader's fragment stage on NumPy.

    Args:
        varyings: an array for each varying that the stage reads, or a structured one: `(…, rows, columns)`
            for a number, `(…, rows, columns, 3)` for a `vec3`. All broadcast with `covered`.
        covered: which fragments are covered, (…, rows, columns). The others in their quads are helpers.
        fragment_coordinate: (…, rows, columns, 4); by default pixel centres counted from 0, depth 0 and 1 / w
            = 1.
        front_facing: one for the primitive, or one for each fragment.
        primitive_index: one for the primitive, or one for each fragment.
        point_coordinate: (…, rows, columns, 2), or one for all fragments.
        dtype: the type of floats in variables; buffers hold float32.
        bindings: as for `run_compute`.

    Raises:
        ValidationError `shading-arguments`: a varying or binding is missing, unknown or has another shape; or
            the stage uses `ddx` or `ddy` and the number of rows or columns is odd.
        ShaderError: the shader has no fragment stage, or breaks a rule.

    Examples:
        >>> result = sl.run_fragment(Flat, {}, covered=np.ones((2, 2), bool), tint=(1, 0, 0, 1))
        >>> result.outputs["color"][0, 0].tolist()
        [1.0, 0.0, 0.0, 1.0]
    """
    call = f"run_fragment({shader.__name__}, …)"
    compiled = _compiled_stage(shader, Stage.FRAGMENT, call)
    read = {varying.name for varying in varyings_read(compiled.stage, compiled.interface.varyings)}
    values = _inputs(compiled.stage, varyings, read, dtype, call)
    front, primitive = np.asarray(front_facing, np.bool_), np.asarray(primitive_index, np.int32)
    shapes = [np.shape(value) for value in (*values, front, primitive, covered)]
    at = (
        []
        if fragment_coordinate is None
        else scalars_of(VEC4, fragment_coordinate, dtype, f"{call}: coordinate")
    )
    inside = scalars_of(VECTORS[FLOAT, 2], point_coordinate, dtype, f"{call}: point coordinate")
    shape = _broadcast([*shapes, *map(np.shape, at), *map(np.shape, inside), (1, 1)], call)
    if takes_differences(compiled.stage) and (shape[-2] % 2 or shape[-1] % 2):
        refuse(
            rules.WRONG_ARGUMENTS,
            call,
            f"{shape[-2]} by {shape[-1]} fragments",
            "even numbers, for ddx and ddy",
        )
    if not at:
        rows, columns = np.ogrid[: shape[-2], : shape[-1]]
        at = [(columns + 0.5).astype(dtype), (rows + 0.5).astype(dtype), dtype(0), dtype(1)]
    mask = np.array(np.broadcast_to(covered, shape), np.bool_)
    memory, written = bound_words(shader, bindings, call)
    with np.errstate(all="ignore"):
        results = list(
            compiled.run(dtype, memory, Invocations(shape), [*values, *at, front, primitive, *inside, mask])
        )
    coverage = np.array(np.broadcast_to(results.pop(), shape), np.bool_)
    depth = results.pop() if compiled.code.has_depth else None
    outputs = {}
    for output in compiled.interface.outputs:
        words = range(4 * output.location, 4 * output.location + output.components)
        parts = [results[compiled.code.words.index(word)] for word in words]
        outputs[output.name] = assemble(_output_type(compiled.stage, output.name), parts, shape, dtype)
    return FragmentRun(
        outputs, None if depth is None else assemble(FLOAT, [depth], shape, dtype), coverage, written
    )


def _output_type(stage: tree.StageTree, name: str) -> HostType:
    result = stage.entry.result
    if isinstance(result, StructType):
        result = next(field.type for field in result.fields if field.name == name)
    return result  # type: ignore[return-value]


def _fields(
    type: Any, position: str, results: list[Any], shape: tuple[int, ...], dtype: Any
) -> dict[str, Array]:
    """Return the fields of a vertex stage's result by name; a plain position has the name ""."""
    fields = [(field.name, field.type) for field in type.fields] if position else [("", type)]
    outputs, start = {}, 0
    for name, part in fields:
        size = words_of(part)
        outputs[name] = assemble(part, results[start : start + size], shape, dtype)
        start += size
    return outputs


def _inputs(
    stage: tree.StageTree,
    inputs: Mapping[str, Any] | Array | None,
    read: set[str],
    dtype: Any,
    call: str,
) -> list[Any]:
    """Return the components of the fields in `read` of a stage's parameters.

    Unknown varyings are ignored, unknown attributes are refused."""
    if dtype not in (np.float32, np.float64):
        refuse(rules.WRONG_ARGUMENTS, call, f"dtype={dtype!r}", "np.float32, np.float64")
    types = [parameter.type for parameter in stage.entry.parameters]
    fields = [field for type in types if isinstance(type, StructType) for field in type.fields]
    if isinstance(inputs, np.ndarray):
        inputs = {name: inputs[name] for name in inputs.dtype.names or ()}
    inputs, names = inputs or {}, {field.name for field in fields}
    is_unknown = stage.stage is Stage.VERTEX and set(inputs) - names
    if names & read - set(inputs) or is_unknown:
        refuse(
            rules.WRONG_ARGUMENTS, call, ", ".join(inputs) or "nothing", ", ".join(sorted(names)) or "nothing"
        )
    values: list[Any] = []
    for field in fields:
        if field.name in read:
            values += scalars_of(field.type, inputs[field.name], dtype, f"{call}: {field.name}")
    return values


def _broadcast(shapes: list[tuple[int, ...]], call: str) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        refuse(
            rules.WRONG_ARGUMENTS, call, ", ".join(map(str, dict.fromkeys(shapes))), "shapes that broadcast"
        )


def _compiled_stage(shader: type[Shader], stage: Stage, call: str) -> _CompiledStage:
    compiled = _stages.get(shader, {}).get(stage)
    if compiled is None:
        with SHARED:
            compiled = _compile_stage(shader, stage, call)
    return compiled


def _compile_stage(shader: type[Shader], stage: Stage, call: str) -> _CompiledStage:
    stages = _stages.setdefault(shader, {})
    if stage not in stages:
        compiled = compiled_code(shader)
        if stage not in compiled.stages:
            refuse(rules.STAGES, call, f"no {stage.value} stage", f"{stage.value}(self, …)")
        stage_tree, interface = compiled.stages[stage], compiled.interface
        if stage is Stage.VERTEX:
            varyings = words_of_varyings(interface.varyings, {varying.name for varying in interface.varyings})
        else:
            varyings = varyings_read(stage_tree, interface.varyings)
        code = lower_stage(stage_tree, interface, varyings, 0, shader.checked)
        run = load_module(write_numpy_function(code.code), shader.__name__)["run"]
        stages[stage] = _CompiledStage(stage_tree, interface, code, run)
    return stages[stage]
