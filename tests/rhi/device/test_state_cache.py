"""Scopes always restore, differences are minimal, memory is bounded (thesis 4.2)."""

import dataclasses
import sys
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rhi.contract.limits import ANY_DEVICE
from rhi.contract.states import (
    DEFAULTS,
    MAX_TARGETS,
    PER_TARGET,
    STATE_TYPES,
    AlphaTest,
    BlendFunction,
    ColorWrite,
    CullMode,
    DepthBias,
    DepthTest,
    DepthWrite,
    LineWidth,
    PlatformState,
    Scissor,
    StateChange,
    Viewport,
)
from rhi.device.core.scopes import STACK_DEPTH
from rhi.device.core.state_cache import StateCache
from rhi.errors import ValidationError

VALUES = st.one_of(
    st.sampled_from(list(CullMode)),
    st.sampled_from(list(DepthWrite)),
    st.sampled_from(list(DepthTest)),
    st.sampled_from([ColorWrite.ON, ColorWrite.OFF, ColorWrite.OFF.at(0), ColorWrite.ON.at(7)]),
    st.sampled_from([BlendFunction.OFF, BlendFunction.ALPHA, BlendFunction.ADDITIVE.at(3)]),
    st.builds(Viewport, st.integers(0, 2), st.integers(0, 2), st.just(8), st.just(8)),
    st.builds(Scissor, st.integers(0, 2)),
    st.builds(DepthBias, st.sampled_from([0.0, -0.0, 1.0])),
)
SCOPES = st.lists(VALUES, min_size=1, max_size=4, unique_by=lambda s: (type(s), getattr(s, "target", None)))
# A program: a scope to open, "close" the innermost one, or "draw" (a flush).
PROGRAMS = st.lists(st.one_of(SCOPES.map(tuple), st.just("close"), st.just("draw")), max_size=40)


def expand(value):
    """A state as the hardware has it: per target for the types that exist per target."""
    return (value,) * MAX_TARGETS if type(value) in PER_TARGET else value


def apply(model, states):
    """The plain model: a dict from state type to value."""
    model = dict(model)
    for state in states:
        target = getattr(state, "target", None)
        if target is None:
            model[type(state)] = expand(state)
        else:
            row = list(model[type(state)])
            row[target] = dataclasses.replace(state, target=None)
            model[type(state)] = tuple(row)
    return model


def requested(cache):
    return dict(zip(STATE_TYPES, cache.requested.values, strict=True))


DEFAULT_MODEL = {state_type: expand(value) for state_type, value in DEFAULTS.items()} | {PlatformState: ()}


@given(PROGRAMS, st.sampled_from([16_384, 8, 1]))
@settings(max_examples=150)
def test_the_hardware_states_equal_the_requested_states_at_each_draw(program, pool_entries):
    cache = StateCache(pool_entries=pool_entries)
    models, open_scopes, hardware = [DEFAULT_MODEL], [], dict(DEFAULT_MODEL)
    software = sent = 0
    for step in program:
        if step == "draw":
            changes = cache.flush()
            assert len({change.type for change in changes}) == len(changes)
            for change in changes:
                assert change.value != hardware[change.type]  # nothing is sent that is already there
                hardware[change.type] = change.value
            sent += len(changes)
            assert hardware == models[-1]
            assert cache.flush() == ()
        elif step == "close":
            if open_scopes:
                open_scopes.pop().__exit__(None, None, None)
                models.pop()
        else:
            scope = cache.scope(step)
            scope.__enter__()
            open_scopes.append(scope)
            models.append(apply(models[-1], step))
            software += len(step)
        assert requested(cache) == models[-1]
        assert cache.depth == len(open_scopes)
        assert cache.vector_count <= pool_entries + 2
    assert (cache.software_changes, cache.hardware_changes) == (software, sent)


@given(st.lists(SCOPES.map(tuple), min_size=1, max_size=6), st.integers(0, 5))
@settings(max_examples=80)
def test_scopes_restore_when_an_exception_leaves_them(scopes, depth):
    cache = StateCache()

    def enter(level):
        if level == min(depth, len(scopes)):
            raise KeyError(level)
        before = cache.requested
        try:
            with cache.scope(scopes[level]):
                enter(level + 1)
        finally:
            assert cache.requested.values == before.values

    with pytest.raises(KeyError):
        enter(0)
    assert requested(cache) == DEFAULT_MODEL
    assert cache.depth == 0


def test_equal_combinations_are_one_vector_whichever_way_they_came_about():
    cache = StateCache()
    with cache.scope((CullMode.NONE,)), cache.scope((DepthTest.OFF,)):
        first = cache.requested
    with cache.scope((DepthTest.OFF, CullMode.NONE)):
        assert cache.requested is first


def test_a_scope_of_no_states_changes_nothing():
    cache = StateCache()
    with cache.scope((CullMode.NONE,)):
        before = cache.requested
        with cache.scope(()):
            assert cache.requested is before
            assert (cache.depth, cache.software_changes) == (2, 1)
    assert requested(cache) == DEFAULT_MODEL


def test_a_missing_capability_refuses_the_state_but_not_its_default():
    cache = StateCache(replace(ANY_DEVICE, alpha_test=False))
    with cache.scope((AlphaTest.OFF,)):
        pass
    with (
        pytest.raises(ValidationError, match=r"^\[state-capability\]") as caught,
        cache.scope((AlphaTest.ON,)),
    ):
        pass
    assert "alpha_test" in caught.value.allowed


@pytest.mark.parametrize(("maximum", "wider"), [(1.0, 1.001), (8.0, 8.5)])
def test_a_line_is_as_wide_as_the_device_allows_and_no_wider(maximum, wider):
    limits = replace(ANY_DEVICE, max_line_width=maximum)
    for cache in (StateCache(limits), StateCache(limits).fresh()):
        with cache.scope((LineWidth(maximum),)):
            pass
        with (
            pytest.raises(ValidationError, match=r"^\[state-capability\]") as caught,
            cache.scope((LineWidth(wider),)),
        ):
            pass
        assert f"max_line_width, {maximum:g}" in caught.value.allowed


def test_the_deepest_scope_fits_and_one_more_is_refused():
    cache = StateCache()
    scope = cache.scope((CullMode.NONE,))
    for _ in range(STACK_DEPTH):
        scope.__enter__()
    with pytest.raises(ValidationError, match=r"^\[container-full\]"):
        scope.__enter__()
    assert cache.software_changes == STACK_DEPTH
    for _ in range(STACK_DEPTH):
        scope.__exit__(None, None, None)
    assert requested(cache) == DEFAULT_MODEL


def test_the_pool_of_vectors_stays_bounded():
    cache = StateCache(pool_entries=50)
    for x in range(500):
        with cache.scope((Viewport(x, 0, 8, 8),)):
            assert cache.flush() == (StateChange(Viewport, Viewport(x, 0, 8, 8)),)
        assert cache.flush() == (StateChange(Viewport, Viewport.TARGET),)
        assert cache.vector_count <= 52
        assert len(cache.requested.after) <= 52
        assert len(cache.requested.changes) <= 52


def test_stack_and_hardware_cache_fit_into_4_kilobytes():
    """Thesis 4.2.3: about 4 kB, with room for more than 200 states."""
    cache = StateCache()
    stack, vector = cache.scopes, cache.hardware
    per_target = [vector[state_type] for state_type in PER_TARGET]
    parts = [stack, stack._data, vector, vector.values, *per_target]
    assert stack.capacity > 200
    assert sum(map(sys.getsizeof, parts)) <= 4096
