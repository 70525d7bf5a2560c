"""A file never runs code: nothing that it names is imported, its shaders run only if it is trusted, and what
it draws lies in the buffers that it makes."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nightly_reasons import CHEAPER_TEST
from testing_kit import backend_works
from trace_kit import VERSION_1, edit_line, record, record_draws, record_much, rewrite

import rhi
from rhi import Format
from rhi.backends.gl import DepthClamp
from rhi.conformance.operation.test_samples import ReadSample, Sample
from rhi.conformance.shaders import Loads
from rhi.conformance.shapes import rectangle
from rhi.conformance.validation.refusal import refuses
from rhi.trace import diff, load, reduce, replay, save
from rhi.trace.rules import TRACE_COMMAND, TRACE_REFERENCE, TRACE_TRUST

Change = Callable[[dict[str, Any]], object]
DRAWING = [name for name in ("gl", "cl", "wgpu") if backend_works(name)]
drawing = pytest.mark.parametrize("backend", DRAWING)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return record(tmp_path / "t.zip")


# -- names ---------------------------------------------------------------------------------------------------


def state(name: str) -> Change:
    return lambda line: line["arguments"].update(changes=[{"type": "PlatformState", "value": [name]}])


@pytest.mark.parametrize("name", ["wicked:run.X.ON", "wicked.X.ON", "wicked:run", "os:system.X.Y"])
def test_no_module_is_imported_because_a_file_names_it(
    file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    (tmp_path / "wicked.py").write_text("raise SystemExit('imported')\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    with refuses(TRACE_COMMAND):
        load(edit_line(file, "set_states", state(name)))
    assert "wicked" not in sys.modules


def test_states_of_our_own_platforms_are_loaded(file: Path) -> None:
    trace = load(edit_line(file, "set_states", state("gl.DepthClamp.ON")))
    (change,) = trace.stream.filter(rhi.Op.SET_STATES)[0]["changes"]
    assert change.value == (DepthClamp.ON,)


# -- shaders -------------------------------------------------------------------------------------------------


@pytest.mark.nightly_cases("cl", reason=CHEAPER_TEST)
@drawing
def test_shaders_of_a_file_run_only_if_it_is_trusted(file: Path, backend: str) -> None:
    with rhi.create_device(backend) as device:
        with refuses(TRACE_TRUST):
            replay(load(file), on=device)
        with pytest.raises(rhi.ShaderError):  # nor by way of its stream
            replay(load(file).stream, on=device)
        result = replay(load(file, trusted=True), on=device).image
        expected = record_much(device).read()
    assert result is not None
    assert np.array_equal(result, expected)


def test_untrusted_files_can_be_shown_compared_reduced_saved_and_replayed_without_shaders(
    tmp_path: Path, null_device: rhi.Device
) -> None:
    trace = load(VERSION_1)
    assert "draw(" in str(trace.stream)
    assert not diff(trace, load(VERSION_1, trusted=True))
    assert len(reduce(trace, lambda part: len(part.stream.draws()) > 0)) < len(trace)
    assert not trace.select([0, 1]).trusted
    assert replay(trace, on=null_device).commands == len(trace)
    save(trace, tmp_path / "again.zip")
    assert not diff(trace, load(tmp_path / "again.zip"))


@drawing
def test_a_file_without_shaders_needs_no_trust(tmp_path: Path, backend: str) -> None:
    with rhi.create_device("null") as device:
        target = device.texture((4, 4), Format.RGBA8)
        with device.render_pass(target, clear=(1, 0, 0, 1)):
            pass
        device.present(target)
        save(device, tmp_path / "t.zip")
    with rhi.create_device(backend) as device:
        result = replay(load(tmp_path / "t.zip"), on=device).image
    assert result is not None
    assert (result == (255, 0, 0, 255)).all()


# -- draws ---------------------------------------------------------------------------------------------------


def argument(op: str, **changes: object) -> tuple[str, Change]:
    return op, lambda line: line["arguments"].update(changes)


def attribute(**changes: object) -> tuple[str, Change]:
    def change(line: dict[str, Any]) -> None:
        line["arguments"]["descriptor"]["streams"][0]["attributes"][0].update(changes)

    return "create_vertex_array", change


def stream(**changes: object) -> tuple[str, Change]:
    return "create_vertex_array", lambda line: line["arguments"]["descriptor"]["streams"][0].update(changes)


@pytest.mark.parametrize(
    ("wrong", "right"),
    [
        (attribute(offset=1 << 40), attribute(offset=0)),
        (attribute(offset=1), attribute(offset=0)),  # beyond the stride
        (stream(offset=25), stream(offset=24)),  # where no element is left
        (argument("draw", first=1), argument("draw", first=0)),
        (argument("draw", count=7), argument("draw", count=6)),
        (argument("draw", instances=6), argument("draw", instances=5)),
        (argument("draw", base_instance=1), argument("draw", base_instance=0)),
        (argument("draw", base_vertex=4), argument("draw", base_vertex=3)),
        (argument("draw", instances=1 << 40), argument("draw", instances=0)),
        (argument("draw_indirect", primitive="QUADS"), argument("draw_indirect", primitive="LINES")),
        (argument("dispatch", x=1 << 27), argument("dispatch", x=1 << 26)),
    ],
    ids=lambda case: case[0] if isinstance(case, tuple) else str(case),
)
def test_draws_lie_in_the_buffers_of_their_vertex_array(
    tmp_path: Path, wrong: tuple[str, Change], right: tuple[str, Change]
) -> None:
    file = record_draws(tmp_path / "t.zip")
    load(edit_line(file, *right))
    with refuses(TRACE_REFERENCE):
        load(edit_line(file, *wrong))


@drawing
@pytest.mark.parametrize(
    ("array", "word", "wrong"),
    [("arguments", 0, 7), ("arguments", 1, 6), ("arguments", 2, 4), ("arguments", 3, 4), ("arguments", 4, 5),
     ("arguments", 5, 1 << 30), ("groups", 0, 1 << 31), ("groups", 2, 1 << 27)],
)  # fmt: skip
def test_indirect_arguments_of_a_file_are_checked_before_they_are_executed(
    tmp_path: Path, backend: str, array: str, word: int, wrong: int
) -> None:
    file = record_draws(tmp_path / "t.zip")
    stream = load(file).stream
    op = rhi.Op.DRAW_INDIRECT if array == "arguments" else rhi.Op.DISPATCH_INDIRECT
    buffer = stream.filter(op)[0]["buffer"]
    write = next(w for w in stream.filter(rhi.Op.WRITE_BUFFER) if w["buffer"] == buffer)
    values = np.frombuffer(write["data"], np.uint32).copy()
    with rhi.create_device(backend) as device:
        replay(load(file, trusted=True), on=device)
        trace = load(file, trusted=True)
        values[word] = wrong
        trace.stream.data[trace.stream.data.index(write["data"])] = values.tobytes()
        with refuses(TRACE_REFERENCE):
            replay(trace, on=device)
        replay(load(file, trusted=True), on=device)  # the device goes on


@drawing
def test_a_draw_whose_bindings_are_gone_is_refused_before_the_first_command(
    tmp_path: Path, backend: str
) -> None:
    file = record_draws(tmp_path / "t.zip")
    trace = load(file, trusted=True)
    binds = [
        c.index for c in trace.stream if c.op in (rhi.Op.BIND_UNIFORM, rhi.Op.BIND_STORAGE, rhi.Op.BIND_IMAGE)
    ]
    assert len(binds) >= 3
    with rhi.create_device(backend, record=True) as device:
        for left_out in binds[:3]:
            part = trace.select([index for index in range(len(trace)) if index != left_out])
            before = len(device.stream)
            with refuses(TRACE_REFERENCE):
                replay(part, on=device)
            assert len(device.stream) == before


def test_a_binding_smaller_than_its_program_says_is_refused(tmp_path: Path) -> None:
    file = record_draws(tmp_path / "t.zip")
    trace = load(edit_line(file, "bind_uniform", lambda line: line["arguments"].update(size=8)), trusted=True)
    for backend in DRAWING:
        with rhi.create_device(backend) as device, refuses(TRACE_REFERENCE):
            replay(trace, on=device)


def edit_texture(file: Path, texture: int, **changes: object) -> Path:
    """Change how a texture is created."""

    def edit(members: dict[str, bytes]) -> None:
        lines = [json.loads(line) for line in members["commands.jsonl"].splitlines()]
        line = next(text for text in lines if text.get("arguments", {}).get("texture") == texture)
        line["arguments"]["descriptor"].update(changes)
        members["commands.jsonl"] = "".join(json.dumps(line) + "\n" for line in lines).encode()

    return rewrite(file, edit)


def test_an_image_has_the_format_that_its_program_stores(tmp_path: Path) -> None:
    file = record_draws(tmp_path / "t.zip")
    image_id = load(file).stream.filter(rhi.Op.BIND_IMAGE)[0]["texture"]
    changed = edit_texture(file, image_id, format="R8")
    for backend in DRAWING:
        with rhi.create_device(backend) as device, refuses(TRACE_REFERENCE):
            replay(load(changed, trusted=True), on=device)


@drawing
@pytest.mark.parametrize(("reader", "samples"), [(ReadSample, 4), (Loads, 1)], ids=["several", "one"])
def test_a_texture_has_the_samples_that_its_program_reads(
    tmp_path: Path, backend: str, reader: Any, samples: int
) -> None:
    file, more = tmp_path / "t.zip", {"sample": Sample(number=0, origin=(0, 0))} if samples > 1 else {}
    with rhi.create_device("null", record=True) as device, device.mesh(rectangle()) as mesh:
        source, target = (device.texture((4, 4), rhi.Format.RGBA8, samples=count) for count in (samples, 1))
        with device.render_pass(target):
            device.draw(device.program(reader), mesh, source=source, **more)
        save(device.stream, file)
    with rhi.create_device(backend) as device:
        replay(load(file, trusted=True), on=device)
        changed = edit_texture(file, source.id, samples=5 - samples)
        with refuses(TRACE_REFERENCE):
            replay(load(changed, trusted=True), on=device)


@drawing
@pytest.mark.parametrize(("format", "accepted"), [("R8", True), ("RG32I", False), ("R32UI", False)])
def test_a_texture_has_the_numbers_that_its_program_reads(
    tmp_path: Path, backend: str, format: str, accepted: bool
) -> None:
    file = tmp_path / "t.zip"
    with rhi.create_device("null", record=True) as device, device.mesh(rectangle()) as mesh:
        source, target = (device.texture((4, 4), rhi.Format.RGBA8) for _ in range(2))
        with device.render_pass(target):
            device.draw(device.program(Loads), mesh, source=source)
        save(device.stream, file)
    changed = load(edit_texture(file, source.id, format=format), trusted=True)
    with rhi.create_device(backend) as device:
        if accepted:
            replay(changed, on=device)
        else:
            with refuses(TRACE_REFERENCE):
                replay(changed, on=device)


def test_a_draw_needs_the_vertex_array_of_its_program(tmp_path: Path) -> None:
    file = record_draws(tmp_path / "t.zip")
    first, second = (command["vertex_array"] for command in load(file).stream.draws()[:2])
    assert first != second
    load(edit_line(file, *argument("draw", vertex_array=first)))
    with refuses(TRACE_REFERENCE):
        load(edit_line(file, *argument("draw", vertex_array=second)))
