"""The functions generated for each program: its draw, and the checks and bindings before any other call.

- They are generated because a loop over the bindings costs more than the draw: with two bindings, 1.5× of the
  bare OpenGL calls against 1.2× (`benchmarks/draw_cost.py`).
- Their state lies in closure cells that they share: the bound values (compared by identity) and the owners
  whose ranges were checked. An event that invalidates it clears `core.program`, and the next call checks
  everything.
- Until `make_current` a call may be refused; after that nothing is refused. So a refused call has no effect.
  If a call is cut off later, the next call checks and binds everything.
- The number of instances is compared with 1 by identity, which is the quicker comparison and tells 1 from 1.0
  and True.
- A command buffer has functions of its own for a program (`recorded`): uniforms are bound through its
  backend, which records, and prepared draws are kept with the program, not with the mesh, which outlives the
  recording.
- A uniform binding takes a value as well as a range. The class of the last range is kept, so that one
  comparison tells a range from a value. The checks pack a value into bytes. Once nothing is refused any more,
  `UniformRing.bind` writes and binds the bytes; a command buffer binds their range.
- `draw` takes bindings as keywords, for the program's own draw. `draw_with` and `bind` take them as the
  dictionary that `device.draw(**bindings)` has anyway: unpacking it again would cost 70 ns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import lru_cache
from types import CodeType
from typing import Any, Final

from rhi.contract.descriptors import Binding, BindingKind
from rhi.errors import ValidationError
from rhi.errors.named_tuples import NamedTuple
from rhi.shading import Struct

MISSING: Final = object()
"""The value of a binding that was not given."""

_RANGES: Final = (BindingKind.UNIFORM, BindingKind.STORAGE)

_APPLY: Final = {
    BindingKind.UNIFORM: "{name}.owner.bind_uniform({slot}, {name}.offset, {name}.size)",
    BindingKind.STORAGE: "_backend.bind_storage({slot}, {name}.buffer, {name}.offset, {name}.size)",
    BindingKind.TEXTURE: "_backend.bind_texture({slot}, {name}.texture, {name}.sampler)",
    BindingKind.IMAGE: (
        "_backend.bind_image({slot}, {name}.texture, {name}.level, -1 if {name}.layer is None else "
        "{name}.layer)"
    ),
}


_APPLY_RECORDED: Final = _APPLY | {
    BindingKind.UNIFORM: "_backend.bind_uniform({slot}, {name}.buffer, {name}.offset, {name}.size)"
}


class DrawCode(NamedTuple):
    """The generated functions of a program.

    They are `draw(mesh, instances=1, /, **bindings)`, `draw_with(mesh, instances, bindings)`,
    `bind(check, mesh, bindings)`, which calls `check(mesh)` when everything must be checked, and
    `collect_draw_count()`, which returns the number of draws since its last call.
    """

    draw: Callable[..., None]
    draw_with: Callable[[Any, int, dict[str, Any]], None]
    bind: Callable[[Callable[[Any], None], Any, dict[str, Any]], None]
    collect_draw_count: Callable[[], int]


def compile_draw_code(
    name: str,
    bindings: tuple[Binding, ...],
    recorded: bool = False,
    validates: bool = False,
    takes_more: bool = False,
    checks_aliases: bool = False,
) -> CodeType:
    """Compile the functions of a program; `recorded`: for command buffers; `validates`: for a device with
    validation, where each draw checks its thread; `takes_more`: draws may pass bindings that the program
    no longer reads; `checks_aliases`: each call checks that no memory is written and used a second time."""
    lines = _write_source(bindings, recorded, validates, takes_more, checks_aliases)
    return _compile("\n".join(lines), f"<draw of {name}>")


@lru_cache(maxsize=256)
def _compile(source: str, file: str) -> CodeType:
    """Compile a source, which takes a millisecond, once for all devices that have the program."""
    return compile(source, file, "exec")


def make_draw_code(code: CodeType, program: Any, bindings: tuple[Binding, ...]) -> DrawCode:
    """Return the functions of one `Program`, which share their own state."""
    scope: dict[str, Any] = {"__rhi_internal__": True, "__name__": __name__}
    exec(code, scope)
    core = program.core
    types = tuple(binding.type for binding in bindings)
    return DrawCode(
        *scope["make"](
            core,
            core.backend,
            core.states,
            program,
            program.uniforms.push,
            program.uniforms.bind,
            types,
            MISSING,
            object(),
            ValidationError,
        )
    )


def _write_source(
    bindings: tuple[Binding, ...], recorded: bool, validates: bool, takes_more: bool, checks_aliases: bool
) -> Iterator[str]:
    """Yield the source of a function `make` that returns the fields of `DrawCode`.

    Its own names start with an underscore; names of bindings start with a letter.
    """
    cells = [f"_{kind}_{i}" for kind in ("bound", "owner", "class") for i in range(len(bindings))]
    keywords = "".join(f", {binding.name}=_missing" for binding in bindings if not binding.table)
    yield "def make(_core, _backend, _states, _program, _push, _bind, _types, _missing, _unbound, _refusal, _one=1):"
    yield f"    {' = '.join([*cells, '_unset'])} = _unbound"
    yield "    _len, _type = len, type  # a binding may have that name"
    if any(binding.table for binding in bindings):
        yield "    _attribute = getattr"
    yield "    _draws = 0  # counted in a cell, at half the cost of an attribute"
    for i in range(len(bindings)):
        yield f"    _type_{i} = _types[{i}]"

    more = ("if _more:", "    _program.check_unknown(_more)") if takes_more else ()
    star, rest = ", *" if bindings else "", ", **_more" if takes_more else ""
    yield f"    def draw(_mesh, _instances=1, /{star}{keywords}{rest}):"
    flags = {"recorded": recorded, "validates": validates, "checks_aliases": checks_aliases}
    yield from _write_draw(bindings, cells, more, **flags)
    yield "    def draw_with(_mesh, _instances, _bindings):"
    yield from _write_draw(bindings, cells, tuple(_write_unpack(bindings)), **flags)
    yield "    def bind(_check, _mesh, _bindings):"
    yield from _write_nonlocal(cells)
    unpack = tuple(_write_unpack(bindings))
    yield from _write_bind(bindings, cells, "_check(_mesh)", unpack, recorded, checks_aliases, draws=False)
    yield from _write_cut_off()
    yield "    def collect_draw_count():"
    yield "        nonlocal _draws"
    yield "        count, _draws = _draws, 0"
    yield "        return count"
    yield "    return draw, draw_with, bind, collect_draw_count"


def _write_draw(
    bindings: tuple[Binding, ...],
    cells: list[str],
    names: tuple[str, ...],
    recorded: bool,
    validates: bool,
    checks_aliases: bool,
) -> Iterator[str]:
    yield from _write_nonlocal([*cells, "_draws"])
    if validates:
        yield "        _core.check_ready()"
    unpack = (
        *names,
        "try:",
        f"    _draw = {'_program.prepared_draws[_mesh]' if recorded else '_mesh.prepared_draws[_program]'}",
        "except KeyError:",
        "    _draw = _program.prepare_draw(_mesh, _instances)",
        "if _instances is not _one:",
        "    _instances = _program.check_instances(_instances, _mesh)",
    )
    check = "_program.check_can_draw(_mesh)"
    yield from _write_bind(bindings, cells, check, unpack, recorded, checks_aliases, draws=True)
    yield "            if _states.requested is not _states.hardware:"
    yield "                _core.flush_states()"
    yield "            if _core.tests_alpha:"
    yield "                _program.draw_unprepared(_mesh, _instances)"
    yield "            else:"
    yield "                _draw(_instances)"
    yield from _write_cut_off()
    yield "        _draws += 1"


def _write_nonlocal(cells: list[str]) -> Iterator[str]:
    if cells:
        yield f"        nonlocal {', '.join(cells)}"


def _write_unpack(bindings: tuple[Binding, ...]) -> Iterator[str]:
    """Yield the lines that unpack the dictionary of bindings and check its names."""
    passed = [binding.name for binding in bindings if not binding.table]
    yield f"if _len(_bindings) != {len(passed)}:"
    yield "    _program.check_names(_bindings)"
    if passed:
        yield "try:"
        for name in passed:
            yield f"    {name} = _bindings[{name!r}]"
        yield "except KeyError:"
        yield "    _program.check_names(_bindings)"


def _write_bind(
    bindings: tuple[Binding, ...],
    cells: list[str],
    check: str,
    unpack: tuple[str, ...],
    recorded: bool,
    checks_aliases: bool,
    draws: bool,
) -> Iterator[str]:
    """Yield the lines that check everything, then bind what changed."""
    values = "(" + "".join(f"{binding.name}, " for binding in bindings) + ")"
    packed = [f"_data_{i}" for i, binding in enumerate(bindings) if binding.kind is BindingKind.UNIFORM]
    yield "        try:"
    if packed:
        yield f"            {' = '.join(packed)} = None"
    described = [binding for binding in bindings if binding.table]
    if described:  # bound below, should unpacking be refused
        yield f"            {' = '.join(binding.name for binding in described)} = _missing"
    for line in unpack:
        yield f"            {line}"
    for binding in described:
        yield f"            {binding.name} = _attribute({binding.table}, 'words', _missing)"
    yield "            _fresh = _core.program is not _program"
    yield "            if _fresh:"
    yield f"                {check}"
    if cells:
        yield f"                {' = '.join(cells)} = _unbound"
    for i, binding in enumerate(bindings):
        name = binding.name
        # For another range of an owner that was checked already, only the type is compared.
        differs = f" and ({name}.owner is not _owner_{i} or {name}.type is not _type_{i})"
        if binding.kind is BindingKind.UNIFORM:
            yield f"            if {name} is not _bound_{i}:"
            yield f"                if _type({name}) is _class_{i}:"
            yield f"                    if {differs.removeprefix(' and ')}:"
            yield f"                        _program.check({i}, {name})"
            yield f"                        _owner_{i} = {name}.owner"
            if isinstance(binding.type, type) and issubclass(
                binding.type, Struct
            ):  # as `take_uniform` does, without its two frames
                yield f"                elif _type({name}) is _type_{i}:"
                yield f"                    _data_{i} = {name}.__dict__.get('_bytes') or {name}.to_bytes()"
            yield "                else:"
            yield f"                    _data_{i} = _program.take_uniform({i}, {name})"
            yield f"                    if _data_{i} is None:"
            yield f"                        _class_{i}, _owner_{i} = _type({name}), {name}.owner"
            continue
        yield f"            if {name} is not _bound_{i}{differs if binding.kind in _RANGES else ''}:"
        yield f"                _program.check({i}, {name})"
        if binding.kind in _RANGES:
            yield f"                _owner_{i} = {name}.owner"
    if checks_aliases:
        yield f"            _program.check_aliases({values}, _mesh)"
    # Only the user's frames and this one stay in the traceback of a refusal.
    yield "        except _refusal as _error:"
    yield "            raise _error.with_traceback(None) from None"
    yield "        except AttributeError as _error:"
    yield f"            raise _program.explain(_error, {values}{', _mesh' if draws else ''}) from None"
    yield "        try:"
    yield "            if _fresh:"
    yield "                _program.make_current()"
    yield from _write_applications(bindings, recorded)


def _write_applications(bindings: tuple[Binding, ...], recorded: bool) -> Iterator[str]:
    """Yield the lines that bind what changed, once nothing is refused any more."""
    for i, binding in enumerate(bindings):
        condition = "if"
        if binding.kind is BindingKind.UNIFORM and recorded:
            yield f"            if _data_{i} is not None:"
            yield f"                {binding.name} = _push(_data_{i}, _type_{i})"
        elif binding.kind is BindingKind.UNIFORM:
            yield f"            if _data_{i} is not None:"
            yield f"                _bind({binding.slot}, _data_{i})"
            yield f"                _bound_{i} = _unbound"
            condition = "elif"
        yield f"            {condition} {binding.name} is not _bound_{i}:"
        apply = (_APPLY_RECORDED if recorded else _APPLY)[binding.kind]
        yield "                " + apply.format(slot=binding.slot, name=binding.name)
        yield f"                _bound_{i} = {binding.name}"


def _write_cut_off() -> Iterator[str]:
    """Yield the lines that end the part in which a call takes effect. If an interrupt or a driver's error
    cuts it off, the bindings are unknown, so the next call binds everything."""
    yield "        except BaseException:"
    yield "            _core.program = None"
    yield "            raise"
