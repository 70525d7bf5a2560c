"""Programs: compiled shaders, and the checks before each draw or dispatch.

- A draw checks everything first and binds afterwards, so that a refused draw has no effect. The functions
  that do this are generated per program (`rhi.device.resources.draw_code`) and compare bound and given values
  by identity.
- The checks themselves, which say what is wrong and what is allowed, are here, off the fast path.
"""

from __future__ import annotations

import keyword
import warnings
from collections.abc import Callable, Iterable
from types import CodeType
from typing import Any, Final, Generic, NoReturn, Protocol

from typing_extensions import ParamSpec

from rhi.contract.alternatives import ALTERNATIVES
from rhi.contract.descriptors import Binding, BindingKind, Id, ProgramDescriptor, Stage, TextureKind
from rhi.contract.formats import ChannelKind, Format
from rhi.contract.limits import program_faults, range_faults, show_stages
from rhi.contract.states import BlendFunction
from rhi.device.core.core import Core, describe_object
from rhi.device.core.timeline import Timeline
from rhi.device.core.uniform_ring import UniformRing
from rhi.device.resources.buffers import Buffer, pack_single
from rhi.device.resources.draw_code import MISSING, compile_draw_code, make_draw_code
from rhi.device.resources.lifetime import retire
from rhi.device.resources.meshes import Drawable, check_instance_end, reads_instances
from rhi.device.resources.textures import Texture
from rhi.errors import ShaderWarning, ValidationError, rules
from rhi.errors.arguments import ArgumentChecker
from rhi.errors.call_sites import CallSite, find_call_site
from rhi.errors.device_objects import DeviceObject
from rhi.shading import Precision, Shader, Struct
from rhi.shading.language.bindings import (
    ImageBinding,
    StorageRange,
    TableBinding,
    TextureBinding,
    UniformRange,
)
from rhi.shading.language.texture_tables import TextureTable

P = ParamSpec("P")
MAX_INSTANCES: Final = (1 << 31) - 1
_RANGES = {BindingKind.UNIFORM: UniformRange, BindingKind.STORAGE: StorageRange}


class DrawFunction(Protocol[P]):
    """The type of `Program.draw`. It is an attribute: type checkers don't bind it like a method."""

    def __call__(self, mesh: Drawable, instances: int = 1, /, *args: P.args, **bindings: P.kwargs) -> None:
        """Draw `mesh` with the program's bindings as keywords."""


class Program(DeviceObject, Generic[P]):
    """A shader on the device; created by `device.program`.

    Attributes:
        id: the program's id in the command stream.
        descriptor: stages, bindings, vertex inputs and outputs.
        name: the name of the shader class.
        uniforms: where the values of uniform bindings are written.
        recorded_code: the code of its functions in command buffers, None before the first use in one.
    """

    __slots__ = (
        # Bindings that the shader declares, or had before an edit, and doesn't read: draws may pass them.
        # The value says whether a warning was issued.
        "_left_out",
        "bind",
        "core",
        "descriptor",
        "destroyed",
        "draw",
        "draw_with",
        "id",
        "name",
        "recorded_code",
        "uniforms",
    )

    draw_with: Callable[[Drawable, int, dict[str, Any]], None]
    """The draw with the bindings in a dictionary: `draw_with(mesh, instances, bindings)`."""

    bind: Callable[[Callable[[Any], None], Any, dict[str, Any]], None]
    """Check and bind values for any call but a plain draw: `bind(check, mesh, bindings)`."""

    draw: DrawFunction[P]
    """Draw a mesh, like `device.draw(program, mesh, …)` but with one Python call less."""

    def __init__(
        self, core: Core, uniforms: UniformRing, descriptor: ProgramDescriptor, declared: Iterable[str] = ()
    ) -> None:
        _check_limits(core, descriptor)
        self.core = core
        self.uniforms = uniforms
        self.descriptor = descriptor
        self.name = descriptor.name
        self.destroyed = False
        self.recorded_code: CodeType | None = None
        self._left_out = dict.fromkeys(
            set(declared) - {binding.name for binding in descriptor.bindings}, False
        )
        self.id = core.create_id()
        core.create(core.backend.create_program, self.id, descriptor)
        self._install_code(self._compile_code())

    def _compile_code(self) -> CodeType:
        return compile_draw_code(
            self.name,
            self.descriptor.bindings,
            validates=self.core.validates,
            takes_more=bool(self._left_out),
            checks_aliases=self.must_check_aliases,
        )

    @property
    def must_check_aliases(self) -> bool:
        """True if the program writes memory that it may use only once."""
        return self.descriptor.writes_memory and not self.core.capabilities.aliased_writes

    def _install_code(self, code: CodeType) -> None:
        functions = make_draw_code(code, self, self.descriptor.bindings)
        self.draw = functions.draw
        self.draw_with = functions.draw_with
        self.bind = functions.bind
        self.core.draw_counters[self.id] = functions.collect_draw_count

    @property
    def label(self) -> str:
        """The program's name, in the role of a resource's label."""
        return self.name

    def __repr__(self) -> str:
        return f"Program({self.name!r})"

    def destroy(self) -> None:
        """Destroy the program once the GPU no longer uses it."""
        if not self.destroyed:
            core = self.core
            core.check_thread("destroy")
            core.program = None
            if self.id in core.draw_counters:
                core.draws += core.draw_counters[self.id]()
                del core.draw_counters[self.id]
            retire(self)

    def build(self, descriptor: ProgramDescriptor) -> Id:
        """Create the backend's program for a later `exchange`, inside a `creation` block; return its id."""
        _check_limits(self.core, descriptor)
        number = self.core.create_id()
        self.core.create(self.core.backend.create_program, number, descriptor)
        return number

    def exchange(self, number: Id, descriptor: ProgramDescriptor) -> None:
        """Replace the backend's program by one that `build` has created; meshes and command buffers drop what
        they store for the old one."""
        core = self.core
        core.program = None
        core.draws += core.draw_counters.pop(self.id)()
        core.timeline.retire(self.id)
        for binding in self.descriptor.bindings:
            self._left_out.setdefault(binding.name, False)
        self.id = number
        self.descriptor = descriptor
        self.name = descriptor.name
        self.recorded_code = None
        self._install_code(self._compile_code())

    # -- checks, off the fast path -----------------------------------------------------------------------

    def check_can_draw(self, mesh: Drawable) -> None:
        """Refuse a draw of `mesh` that is not possible now, whatever its bindings."""
        core = self.core
        call = f"draw of program {self.name!r}"
        core.check_command()
        core.check_usable(self, call)
        if Stage.VERTEX not in self.descriptor.stages:
            core.refuse(
                rules.PROGRAM_STAGE, call, show_stages(self.descriptor), "a program with a vertex stage"
            )
        if core.render_pass is None:
            core.refuse(rules.DRAW_OUTSIDE_PASS, call, "no open pass")
        for buffer in mesh.buffers:
            core.check_usable(buffer, call)
        targets = zip(core.target_kinds, core.target_channels, strict=True)
        for output, (kind, channels) in zip(self.descriptor.outputs, targets, strict=False):
            if output.components < channels and output.kind == kind:
                core.refuse(
                    rules.PROGRAM_OUTPUT,
                    call,
                    f"{output.name}: {output.components} components",
                    f"{channels} or more, as target {output.location} has",
                    "return a vec4: what the target lacks is dropped",
                )
            if output.kind != kind:
                core.refuse(
                    rules.PROGRAM_OUTPUT,
                    call,
                    f"{output.name}: {output.kind}",
                    f"{kind}, as target {output.location} is",
                )

        for index in core.unblendable_targets:
            blends: Any = core.states.requested[BlendFunction]
            blend = blends[index]
            if not blend.is_off:
                core.refuse(
                    rules.DEVICE_CAPABILITY,
                    call,
                    f"{blend!r} on target {index}",
                    "a format outside of capabilities.unblendable_formats, or no blending",
                )

    def check_can_dispatch(self, subject: object = None) -> None:
        """Refuse a dispatch that is not possible now, whatever its bindings."""
        core = self.core
        call = f"dispatch of program {self.name!r}"
        core.check_open()
        core.check_usable(self, call)
        if Stage.COMPUTE not in self.descriptor.stages:
            core.refuse(
                rules.PROGRAM_STAGE, call, show_stages(self.descriptor), "a program with a compute stage"
            )
        if core.has_open_pass():
            core.refuse(rules.PASS_OPEN, call, "an open render pass")

    def make_current(self) -> None:
        """Bind this program and make it the current one; none is current while a resource is locked, or while
        a pass has targets that can't blend, as each draw then checks everything."""
        core = self.core
        core.backend.bind_program(self.id)
        core.program = None if core.locked or core.unblendable_targets else self

    def prepare_draw(self, mesh: Drawable, instances: int) -> Callable[[int], object]:
        """Prepare the draw of a mesh that this program has not drawn yet, and keep it for the next one.

        It isn't kept if the mesh's first instance lies beyond its data: only a draw of no instances is valid
        then. So a draw of one instance, the usual case, needs no check.
        """
        draw = self._make_draw(mesh)
        if mesh.base_instance < mesh.instance_count or not reads_instances(mesh, self.descriptor.attributes):
            self._cache_draw(mesh, draw)
        elif instances:
            self._check_instance_end(mesh, 1)
        return draw

    def _cache_draw(self, mesh: Drawable, draw: Callable[[int], object]) -> None:
        mesh.prepared_draws[self] = draw

    def _check_instance_end(self, mesh: Drawable, instances: int) -> None:
        """Refuse a draw of instances that the mesh doesn't have, if this program reads them."""
        if reads_instances(mesh, self.descriptor.attributes):
            call = f"draw of program {self.name!r}"
            check_instance_end(self.core, mesh, mesh.base_instance + instances, call)

    def _make_draw(self, mesh: Drawable) -> Callable[[int], object]:
        """Return the draw of a mesh as a function of the number of instances."""
        self.check_can_draw(mesh)
        return self.core.prepare_draw(
            self.id,
            self.get_vertex_array(mesh),
            mesh.primitive,
            mesh.first,
            mesh.count,
            mesh.base_vertex,
            mesh.base_instance,
        )

    def get_vertex_array(self, mesh: Drawable) -> Id:
        """Return the vertex array through which this program reads a mesh, creating it on first use."""
        vertex_array = mesh.vertex_arrays.get(self)
        return vertex_array or mesh.create_vertex_array(self, self.id, self.name, self.descriptor.attributes)

    def draw_unprepared(self, mesh: Drawable, instances: int) -> None:
        """Draw through the backend's `draw`, without a prepared draw."""
        self.core.backend.draw(
            self.get_vertex_array(mesh),
            mesh.primitive,
            mesh.first,
            mesh.count,
            instances,
            mesh.base_vertex,
            mesh.base_instance,
        )

    def pack_value(self, index: int, value: Any) -> bytes | None:
        """Return the bytes of a value for the uniform binding at `index`, None for a range of memory or a
        misfit.

        Raises:
            ValidationError: `shading-struct-value` for a dictionary that doesn't give a struct's fields.
        """
        type: Any = self.descriptor.bindings[index].type
        if value.__class__ is type and issubclass(type, Struct):
            return value.to_bytes()  # type: ignore[no-any-return]
        if isinstance(value, UniformRange | Struct | str | bytes) or value is MISSING or value is None:
            return None
        with self.core.refusals:
            if issubclass(type, Struct):
                is_named = isinstance(value, dict) and all(isinstance(name, str) for name in value)
                return type(**value).to_bytes() if is_named else None
            return pack_single(type, value)

    def take_uniform(self, index: int, value: Any) -> bytes | None:
        """Return the bytes of a value for the uniform binding at `index`, or None for a range, once it is
        checked."""
        data = self.pack_value(index, value)
        if data is None:
            self.check(index, value)
        return data

    def check(self, index: int, value: Any) -> None:
        """Refuse `value` for the binding at `index` unless its type fits and its resource can be used."""
        binding = self.descriptor.bindings[index]
        if binding.kind is BindingKind.UNIFORM and self.pack_value(index, value) is not None:
            return
        call = f"{binding.name}= of program {self.name!r}"
        if value is MISSING or value is None:
            self.core.refuse(rules.BINDING_MISSING, call, "nothing", _expected_text(binding))
        match binding.kind:
            case BindingKind.UNIFORM | BindingKind.STORAGE:
                self._check_range(binding, value, call)
            case BindingKind.TEXTURE:
                self._check_texture(binding, value, call)
            case BindingKind.IMAGE:
                self._check_image(binding, value, call)

    def _check_range(self, binding: Binding, value: Any, call: str) -> None:
        fits = isinstance(value, _RANGES[binding.kind])
        if not fits or value.type is not binding.type:
            tip = "" if isinstance(value, UniformRange | StorageRange) else _creation_tip(binding)
            self.core.refuse(rules.BINDING_TYPE, call, _actual_text(value), _expected_text(binding), tip)
        self.core.check_usable(value.owner, call)
        if binding.writes and not isinstance(value.owner, Buffer):
            tip = "make it with device.storage(…): shaders can't write transient memory"
            self.core.refuse(
                rules.BINDING_TYPE,
                call,
                "transient storage, which shaders only read",
                _expected_text(binding),
                tip,
            )
        faults = range_faults(binding.kind, value.offset, value.size, binding.size, self.core.capabilities)
        self.core.require(call, faults)

    def _check_texture(self, binding: Binding, value: Any, call: str) -> None:
        if binding.type == TextureTable.shading_type and not isinstance(value, TableBinding):
            tip = "make it with device.texture_table(images)"
            self.core.refuse(rules.BINDING_TYPE, call, _actual_text(value), _expected_text(binding), tip)
        if not isinstance(value, TextureBinding) or not isinstance(value.owner, Texture):
            self.core.refuse(rules.BINDING_TYPE, call, _actual_text(value), _expected_text(binding))
        texture = value.owner
        self.core.check_usable(texture, call)
        self._check_feedback(texture, call)
        expected: Any = binding.type
        if (texture.samples > 1) != expected.samples:
            given = f"{texture!r} of {texture.samples} samples"
            allowed, tip = (
                "a texture of several samples",
                "give the binding a type of one sample, such as Texture2D",
            )
            if texture.samples > 1:
                allowed = "a single-sampled texture"
                tip = "resolve it first: texture.resolve_to(…); or read each sample of a Texture2DSamples"
            self.core.refuse(rules.BINDING_TYPE, call, given, allowed, tip)
        if texture.kind is not expected.kind:
            self.core.refuse(
                rules.BINDING_TYPE, call, f"{texture!r}, {texture.kind.name}", _expected_text(binding)
            )
        compares = self.core.sampler_descriptors[value.sampler].compare is not None
        if expected.compare != compares:
            tip = "use texture.sampled(SamplerDescriptor(compare=…))" if expected.compare else ""
            given = "a sampler that compares" if compares else "a sampler that does not compare"
            self.core.refuse(rules.BINDING_TYPE, call, given, _expected_text(binding), tip)
        if expected.compare and not texture.format.is_depth:
            self.core.refuse(rules.BINDING_TYPE, call, texture.format.name, "a depth format")
        if shader_kind(texture.format) != str(expected.scalar):
            self.core.refuse(
                rules.BINDING_TYPE,
                call,
                f"{texture.format.name}, read as {shader_kind(texture.format)}",
                _expected_text(binding),
            )

    def _check_image(self, binding: Binding, value: Any, call: str) -> None:
        if not isinstance(value, ImageBinding) or not isinstance(value.owner, Texture):
            self.core.refuse(
                rules.BINDING_TYPE,
                call,
                _actual_text(value),
                _expected_text(binding),
                "use texture.image(level)",
            )
        texture = value.owner
        self.core.check_usable(texture, call)
        self._check_feedback(texture, call)
        expected: Any = binding.type
        if texture.format is not expected.format or texture.samples != 1:
            self.core.refuse(rules.BINDING_TYPE, call, repr(texture), _expected_text(binding))
        kind = TextureKind.D2 if value.layer is not None else texture.kind
        if kind is not expected.kind:
            self.core.refuse(rules.BINDING_TYPE, call, f"{texture!r}, {kind.name}", _expected_text(binding))

    def _check_feedback(self, texture: Texture, call: str) -> None:
        core = self.core
        if texture.id in core.targets:
            core.refuse(rules.PASS_FEEDBACK, call, f"{texture!r}, a target of the open pass")
        resolved = (
            [color.resolve for color in core.render_pass.colors] if core.render_pass is not None else []
        )
        if texture.id in resolved and not core.capabilities.resolve_feedback:
            allowed = "another texture, without capabilities.resolve_feedback"
            tip = ALTERNATIVES["resolve_feedback"]
            core.refuse(
                rules.PASS_FEEDBACK, call, f"{texture!r}, to which the open pass resolves", allowed, tip
            )

    def check_aliases(self, values: tuple[Any, ...], mesh: Drawable | None) -> None:
        """Refuse memory that this program writes and uses a second time; `mesh` is None for a dispatch."""
        bindings = self.descriptor.bindings
        for binding, value in zip(bindings, values, strict=True):
            if not binding.writes:
                continue
            for other, used in zip(bindings, values, strict=True):
                if other is not binding and _is_alias(binding, value, other, used):
                    self._refuse_alias(f"{binding.name}= and {other.name}=", value)
            vertices = mesh.buffers if mesh is not None and binding.kind is BindingKind.STORAGE else ()
            if any(buffer is value.owner for buffer in vertices):
                self._refuse_alias(f"{binding.name}= and the mesh", value)

    def _refuse_alias(self, uses: str, value: Any) -> NoReturn:
        self.core.refuse(
            rules.DEVICE_CAPABILITY,
            f"draw or dispatch of program {self.name!r}",
            f"{describe_object(value.owner)} as {uses}",
            "memory that is written once, without capabilities.aliased_writes",
            ALTERNATIVES["aliased_writes"],
        )

    def explain(self, error: Exception, values: tuple[Any, ...], *meshes: object) -> Exception:
        """Return the refusal for the argument that caused a Python error in a generated function; without
        one, the error."""
        try:
            for mesh in meshes:
                if not isinstance(mesh, Drawable):
                    call = f"draw of program {self.name!r}"
                    self.core.refuse(rules.DEVICE_ARGUMENT, call, repr(mesh), "a Mesh from device.mesh(…)")
            for index, value in enumerate(values):
                self.check(index, value)
        except ValidationError as refusal:
            return refusal.with_traceback(None)
        return error

    def check_names(self, argument_names: Iterable[str]) -> None:
        """Refuse unknown and missing names of bindings."""
        names = set(argument_names)
        declared = {binding.name for binding in self.descriptor.bindings if not binding.table}
        self.check_unknown(names - declared)
        if declared - names:
            missing_text = f"nothing for {', '.join(sorted(declared - names))}"
            declared_text = ", ".join(sorted(declared))
            self.core.refuse(
                rules.BINDING_MISSING, f"draw of program {self.name!r}", missing_text, declared_text
            )

    def check_unknown(self, names: Iterable[str]) -> None:
        """Refuse names that aren't bindings; a name that the shader declares but doesn't read causes one
        warning."""
        declared = {binding.name for binding in self.descriptor.bindings if not binding.table}
        unknown = sorted(set(names) - self._left_out.keys())
        if unknown:
            declared_text = ", ".join(sorted(declared)) or "no bindings"
            self.core.refuse(
                rules.BINDING_UNKNOWN, f"draw of program {self.name!r}", ", ".join(unknown), declared_text
            )
        for name in sorted(names):
            if name not in declared and not self._left_out[name]:
                self._left_out[name] = True
                site = find_call_site() or CallSite("rhi", 1)
                text = (
                    f"program {self.name!r} doesn't read {name!r}, which a draw passes; the value is ignored"
                )
                warnings.warn_explicit(text, ShaderWarning, site.file, site.line)

    def check_instances(self, instances: Any, mesh: Drawable) -> int:
        """Return the number of instances as an int; refuse an invalid one, and one that `mesh` doesn't
        have."""
        if instances.__class__ is not int or not 0 <= instances <= MAX_INSTANCES:
            check = ArgumentChecker(f"draw of program {self.name!r}", self.core.refuse, rules.DRAW_COUNT)
            instances = check.integer("instances", instances, 0, MAX_INSTANCES)
        if mesh.instance_fields and instances:
            self._check_instance_end(mesh, instances)
        return int(instances)


def _is_alias(written: Binding, value: Any, other: Binding, used: Any) -> bool:
    """True if two values of a program's bindings, of which the first is written, share memory."""
    if written.kind is BindingKind.IMAGE:
        if other.kind is not BindingKind.IMAGE or used.texture != value.texture or used.level != value.level:
            return False
        return value.layer is None or used.layer is None or value.layer == used.layer
    if other.kind not in _RANGES or not isinstance(used, UniformRange | StorageRange):
        return False
    if used.buffer != value.buffer:
        return False
    return not other.writes or (
        value.offset < used.offset + used.size and used.offset < value.offset + value.size
    )


def check_program(core: Core, program: object, call: str) -> None:
    """Refuse anything but a usable program."""
    check = ArgumentChecker(call, core.refuse)
    core.check_usable(check.instance("program", program, Program, "a Program from device.program(…)"), call)


class ProgramTable:
    """The programs of a device, by their shader class or descriptor. Destroyed programs leave it."""

    def __init__(self, timeline: Timeline, precision: Precision = Precision.EXACT) -> None:
        """Create an empty table. `precision` is for shaders that don't state one."""
        self.precision = precision
        self._timeline = timeline
        self._programs: dict[object, Program[...]] = {}
        self._shaders: dict[Id, object] = {}

    def compile(self, shader: type[Shader]) -> ProgramDescriptor:
        """Compile a shader in its own precision, or else in the device's."""
        from rhi.shading.compile import describe_with_precision  # slow to import: when a program needs it

        return describe_with_precision(shader, self.precision)

    def list_exact_functions(self, shader: type[Shader]) -> list[str]:
        """Return the functions of a shader that run in `Precision.EXACT` here and have a faster form."""
        from rhi.shading.compile import list_exact_functions

        return list_exact_functions(shader) if self.compile(shader).flushes_denormals is False else []

    def find(self, shader: object) -> Program[...] | None:
        """Return the program of a shader, None if there is none."""
        return self._programs.get(shader)

    def items(self) -> list[tuple[object, Program[...]]]:
        """Return all programs with what they were made of."""
        return list(self._programs.items())

    def add(self, shader: object, program: Program[...]) -> None:
        """Keep a program until it is destroyed."""
        self._programs[shader], self._shaders[program.id] = program, shader
        self._timeline.watch(self, program.id)

    def note_retired(self, resource: Id) -> None:
        """Drop a program that is destroyed; called by `Timeline`."""
        self._programs.pop(self._shaders.pop(resource, None), None)


def shader_kind(form: Format) -> str:
    """The scalar type in which shaders read a format's channels: "float", "int" or "uint"."""
    return {ChannelKind.UINT: "uint", ChannelKind.INT: "int"}.get(form.kind, "float")


def _actual_text(value: object) -> str:
    element = getattr(value, "type", None)
    name = getattr(element, "__name__", None)
    return f"{describe_object(value)}{f' of {name}' if name else ''}"


def _expected_text(binding: Binding) -> str:
    return f"{binding.kind.name.lower()} of {_type_name(binding)}"


def _type_name(binding: Binding) -> str:
    return getattr(binding.type, "__name__", None) or str(binding.type)


def _creation_tip(binding: Binding) -> str:
    """Return the call that creates a value for a uniform or storage binding, as a tip."""
    name = _type_name(binding)
    if binding.kind is BindingKind.STORAGE:
        return f"make it with device.storage({name}, …)"
    value = f"{name}(…)" if isinstance(binding.type, type) and issubclass(binding.type, Struct) else "…"
    return f"give the value itself, {value}, or keep it in device.uniform({value})"


def _check_limits(core: Core, descriptor: ProgramDescriptor) -> None:
    call = f"device.program({descriptor.name})"
    core.check_ready()
    core.require(call, program_faults(descriptor, core.capabilities))
    for binding in descriptor.bindings:
        if binding.name == "self" or keyword.iskeyword(binding.name):
            core.refuse(rules.BINDING_NAME, call, binding.name, "a name that can be a keyword argument")
