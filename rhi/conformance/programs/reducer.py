"""The reduction of a failing program to a small one that fails too.

Each proposal is a program that is simpler in one place; the first one that still fails is taken, until none
does. Proposals that no longer make sense (a condition on a query that never ended) raise, and count as
passing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from rhi import Primitive
from rhi.conformance.programs.model import Draw, DrawMethod, Part, Pass, Program, RecordedPasses, Shape, Step
from rhi.errors import RhiError


def reduce(program: Program, fails: Callable[[Program], bool], attempts: int = 2000) -> Program:
    """Return the smallest program found that still fails; `attempts` bounds the number of runs."""

    def still_fails(proposal: Program) -> bool:
        try:
            return fails(proposal)
        except RhiError:
            return False

    is_smaller = True
    while is_smaller:
        is_smaller = False
        for proposal in propose(program):
            attempts -= 1
            if attempts < 0:
                return program
            if still_fails(proposal):
                program, is_smaller = proposal, True
                break
    return program


def propose(program: Program) -> Iterator[Program]:
    """Yield programs that are simpler in one place, the largest simplifications first."""
    steps = program.steps
    for count in (len(steps) // 2, len(steps) - 1):
        if 0 < count < len(steps):
            yield replace(program, steps=steps[:count])
            yield replace(program, steps=steps[-count:])
    for i in range(len(steps)):
        if len(steps) > 1:
            yield replace(program, steps=steps[:i] + steps[i + 1 :])
    for i, step in enumerate(steps):
        for simpler in _simplify_step(step):
            yield replace(program, steps=steps[:i] + simpler + steps[i + 1 :])
    for i, shape in enumerate(program.shapes):
        for smaller, renumber in _shrink(shape):
            shapes = (*program.shapes[:i], smaller, *program.shapes[i + 1 :])
            changed = tuple(_with_parts(step, i, renumber) for step in steps)
            yield replace(program, shapes=shapes, steps=changed)


def _simplify_step(step: Step) -> Iterator[tuple[Step, ...]]:
    if isinstance(step, RecordedPasses):
        yield step.passes
        if step.times > 1:
            yield (replace(step, times=1),)
    if not isinstance(step, Pass):
        return
    draws = step.draws
    for i in range(len(draws)):
        yield (replace(step, draws=draws[:i] + draws[i + 1 :]),)
    if any(image is not None for image in step.resolve):
        yield (replace(step, resolve=()),)
    if step.depth is not None and step.colors:
        yield (replace(step, depth=None, clear_depth=None, clear_stencil=None),)
    if step.clear_depth is not None:
        yield (replace(step, clear_depth=None),)
    if step.clear_stencil is not None:
        yield (replace(step, clear_stencil=None),)
    for i, color in enumerate(step.clear):
        if color is not None:
            yield (replace(step, clear=(*step.clear[:i], None, *step.clear[i + 1 :])),)
    for i, draw in enumerate(draws):
        for simpler in _simplify_draw(draw):
            yield (replace(step, draws=(*draws[:i], simpler, *draws[i + 1 :])),)


def _simplify_draw(draw: Draw) -> Iterator[Draw]:
    if draw.method is not DrawMethod.DIRECT:
        yield replace(draw, method=DrawMethod.DIRECT)
    if draw.condition is not None:
        yield replace(draw, condition=None)
    if draw.query is not None:
        yield replace(draw, query=None)
    for i in range(len(draw.states)):
        yield replace(draw, states=draw.states[:i] + draw.states[i + 1 :])
    for i, part in enumerate(draw.parts):
        if len(draw.parts) > 1:
            yield replace(draw, parts=draw.parts[:i] + draw.parts[i + 1 :])
        for simpler in _simplify_part(part):
            yield replace(draw, parts=(*draw.parts[:i], simpler, *draw.parts[i + 1 :]))
    if draw.step != (0.0, 0.0):
        yield replace(draw, step=(0.0, 0.0))


def _simplify_part(part: Part) -> Iterator[Part]:
    if part.instances > 1:
        yield replace(part, instances=1)
    if part.base_instance:
        yield replace(part, base_instance=0)
    for per in (3, 4, 1):
        if part.count > per and part.count % per == 0:
            yield replace(part, first=part.first + per, count=part.count - per)
            yield replace(part, count=part.count - per)


def _shrink(shape: Shape) -> Iterator[tuple[Shape, Callable[[Part], Part]]]:
    """Yield shapes without indices, and without corners that no part may name then; with the parts' new
    ranges."""
    if shape.indices is not None:
        corners = tuple(shape.corners[i] for i in shape.indices)
        yield Shape(shape.primitive, corners), lambda part: part
        return
    per = {Primitive.TRIANGLES: 3, Primitive.QUADS: 4}.get(shape.primitive, 1)
    if len(shape.corners) > per:
        yield (
            Shape(shape.primitive, shape.corners[per:]),
            lambda part: (
                replace(part, first=part.first - per) if part.first >= per else replace(part, first=-1)
            ),
        )
        left = len(shape.corners) - per
        yield (
            Shape(shape.primitive, shape.corners[:-per]),
            lambda part: part if part.first + part.count <= left else replace(part, first=-1),
        )
    plain = tuple((*corner[:3], 1.0, *corner[4:]) for corner in shape.corners)
    if plain != shape.corners:
        yield Shape(shape.primitive, plain), lambda part: part
    for values in ((1.0, 1.0, 1.0, 1.0), shape.corners[0][4:]):
        even = tuple((*corner[:4], *values) for corner in shape.corners)
        if even != shape.corners and shape.corners[0][4:] != (1.0,) * 4:
            yield Shape(shape.primitive, even), lambda part: part


def _with_parts(step: Step, shape: int, renumber: Callable[[Part], Part]) -> Step:
    if isinstance(step, RecordedPasses):
        passes = tuple(_with_parts(part, shape, renumber) for part in step.passes)
        return replace(step, passes=tuple(part for part in passes if isinstance(part, Pass)))
    if not isinstance(step, Pass):
        return step
    draws = tuple(
        replace(draw, parts=tuple(map(renumber, draw.parts))) if draw.shape == shape else draw
        for draw in step.draws
    )
    return replace(step, draws=draws)
