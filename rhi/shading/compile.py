"""The compiler of shader classes: from a class to the `ProgramDescriptor` that backends create programs from.

- `compile_shader` parses and checks a class once. The texts of its stages are written when a backend requests
  them.
- A compute stage is lowered to lane code for devices that run lane code. Only lane code knows the uniformity
  of values, which decides about barriers and races. Where the typed tree doesn't show that a stage keeps
  those rules (`rhi.shading.parser.group_rules`), it is therefore lowered at once, so that every device
  refuses the same shaders.
"""

from __future__ import annotations

import sys
import weakref
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from types import ModuleType

from rhi.contract.descriptors import Binding, BindingKind, ProgramDescriptor, Stage, StageText
from rhi.contract.layout import Layout, StructType, memory_layout, stride_of
from rhi.errors import ShaderError, ShaderErrors
from rhi.errors.call_sites import find_call_site
from rhi.errors.shared_caches import SHARED
from rhi.shading.emitters import WIDTHS, ShaderCode, make_depth_error
from rhi.shading.ir import tree
from rhi.shading.ir.interface import Interface
from rhi.shading.language import rules
from rhi.shading.language.annotations import Role
from rhi.shading.language.builtins import Precision
from rhi.shading.language.edits import Edit, file_of
from rhi.shading.language.shader import Declaration, Shader, StorageClass, work_group_size
from rhi.shading.language.structs import Struct
from rhi.shading.language.types import VOID, ImageType, StorageType
from rhi.shading.parser.foreign_stages import refuse_foreign_stages
from rhi.shading.parser.group_rules import may_break_group_rules
from rhi.shading.parser.interface import (
    attributes_read,
    check_fragment_input,
    field_of_role,
    fragment_outputs,
    varyings_of,
    varyings_read,
    vertex_inputs,
)
from rhi.shading.parser.signatures import Callee, find_method
from rhi.shading.parser.stage import parse_stage
from rhi.shading.parser.unused import collect_unused_bindings, warn_of_unused

_compiled: weakref.WeakKeyDictionary[type[Shader], tuple[ProgramDescriptor, ShaderCode]] = (
    weakref.WeakKeyDictionary()
)

CompiledShaders = Mapping[type[Shader], tuple[ProgramDescriptor, ShaderCode]]
"""Shader classes with the descriptors and code that they compile to."""


_COMPARED = tuple(field.name for field in fields(ProgramDescriptor) if field.name != "emit")


def compile_shader(shader: type[Shader], *, strict: bool = False) -> ProgramDescriptor:
    """Parse and type-check a shader's stages, once for each class. Their texts are written on request.

    A binding that no method uses is a `ShaderWarning`, once; with `strict` it is an error.

    Raises:
        ShaderError: the shader breaks rules of `rhi.shading.language.rules`; the error shows each line that
            breaks one.

    Examples:
        >>> [binding.name for binding in sl.compile_shader(Flat).bindings]
        ['tint']
    """
    compiled = _compiled.get(shader)
    if compiled is None or strict:
        try:
            with SHARED:
                compiled = _compile_once(shader, strict)
        except ShaderError as error:  # the error shows the line; the compiler's traceback would bury it
            raise error.with_traceback(None) from error.__cause__
    return compiled[0]


def _compile_once(shader: type[Shader], strict: bool) -> tuple[ProgramDescriptor, ShaderCode]:
    """Return the compiled shader, which the lock keeps other threads from compiling as well."""
    compiled = _compiled.get(shader)
    if compiled is None:
        try:
            compiled = _compile(shader)
        except RecursionError:
            raise make_depth_error(shader.__qualname__) from None
    unused = compiled[1].unused
    if unused and strict:
        ShaderErrors(unused).check()
    if shader not in _compiled:
        warn_of_unused(unused)
        _compiled[shader] = compiled
    return compiled


def describe_with_precision(shader: type[Shader], precision: Precision) -> ProgramDescriptor:
    """Compile a shader like `compile_shader`, in this precision unless the shader or a base sets its own."""
    with SHARED:
        return _describe_with_precision(shader, precision)


def _describe_with_precision(shader: type[Shader], precision: Precision) -> ProgramDescriptor:
    exact = compile_shader(shader)
    own = any("precision" in vars(base) for base in shader.__mro__[: shader.__mro__.index(Shader)])
    if own or precision is shader.precision:
        return exact
    code = _compiled[shader][1].with_other_precision(precision)
    return replace(exact, emit=code.emit, flushes_denormals=precision is Precision.FAST)


def list_exact_functions(shader: type[Shader]) -> list[str]:
    """Return the built-ins of a compiled shader that `Precision.FAST` would compute with fewer instructions.

    Only texts that were written in OpenCL C count; the name "divide" stands for division."""
    compiled = _compiled.get(shader)
    return compiled[1].list_exact_functions() if compiled is not None else []


def forget_compiled(edit: Edit) -> CompiledShaders:
    """Discard and return the compiled shaders that a module's edit may concern; they are compiled again on
    demand.

    These are the classes of the module and those derived from them, those that call its functions or use
    structs that it changed, and those of modules that have imported it.
    """
    with SHARED:
        concerned = {
            compiled_shader: code
            for compiled_shader, code in _compiled.items()
            if _is_concerned(compiled_shader, code[1], edit.module, edit.structs)
        }
        for shader in concerned:
            del _compiled[shader]
    return concerned


def is_compiled(shader: type[Shader]) -> bool:
    """Return whether programs may be made of a shader: it was compiled."""
    return shader in _compiled


def restore_compiled(compiled: CompiledShaders) -> None:
    """Restore compiled shaders that `forget_compiled` has returned, because the edit was undone."""
    with SHARED:
        _compiled.update(compiled)


def depends_on_module(shader: type[Shader], module: ModuleType) -> bool:
    """Return whether a compiled shader has classes, functions or structs of a module, or a base has imported
    it."""
    members = [
        value for value in vars(module).values() if getattr(value, "__module__", "") == module.__name__
    ]
    structs = {
        value.shading_type for value in members if isinstance(value, type) and issubclass(value, Struct)
    }
    compiled = _compiled.get(shader)
    return compiled is not None and _is_concerned(shader, compiled[1], module, structs)


def _is_concerned(
    shader: type[Shader], code: ShaderCode, module: ModuleType, structs: set[StructType]
) -> bool:
    for base in shader.__mro__:
        names = vars(sys.modules.get(base.__module__, module))
        if base.__module__ == module.__name__ or any(value is module for value in names.values()):
            return True
    return any(
        not structs.isdisjoint(stage.structs)
        or any(function.file == file_of(module) for function in (stage.entry, *stage.functions))
        for stage in code.stages.values()
    )


def is_same(program: ProgramDescriptor, compiled: CompiledShaders, shader: type[Shader]) -> bool:
    """Return whether a newly compiled program equals the earlier one in its interface and all texts written
    so far."""
    before, code = compiled[shader]
    if any(getattr(program, name) != getattr(before, name) for name in _COMPARED):
        return False
    written = dict(code.written())
    try:
        written = written or {("glsl", stage): code.emit("glsl", stage) for stage in before.stages}
    except ShaderError:  # its stages are written in another language only
        return False
    for (language, stage), text in written.items():
        new = program.emit(language, stage)
        if new != text if program.checked else (new.text, new.binary) != (text.text, text.binary):
            return False
    return True


def stage_trees(shader: type[Shader]) -> dict[Stage, tree.StageTree]:
    """Return the typed tree of each stage of a shader, from which its texts are written.

    Raises:
        ShaderError: the shader breaks a rule of `rhi.shading.language.rules`; the error shows the line.
    """
    return dict(compiled_code(shader).stages)


def compiled_code(shader: type[Shader]) -> ShaderCode:
    """Return the stages that `compile_shader` has parsed, from which texts are written."""
    with SHARED:
        compile_shader(shader)
        return _compiled[shader][1]


def _compile(shader: type[Shader]) -> tuple[ProgramDescriptor, ShaderCode]:
    entries, errors, stages = _entries(shader), ShaderErrors(), {}
    interface = Interface(
        shader.__qualname__.replace("<locals>.", ""), work_group_size(shader), shader.early_depth
    )
    with errors.collect():
        interface = _complete(interface, entries)
    for stage, entry in entries.items():
        with errors.collect():
            stages[stage] = parse_stage(shader, stage, entry)
    errors.check()
    stored = frozenset().union(*(stage.stored for stage in stages.values()))
    used = frozenset(declaration.name for stage in stages.values() for declaration in stage.bindings)
    unused = collect_unused_bindings(shader, used)
    loaded = frozenset().union(*(stage.loaded for stage in stages.values()))
    bindings = tuple(_bindings(shader, stored, loaded, used))
    interface = replace(interface, bindings={binding.name: binding for binding in bindings})
    if shader.lean and Stage.VERTEX in stages:
        interface = replace(interface, attributes=attributes_read(stages[Stage.VERTEX], interface.attributes))
    fragment = stages.get(Stage.FRAGMENT)
    if shader.early_depth and interface.depth:
        source = entries[Stage.FRAGMENT].source
        source.refuse(
            rules.INTERFACE, source.node, "a FragmentDepth with early_depth = True", "at most one of them"
        )
    compute = stages.get(Stage.COMPUTE)
    checked = shader.checked and not any(stage.entry.native for stage in stages.values())
    if compute is not None:
        checked = checked and tree.has_python_bodies(compute)
    varyings = varyings_read(fragment, interface.varyings, {interface.point_size, interface.target_layer})
    code = ShaderCode(stages, interface, varyings, shader.precision, checked, unused)
    if (
        compute is not None
        and tree.has_python_bodies(compute)
        and may_break_group_rules(compute, interface.work_group)
    ):
        code.lower_compute(max(WIDTHS))
    descriptor = ProgramDescriptor(
        name=interface.name,
        stages=frozenset(stages),
        bindings=bindings,
        attributes=interface.attributes,
        outputs=interface.outputs,
        work_group=interface.work_group if Stage.COMPUTE in stages else (1, 1, 1),
        emit=code.emit,
        writes_memory=any(binding.writes for binding in bindings),
        discards=fragment is not None and fragment.discards,
        early_depth=shader.early_depth,
        writes_depth=bool(interface.depth),
        varyings=varyings,
        shared_bytes=sum(
            memory_layout(declaration.type, Layout.STD430).size
            for declaration in (compute.bindings if compute is not None else ())
            if declaration.storage_class is StorageClass.SHARED
        ),
        checked=checked,
        flushes_denormals=shader.precision is Precision.FAST,
        point_size=interface.point_size,
        target_layer=interface.target_layer,
        reads_point_coordinates=fragment is not None
        and any(builtin.name == "point_coordinate" for builtin in fragment.builtins),
        reads_draw_index=Stage.VERTEX in stages
        and any(builtin.name == "draw_index" for builtin in stages[Stage.VERTEX].builtins),
        vertex_writes=Stage.VERTEX in stages and bool(stages[Stage.VERTEX].stored),
    )
    return descriptor, code


def opencl_kernel(shader: type[Shader], width: int = 16) -> StageText:
    """Return a compute shader as an OpenCL C kernel for `width` lanes: 1, 4, 8 or 16.

    `rhi.shading.opencl.opencl_writer` writes it.

    Raises:
        ShaderError: the shader has no compute stage, uses a feature that lane code doesn't support, or breaks
            a rule.
    """
    descriptor = compile_shader(shader)
    if Stage.COMPUTE not in descriptor.stages or width not in WIDTHS:
        actual = ", ".join(stage.value for stage in descriptor.stages) + f", width={width}"
        call = f"opencl_kernel({shader.__name__}, …)"
        raise ShaderError(rules.STAGES, call, actual, f"a compute stage, width {WIDTHS}")
    return descriptor.emit(f"opencl{width}", Stage.COMPUTE)


def _entries(shader: type[Shader]) -> dict[Stage, Callee]:
    refuse_foreign_stages(shader)
    methods = {stage: find_method(shader, stage.value) for stage in Stage}
    entries = {stage: callee for stage, callee in methods.items() if callee is not None}
    allowed = "`vertex`, `vertex` and `fragment`, or `compute`"
    if not entries or (Stage.COMPUTE in entries and len(entries) > 1) or list(entries) == [Stage.FRAGMENT]:
        actual = ", ".join(stage.value for stage in entries) or "no stage"
        raise ShaderError(rules.STAGES, f"class {shader.__name__}", actual, allowed, site=find_call_site())
    return entries


def _complete(interface: Interface, entries: dict[Stage, Callee]) -> Interface:
    """Return an interface with the inputs, outputs and varyings of a shader's stages."""
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
        return interface
    vertex, fragment = entries[Stage.VERTEX], entries.get(Stage.FRAGMENT)
    attributes = vertex_inputs(vertex)
    position, varyings = varyings_of(vertex)
    interface = replace(
        interface,
        attributes=attributes,
        varyings=varyings,
        position=position,
        point_size=field_of_role(vertex, Role.POINT_SIZE, "PointSize"),
        target_layer=field_of_role(vertex, Role.TARGET_LAYER, "TargetLayer"),
    )
    if fragment is None:
        return interface
    check_fragment_input(fragment, varyings)
    depth, outputs = fragment_outputs(fragment)
    return replace(interface, outputs=outputs, depth=depth)


_KINDS = {
    StorageClass.UNIFORM: BindingKind.UNIFORM,
    StorageClass.STORAGE: BindingKind.STORAGE,
    StorageClass.TEXTURE: BindingKind.TEXTURE,
    StorageClass.IMAGE: BindingKind.IMAGE,
}


def _bindings(
    shader: type[Shader], stored: frozenset[str], loaded: frozenset[str], used: frozenset[str]
) -> Iterator[Binding]:
    slots = dict.fromkeys(BindingKind, 0)
    for declaration in shader._declared.values():
        if shader.lean and declaration.name not in used:
            continue
        if declaration.storage_class is not StorageClass.SHARED:
            kind = _KINDS[declaration.storage_class]
            yield _binding(
                declaration, kind, slots[kind], declaration.name in stored, declaration.name in loaded
            )
            slots[kind] += 1


def _binding(declaration: Declaration, kind: BindingKind, slot: int, stored: bool, loaded: bool) -> Binding:
    name, type = declaration.name, declaration.type
    match type:
        case StorageType(element=element, writable=writable):
            size = stride_of(element, Layout.STD430)
            return Binding(name, kind, slot, writable, declaration.host, size)
        case ImageType():
            return Binding(name, kind, slot, stored, type, reads=loaded)
    if kind is BindingKind.TEXTURE:
        return Binding(name, kind, slot, False, type, table=declaration.table)
    return Binding(name, kind, slot, False, declaration.host, memory_layout(type, Layout.STD140).size)
