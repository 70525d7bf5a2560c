"""Programs and vertex arrays: what a draw runs and what it reads.

- A `Pipeline` is one linked program with a table from vertex array to the C function that draws it. The
  backend keeps the bound pipeline's table, so a draw is one look-up and one call; what is special about a
  program (it writes memory, it does the alpha test) is in the functions of its table, and a program that
  isn't special pays nothing.
- moderngl ties a vertex array to one program, so a table makes its entries when they are first asked for.
- A vertex stage gets an end that flips y: GL's window y runs up, ours down (`backend` says why it isn't left to
  clip control).
- GL's core profile has no alpha test: a program gets a variant per comparison whose fragment stage ends in the
  test, compiled when it is first drawn with; the reference is a uniform.
- Both are done by renaming `main` and calling it from another, which keeps the lines of the text.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Final, TypeAlias

import moderngl

from rhi.backends.gl import enums
from rhi.backends.gl.driver_log import make_shader_error
from rhi.backends.gl.entry_points import EntryPoints
from rhi.backends.gl.formats import VERTEX_TYPES
from rhi.backends.gl.resources import Buffers
from rhi.contract.descriptors import Id, ProgramDescriptor, Stage, StageText, VertexArrayDescriptor
from rhi.contract.states import AlphaFunction

__rhi_internal__ = True

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
_TITLES: Final = {
    "vertex_shader": Stage.VERTEX,
    "fragment_shader": Stage.FRAGMENT,
    "compute_shader": Stage.COMPUTE,
}


class VertexArrays:
    """All vertex arrays of one context; GL's objects are made per pipeline."""

    def __init__(self, context: moderngl.Context, gl: EntryPoints, buffers: Buffers) -> None:
        self._context = context
        self._gl = gl
        self._buffers = buffers
        self.descriptors: dict[Id, VertexArrayDescriptor] = {}

    def make(self, vertex_array: Id, program: GlProgram) -> moderngl.VertexArray:
        """moderngl's vertex array for a program of moderngl."""
        gl, descriptor = self._gl, self.descriptors[vertex_array]
        objects = self._buffers.objects
        indices = objects[descriptor.index_buffer] if descriptor.index_buffer else None
        made = self._context.vertex_array(program, [], indices, descriptor.index_format.size)
        for binding, stream in enumerate(descriptor.streams):
            gl.VertexArrayVertexBuffer(
                made.glo, binding, objects[stream.buffer].glo, stream.offset, stream.stride
            )
            gl.VertexArrayBindingDivisor(made.glo, binding, int(stream.per_instance))
            for attribute in stream.attributes:
                texel, location = attribute.format, attribute.location
                kind = VERTEX_TYPES[texel]
                if texel.kind == "float":
                    gl.VertexArrayAttribFormat(
                        made.glo, location, texel.components, kind, texel.normalized, attribute.offset
                    )
                else:
                    gl.VertexArrayAttribIFormat(made.glo, location, texel.components, kind, attribute.offset)
                gl.VertexArrayAttribBinding(made.glo, location, binding)
                gl.EnableVertexArrayAttrib(made.glo, location)
        return made


class Pipeline(dict[Id, Render]):
    """A linked program, as the table of what draws each vertex array with it.

    Attributes:
        program: moderngl's program or compute shader.
        writes_memory: whether what follows must be made to see what it wrote.
    """

    def __init__(
        self, gl: EntryPoints, arrays: VertexArrays, program: GlProgram, writes_memory: bool
    ) -> None:
        super().__init__()
        self._gl = gl
        self._arrays = arrays
        self._made: dict[Id, moderngl.VertexArray] = {}
        self.program = program
        self.writes_memory = writes_memory

    def __missing__(self, vertex_array: Id) -> Render:
        made = self._made[vertex_array] = self._arrays.make(vertex_array, self.program)
        render: Render = made.mglo.render
        self[vertex_array] = self.then_memory_barrier(render) if self.writes_memory else render
        return self[vertex_array]

    def prepare(self, vertex_array: Id) -> None:
        """Make what a draw of `vertex_array` needs, if it isn't there."""
        if vertex_array not in self:
            self.__missing__(vertex_array)

    def memory_barrier(self) -> None:
        """Make what was written visible to all that follows, whatever reads it and how."""
        self._gl.MemoryBarrier(enums.ALL_BARRIER_BITS)

    def dispatch(self, x: int, y: int, z: int) -> None:
        self.program.mglo.run(x, y, z)
        self.memory_barrier()

    def dispatch_indirect(self, buffer: moderngl.Buffer, offset: int) -> None:
        self.program.mglo.run_indirect(buffer.mglo, offset)
        self.memory_barrier()

    def use(self, vertex_array: Id) -> int:
        """Make program and vertex array current for a draw through GL itself; the vertex array's name."""
        self.prepare(vertex_array)
        name: int = self._made[vertex_array].glo
        self._gl.UseProgram(self.program.glo)
        self._gl.BindVertexArray(name)
        return name

    def forget(self, vertex_array: Id) -> None:
        if self.pop(vertex_array, None) is not None:
            self._made.pop(vertex_array).release()

    def release(self) -> None:
        for vertex_array in list(self):
            self.forget(vertex_array)
        self.program.release()

    def then_memory_barrier(self, draw: Callable[..., object]) -> Callable[..., object]:
        """A draw, and what it wrote made visible."""
        memory_barrier = self.memory_barrier

        def draw_and_barrier(*arguments: object) -> None:
            draw(*arguments)
            memory_barrier()

        return draw_and_barrier


class _Program:
    """A program's descriptor, its pipeline and the variants of that for the alpha test."""

    def __init__(self, descriptor: ProgramDescriptor, pipeline: Pipeline) -> None:
        self.descriptor = descriptor
        self.pipeline = pipeline
        self.variants: dict[AlphaFunction, tuple[Pipeline, int]] = {}  # and the location of the reference

    @property
    def pipelines(self) -> list[Pipeline]:
        return [self.pipeline, *(pipeline for pipeline, _ in self.variants.values())]


class Programs:
    """All programs of one context."""

    def __init__(self, context: moderngl.Context, gl: EntryPoints, arrays: VertexArrays) -> None:
        self._context = context
        self._gl = gl
        self._arrays = arrays
        self._programs: dict[Id, _Program] = {}

    def __getitem__(self, program: Id) -> Pipeline:
        return self._programs[program].pipeline

    def create(self, program: Id, descriptor: ProgramDescriptor) -> None:
        sources = {stage: descriptor.emit("glsl", stage) for stage in descriptor.stages}
        self._programs[program] = _Program(descriptor, self._link(descriptor, sources))

    def destroy(self, program: Id) -> None:
        for pipeline in self._programs.pop(program).pipelines:
            pipeline.release()

    def forget_vertex_array(self, vertex_array: Id) -> None:
        for program in self._programs.values():
            for pipeline in program.pipelines:
                pipeline.forget(vertex_array)

    def find_alpha_tested(self, program: Id, function: AlphaFunction, reference: float) -> Pipeline:
        """The pipeline that drops fragments unless `alpha function reference`."""
        made = self._programs[program]
        if function not in made.variants:
            source = add_alpha_test(made.descriptor, function)
            if source is None:
                return made.pipeline
            sources = {stage: made.descriptor.emit("glsl", stage) for stage in made.descriptor.stages}
            pipeline = self._link(made.descriptor, sources | {Stage.FRAGMENT: source})
            location = self._gl.GetUniformLocation(pipeline.program.glo, b"rhi_alpha_reference")
            made.variants[function] = pipeline, location
        pipeline, location = made.variants[function]
        if location >= 0:
            self._gl.ProgramUniform1f(pipeline.program.glo, location, reference)
        return pipeline

    def _link(self, descriptor: ProgramDescriptor, sources: dict[Stage, StageText]) -> Pipeline:
        if Stage.VERTEX in sources:
            sources[Stage.VERTEX] = _extend_main(sources[Stage.VERTEX], "gl_Position.y = -gl_Position.y;")
        # Bytes, because moderngl strips and preprocesses text, which would move its lines.
        encoded = {stage: source.text.encode() for stage, source in sources.items()}
        program: GlProgram
        try:
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
        return Pipeline(self._gl, self._arrays, program, descriptor.writes_memory)


def add_alpha_test(descriptor: ProgramDescriptor, function: AlphaFunction) -> StageText | None:
    """The fragment stage's source ending in the test, or None where it tests nothing: with ALWAYS, and for
    programs that give target 0 no alpha."""
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
    """`source` with `statement` at the end of its main function."""
    renamed = _MAIN.sub("void rhi_inner_main()", source.text)
    text = f"{renamed}\n{declaration}\nvoid main() {{ rhi_inner_main(); {statement} }}\n"
    return StageText(text, source.origins)


def _split_message(message: str) -> tuple[str, str]:
    """moderngl's message is what failed, an empty line, which stage, a line of `=`, and the driver's log."""
    parts = message.split("\n", 4)
    return (parts[2], parts[4]) if len(parts) == 5 else ("", message)
