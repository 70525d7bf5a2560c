"""Scopes nest: wrong orders of every kind inside every kind, and calls that no scope may surround.

Locks, immediate blocks and recordings hold nothing that a scope restores, so they may be left in any order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, suppress
from typing import Any, NamedTuple

import pytest

import rhi
from rhi import Access, ColorWrite, CullMode, DepthWrite, Device, Format, Op, Primitive, Scissor
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Colored, Tint, Tinted
from rhi.conformance.shapes import rectangle
from rhi.conformance.validation.refusal import refuses
from rhi.errors import rules

SIZE = (4, 4)
Block = AbstractContextManager[Any]


class Things:
    """The objects that the table's blocks use."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.image, self.mesh = device.texture(SIZE, Format.R8), device.mesh(rectangle())
        self.program, self.tinted = device.program(Colored), device.program(Tinted)
        self.tint = device.uniform(Tint(color=(1, 1, 1, 1)))
        self.buffer, self.other = device.buffer(4), device.buffer(4)
        self.texture = device.texture(SIZE, Format.R8)
        self.query, self.answered = device.occlusion_query(), device.occlusion_query()
        with device.render_pass(self.image), self.answered:
            device.draw(self.program, self.mesh)

    def destroy(self) -> None:
        resources = (
            self.image,
            self.mesh,
            self.tint,
            self.buffer,
            self.other,
            self.texture,
            self.query,
            self.answered,
        )
        for resource in resources:
            resource.destroy()


ORDERED: dict[str, Callable[[Things], Block]] = {
    "states": lambda t: t.device.states(CullMode.NONE),
    "event": lambda t: t.device.event("labelled"),
    "pass": lambda t: t.device.render_pass(t.image),
    "condition": lambda t: t.device.conditional(t.answered),
    "query": lambda t: t.query,
}
"""Scopes that must be left in the reverse order of entry."""

FREE: dict[str, Callable[[Things], Block]] = {
    "buffer read": lambda t: t.buffer.lock(Access.READ),
    "buffer write": lambda t: t.other.lock(Access.WRITE),
    "texture lock": lambda t: t.texture.lock(Access.READ_WRITE),
    "immediate": lambda t: t.device.immediate(t.tinted, Primitive.TRIANGLES, tint=t.tint),
    "recording": lambda t: t.device.record(),
}
"""Blocks that may be left in any order."""

ALL = ORDERED | FREE
PAIRS = [
    (outer, inner)
    for outer in ALL
    for inner in ALL
    if (outer != inner or outer in ("states", "event")) and (outer, inner) != ("query", "pass")
]
"""Kinds that can lie in each other."""
BEGIN_END = {
    Op.BEGIN_PASS: Op.END_PASS,
    Op.BEGIN_QUERY: Op.END_QUERY,
    Op.BEGIN_CONDITIONAL: Op.END_CONDITIONAL,
    Op.PUSH_LABEL: Op.POP_LABEL,
}


@pytest.fixture(autouse=True)
def conditional(request: pytest.FixtureRequest, shared_device: Device) -> None:
    """Skip a test of conditions where the device has none."""
    parameters = request.node.callspec.params.values()
    if "condition" in parameters and not shared_device.capabilities.conditional_rendering:
        pytest.skip("the device declares no conditional_rendering")


@pytest.fixture
def things(recording: Device) -> Iterator[Things]:
    things = Things(recording)
    yield things
    assert recording._core.scopes.describe_open() == ""
    things.destroy()


def assert_nested(commands: Any) -> None:
    """Assert that begins and ends nest in what the backend has received."""
    open_ops: list[Op] = []
    for command in commands:
        if command.op in BEGIN_END:
            open_ops.append(BEGIN_END[command.op])
        elif command.op in BEGIN_END.values():
            assert open_ops.pop() is command.op
    assert not open_ops


def surround(stack: ExitStack, things: Things, *kinds: str) -> None:
    """Open a pass around a query that needs one."""
    if "query" in kinds and kinds != ("pass", "query"):
        stack.enter_context(things.device.render_pass(things.image))


@pytest.mark.requires("draws", "occlusion_queries")
@pytest.mark.parametrize(("outer", "inner"), PAIRS)
def test_leaving_an_outer_scope_before_an_inner_scope_is_refused(
    recording: Device, things: Things, outer: str, inner: str
) -> None:
    """Refused where it matters; then all is as before, and commands nest."""
    since = len(recording.stream)
    before = recording._core.states.requested
    with ExitStack() as stack:
        surround(stack, things, outer, inner)
        first, second = ALL[outer](things), ALL[inner](things)
        first.__enter__()
        second.__enter__()
        if outer in ORDERED and inner in ORDERED:
            rule = rules.QUERY_STATE if (outer, inner) == ("pass", "query") else rules.SCOPE_ORDER
            with refuses(rule) as refusal:
                first.__exit__(None, None, None)
            assert "open" in refusal.error.given
        else:
            first.__exit__(None, None, None)
        second.__exit__(None, None, None)
    assert recording._core.states.requested is before
    assert_nested(recording.stream[since:])


@pytest.mark.requires("draws", "occlusion_queries")
@pytest.mark.parametrize(("outer", "inner"), PAIRS)
def test_the_same_scopes_left_in_order(recording: Device, things: Things, outer: str, inner: str) -> None:
    since = len(recording.stream)
    with ExitStack() as stack:
        surround(stack, things, outer, inner)
        with ALL[outer](things), ALL[inner](things):
            pass
    assert_nested(recording.stream[since:])


LEFT_TWICE = {
    **dict.fromkeys(("states", "event", "pass", "condition"), rules.SCOPE_ORDER),
    **dict.fromkeys(("buffer read", "buffer write", "texture lock"), rules.LOCK_CLOSED),
    "immediate": rules.SCOPE_ORDER,
    "recording": rules.SCOPE_ORDER,
    "query": None,  # `with query:` may end after `query.end()`
}


@pytest.mark.requires("draws", "occlusion_queries")
@pytest.mark.parametrize("kind", ALL)
def test_a_block_left_twice(recording: Device, things: Things, kind: str) -> None:
    rule = LEFT_TWICE[kind]
    with ExitStack() as stack:
        surround(stack, things, kind)
        with recording.states(DepthWrite.OFF):
            inside = recording._core.states.requested
            block = ALL[kind](things)
            with block:
                pass
            if rule is None:
                block.__exit__(None, None, None)
            else:
                with refuses(rule, recording):
                    block.__exit__(None, None, None)
            assert recording._core.states.requested is inside


ENTERED_TWICE = {
    "pass": rules.PASS_NESTED,
    "condition": rules.CONDITION_NESTED,
    "query": rules.QUERY_NESTED,
    **dict.fromkeys(("buffer read", "buffer write", "texture lock"), rules.LOCK_TWICE),
    "immediate": rules.SCOPE_ORDER,
    "recording": rules.RECORD_STATE,
    "states": None,
    "event": None,
}


@pytest.mark.requires("draws", "occlusion_queries")
@pytest.mark.parametrize("kind", ALL)
def test_a_block_entered_twice(recording: Device, things: Things, kind: str) -> None:
    rule, since = ENTERED_TWICE[kind], len(recording.stream)
    with ExitStack() as stack:
        surround(stack, things, kind)
        block = ALL[kind](things)
        with block:
            if rule is None:
                with block:
                    pass
            else:
                with refuses(rule, recording):
                    block.__enter__()
    assert_nested(recording.stream[since:])


@pytest.mark.requires("draws")
def test_scopes_of_two_devices_are_left_in_any_order(recording: Device, backend: str) -> None:
    with rhi.create_device(backend) as other:
        image = other.texture(SIZE, Format.R8)
        ours, theirs = recording.states(CullMode.NONE), other.states(CullMode.FRONT)
        outer, inner = recording.event("ours"), other.render_pass(image)
        for block in (ours, theirs, outer, inner):
            block.__enter__()
        outer.__exit__(None, None, None)
        ours.__exit__(None, None, None)
        assert recording._core.states.requested[CullMode] is CullMode.BACK
        assert other._core.states.requested[CullMode] is CullMode.FRONT
        inner.__exit__(None, None, None)
        theirs.__exit__(None, None, None)


# -- which states hold ------------------------------------------------------------------------------------


def states_block(device: Device, *states: rhi.State) -> Iterator[None]:
    with device.states(*states):
        yield


class ClosedInside(NamedTuple):
    """A generator that closes its scope inside another one.

    Attributes:
        refusal: the refusal of the close.
        inner: the states of a draw inside the inner scope, after the close.
        after: the states of a draw after the inner scope.
        image: the pixels that both drew.
    """

    refusal: refuses
    inner: dict[type, object]
    after: dict[type, object]
    image: Any


@pytest.fixture
def closed_inside(recording: Device) -> ClosedInside:
    program, since = recording.program(Colored), len(recording.stream)
    with recording.texture(SIZE, Format.R8) as image, recording.mesh(rectangle()) as mesh:
        with recording.render_pass(image, clear=(0, 0, 0, 0)):
            generator = states_block(recording, Scissor(0, 0, 2, 4))
            next(generator)
            with recording.states(DepthWrite.OFF, ColorWrite.OFF):
                with refuses(rules.SCOPE_ORDER) as refusal:
                    generator.close()  # type: ignore[attr-defined]
                recording.draw(program, mesh)
            recording.draw(program, mesh)
        inner, after = (draw.states for draw in recording.stream[since:].draws())
        return ClosedInside(refusal, inner, after, image.read())


@pytest.mark.requires("draws")
def test_a_generator_closed_inside_another_scope_leaves_the_inner_scope_its_states(
    closed_inside: ClosedInside,
) -> None:
    assert closed_inside.inner[DepthWrite] is DepthWrite.OFF
    assert closed_inside.inner[Scissor] == Scissor(0, 0, 2, 4)


@pytest.mark.requires("draws")
def test_after_the_inner_scope_of_a_closed_generator_the_defaults_hold(closed_inside: ClosedInside) -> None:
    assert closed_inside.after[DepthWrite] is DepthWrite.ON
    assert closed_inside.after[Scissor] == Scissor.OFF


@pytest.mark.requires("draws", "shading")
def test_a_draw_after_the_inner_scope_of_a_closed_generator_covers_the_whole_image(
    closed_inside: ClosedInside,
) -> None:
    assert_same(closed_inside.image, 255)


@pytest.mark.requires("draws")
def test_a_generator_closed_inside_another_scope_is_refused_with_both_scopes_and_lines(
    closed_inside: ClosedInside,
) -> None:
    error = closed_inside.refusal.error
    assert "Scissor" in error.call
    assert "DepthWrite" in error.given
    assert error.given.count("test_scopes.py:") == 2  # with validation, the lines of both


@pytest.mark.requires("draws")
def test_several_scopes_left_too_early_end_with_the_last_one_inside(recording: Device) -> None:
    states = recording._core.states
    scopes = [recording.states(Scissor(0, 0, n, n)) for n in range(4)]
    for scope in scopes:
        scope.__enter__()
    inside = states.requested
    for scope in scopes[:-1]:
        with refuses(rules.SCOPE_ORDER):
            scope.__exit__(None, None, None)
        assert states.requested is inside
    scopes[-1].__exit__(None, None, None)
    assert states.requested[Scissor] == Scissor.OFF
    assert states.depth == 0
    for scope in scopes[:-1]:
        scope.__exit__(None, None, None)  # quietly, once
    with refuses(rules.SCOPE_ORDER):
        scopes[0].__exit__(None, None, None)


def test_a_wrong_order_hides_no_exception(recording: Device) -> None:
    def fail() -> Iterator[None]:
        with recording.states(CullMode.NONE):
            yield
            raise ZeroDivisionError

    states, failing = recording._core.states, fail()
    next(failing)
    with recording.states(DepthWrite.OFF):
        with pytest.raises(ZeroDivisionError):
            next(failing)
        assert states.requested[DepthWrite] is DepthWrite.OFF
    assert states.requested[CullMode] is CullMode.BACK
    assert states.depth == 0


def test_a_query_that_is_not_the_innermost_scope_ends_later(recording: Device) -> None:
    if not (recording.capabilities.occlusion_queries and recording.capabilities.draws):
        pytest.skip("the device declares no occlusion_queries")
    query = recording.occlusion_query()
    with recording.texture(SIZE, Format.R8) as image, recording.render_pass(image):
        query.begin()
        with recording.states(CullMode.NONE):
            with refuses(rules.SCOPE_ORDER, recording):
                query.end()
        query.end()
    query.destroy()


# -- what no scope may surround -----------------------------------------------------------------------------


@pytest.mark.requires("draws", "occlusion_queries")
@pytest.mark.parametrize("kind", [*ORDERED, "buffer read"])
def test_a_frame_ends_outside_of_all_scopes(recording: Device, things: Things, kind: str) -> None:
    rule = {"pass": rules.PASS_OPEN, "query": rules.PASS_OPEN}.get(kind, rules.SCOPE_OPEN)
    with ExitStack() as stack:
        surround(stack, things, kind)
        stack.enter_context(ALL[kind](things))
        if kind in ORDERED:
            with refuses(rule, recording):
                recording.present()
        else:
            recording.present()
    recording.present()


@pytest.mark.requires("draws", "occlusion_queries")
@pytest.mark.parametrize("kind", ORDERED)
def test_a_submission_may_lie_in_scopes_but_not_in_a_pass(
    recording: Device, things: Things, kind: str
) -> None:
    with recording.record() as commands:
        commands.clear(things.buffer, 7)
    with ExitStack() as stack:
        surround(stack, things, kind)
        stack.enter_context(ALL[kind](things))
        if kind in ("pass", "query"):
            with refuses(rules.PASS_OPEN, recording):
                recording.submit(commands)
        else:
            recording.submit(commands)


@pytest.mark.requires("draws", "occlusion_queries")
@pytest.mark.parametrize("kind", ALL)
def test_a_device_closed_inside_a_block_is_closed(backend: str, kind: str) -> None:
    """The error is raised after the device has been released, and not by the ends of the blocks."""
    device = rhi.create_device(backend)
    things = Things(device)
    with ExitStack() as stack:
        surround(stack, things, kind)
        stack.enter_context(ALL[kind](things))
        if kind in ORDERED:
            with refuses(rules.SCOPE_OPEN):
                device.close()
        elif "lock" in kind or "buffer" in kind:
            with refuses(rules.LOCK_OPEN):
                device.close()
        else:
            device.close()
        assert device.closed
        if kind in ("immediate", "recording"):
            with suppress(rhi.ValidationError):
                stack.close()


def test_closing_a_device_hides_no_exception(backend: str) -> None:
    device = rhi.create_device(backend)
    with pytest.raises(ZeroDivisionError), device.states(CullMode.NONE):
        try:
            raise ZeroDivisionError
        finally:
            device.close()
    assert device.closed


# -- in command buffers --------------------------------------------------------------------------------------


@pytest.mark.requires("draws")
@pytest.mark.parametrize("outer", ["states", "event", "pass"])
@pytest.mark.parametrize("inner", ["states", "event"])
def test_recorded_scopes_nest_too(recording: Device, outer: str, inner: str) -> None:
    with recording.texture(SIZE, Format.R8) as image:
        with recording.record() as commands:
            kinds: dict[str, Callable[[], Block]] = {
                "states": lambda: commands.states(CullMode.NONE),
                "event": lambda: commands.event("labelled"),
                "pass": lambda: commands.render_pass(image),
            }
            first, second = kinds[outer](), kinds[inner]()
            first.__enter__()
            second.__enter__()
            with refuses(rules.SCOPE_ORDER):
                first.__exit__(None, None, None)
            second.__exit__(None, None, None)
        assert_nested(commands.stream)
        recording.submit(commands)


def test_scopes_left_after_their_recording_record_nothing(recording: Device) -> None:
    event = None
    with refuses(rules.RECORD_OPEN), recording.record() as commands:
        event = commands.event("late")
        event.__enter__()
    recorded = len(commands)
    assert event is not None
    event.__exit__(None, None, None)
    assert len(commands) == recorded
