"""The lowering of vertex and fragment stages: inputs and outputs, helper lanes, discard, differences between pixels.

- A stage's inputs are arguments. Inputs that 16 vertices or a block of 4 by 4 pixels share have the uniformity LANES:
  flat varyings, the instance, the draw, the facing. A material index, for example, gives scalar loads.
- Only covered lanes have side effects. If a stage takes differences between pixels, the other pixels of the quads run
  as helpers: they compute and read (within bounds, whatever their extrapolated inputs are) but never write.
- `discard()` removes lanes from all masks, as if they returned from the whole stage, and from the stage's result.
- A difference is undefined where a part of the quad is inactive or was discarded before, as in GLSL.
"""

from __future__ import annotations

from typing import Final

from rhi.contract.descriptors import Interpolation, Stage, StageVarying
from rhi.contract.layout import HostType, StructType
from rhi.shading.ir import lanes, tree
from rhi.shading.ir.interface import Interface
from rhi.shading.ir.lanes import (
    FIRST_VERTEX,
    WIDTH,
    AddressSpace,
    Affine,
    Argument,
    Code,
    ElementCount,
    Get,
    MemoryRegion,
    ScalarKind,
    StageCode,
    Uniformity,
    Value,
    Variable,
    apply,
    get,
    literal,
    number,
)
from rhi.shading.lowering.components import all_kinds
from rhi.shading.lowering.functions import Lowering
from rhi.shading.lowering.scopes import InlinedFrame

_DIFFERENCES: Final = frozenset({"ddx", "ddy", "fwidth", "sample", "sample_bias", "sample_compare"})
"""The built-ins that compare pixels of a quad, including the texture methods that compute the mip level implicitly."""

_DEPTH: Final = -1


def _argument(name: str, kind: ScalarKind = ScalarKind.INT, uniformity: Uniformity = Uniformity.LANES) -> Argument:
    return Argument(kind, uniformity, name)


_MASK: Final = _argument("mask", ScalarKind.BOOL, Uniformity.VARYING)
_INPUTS: Final[dict[Stage, dict[str, tuple[Value, ...]]]] = {
    Stage.VERTEX: {
        "vertex_index": (_argument(FIRST_VERTEX, uniformity=Uniformity.VARYING),),
        "instance_index": (_argument("instance"),),
        "draw_index": (_argument("draw"),),
    },
    Stage.FRAGMENT: {
        "fragment_coordinate": tuple(_argument(axis, ScalarKind.FLOAT, Uniformity.VARYING) for axis in "xyzw"),
        "front_facing": (_argument("front", ScalarKind.BOOL),),
        "primitive_index": (_argument("primitive"),),
        "point_coordinate": tuple(_argument(axis, ScalarKind.FLOAT, Uniformity.VARYING) for axis in ("across", "down")),
    },
}


def lower_stage(
    stage: tree.StageTree,
    name: str,
    interface: Interface,
    varyings: tuple[StageVarying, ...],
    width: int = WIDTH,
    checked: bool = False,
) -> StageCode:
    """Lower a vertex or fragment stage for `width` lanes, or for whole arrays with 0.

    Args:
        checked: whether to test every index.

    Raises:
        ShaderError: the stage uses a feature that lane code doesn't support.
    """
    if f"opencl{width}" in stage.entry.native:
        return StageCode(Code(name, width, [], ()), (), False)
    lowering = StageLowering(stage, width)
    lowering.checked = checked
    if stage.stage is Stage.VERTEX:
        arguments, words = _vertex_arguments(stage, interface), _vertex_words(stage, interface, varyings)
    else:
        arguments, words = _fragment_arguments(stage, varyings), _fragment_words(stage, interface)
    results = lowering.settle(lambda: lowering.run(arguments))
    outputs = [(word, value) for word, value in zip(words, results, strict=True) if word is not None]
    depth = [value for word, value in outputs if word == _DEPTH]
    outputs = [(word, value) for word, value in outputs if word != _DEPTH]
    values = [value for _, value in outputs] + depth
    if stage.stage is Stage.FRAGMENT:
        values.append(lowering.kept)
    memories = tuple(lowering.memories.values())
    built_in = [value for values in _INPUTS[stage.stage].values() for value in values]
    given = tuple(value for value in (*arguments, *built_in, _MASK) if isinstance(value, Argument))
    code = Code(name, width, lowering.block, memories, given, tuple(values), checked=checked)
    return StageCode(code, tuple(word for word, _ in outputs), bool(depth))


# -- inputs and outputs ------------------------------------------------------------------------------------


def _parameter_fields(stage: tree.StageTree) -> list[tuple[str, HostType]]:
    types = [parameter.type for parameter in stage.entry.parameters]
    return [(field.name, field.type) for type in types if isinstance(type, StructType) for field in type.fields]


def _vertex_arguments(stage: tree.StageTree, interface: Interface) -> list[Value]:
    """Return the components of the parameters: the words of the attributes in order, and zeros for those that a lean
    stage lacks, since it doesn't read them."""
    known = {attribute.name for attribute in interface.attributes}
    values: list[Value] = []
    word = 0
    for name, type in _parameter_fields(stage):
        for kind in all_kinds(type):
            if name in known:
                values.append(_argument(f"inputs_{word}", kind, Uniformity.VARYING))
                word += 1
            else:
                values.append(literal(0, kind))
    return values


def _fragment_arguments(stage: tree.StageTree, varyings: tuple[StageVarying, ...]) -> list[Value]:
    """Return the components of the parameter, with zeros for those that are never read."""
    known = {varying.name: varying for varying in varyings}
    values: list[Value] = []
    for name, type in _parameter_fields(stage):
        varying = known.get(name)
        for i, kind in enumerate(all_kinds(type)):
            if varying is None:
                values.append(literal(0, kind))
            elif varying.interpolation is Interpolation.FLAT:
                values.append(_argument(f"flat_{varying.word + i}", kind))
            else:
                values.append(_argument(f"inputs_{varying.word + i}", kind, Uniformity.VARYING))
    return values


def _vertex_words(stage: tree.StageTree, interface: Interface, varyings: tuple[StageVarying, ...]) -> list[int | None]:
    """Return the word of each result component: position from 0, varyings from 4 on, None for those never read."""
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


class StageLowering(Lowering):
    """Lowers a vertex or fragment stage."""

    def __init__(self, stage: tree.StageTree, width: int) -> None:
        super().__init__(width, (1, 1, 1))
        self.stage = stage
        self.has_helpers = stage.stage is Stage.FRAGMENT and takes_differences(stage)

    def start(self) -> None:
        super().start()
        self.discards = 0  # the number of masked discards
        self.discarded = Uniformity.DISPATCH  # how much they vary
        self.covered: Variable  # the mask of lanes that aren't helpers
        self.kept: Value  # the mask of covered lanes that weren't discarded

    def run(self, arguments: list[Value]) -> list[Value]:
        """Lower the whole stage and return the components of its result."""
        entry = self.stage.entry
        self.frame = InlinedFrame(entry, ())
        present = self.covered = self.new_mask(_MASK, "covered")
        if self.has_helpers:
            present = self.new_mask(apply("quads", get(present)), "present")
        self.scope.mask, self.scope.owns_mask = present, True
        self.kept = get(self.new_mask(get(self.covered), "kept")) if self.stage.discards else _MASK
        return self.inline(entry, list(arguments), ())

    # -- masks

    def returns_early(self, function: tree.Function, path: tuple[int, ...]) -> bool:
        whole = not path and self.stage.discards
        return whole or super().returns_early(function, path)

    def effect_mask(self) -> Variable | None:
        if not self.has_helpers:
            return super().effect_mask()
        return self.new_mask(self.mask_value() & get(self.covered), "covered")

    def inline(
        self,
        function: tree.Function,
        values: list[Value],
        path: tuple[int, ...],
        textures: dict[tree.Local, tree.BindingRead] | None = None,
    ) -> list[Value]:
        before = self.discards
        results = super().inline(function, values, path, textures)
        if self.discards > before:  # its callers lose the same lanes
            self.jump_pending = True
            self.frame.return_uniformity = max(self.frame.return_uniformity, self.discarded)
        return results

    def discard(self) -> None:
        frame, scopes = self.frame, list(self.scopes_up_to(None))
        while frame.caller is not None and frame.caller.caller is not None:
            frame = frame.caller
        target = scopes[-2]  # the entry function's scope; the last one holds the stage's mask
        uniformity = max([scope.uniformity for scope in scopes[:-2]], default=Uniformity.DISPATCH)
        self.join((target.key, "function"), uniformity)
        self.discarded = max(self.discarded, uniformity)
        self.frame.return_uniformity = max(self.frame.return_uniformity, uniformity)
        assert frame.inlined_call is not None
        assert isinstance(self.kept, Get)
        remaining = apply("not", self.mask_value())
        self.emit(lanes.Set(self.line, self.kept.variable, self.kept & remaining, None))
        if self.branches(uniformity) and self.width:
            frame.inlined_call.returns_early = True
            self.emit(lanes.Return(self.line, frame.inlined_call))
        else:
            self.narrow(target)
            if self.has_helpers:  # helpers whose quad is discarded become inactive, too
                needed = self.let(apply("quads", self.kept))
                for scope in scopes[:-1]:
                    if scope.owns_mask and scope.mask is not None:
                        both = get(scope.mask) & needed
                        self.emit(lanes.Set(self.line, scope.mask, both, None))
            self.jump_pending = True
            self.discards += 1
            self.returns += 1

    # -- values

    def load(self, memory: MemoryRegion, kind: ScalarKind, index: Value, scale: int, offset: int) -> Value:
        last: Value = number((memory.length - 1 - offset) // scale)
        if memory.space is AddressSpace.STORAGE:  # the scale is the words of an element, or 1
            count = ElementCount(ScalarKind.INT, Uniformity.DISPATCH, memory)
            whole = scale == memory.stride
            last = count - number(1) if whole else count * number(memory.stride) - number(offset + 1)
        return super().load(memory, kind, self.limited(index, last), scale, offset)

    def store_private(self, memory: MemoryRegion, index: Value, value: Value) -> None:
        super().store_private(memory, self.limited(index, number(memory.length - 1)), value)

    def limited(self, index: Value, last: Value) -> Value:
        """Return an index clamped to memory if helpers run, because theirs may be out of bounds."""
        if not self.has_helpers or index.uniformity < Uniformity.VARYING:
            return index
        return self.let(apply("max", apply("min", index, last), number(0)))

    def builtin(self, node: tree.BuiltinCall, needs_result: bool) -> list[Value]:
        name = node.builtin.name
        if name == "vertex_index" and self.width:
            return [Affine(ScalarKind.INT, Uniformity.VARYING, _argument(FIRST_VERTEX), 1)]
        if name in _INPUTS[self.stage.stage]:
            return list(_INPUTS[self.stage.stage][name])
        if name in ("ddx", "ddy", "fwidth"):
            values = [self.let(value) for value in self.lower(node.arguments[0])]
            if name != "fwidth":
                return [self.difference(name, value) for value in values]
            return [
                apply("abs", self.difference("ddx", value)) + apply("abs", self.difference("ddy", value))
                for value in values
            ]
        return super().builtin(node, needs_result)

    def difference(self, name: str, value: Value) -> Value:
        """Return `ddx` or `ddy` of a component."""
        return apply(name, value) if value.uniformity is Uniformity.VARYING else literal(0.0)


def takes_differences(stage: tree.StageTree) -> bool:
    """Return whether a stage compares pixels of a quad."""
    return any(builtin.name in _DIFFERENCES for builtin in stage.builtins)
