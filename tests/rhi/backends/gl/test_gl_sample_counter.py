"""The running samples-passed counter made of consecutive queries."""

from __future__ import annotations

import ctypes

import pytest
from gl_kit import FULL, GlKit, describe_program
from hypothesis import given
from hypothesis import strategies as st

from rhi.backends.gl import create_backend, enums
from rhi.backends.gl.gl_queries import SampleCounter
from rhi.contract.descriptors import BufferDescriptor, Id, QueryKind
from rhi.contract.states import CullMode


class FakeQueries:
    """Fake GL queries, whose results become available when a test says so."""

    def __init__(self) -> None:
        self.samples: dict[int, int] = {}
        self.active = 0
        self.ready = 0  # queries up to this name have results
        self.freed: list[int] = []
        self.counter = SampleCounter(self.begin, self.end, self.read, self.freed.append)

    def begin(self) -> int:
        assert not self.active, "GL allows one at a time"
        self.active = len(self.samples) + 1
        self.samples[self.active] = 0
        return self.active

    def end(self) -> None:
        assert self.active
        self.active = 0

    def read(self, name: int) -> int | None:
        assert name != self.active
        return self.samples[name] if name <= self.ready else None

    def draw(self, samples: int) -> None:
        if self.active:
            self.samples[self.active] += samples


@given(st.lists(st.lists(st.integers(0, 1000), max_size=4), max_size=12), st.integers(0, 20))
def test_a_count_is_the_sum_of_all_drawn_before_it(draws: list[list[int]], ready: int) -> None:
    fake = FakeQueries()
    fake.counter.start()
    counts, sums, total = [], [], 0
    for samples in draws:
        for count in samples:
            fake.draw(count)
            total += count
        counts.append(fake.counter.take())
        sums.append(total)
    fake.ready = ready
    fake.counter.collect()
    assert [count.value for count in counts[:ready]] == sums[:ready]
    assert all(count.value is None for count in counts[ready:])
    fake.ready = len(fake.samples)
    fake.counter.collect()
    assert [count.value for count in counts] == sums


def test_a_result_that_comes_early_waits_for_those_before_it() -> None:
    fake = FakeQueries()
    late: set[int] = {1}
    counter = SampleCounter(
        fake.begin, fake.end, lambda n: None if n in late else fake.samples[n], fake.freed.append
    )
    counter.start()
    fake.draw(3)
    first = counter.take()
    fake.draw(4)
    second = counter.take()
    counter.collect()
    assert (first.value, second.value) == (None, None)
    late.clear()
    counter.collect()
    assert (first.value, second.value) == (3, 7)


def test_each_segment_gives_its_query_back_once_it_is_counted() -> None:
    fake = FakeQueries()
    fake.counter.start()
    fake.counter.take()
    fake.counter.take()
    assert fake.freed == []
    fake.ready = 1
    fake.counter.collect()
    assert fake.freed == [1]


def test_no_query_is_active_outside_start_and_stop() -> None:
    fake = FakeQueries()
    assert not fake.counter.is_running
    assert not fake.active
    fake.counter.start()
    assert fake.active
    fake.counter.stop()
    assert not fake.active
    fake.draw(9)
    fake.ready = 9
    assert fake.counter.start().value is None  # the segment before has yet to be collected
    fake.counter.collect()
    assert fake.counter.take().value == 0


def _begin(kit: GlKit) -> tuple[Id, Id]:
    program = kit.program(describe_program())
    shape, image = kit.shape(program, FULL), kit.texture()
    kit.set(CullMode.NONE)
    kit.begin(image)
    kit.backend.bind_program(program)
    return shape, image


def test_occlusion_queries_are_gls_own_without_counters(gl_kit: GlKit) -> None:
    query = gl_kit.query(QueryKind.OCCLUSION)
    shape, _ = _begin(gl_kit)
    gl_kit.backend.begin_query(query)
    gl_kit.draw(shape)
    gl_kit.backend.end_query(query)
    assert gl_kit.backend._queries._queries[query].end is None
    assert gl_kit.answer(query) == 64


def test_an_occlusion_query_counts_across_counters_taken_inside_it(gl_kit: GlKit) -> None:
    counters = [gl_kit.query(QueryKind.COUNTER) for _ in range(3)]
    query = gl_kit.query(QueryKind.OCCLUSION)
    shape, _ = _begin(gl_kit)
    gl_kit.draw(shape)
    gl_kit.backend.write_query(counters[0])
    gl_kit.backend.begin_query(query)
    gl_kit.draw(shape)
    gl_kit.backend.write_query(counters[1])
    gl_kit.draw(shape)
    gl_kit.backend.end_query(query)
    gl_kit.draw(shape)
    gl_kit.backend.write_query(counters[2])
    assert gl_kit.answer(query) == 128
    assert [gl_kit.answer(counter) for counter in counters] == [64, 128, 256]


def test_a_counter_made_inside_an_occlusion_query_takes_it_over(gl_kit: GlKit) -> None:
    query = gl_kit.query(QueryKind.OCCLUSION)
    shape, _ = _begin(gl_kit)
    gl_kit.backend.begin_query(query)
    gl_kit.draw(shape)
    counter = gl_kit.query(QueryKind.COUNTER)
    gl_kit.draw(shape)
    gl_kit.backend.write_query(counter)
    gl_kit.draw(shape)
    gl_kit.backend.end_query(query)
    assert gl_kit.answer(query) == 192


def test_the_chain_of_queries_ends_with_the_last_counter(gl_kit: GlKit) -> None:
    counters = [gl_kit.query(QueryKind.COUNTER) for _ in range(2)]
    running = gl_kit.backend._queries._counter
    gl_kit.backend.destroy(counters[0])
    assert running.is_running
    gl_kit.backend.destroy(counters[1])
    assert not running.is_running


def test_a_counted_query_drops_draws_like_one_of_gl(gl_kit: GlKit) -> None:
    query = gl_kit.query(QueryKind.OCCLUSION)
    gl_kit.query(QueryKind.COUNTER)
    shape, image = _begin(gl_kit)
    gl_kit.backend.begin_query(query)
    gl_kit.backend.end_query(query)
    for inverted, drawn in ((False, 0), (True, 255)):
        gl_kit.backend.begin_conditional(query, inverted)
        gl_kit.draw(shape)
        gl_kit.backend.end_conditional()
        assert (gl_kit.read(image)[..., 0] == drawn).all()


@pytest.mark.parametrize("kind", [QueryKind.OCCLUSION, QueryKind.COUNTER])
def test_no_query_is_active_when_the_context_goes(kind: QueryKind, monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise llvmpipe crashes more often than not."""
    kit, active = GlKit(create_backend()), []
    gl = kit.backend.gl
    begin, end = gl.BeginQuery, gl.EndQuery
    monkeypatch.setattr(gl, "BeginQuery", lambda target, name: begin(target, name) or active.append(name))
    monkeypatch.setattr(gl, "EndQuery", lambda target: end(target) or active.pop())
    query = kit.query(kind)
    shape, _ = _begin(kit)
    if kind is QueryKind.OCCLUSION:
        kit.backend.begin_query(query)
    kit.draw(shape)
    assert len(active) == 1
    kit.backend.close()
    assert not active


@pytest.mark.parametrize("kind", [QueryKind.OCCLUSION, QueryKind.COUNTER])
@pytest.mark.parametrize("is_new", [False, True], ids=["drawing", "created"])
def test_no_query_is_active_while_another_device_has_the_thread(
    gl_kit: GlKit, kind: QueryKind, is_new: bool
) -> None:
    """Drivers of some GPUs would add what the other draws. llvmpipe doesn't, so counts alone can't show it
    here."""

    def list_active() -> int:
        active = ctypes.c_int()
        gl_kit.backend.context.mglo.__enter__()
        gl_kit.backend.gl.GetQueryiv(enums.SAMPLES_PASSED, enums.CURRENT_QUERY, ctypes.byref(active))
        other.context.mglo.__enter__()
        return active.value

    other = None if is_new else create_backend()
    program, query = gl_kit.program(describe_program()), gl_kit.query(kind)
    shape = gl_kit.shape(program, FULL)
    gl_kit.begin(gl_kit.texture())
    gl_kit.set(CullMode.NONE)
    gl_kit.backend.bind_program(program)
    if kind is QueryKind.OCCLUSION:
        gl_kit.backend.begin_query(query)
    gl_kit.draw(shape)
    other = other or create_backend()
    other.create_buffer(901, BufferDescriptor(64))
    assert list_active() == 0
    gl_kit.draw(shape)
    assert list_active() != 0  # and counts again
    other.activate()
    if kind is QueryKind.OCCLUSION:
        gl_kit.backend.end_query(query)
    else:
        gl_kit.backend.write_query(query)
    assert gl_kit.answer(query) == 128
    other.close()
