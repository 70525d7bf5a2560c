"""The compiler of shader classes: from a class to the `ProgramDescriptor` that backends create programs from.

- `compile_shader` parses and checks a class once. The texts of its stages are written when a backend requests them.
- A compute stage is also lowered to lane code at once, because only lane code knows the uniformity of values, which
  decides about barriers and races.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from rhi.contract.descriptors import Binding, BindingKind, ProgramDescriptor, Stage, StageText, StageVarying
from rhi.contract.layout import Layout, place, stride_of
from rhi.errors import ShaderError, find_call_site
from rhi.shading.glsl.stages import StageOptions, write_stage
from rhi.shading.ir import tree
from rhi.shading.ir.interface import Interface
from rhi.shading.language import rules
from rhi.shading.language.builtins import Precision
from rhi.shading.language.shader import Declaration, Shader, StorageClass
from rhi.shading.language.types import VOID, ImageType, StorageType
from rhi.shading.parser.interface import (
    check_fragment_input,
    fragment_outputs,
    point_size_of,
    varyings_of,
    varyings_read,
    vertex_inputs,
)
from rhi.shading.parser.signatures import Callee, find_method
from rhi.shading.parser.stage import StageParser
from rhi.shading.parser.unused import check_bindings_are_used

__rhi_internal__ = True

# Lane code and OpenCL C are imported when a shader first needs them: they would take a tenth of the time of
# `import rhi`.
if TYPE_CHECKING:
    from rhi.shading.ir.lanes import Code

WIDTHS: Final = (1, 4, 8, 16)
_COMPUTE_WIDTHS: Final = {f"opencl{width}": width for width in WIDTHS} | {"numpy": 0}

_compiled: weakref.WeakKeyDictionary[type[Shader], ProgramDescriptor] = weakref.WeakKeyDictionary()


def compile_shader(shader: type[Shader]) -> ProgramDescriptor:
    """Parse and type-check a shader's stages, once for each class. Their texts are written on request.

    Raises:
        ShaderError: the shader breaks a rule of `rhi.shading.language.rules`; the error shows the line.
    """
    known = _compiled.get(shader)
    if known is None:
        try:
            known = _compiled[shader] = _compile(shader)
        except ShaderError as error:  # it shows the line, which the compiler's own traceback would bury
            raise error.with_traceback(None) from error.__cause__
    return known


def stage_trees(shader: type[Shader]) -> dict[Stage, tree.StageTree]:
    """Return the typed trees of a shader's stages."""
    return {stage: StageParser(shader, stage).parse(entry) for stage, entry in _entries(shader).items()}


def stage_interface(shader: type[Shader]) -> Interface:
    """Return the inputs, outputs and varyings of a shader's stages."""
    return _interface(_entries(shader))


def _compile(shader: type[Shader]) -> ProgramDescriptor:
    entries = _entries(shader)
    interface = _interface(entries)
    stages = {stage: StageParser(shader, stage).parse(entry) for stage, entry in entries.items()}
    stored = frozenset().union(*(stage.stored for stage in stages.values()))
    used = frozenset(declaration.name for stage in stages.values() for declaration in stage.bindings)
    check_bindings_are_used(shader, used)
    bindings = tuple(_bindings(shader, stored))
    fragment = stages.get(Stage.FRAGMENT)
    if shader.early_depth and interface.depth:
        source = entries[Stage.FRAGMENT].source
        source.refuse(
            rules.INTERFACE, source.node, "a FragmentDepth with early_depth = True", "one of the two"
        )
    options = StageOptions(
        shader.__qualname__.replace("<locals>.", ""),
        interface,
        {binding.name: binding for binding in bindings},
        _work_group(shader),
        shader.early_depth,
    )
    compute, needs_lane_check = stages.get(Stage.COMPUTE), False
    checked = shader.checked and not any(stage.entry.native for stage in stages.values())
    if compute is not None:
        from rhi.shading.lowering.functions import has_lane_code

        needs_lane_check = has_lane_code(compute)
        checked = checked and needs_lane_check
    varyings = varyings_read(fragment, interface.varyings, interface.point_size)
    emitter = _StageEmitter(stages, options, bindings, varyings, shader.precision, checked)
    if needs_lane_check:
        # Finds barriers that part of a work-group may not reach, and races.
        emitter.lower_compute(max(WIDTHS))
    return ProgramDescriptor(
        name=options.name,
        stages=frozenset(stages),
        bindings=bindings,
        attributes=interface.attributes,
        outputs=interface.outputs,
        work_group=options.work_group if Stage.COMPUTE in stages else (1, 1, 1),
        emit=emitter.emit,
        writes_memory=any(binding.writes for binding in bindings),
        discards=fragment is not None and fragment.discards,
        early_depth=shader.early_depth,
        writes_depth=bool(interface.depth),
        varyings=varyings,
        shared_bytes=sum(
            place(declaration.type, Layout.STD430).size
            for declaration in (compute.bindings if compute is not None else ())
            if declaration.storage_class is StorageClass.SHARED
        ),
        checked=checked,
        flushes_denormals=shader.precision is Precision.FAST,
        point_size=interface.point_size,
        reads_point_coordinates=fragment is not None
        and any(builtin.name == "point_coordinate" for builtin in fragment.builtins),
    )


def opencl_kernel(shader: type[Shader], width: int = 16) -> StageText:
    """Return a compute shader as an OpenCL C kernel for `width` lanes: 1, 4, 8 or 16 (`rhi.shading.opencl.writer`).

    Raises:
        ShaderError: the shader has no compute stage, uses a feature that lane code doesn't support, or breaks a rule.
    """
    descriptor = compile_shader(shader)
    if Stage.COMPUTE not in descriptor.stages or width not in WIDTHS:
        given = ", ".join(stage.value for stage in descriptor.stages) + f", width={width}"
        call = f"opencl_kernel({shader.__name__}, …)"
        raise ShaderError(rules.STAGES, call, given, f"a compute stage, width {WIDTHS}")
    return descriptor.emit(f"opencl{width}", Stage.COMPUTE)


class _StageEmitter:
    """The `emit` of a shader's descriptor: writes texts when they are first requested.

    - Texts are kept by language and stage, because several devices may request them.
    - Lane code is kept only until its text is written: nothing reads it afterwards. It is kept at all because a compute
      stage is lowered for 16 lanes when it is checked, long before its text may be requested.
    """

    def __init__(
        self, stages: dict[Stage, tree.StageTree], options: StageOptions, bindings: tuple[Binding, ...],
        varyings: tuple[StageVarying, ...], precision: Precision, checked: bool,
    ) -> None:  # fmt: skip
        self._stages = stages
        self._options = options
        self._bindings = bindings
        self._varyings = varyings
        self._precision = precision
        self._checked = checked
        self._texts: dict[tuple[str, Stage], StageText] = {}
        self._lane_code: dict[int, Code] = {}  # of the compute stage, by width

    def emit(self, language: str, stage: Stage) -> StageText:
        """Return a stage's text in a language, writing it on first use.

        Args:
            language: "glsl"; for compute stages also "opencl1", "opencl4", "opencl8" and "opencl16", a kernel for that
                many lanes, and "numpy" (`rhi.shading.numpy.kernel`); for the others also "opencl16"
                (`rhi.shading.opencl.stages`).

        Raises:
            ShaderError: `shading-native`: the stage can't be had in this language.
        """
        text = self._texts.get((language, stage))
        if text is None:
            text = self._texts[language, stage] = self._write(language, stage)
        return text

    def lower_compute(self, width: int) -> Code:
        """Return the lane code of the compute stage for `width` lanes, or for whole arrays with 0.

        Raises:
            ShaderError: a rule that only lane code can check, such as one about barriers.
        """
        code = self._lane_code.get(width)
        if code is None:
            from rhi.shading.lowering.functions import lower_compute

            stage, options = self._stages[Stage.COMPUTE], self._options
            code = lower_compute(stage, options.name, options.work_group, width, self._checked)
            self._lane_code[width] = code
        return code

    def _write(self, language: str, stage: Stage) -> StageText:
        if language == "glsl":
            return write_stage(self._stages[stage], self._options)
        if stage is Stage.COMPUTE and language in _COMPUTE_WIDTHS:
            width = _COMPUTE_WIDTHS[language]
            text = self._write_kernel(width) if width else self._write_numpy()
            self._lane_code.pop(width, None)
            return text
        if stage is not Stage.COMPUTE and language == "opencl16":
            return self._write_function(stage)
        call = f"{self._options.name}: emit({language!r}, {stage})"
        others = _COMPUTE_WIDTHS if stage is Stage.COMPUTE else ["opencl16"]
        raise ShaderError(rules.NATIVE, call, language, ", ".join(["glsl", *others]))

    def _write_kernel(self, width: int) -> StageText:
        """Write the compute stage as an OpenCL C kernel for `width` lanes."""
        from rhi.shading.ir.lanes import Code
        from rhi.shading.opencl.writer import write_opencl_kernel

        entry, options = self._stages[Stage.COMPUTE].entry, self._options
        if f"opencl{width}" in entry.native:
            empty = Code(options.name, width, [], (), work_group=options.work_group)
            return write_opencl_kernel(empty, self._bindings, self._precision, entry)
        return write_opencl_kernel(self.lower_compute(width), self._bindings, self._precision)

    def _write_numpy(self) -> StageText:
        """Write the compute stage as a NumPy module."""
        from rhi.shading.numpy.kernel import write_numpy_kernel

        return StageText(write_numpy_kernel(self.lower_compute(0)))

    def _write_function(self, stage: Stage) -> StageText:
        """Write a vertex or fragment stage as an OpenCL C function for 16 lanes."""
        from rhi.shading.lowering.bounds import bound_positions
        from rhi.shading.lowering.stages import lower_stage
        from rhi.shading.opencl.stages import write_opencl_stage

        options = self._options
        code = lower_stage(
            self._stages[stage], options.name, options.interface, self._varyings, checked=self._checked
        )
        bounds = bound_positions(code) if stage is Stage.VERTEX else None
        return write_opencl_stage(self._stages[stage], code, bounds, self._bindings, self._precision)


def _entries(shader: type[Shader]) -> dict[Stage, Callee]:
    found = {stage: find_method(shader, stage.value) for stage in Stage}
    entries = {stage: callee for stage, callee in found.items() if callee is not None}
    allowed = "`vertex`, `vertex` and `fragment`, or `compute`"
    if not entries or (Stage.COMPUTE in entries and len(entries) > 1) or list(entries) == [Stage.FRAGMENT]:
        given = ", ".join(stage.value for stage in entries) or "no stage"
        raise ShaderError(rules.STAGES, f"class {shader.__name__}", given, allowed, site=find_call_site())
    return entries


def _interface(entries: dict[Stage, Callee]) -> Interface:
    compute = entries.get(Stage.COMPUTE)
    if compute is not None:
        described = compute.signature
        if described.parameters or described.result != VOID:
            compute.source.refuse(
                rules.INTERFACE,
                compute.source.node,
                "parameters or a result",
                "compute(self) -> None",
                "read global_id() and bindings, write StorageRW and images",
            )
        return Interface()
    vertex, fragment = entries[Stage.VERTEX], entries.get(Stage.FRAGMENT)
    attributes = vertex_inputs(vertex)
    position, varyings = varyings_of(vertex)
    point_size = point_size_of(vertex)
    if fragment is None:
        return Interface(attributes, varyings, position, point_size=point_size)
    check_fragment_input(fragment, varyings)
    depth, outputs = fragment_outputs(fragment)
    return Interface(attributes, varyings, position, outputs, depth, point_size)


_KINDS = {
    StorageClass.UNIFORM: BindingKind.UNIFORM,
    StorageClass.STORAGE: BindingKind.STORAGE,
    StorageClass.TEXTURE: BindingKind.TEXTURE,
    StorageClass.IMAGE: BindingKind.IMAGE,
}


def _bindings(shader: type[Shader], stored: frozenset[str]) -> Iterator[Binding]:
    slots = dict.fromkeys(BindingKind, 0)
    for declaration in shader._declared.values():
        if declaration.storage_class is not StorageClass.SHARED:
            kind = _KINDS[declaration.storage_class]
            yield _binding(declaration, kind, slots[kind], declaration.name in stored)
            slots[kind] += 1


def _binding(declaration: Declaration, kind: BindingKind, slot: int, stored: bool) -> Binding:
    name, type = declaration.name, declaration.type
    match type:
        case StorageType(element=element, writable=writable):
            return Binding(name, kind, slot, writable, declaration.host, stride_of(element, Layout.STD430))
        case ImageType():
            return Binding(name, kind, slot, stored, type)
    if kind is BindingKind.TEXTURE:
        return Binding(name, kind, slot, False, type)
    return Binding(name, kind, slot, False, declaration.host, place(type, Layout.STD140).size)


def _work_group(shader: type[Shader]) -> tuple[int, int, int]:
    given = shader.work_group
    valid = (
        isinstance(given, tuple) and 1 <= len(given) <= 3 and all(isinstance(n, int) and n > 0 for n in given)
    )
    if not valid or given[0] * (given[1:] or (1,))[0] * (given[2:] or (1,))[0] > 1024:
        raise ShaderError(
            rules.OUT_OF_RANGE,
            f"class {shader.__name__}: work_group",
            repr(given),
            "1 to 3 positive numbers whose product is at most 1024",
            site=find_call_site(),
        )
    x, y, z = (*given, 1, 1)[:3]
    return x, y, z
