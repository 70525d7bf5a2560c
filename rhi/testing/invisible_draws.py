"""`explain_invisible_draw(draw)`: possible causes for a recorded draw not being visible.

- Only the recorded commands are examined; no shader runs. So a cause is either *certain*, if the draw can't
  have had any effect (an empty scissor), or *possible* and worth checking (back faces are culled).
- Certain causes come first.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from rhi.commands.ops import DISPATCHES, DRAWS, Op
from rhi.commands.stream import Command, CommandStream
from rhi.contract.descriptors import (
    ALL_LAYERS,
    BindingKind,
    BufferDescriptor,
    PassDescriptor,
    Primitive,
    ProgramDescriptor,
    Stage,
)
from rhi.contract.states import (
    AlphaFunction,
    AlphaTest,
    BlendFactor,
    BlendFunction,
    BlendOperation,
    ColorWrite,
    Comparison,
    CullMode,
    DepthFunction,
    DepthTest,
    DepthWrite,
    Scissor,
    StencilBack,
    StencilFront,
    StencilTest,
    Viewport,
)
from rhi.testing.arguments import read_command
from rhi.testing.buffer_tracking import bindings_of
from rhi.testing.conditions import describe_resource
from rhi.testing.messages import fail

_MIN_VERTICES: Final = {
    Primitive.POINTS: 1,
    Primitive.LINES: 2,
    Primitive.LINE_STRIP: 2,
    Primitive.TRIANGLES: 3,
    Primitive.TRIANGLE_STRIP: 3,
    Primitive.TRIANGLE_FAN: 3,
    Primitive.QUADS: 4,
}
_FACES: Final = frozenset(Primitive) - {Primitive.POINTS, Primitive.LINES, Primitive.LINE_STRIP}
_FILLS: Final = DISPATCHES | {Op.WRITE_BUFFER, Op.COPY_BUFFER, Op.CLEAR_BUFFER}


@dataclass(frozen=True, slots=True)
class Cause:
    """A cause that could hide a draw.

    Attributes:
        subject: the name of the state type, argument or binding that is responsible.
        text: the cause in a sentence.
        certain: whether it hides the draw for sure.
    """

    subject: str
    text: str
    certain: bool

    def __str__(self) -> str:
        return f"{'certain' if self.certain else 'perhaps'}: {self.text}"


def explain_invisible_draw(draw: Command) -> list[Cause]:
    """List the causes that could keep `draw` from being visible, certain ones first; empty if none was found.

    Raises:
        AssertionError: the command isn't a draw.
        ValidationError: `assertion-argument` for what is no command, `command-cleared` if the stream has been
            cleared since the draw.

    Examples:
        >>> with device.render_pass(image), device.states(rhi.Scissor(0, 0, 0, 0)):
        ...     device.draw(program, mesh, tint=(1, 0, 0, 1))
        >>> explain_invisible_draw(device.stream.draws()[-1])[0].subject
        'Scissor'
    """
    if read_command("explain_invisible_draw", draw).op not in DRAWS:
        fail(f"a {draw.op.method} is not a draw")
    causes = [
        *_call(draw),
        *_coverage(draw),
        *_tests(draw),
        *_writes(draw),
        *_memory(draw),
        *_afterwards(draw),
    ]
    return sorted(causes, key=lambda cause: not cause.certain)


def _certain(subject: str, text: str) -> Cause:
    return Cause(subject, text, True)


def _possible(subject: str, text: str) -> Cause:
    return Cause(subject, text, False)


def _call(draw: Command) -> Iterator[Cause]:
    """Yield causes in the arguments of the call."""
    if draw.failure is not None:
        yield _certain("failure", f"the call failed: {draw.failure.message.splitlines()[0]}")
    if draw.render_pass is None:
        yield _certain("pass", "it isn't in a render pass")
    if draw.op is Op.DRAW:
        minimum = _MIN_VERTICES[draw["primitive"]]
        if draw["count"] < minimum:
            yield _certain(
                "count",
                f"count={draw['count']} is too few for {draw['primitive'].name}, which need {minimum}",
            )
        if draw["instances"] == 0:
            yield _certain("instances", "instances=0 draws nothing")
    else:
        if draw["draws"] == 0:
            yield _certain("draws", "draws=0 draws nothing")
        if draw["count_buffer"]:
            yield _possible("count_buffer", "the number of draws comes from a buffer and may be 0")
    if _inside(draw, Op.BEGIN_CONDITIONAL, Op.END_CONDITIONAL):
        yield _possible("conditional", "it is rendered conditionally: the query may have counted no samples")


def _coverage(draw: Command) -> Iterator[Cause]:
    """Yield causes in scissor, viewport and culling."""
    target, states = draw.render_pass, draw.states
    scissor: Any = states[Scissor]
    viewport: Any = states[Viewport]
    if scissor.width == 0 or scissor.height == 0:
        yield _certain("Scissor", f"the scissor is empty: {scissor!r}")
    elif target is not None and _is_outside(scissor, target.size):
        yield _certain("Scissor", f"{scissor!r} lies outside the target of {_size(target)}")
    if viewport is not Viewport.TARGET:
        if viewport.width == 0 or viewport.height == 0:
            yield _certain("Viewport", f"the viewport is empty: {viewport!r}")
        elif target is not None and _is_outside(viewport, target.size):
            yield _certain("Viewport", f"{viewport!r} lies outside the target of {_size(target)}")
        elif scissor is not Scissor.OFF and not _overlap(scissor, viewport):
            yield _certain("Scissor", f"{scissor!r} and {viewport!r} don't overlap")
    mode = states[CullMode]
    if mode is not CullMode.NONE and draw["primitive"] in _FACES:
        side = "back" if mode is CullMode.BACK else "front"
        yield _possible("CullMode", f"{side} faces are culled; its triangles may be wound the other way")


def _tests(draw: Command) -> Iterator[Cause]:
    """Yield causes in the fragment tests."""
    target, states = draw.render_pass, draw.states
    depth = target.depth if target is not None else None
    if depth is not None and states[DepthTest] is DepthTest.ON:
        function = states[DepthFunction]
        if function is DepthFunction.NEVER:
            yield _certain("DepthFunction", "DepthFunction.NEVER rejects all fragments")
        elif depth.clear is not None and (function, depth.clear) in (
            (DepthFunction.GREATER, 1.0),
            (DepthFunction.LESS, 0.0),
        ):
            yield _certain(
                "DepthFunction",
                f"depth was cleared to {depth.clear:g}, and {function!s} rejects all fragments there "
                "(reversed depth is cleared to 0 and tested with GREATER)",
            )
        elif function is DepthFunction.EQUAL and not _has_earlier_draws(draw):
            yield _possible(
                "DepthFunction", "it tests for EQUAL depth, but it is the first draw of this pass"
            )
        elif function is not DepthFunction.ALWAYS:
            yield _possible("DepthFunction", f"it may be hidden by earlier draws ({function!s})")
    if states[StencilTest] is StencilTest.ON and depth is not None:
        front: Any = states[StencilFront]
        back: Any = states[StencilBack]
        if front.function is Comparison.NEVER and back.function is Comparison.NEVER:
            yield _certain("StencilFront", "the stencil test never passes")
        elif front.function is not Comparison.ALWAYS or back.function is not Comparison.ALWAYS:
            yield _possible("StencilTest", "the stencil test may reject it")
    if states[AlphaTest] is AlphaTest.ON:
        if states[AlphaFunction] is AlphaFunction.NEVER:
            yield _certain("AlphaFunction", "AlphaFunction.NEVER rejects all fragments")
        else:
            yield _possible("AlphaTest", "the alpha test may reject it")
    program = draw.resource(draw.program)
    if isinstance(program, ProgramDescriptor) and program.discards:
        yield _possible("discard", f"program {program.name!r} may discard its fragments")


def _writes(draw: Command) -> Iterator[Cause]:
    """Yield causes in write masks, blending and depth writes."""
    target, states = draw.render_pass, draw.states
    if target is None:
        return
    masks: Any = states[ColorWrite]
    blends: Any = states[BlendFunction]
    count = len(target.colors)
    program = draw.resource(draw.program)
    if isinstance(program, ProgramDescriptor):
        if program.writes_memory:
            return  # its result may be in memory
        if Stage.FRAGMENT not in program.stages and count:
            yield _certain(
                "fragment stage", f"program {program.name!r} has no fragment stage, so no color is written"
            )
            count = 0
    open_targets = [
        i for i in range(count) if masks[i].red or masks[i].green or masks[i].blue or masks[i].alpha
    ]
    keeping = [i for i in open_targets if _preserves_destination(blends[i])]
    writes_depth = (
        target.depth is not None and states[DepthWrite] is DepthWrite.ON and states[DepthTest] is DepthTest.ON
    )
    if count and not open_targets:
        yield Cause("ColorWrite", "all channels of all color targets are masked out", not writes_depth)
    if keeping:
        yield Cause(
            "BlendFunction",
            f"blending keeps the old color of target {', '.join(map(str, keeping))}",
            keeping == open_targets and not writes_depth,
        )
    if not target.colors and not writes_depth:
        yield _certain("DepthWrite", "the pass has no color target, and depth isn't written")


def _memory(draw: Command) -> Iterator[Cause]:
    """Yield causes in memory that was never written, and so is zero."""
    created: dict[int, Command] = {}
    written: set[int] = set()
    for command in _before(draw):
        if command.op is Op.CREATE_BUFFER:
            created[command["buffer"]] = command
        elif command.op in _FILLS:
            values = command.arguments
            if "buffer" in values:
                written.add(values["buffer"])
            elif "target" in values:
                written.add(values["target"])
            else:
                return  # a dispatch may have written anything
    unwritten = created.keys() - written
    bound = draw.bindings
    for binding in bindings_of(draw):
        value = bound.get(binding.name)
        if value is None:
            yield _certain(binding.name, f"nothing is bound as {binding.name}")
        elif binding.kind in (BindingKind.UNIFORM, BindingKind.STORAGE) and value[0] in unwritten:
            yield _possible(
                binding.name,
                f"{binding.name} reads {describe_resource(draw, value[0])}, which was never written: zeros",
            )
    vertex_array: Any = draw.resource(draw["vertex_array"])
    for stream in getattr(vertex_array, "streams", ()):
        if stream.buffer in unwritten:
            yield _possible(
                "vertices",
                f"the vertices in {describe_resource(draw, stream.buffer)} were never written: zeros",
            )
    arguments = draw["buffer"] if draw.op is Op.DRAW_INDIRECT else 0
    descriptor = draw.resource(arguments)
    if arguments in unwritten and isinstance(descriptor, BufferDescriptor):
        yield _certain("buffer", "the arguments of the indirect draw were never written: zeros")


def _afterwards(draw: Command) -> Iterator[Cause]:
    """Yield later passes that clear the target before it is read."""
    target = draw.render_pass
    if target is None:
        return
    targets = {(color.texture, color.level, color.layer) for color in target.colors}
    targets |= {(color.texture, color.level, ALL_LAYERS) for color in target.colors}
    stream: CommandStream = draw._stream
    for command in stream[draw.index + 1 :]:
        if command.op is Op.BEGIN_PASS and command.failure is None:
            for color in command["descriptor"].colors:
                if color.clear is not None and (color.texture, color.level, color.layer) in targets:
                    yield _certain(
                        "clear",
                        f"{describe_resource(draw, color.texture)} is cleared again by a later pass, at "
                        f"{command.site}",
                    )
                    return
        values = command.arguments
        reads = [values.get("source"), values.get("texture")]
        if any(texture in {target[0] for target in targets} for texture in reads):
            return  # the target was read before it was cleared


# -- helpers -------------------------------------------------------------------------------------------------


def _before(draw: Command) -> Iterator[Command]:
    stream: CommandStream = draw._stream
    return (command for command in stream[: draw.index] if command.failure is None)


def _inside(draw: Command, begin: Op, end: Op) -> bool:
    latest = None
    for command in _before(draw):
        if command.op in (begin, end):
            latest = command.op
    return latest is begin


def _has_earlier_draws(draw: Command) -> bool:
    """True if earlier draws of the same pass precede the draw."""
    drawn = False
    for command in _before(draw):
        if command.op is Op.BEGIN_PASS:
            drawn = False
        drawn = drawn or command.op in DRAWS
    return drawn


def _size(target: PassDescriptor) -> str:
    return f"{target.size[0]}×{target.size[1]}"


def _is_outside(box: Any, size: tuple[int, int]) -> bool:
    return bool(box.x >= size[0] or box.y >= size[1] or box.x + box.width <= 0 or box.y + box.height <= 0)


def _overlap(a: Any, b: Any) -> bool:
    return bool(a.x < b.x + b.width and b.x < a.x + a.width and a.y < b.y + b.height and b.y < a.y + a.height)


def _preserves_destination(blend: BlendFunction) -> bool:
    keeps = blend.source is BlendFactor.ZERO and blend.destination is BlendFactor.ONE
    alpha = blend.source_alpha in (None, BlendFactor.ZERO) and blend.destination_alpha in (
        None,
        BlendFactor.ONE,
    )
    return keeps and alpha and blend.operation is BlendOperation.ADD
