"""Query sets of gl and cl without a recorder or a driver's checks: beside counters, and their memory."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi
from rhi import Device, Format, Mesh, QuerySet
from rhi.backends.cl.cl_backend import ClBackend
from rhi.backends.gl.gl_backend import GlBackend
from rhi.backends.gl.gl_query_sets import GlQuerySet
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import texel_rectangle
from rhi.contract.descriptors import QueryKind

SIZE = (16, 16)
SAMPLES = np.arange(1, 17)


@pytest.fixture(params=["gl", "cl"])
def device(request: pytest.FixtureRequest) -> Iterator[Device]:
    try:
        device = rhi.create_device(request.param)
    except rhi.DeviceError as error:
        pytest.skip(f"no {request.param} device here: {error.given or error.rule.sentence}")
    with device:
        yield device


@pytest.fixture
def bars(device: Device) -> Mesh:
    """16 rectangles; the i-th has i + 1 texels."""
    return device.mesh(np.concatenate([texel_rectangle(0, 0, i + 1, 1, SIZE) for i in range(16)]))


def draw(device: Device, bars: Mesh, queries: QuerySet, rows: Any) -> None:
    """Draw the rectangles `rows`, each counted by the row of its number."""
    first: NDArray[Any] = 6 * np.array(rows)
    device.draw_counted(device.program(Colored), bars, bars.draws(first, 6), queries, rows)


def test_a_backend_takes_all_queries_at_once(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both backends implement query sets; else these tests would examine the methods for single queries."""
    backend: Any = device._core.backend
    assert isinstance(backend, (GlBackend, ClBackend))
    bars = device.mesh(texel_rectangle(0, 0, 3, 1, SIZE))
    queries = device.query_set(2)
    for method in ("begin_query", "end_query", "read_query", "draw"):
        monkeypatch.delattr(backend if method in vars(backend) else type(backend), method)
    with device.texture(SIZE, Format.R8) as image:
        with device.render_pass(image):
            device.draw_counted(device.program(Colored), bars, bars.draws([0, 0]), queries)
        assert queries.wait().tolist() == [3, 3]


def test_a_running_counter_includes_the_draws_of_a_query_set(device: Device, bars: Mesh) -> None:
    """Queries before, in and after it, in whichever order they are read."""
    backend, core = device._core.backend, device._core
    queries, program = device.query_set(16), device.program(Colored)
    counters = [core.create_id() for _ in range(4)]
    for counter in counters:
        backend.create_query(counter, QueryKind.COUNTER)
    with device.texture(SIZE, Format.R8) as image:
        for _ in range(3):
            with device.render_pass(image):
                backend.write_query(counters[0])
                device.draw(program, bars.view(6 * 9, 6))
                backend.write_query(counters[1])
                draw(device, bars, queries, range(5))
                draw(device, bars, queries, range(16))
                backend.write_query(counters[2])
                device.draw(program, bars.view(6 * 3, 6))
                backend.write_query(counters[3])
            device.finish()
            counts = [backend.read_query(counter) for counter in counters]
            assert np.diff(np.array(counts)).tolist() == [10, SAMPLES[:5].sum() + SAMPLES.sum(), 4]
            assert queries.wait().tolist() == SAMPLES.tolist()


def test_a_counter_that_begins_to_run_between_draws_and_answers_changes_neither(
    device: Device, bars: Mesh
) -> None:
    first, second = device.query_set(16), device.query_set(16)
    with device.texture(SIZE, Format.R8) as image:
        with device.render_pass(image):
            draw(device, bars, first, range(16))
            emulated = device.query_set(16, emulated=True)
            draw(device, bars, second, range(16))
            draw(device, bars, emulated, range(16))
        assert [answer.wait().tolist() for answer in (first, second, emulated)] == [SAMPLES.tolist()] * 3
        emulated.destroy()
        device.finish()
        with device.render_pass(image):
            draw(device, bars, first, range(16))
        assert first.wait().tolist() == SAMPLES.tolist()


def test_sets_that_are_gone_give_their_memory_back(device: Device, bars: Mesh) -> None:
    """Memory is reused also by queries that were begun again before they were read."""
    with device.texture(SIZE, Format.R8) as image:
        for _ in range(50):
            queries = device.query_set(400)
            for rows in (range(8), range(16)):
                with device.render_pass(image):
                    draw(device, bars, queries, rows)
            assert queries.wait()[:16].tolist() == SAMPLES.tolist()
            queries.destroy()
            del queries
        device.finish()
        gc.collect()
    backend: Any = device._core.backend
    if isinstance(backend, ClBackend):
        assert len(backend._rasteriser.queries._free) <= 3
    else:
        assert not backend._queries._queries


def test_queries_of_gl_are_not_waited_for_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the last query is polled for its result."""
    try:
        device = rhi.create_device("gl")
    except rhi.DeviceError as error:
        pytest.skip(f"no gl device here: {error.given or error.rule.sentence}")
    with device, device.texture(SIZE, Format.R8) as image:
        bars = device.mesh(np.concatenate([texel_rectangle(0, 0, i + 1, 1, SIZE) for i in range(16)]))
        queries = device.query_set(16)
        assert isinstance(queries._prepared, GlQuerySet)
        with device.render_pass(image):
            draw(device, bars, queries, range(16))
        device.finish()
        gl, asked = queries._prepared._gl, []
        get = gl.GetQueryObjectui64v

        def note(name: int, what: int, address: Any) -> None:
            asked.append(what)
            get(name, what, address)

        monkeypatch.setattr(gl, "GetQueryObjectui64v", note)
        assert queries.wait().tolist() == SAMPLES.tolist()
    assert len(asked) == 17
