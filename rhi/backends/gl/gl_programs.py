"""Programs and vertex arrays: the code that a draw executes and the inputs that it reads.

- A `LinkedProgram` is a program with a table from vertex array to the C function that draws it. The backend
  keeps the table of the bound program, so a draw is one look-up and one call. Programs that write memory or
  have an alpha test have other functions in their tables, so ordinary programs pay nothing for them.
- moderngl ties a vertex array to one program, so entries of a table are created on first use.
- Each vertex stage ends by negating y, because GL's window y points up and ours down (`backend` says why clip
  control doesn't do this).
- GL's core profile has no alpha test. Instead, a program gets a variant for each comparison, compiled on
  first use, whose fragment stage ends with the test. The reference is a uniform.
- llvmpipe's vertex stages read textures while these may still be drawn, so a draw whose vertex stage reads
  one first waits (`llvmpipe`).
- Both endings are added by renaming `main` and calling it from a new one, which keeps the line numbers of the
  source.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final, TypeAlias

import moderngl

from rhi.backends.gl import enums
from rhi.backends.gl.entry_points import EntryPoints
from rhi.backends.gl.gl_buffers import Buffers
from rhi.backends.gl.gl_driver_log import make_shader_error
from rhi.backends.gl.gl_formats import VERTEX_TYPES
from rhi.contract.descriptors import Id, ProgramDescriptor, Stage, StageText, VertexArrayDescriptor
from rhi.contract.interrupts import DeferredSignals
from rhi.contract.limits import ElementCounts, count_elements
from rhi.contract.states import AlphaFunction

GlProgram: TypeAlias = moderngl.Program | moderngl.ComputeShader

Render: TypeAlias = Callable[[int, int, int, int], object]
"""(GL mode, count, first, instances)"""

_OPERATORS: Final = {
    AlphaFunction.LESS: "<",
    AlphaFunction.EQUAL: "==",
    AlphaFunction.LESS_EQUAL: "<=",
    AlphaFunction.GREATER: ">",
    AlphaFunction.NOT_EQUAL: "!=",
    AlphaFunction.GREATER_EQUAL: ">=",
}
_MAIN: Final = re.compile(r"\bvoid\s+main\s*\(\s*(?:void)?\s*\)")
_OUTPUT: Final = re.compile(r"\blayout\s*\([^)]*\blocation\s*=\s*0\b[^)]*\)\s*out\s+vec4\s+(\w+)")
_DROP_LAYERS: Final = (
    " if (rhi_layer_count >= 0 && uint(gl_Layer) >= uint(rhi_layer_count))"
    " gl_Position = vec4(2.0, 0.0, 0.0, 1.0);"
)
_READS_TEXELS: Final = re.compile(r"\buniform\b[^;]*\b[iu]?(?:sampler|image)(?:2D|3D|Cube)")
_TITLES: Final = {
    "vertex_shader": Stage.VERTEX,
    "fragment_shader": Stage.FRAGMENT,
    "compute_shader": Stage.COMPUTE,
}


class VertexArrays:
    """The vertex arrays of one context. Their GL objects are created once for each linked program that uses
    them.

    Attributes:
        check_context: called before draws create something on first use; raises if another context is
            current.
    """

    def __init__(
        self, context: moderngl.Context, gl: EntryPoints, buffers: Buffers, check_context: Callable[[], None]
    ) -> None:
        self.check_context = check_context
        self._context = context
        self._gl = gl
        self._buffers = buffers
        self.descriptors: dict[Id, VertexArrayDescriptor] = {}
        self._elements: dict[Id, ElementCounts] = {}

    def count_elements(self, vertex_array: Id) -> ElementCounts:
        """Return the number of elements in the buffers of a vertex array."""
        elements = self._elements.get(vertex_array)
        if elements is None:
            elements = self._elements[vertex_array] = count_elements(
                self.descriptors[vertex_array], lambda buffer: self._buffers.objects[buffer].size
            )
        return elements

    def destroy(self, vertex_array: Id) -> None:
        """Forget a vertex array."""
        del self.descriptors[vertex_array]
        self._elements.pop(vertex_array, None)

    def create(self, vertex_array: Id, program: GlProgram) -> moderngl.VertexArray:
        """Create moderngl's vertex array for one of moderngl's programs."""
        self.check_context()
        gl, descriptor = self._gl, self.descriptors[vertex_array]
        objects = self._buffers.objects
        indices = objects[descriptor.index_buffer] if descriptor.index_buffer else None
        array = self._context.vertex_array(program, [], indices, descriptor.index_format.size)
        for binding, stream in enumerate(descriptor.streams):
            gl.VertexArrayVertexBuffer(
                array.glo, binding, objects[stream.buffer].glo, stream.offset, stream.stride
            )
            gl.VertexArrayBindingDivisor(array.glo, binding, int(stream.per_instance))
            for attribute in stream.attributes:
                texel, location = attribute.format, attribute.location
                kind = VERTEX_TYPES[texel]
                if texel.kind == "float":
                    gl.VertexArrayAttribFormat(
                        array.glo, location, texel.components, kind, texel.normalized, attribute.offset
                    )
                else:
                    gl.VertexArrayAttribIFormat(array.glo, location, texel.components, kind, attribute.offset)
                gl.VertexArrayAttribBinding(array.glo, location, binding)
                gl.EnableVertexArrayAttrib(array.glo, location)
        return array


class LinkedProgram(dict[Id, Render]):
    """A linked program: a table from vertex array to the function that draws it with this program.

    Attributes:
        program: moderngl's program or compute shader.
        writes_memory: whether the program writes memory, so that a memory barrier follows each draw.
        outputs: the color targets, as bits, that the fragment stage has an output for.
        has_layer: whether the vertex stage chooses the target's layer.
    """

    def __init__(
        self,
        gl: EntryPoints,
        arrays: VertexArrays,
        program: GlProgram,
        descriptor: ProgramDescriptor,
        finish: Callable[[], None] | None,
    ) -> None:
        """`finish` is called before each draw."""
        super().__init__()
        self._gl = gl
        self._arrays = arrays
        self._vertex_arrays: dict[Id, moderngl.VertexArray] = {}
        self.program = program
        self.writes_memory = descriptor.writes_memory
        self.outputs = sum(1 << output.location for output in descriptor.outputs)
        self._finish = finish
        self.has_layer = bool(descriptor.target_layer)
        self._layer_count = 0

    def __missing__(self, vertex_array: Id) -> Render:
        array = self._vertex_arrays[vertex_array] = self._arrays.create(vertex_array, self.program)
        render: Render = array.mglo.render
        if self._finish is not None:
            render = _precede(render, self._finish)
        self[vertex_array] = self.then_memory_barrier(render) if self.writes_memory else render
        return self[vertex_array]

    def prepare(self, vertex_array: Id) -> None:
        """Create the entry of `vertex_array` if it doesn't exist yet."""
        if vertex_array not in self:
            self.__missing__(vertex_array)

    def set_layer_count(self, count: int) -> None:
        """Tell a vertex stage that chooses a layer how many the targets have: GL leaves undefined what others
        do, so it drops them itself. `count`: −1 for a pass without layers."""
        if count != self._layer_count:
            location = self._gl.GetUniformLocation(self.program.glo, b"rhi_layer_count")
            if location >= 0:
                self._gl.ProgramUniform1i(self.program.glo, location, count)
            self._layer_count = count

    def memory_barrier(self) -> None:
        """Make all writes so far visible to all later reads."""
        self._gl.MemoryBarrier(enums.ALL_BARRIER_BITS)

    def dispatch(self, x: int, y: int, z: int) -> None:
        self.program.mglo.run(x, y, z)
        self.memory_barrier()

    def dispatch_indirect(self, buffer: moderngl.Buffer, offset: int) -> None:
        self.program.mglo.run_indirect(buffer.mglo, offset)
        self.memory_barrier()

    def use(self, vertex_array: Id) -> int:
        """Bind the program and a vertex array, for draws through an entry point. Return the vertex array's GL
        name."""
        self.prepare(vertex_array)
        if self._finish is not None:
            self._finish()
        name: int = self._vertex_arrays[vertex_array].glo
        self._gl.UseProgram(self.program.glo)
        self._gl.BindVertexArray(name)
        return name

    def forget(self, vertex_array: Id) -> None:
        if self.pop(vertex_array, None) is not None:
            self._vertex_arrays.pop(vertex_array).release()

    def release(self) -> None:
        for vertex_array in list(self):
            self.forget(vertex_array)
        self.program.release()

    def then_memory_barrier(self, draw: Callable[..., object]) -> Callable[..., object]:
        """Return a function that calls `draw` and then issues a memory barrier."""
        memory_barrier = self.memory_barrier

        def draw_and_barrier(*arguments: object) -> None:
            draw(*arguments)
            memory_barrier()

        return draw_and_barrier


def _precede(draw: Render, finish: Callable[[], None]) -> Render:
    """Return a function that calls `finish` and then `draw`."""

    def finish_and_draw(mode: int, count: int, first: int, instances: int) -> None:
        finish()
        draw(mode, count, first, instances)

    return finish_and_draw


class _ProgramVariants:
    """A program's descriptor, its linked program, and its variants with an alpha test.

    Attributes:
        variants: by comparison, the linked variant and the location of its reference uniform (-1: none).
    """

    def __init__(self, descriptor: ProgramDescriptor, linked: LinkedProgram) -> None:
        self.descriptor = descriptor
        self.linked = linked
        self.variants: dict[AlphaFunction, tuple[LinkedProgram, int]] = {}

    @property
    def all_linked(self) -> list[LinkedProgram]:
        return [self.linked, *(linked for linked, _ in self.variants.values())]


class Programs:
    """The programs of one context.

    Attributes:
        instrument: changes the text of each stage before it is compiled.
    """

    def __init__(
        self,
        context: moderngl.Context,
        gl: EntryPoints,
        arrays: VertexArrays,
        finish: Callable[[], None] | None,
    ) -> None:
        """`finish` is called before draws whose vertex stage reads textures, if the driver doesn't wait for
        them."""
        self._context = context
        self._gl = gl
        self._arrays = arrays
        self._finish = finish
        self.instrument: Callable[[StageText], StageText] = lambda source: source
        self._programs: dict[Id, _ProgramVariants] = {}

    def __getitem__(self, program: Id) -> LinkedProgram:
        return self._programs[program].linked

    def create(self, program: Id, descriptor: ProgramDescriptor) -> None:
        self._programs[program] = _ProgramVariants(descriptor, self._link(descriptor))

    def destroy(self, program: Id) -> None:
        for linked in self._programs.pop(program).all_linked:
            linked.release()

    def forget_vertex_array(self, vertex_array: Id) -> None:
        for program in self._programs.values():
            for linked in program.all_linked:
                linked.forget(vertex_array)

    def get_alpha_tested(self, program: Id, function: AlphaFunction, reference: float) -> LinkedProgram:
        """Return the variant that discards fragments unless `alpha function reference`, creating it on first
        use."""
        state = self._programs[program]
        if function not in state.variants:
            fragment = add_alpha_test(state.descriptor, function)
            if fragment is None:
                return state.linked
            linked = self._link(state.descriptor, fragment)
            location = self._gl.GetUniformLocation(linked.program.glo, b"rhi_alpha_reference")
            state.variants[function] = linked, location
        linked, location = state.variants[function]
        if location >= 0:
            self._gl.ProgramUniform1f(linked.program.glo, location, reference)
        return linked

    def _link(self, descriptor: ProgramDescriptor, fragment: StageText | None = None) -> LinkedProgram:
        """Compile and link a program. `fragment` replaces the source of its fragment stage."""
        self._arrays.check_context()
        sources = {stage: self.instrument(descriptor.emit("glsl", stage)) for stage in descriptor.stages}
        if fragment is not None:
            sources[Stage.FRAGMENT] = self.instrument(fragment)
        if Stage.VERTEX in sources:
            ending, declaration = "gl_Position.y = -gl_Position.y;", ""
            if descriptor.target_layer:
                ending, declaration = ending + _DROP_LAYERS, "uniform int rhi_layer_count;"
            sources[Stage.VERTEX] = _extend_main(sources[Stage.VERTEX], ending, declaration)
        # Bytes, because moderngl strips and preprocesses text, which would change its line numbers.
        encoded = {stage: source.text.encode() for stage, source in sources.items()}
        program: GlProgram
        try:
            with (
                DeferredSignals()
            ):  # moderngl calls Python from C: what a handler raised would end the process
                if Stage.COMPUTE in encoded:
                    program = self._context.compute_shader(encoded[Stage.COMPUTE])
                else:
                    program = self._context.program(
                        vertex_shader=encoded[Stage.VERTEX], fragment_shader=encoded.get(Stage.FRAGMENT)
                    )
        except moderngl.Error as error:
            title, log = _split_message(str(error))
            stage = _TITLES.get(title)
            source = sources[stage] if stage is not None else StageText("")
            raise make_shader_error(descriptor, log, stage, source) from None
        if descriptor.name:
            self._gl.ObjectLabel(enums.PROGRAM, program.glo, -1, descriptor.name.encode())
        vertex = sources.get(Stage.VERTEX)
        finish = self._finish if vertex is not None and _READS_TEXELS.search(vertex.text) else None
        return LinkedProgram(self._gl, self._arrays, program, descriptor, finish)


def add_alpha_test(descriptor: ProgramDescriptor, function: AlphaFunction) -> StageText | None:
    """Return the source of the fragment stage with an alpha test at its end.

    Returns None if there is nothing to test: for ALWAYS, and for programs that write no alpha to target 0.
    """
    output = next((o for o in descriptor.outputs if o.location == 0), None)
    if function is AlphaFunction.ALWAYS or output is None or (output.kind, output.components) != ("float", 4):
        return None
    source = descriptor.emit("glsl", Stage.FRAGMENT)
    declared = _OUTPUT.search(source.text)
    alpha = f"{declared[1] if declared else output.name}.a"
    passes = (
        "false" if function is AlphaFunction.NEVER else f"{alpha} {_OPERATORS[function]} rhi_alpha_reference"
    )
    return _extend_main(source, f"if (!({passes})) discard;", "uniform float rhi_alpha_reference;")


def _extend_main(source: StageText, statement: str, declaration: str = "") -> StageText:
    """Return `source` with `statement` added at the end of its main function."""
    renamed = _MAIN.sub("void rhi_inner_main()", source.text)
    text = f"{renamed}\n{declaration}\nvoid main() {{ rhi_inner_main(); {statement} }}\n"
    return StageText(text, source.origins)


def _split_message(message: str) -> tuple[str, str]:
    """Return the stage's title and the driver's log from a message of moderngl.

    Its lines are: what failed, an empty line, the title of the stage, a line of `=`, and the log.
    """
    parts = message.split("\n", 4)
    return (parts[2], parts[4]) if len(parts) == 5 else ("", message)
