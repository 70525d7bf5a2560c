"""The functions generated for each program: its draw, and the checks and bindings before any other call.

- Generated because a loop over the bindings costs more than the draw: with two bindings 1.2× of the bare OpenGL
  calls against 1.5× (`benchmarks/draw_cost.py`).
- All state they keep lies in cells that they share: what is bound (compared by identity) and whose ranges are
  known to be good. What isn't current any more clears `core.program`, and the next call starts from nothing.
- Up to `enter` everything may be refused; from there on nothing is. So what is refused leaves no trace.
- A command buffer has functions of its own for a program (`recorded`): uniforms are bound through its backend, which
  writes down, and prepared draws are kept with the program, not with the mesh, which outlives the recording.
- `draw` takes bindings as keywords, for the program's own draw; `draw_with` and `bind` take them as the dictionary
  that `device.draw(**bindings)` has anyway: to unpack it again would cost 70 ns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from types import CodeType
from typing import Any, Final, NamedTuple

from rhi.contract.descriptors import Binding, BindingKind

__rhi_internal__ = True

MISSING: Final = object()
"""Stands for a binding that was not given."""

_RANGES: Final = (BindingKind.UNIFORM, BindingKind.STORAGE)

_APPLY: Final = {
    BindingKind.UNIFORM: "{name}.owner.bind_uniform({slot}, {name}.offset, {name}.size)",
    BindingKind.STORAGE: "_backend.bind_storage({slot}, {name}.buffer, {name}.offset, {name}.size)",
    BindingKind.TEXTURE: "_backend.bind_texture({slot}, {name}.texture, {name}.sampler)",
    BindingKind.IMAGE: (
        "_backend.bind_image({slot}, {name}.texture, {name}.level, -1 if {name}.layer is None else {name}.layer)"
    ),
}


_APPLY_RECORDED: Final = _APPLY | {
    BindingKind.UNIFORM: "_backend.bind_uniform({slot}, {name}.buffer, {name}.offset, {name}.size)"
}


class DrawCode(NamedTuple):
    """What is generated.

    `draw(mesh, instances=1, /, **bindings)`, `draw_with(mesh, instances, bindings)`,
    `bind(ready, mesh, bindings)` (which calls `ready(mesh)` when everything must be checked), and
    `collect_draw_count()`: how many draws there were since it was last asked.
    """

    draw: Callable[..., None]
    draw_with: Callable[[Any, int, dict[str, Any]], None]
    bind: Callable[[Callable[[Any], None], Any, dict[str, Any]], None]
    collect_draw_count: Callable[[], int]


def compile_draw_code(name: str, bindings: tuple[Binding, ...], *, recorded: bool = False) -> CodeType:
    """The code of the functions of a program; `recorded`: of those that a command buffer uses."""
    return compile("\n".join(_source(bindings, recorded)), f"<draw of {name}>", "exec")


def make_draw_code(code: CodeType, program: Any, bindings: tuple[Binding, ...]) -> DrawCode:
    """The functions for one `Program`."""
    scope: dict[str, Any] = {"__rhi_internal__": True, "__name__": __name__}
    exec(code, scope)
    core = program.core
    types = tuple(binding.type for binding in bindings)
    return DrawCode(
        *scope["make_draw_code"](core, core.backend, core.states, program, types, MISSING, object())
    )


def _source(bindings: tuple[Binding, ...], recorded: bool) -> Iterator[str]:
    """The text of a function `make_draw_code` that returns the fields of `DrawCode`. Names of its own start with an
    underscore and a letter, those of bindings with a letter."""
    cells = [f"_{what}_{i}" for what in ("bound", "owner") for i in range(len(bindings))]
    keywords = "".join(f", {binding.name}=_missing" for binding in bindings)
    yield "def make_draw_code(_core, _backend, _states, _program, _types, _missing, _unbound):"
    yield f"    {' = '.join([*cells, '_unset'])} = _unbound"
    yield "    _len = len  # a binding may have that name"
    yield "    _draws = 0  # counted in a cell, at half the price of an attribute"
    for i in range(len(bindings)):
        yield f"    _type_{i} = _types[{i}]"

    yield f"    def draw(_mesh, _instances=1, /{', *' if bindings else ''}{keywords}):"
    yield from _draw(bindings, cells, unpack=False, recorded=recorded)
    yield "    def draw_with(_mesh, _instances, _given):"
    yield from _draw(bindings, cells, unpack=True, recorded=recorded)
    yield "    def bind(_ready, _mesh, _given):"
    yield from _nonlocal(cells)
    yield from _unpack(bindings)
    yield from _bind(bindings, cells, ready="_ready(_mesh)", find=(), recorded=recorded)
    yield "    def collect_draw_count():"
    yield "        nonlocal _draws"
    yield "        taken, _draws = _draws, 0"
    yield "        return taken"
    yield "    return draw, draw_with, bind, collect_draw_count"


def _draw(bindings: tuple[Binding, ...], cells: list[str], unpack: bool, recorded: bool) -> Iterator[str]:
    yield from _nonlocal([*cells, "_draws"])
    if unpack:
        yield from _unpack(bindings)
    find = (
        "try:",
        f"    _draw = {'_program.prepared_draws[_mesh]' if recorded else '_mesh.prepared_draws[_program]'}",
        "except KeyError:",
        "    _draw = _program.prepare_draw(_mesh)",
        "if _instances != 1:",
        "    _instances = _program.check_instances(_instances)",
    )
    yield from _bind(bindings, cells, "_program.check_can_draw(_mesh)", find, recorded)
    yield "        if _states.wanted is not _states.hardware:"
    yield "            _core.flush_states()"
    yield "        if _core.tests_alpha:"
    yield "            _program.draw_unprepared(_mesh, _instances)"
    yield "        else:"
    yield "            _draw(_instances)"
    yield "        _draws += 1"


def _nonlocal(cells: list[str]) -> Iterator[str]:
    if cells:
        yield f"        nonlocal {', '.join(cells)}"


def _unpack(bindings: tuple[Binding, ...]) -> Iterator[str]:
    """From the dictionary, with the right names and no others."""
    yield f"        if _len(_given) != {len(bindings)}:"
    yield "            _program.check_names(_given)"
    if bindings:
        yield "        try:"
        for binding in bindings:
            yield f"            {binding.name} = _given[{binding.name!r}]"
        yield "        except KeyError:"
        yield "            _program.check_names(_given)"


def _bind(
    bindings: tuple[Binding, ...], cells: list[str], ready: str, find: tuple[str, ...], recorded: bool
) -> Iterator[str]:
    """Check everything, then apply what changed."""
    values = "(" + "".join(f"{binding.name}, " for binding in bindings) + ")"
    yield "        try:"
    for line in find:
        yield f"            {line}"
    yield "            _fresh = _core.program is not _program"
    yield "            if _fresh:"
    yield f"                {ready}"
    if cells:
        yield f"                {' = '.join(cells)} = _unbound"
    for i, binding in enumerate(bindings):
        name = binding.name
        # Of a range that changed within an owner already checked, only the type is compared.
        known = f" and ({name}.owner is not _owner_{i} or {name}.type is not _type_{i})"
        yield f"            if {name} is not _bound_{i}{known if binding.kind in _RANGES else ''}:"
        yield f"                _program.check({i}, {name})"
        if binding.kind in _RANGES:
            yield f"                _owner_{i} = {name}.owner"
    yield "        except AttributeError as _error:"
    yield f"            _program.raise_for(_mesh, {values}, _error)"
    yield "        if _fresh:"
    yield "            _program.make_current()"
    for i, binding in enumerate(bindings):
        yield f"        if {binding.name} is not _bound_{i}:"
        apply = (_APPLY_RECORDED if recorded else _APPLY)[binding.kind]
        yield "            " + apply.format(slot=binding.slot, name=binding.name)
        yield f"            _bound_{i} = {binding.name}"
