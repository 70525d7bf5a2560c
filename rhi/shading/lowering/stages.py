"""The lowering of vertex and fragment stages: inputs and outputs, helper lanes, discard, differences between
pixels.

- A stage's inputs are arguments. Inputs that 16 vertices or a block of 4 by 4 pixels share have the
  uniformity LANES: flat varyings, the instance, the draw, the facing. A material index, for example, gives
  scalar loads.
- Only covered lanes have side effects. If a stage takes differences between pixels, the other pixels of the
  quads run as helpers: they compute and read (within bounds, whatever their extrapolated inputs are) but
  never write.
- `discard()` removes lanes from all masks, as if they returned from the whole stage, and from the stage's
  result.
- A difference is undefined where a part of the quad is inactive or was discarded before, as in GLSL.
"""

from __future__ import annotations

from typing import Final

from rhi.contract.descriptors import Interpolation, Stage, StageVarying
from rhi.contract.layout import BOOL, INT, HostType, StructType
from rhi.shading.ir import lanes, tree
from rhi.shading.ir.interface import Interface
from rhi.shading.lowering.components import all_kinds
from rhi.shading.lowering.context import InlinedFrame, Lowering
from rhi.shading.lowering.functions import EXPRESSIONS, inline
from rhi.shading.lowering.stage_inputs import STAGE_INPUTS, stage_argument

_DIFFERENCES: Final = frozenset({"ddx", "ddy", "fwidth", "sample", "sample_bias", "sample_compare"})
"""The built-ins that compare pixels of a quad, including the texture methods that compute the mip level
implicitly."""

_DEPTH: Final = -1
_MASK: Final = stage_argument("mask", BOOL, lanes.Uniformity.VARYING)


def lower_stage(
    stage: tree.StageTree,
    interface: Interface,
    varyings: tuple[StageVarying, ...],
    width: int = lanes.WIDTH,
    checked: bool = False,
) -> lanes.StageCode:
    """Lower a vertex or fragment stage for `width` lanes, or for whole arrays with 0.

    Args:
        checked: whether to test every index.

    Raises:
        ShaderError: the stage uses a feature that lane code doesn't support.
    """
    if f"opencl{width}" in stage.entry.native:
        return lanes.StageCode(lanes.Code(interface.name, width, [], ()), (), False)
    inputs = STAGE_INPUTS[stage.stage]
    built_in = [value for values in inputs.values() for value in values]
    if stage.stage is Stage.VERTEX and width:
        inputs = inputs | {
            "vertex_index": (
                lanes.Affine(INT, lanes.Uniformity.VARYING, stage_argument(lanes.FIRST_VERTEX), 1),
            )
        }
    has_helpers = stage.stage is Stage.FRAGMENT and takes_differences(stage)
    lowering = Lowering(
        EXPRESSIONS,
        width,
        checked=checked,
        inputs=inputs,
        has_helpers=has_helpers,
        may_discard=stage.discards,
    )
    if stage.stage is Stage.VERTEX:
        arguments, words = _vertex_arguments(stage, interface), _vertex_words(stage, interface, varyings)
    else:
        arguments, words = _fragment_arguments(stage, varyings), _fragment_words(stage, interface)
    if not width:  # in OpenCL C they are elements of arrays
        lowering.reserved |= {value.name for value in arguments if isinstance(value, lanes.Argument)}
    results = lowering.run_to_fixpoint(lambda: _lower(lowering, stage.entry, arguments))
    outputs = [(word, value) for word, value in zip(words, results, strict=True) if word is not None]
    depth = [value for word, value in outputs if word == _DEPTH]
    outputs = [(word, value) for word, value in outputs if word != _DEPTH]
    values = [value for _, value in outputs] + depth
    if stage.stage is Stage.FRAGMENT:
        values.append(lowering.result_mask)
    stage_arguments = tuple(
        value for value in (*arguments, *built_in, _MASK) if isinstance(value, lanes.Argument)
    )
    return lanes.StageCode(
        lowering.code(interface.name, stage_arguments, values),
        tuple(word for word, _ in outputs),
        bool(depth),
    )


# -- inputs and outputs ------------------------------------------------------------------------------------


def _parameter_fields(stage: tree.StageTree) -> list[tuple[str, HostType]]:
    types = [parameter.type for parameter in stage.entry.parameters]
    return [
        (field.name, field.type) for type in types if isinstance(type, StructType) for field in type.fields
    ]


def _vertex_arguments(stage: tree.StageTree, interface: Interface) -> list[lanes.Value]:
    """Return the components of the parameters: the words of the attributes in order, and zeros for unread
    attributes."""
    attributes = {attribute.name for attribute in interface.attributes}
    values: list[lanes.Value] = []
    word = 0
    for name, type in _parameter_fields(stage):
        for kind in all_kinds(type):
            if name in attributes:
                values.append(stage_argument(f"inputs_{word}", kind, lanes.Uniformity.VARYING))
                word += 1
            else:
                values.append(lanes.literal(0, kind))
    return values


def _fragment_arguments(stage: tree.StageTree, varyings: tuple[StageVarying, ...]) -> list[lanes.Value]:
    """Return the components of the parameter, with zeros for varyings that are never read."""
    varyings_by_name = {varying.name: varying for varying in varyings}
    values: list[lanes.Value] = []
    for name, type in _parameter_fields(stage):
        varying = varyings_by_name.get(name)
        for i, kind in enumerate(all_kinds(type)):
            if varying is None:
                values.append(lanes.literal(0, kind))
            elif varying.interpolation is Interpolation.FLAT:
                values.append(stage_argument(f"flat_{varying.word + i}", kind))
            else:
                values.append(stage_argument(f"inputs_{varying.word + i}", kind, lanes.Uniformity.VARYING))
    return values


def _vertex_words(
    stage: tree.StageTree, interface: Interface, varyings: tuple[StageVarying, ...]
) -> list[int | None]:
    """Return the word of each result component: position from 0, varyings from 4 on, None for those never
    read."""
    if not isinstance(stage.entry.result, StructType):
        return [0, 1, 2, 3]
    starts = {varying.name: 4 + varying.word for varying in varyings}
    words: list[int | None] = []
    for field in stage.entry.result.fields:
        start = 0 if field.name == interface.position else starts.get(field.name)
        size = len(all_kinds(field.type))
        words += [None] * size if start is None else range(start, start + size)
    return words


def _fragment_words(stage: tree.StageTree, interface: Interface) -> list[int | None]:
    """Return the word of each component of the result: four for each location."""
    words: list[int | None] = []
    locations = {output.name: output.location for output in interface.outputs}
    if not isinstance(stage.entry.result, StructType):
        return [component for output in interface.outputs for component in range(output.components)]
    for field in stage.entry.result.fields:
        if field.name == interface.depth:
            words.append(_DEPTH)
        else:
            start = 4 * locations[field.name]
            words += range(start, start + len(all_kinds(field.type)))
    return words


# -- lowering ----------------------------------------------------------------------------------------------


def _lower(lowering: Lowering, entry: tree.Function, arguments: list[lanes.Value]) -> list[lanes.Value]:
    """Lower the whole stage and return the components of its result."""
    lowering.frame = InlinedFrame(entry, ())
    present = lowering.covered = lowering.new_mask(_MASK, "covered")
    if lowering.has_helpers:
        present = lowering.new_mask(lanes.apply("quads", lanes.get(present)), "present")
    lowering.scope.mask, lowering.scope.owns_mask = present, True
    lowering.result_mask = (
        lanes.get(lowering.new_mask(lanes.get(lowering.covered), "kept")) if lowering.may_discard else _MASK
    )
    return inline(lowering, entry, list(arguments), ())


def takes_differences(stage: tree.StageTree) -> bool:
    """Return whether a stage compares pixels of a quad."""
    return any(builtin.name in _DIFFERENCES for builtin in stage.builtins)
