"""A trace replays: on null to the same commands, on GL to the same image."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from testing_kit import SampleFrame, backend_works, gl_works
from trace_kit import VERSION_1, Doubled, record, record_much

import rhi
from rhi import CullMode, DepthTest, Format, LineWidth, Op, PolygonMode
from rhi.conformance.shaders import Colored, Tint, Tinted
from rhi.conformance.shapes import rectangle
from rhi.conformance.validation.refusal import refuses
from rhi.contract.descriptors import BufferDescriptor, Stage, StageText
from rhi.errors import DeviceError
from rhi.errors.rules import DEVICE_MEMORY, PASS_OPEN
from rhi.shading import emitters, register_language
from rhi.testing import expect
from rhi.trace import diff, load, replay, save
from rhi.trace.rules import TRACE_CAPABILITY, TRACE_INCOMPLETE
from rhi.trace.validation import check_capabilities

requires_gl = pytest.mark.skipif(not gl_works(), reason="no GL device here")


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return record(tmp_path / "t.zip")


def test_a_trace_is_loaded_as_it_was_recorded(tmp_path: Path) -> None:
    with rhi.create_device("null") as device:
        record_much(device)
        save(device, tmp_path / "t.zip")
        trace = load(tmp_path / "t.zip")
        assert trace.backend == "null"
        assert len(trace) == len(device.stream)
        for a, b in zip(device.stream, trace.stream, strict=True):
            assert (a.op, a.site, a.labels, a.states, a.failure) == (
                b.op,
                b.site,
                b.labels,
                b.states,
                b.failure,
            )
            if a.op is not Op.CREATE_PROGRAM:
                assert a.values == b.values
        assert not diff(device, trace)


def test_equal_recordings_are_equal_files(tmp_path: Path) -> None:
    assert record(tmp_path / "a.zip").read_bytes() == record(tmp_path / "b.zip").read_bytes()


def test_a_loaded_trace_can_be_asserted_on(file: Path) -> None:
    stream = load(file).stream
    expect(stream).draws(program="Shadow").within("sun").with_bindings(light="light").exactly(2)


@requires_gl
def test_a_frame_recorded_on_null_replays_on_gl_to_the_same_image(file: Path) -> None:
    with rhi.create_device("gl", validation=True) as device:
        image = replay(load(file, trusted=True), on=device).image
    with rhi.create_device("gl") as device:
        expected = record_much(device).read()
    assert image is not None
    assert len(np.unique(expected.reshape(-1, 4), axis=0)) >= 3
    assert np.array_equal(image, expected)


@requires_gl
def test_a_frame_recorded_on_gl_replays_on_null_to_the_same_commands(tmp_path: Path) -> None:
    with rhi.create_device("gl", record=True) as device:
        SampleFrame(device).render()
        save(device, tmp_path / "t.zip")
    with rhi.create_device("null") as device:
        replay(load(tmp_path / "t.zip"), on=device)
        differences = diff(load(tmp_path / "t.zip"), device)
        assert [d.b.op for d in differences if d.b is not None] == [Op.READ_TEXTURE, Op.SET_STATES], str(
            differences
        )


def test_the_image_is_the_last_presented_one(null_device: rhi.Device) -> None:
    with rhi.create_device("null") as source:
        image = source.texture((2, 2), Format.R8)
        for value in (0.2, 0.4):
            with source.render_pass(image, clear=(value, 0, 0, 0)):
                pass
            source.present(image)
        with source.render_pass(image, clear=(1, 0, 0, 0)):
            pass
        result = replay(source, on=null_device)
    assert result.image is not None
    assert result.image.shape == (2, 2, 1)
    assert (result.image == 102).all()


def test_without_present_there_is_no_image(null_device: rhi.Device) -> None:
    with rhi.create_device("null") as source:
        source.texture((2, 2), Format.R8)
        source.present()
        assert replay(source, on=null_device).image is None


def test_a_used_device_can_replay_and_go_on(file: Path, null_device: rhi.Device) -> None:
    sample_frame = SampleFrame(null_device)
    with null_device.states(CullMode.NONE):
        with null_device.render_pass(sample_frame.image):
            null_device.draw(
                sample_frame.lit, sample_frame.walls, light=sample_frame.light, tint=sample_frame.tint
            )
    null_device.finish()
    replay(load(file), on=null_device)
    sample_frame.render()
    with null_device.render_pass(sample_frame.image):
        null_device.draw(
            sample_frame.lit, sample_frame.walls, light=sample_frame.light, tint=sample_frame.tint
        )
    last = null_device.stream.draws()[-1]
    assert last.states[CullMode] is CullMode.BACK
    assert last.labels == ()
    expect(null_device).draws(program=sample_frame.lit).with_bindings(tint=sample_frame.tint).at_least(3)


def test_all_ids_of_a_command_are_translated(null_device: rhi.Device) -> None:
    with rhi.create_device("null") as source:
        sample_frame = SampleFrame(source)
        arguments, number = source.buffer(40), source.buffer(4, label="number")
        draws = rhi.IndirectDraws(arguments, 2, count=number)
        with source.render_pass(sample_frame.image):
            source.draw_indirect(
                sample_frame.lit, sample_frame.walls, draws, light=sample_frame.light, tint=sample_frame.tint
            )
        source.buffer(8, label="source").copy_to(source.buffer(8, label="target"))
        for _ in range(3):
            null_device.buffer(4)
        before = len(null_device.stream)
        replay(source, on=null_device)
        replayed = null_device.stream[before:]
    (indirect,) = replayed.filter(Op.DRAW_INDIRECT)
    assert indirect["count_buffer"] != source.stream.filter(Op.DRAW_INDIRECT)[0]["count_buffer"]
    assert indirect.resource(indirect["count_buffer"]).label == "number"
    assert indirect.resource(indirect["vertex_array"]).program == indirect.program
    (copy,) = replayed.filter(Op.COPY_BUFFER)
    assert [copy.resource(copy[name]).label for name in ("source", "target")] == ["source", "target"]
    image = replayed.filter(Op.BEGIN_PASS)[0]["descriptor"].colors[0].texture
    assert indirect.resource(image).label == "image"


def test_scopes_that_a_trace_leaves_open_are_closed_after_a_replay(null_device: rhi.Device) -> None:
    with rhi.create_device("null") as source:
        image = source.texture((2, 2), Format.R8)
        with source.event("outer"), source.render_pass(image), source.states(CullMode.NONE):
            replay(source.stream, on=null_device)
    assert null_device.stream[-1].op in (Op.POP_LABEL, Op.SET_STATES)
    null_device.buffer(4)
    command = null_device.stream[-1]
    assert (command.labels, command.render_pass) == ((), None)


def test_ring_memory_becomes_plain_memory(file: Path, null_device: rhi.Device) -> None:
    replay(load(file), on=null_device)
    created = null_device.stream.filter(Op.CREATE_BUFFER)
    assert {command["descriptor"].usage for command in created} == {rhi.BufferUsage.STATIC}
    recorded = load(file).stream.filter(Op.CREATE_BUFFER)
    assert rhi.BufferUsage.STREAM in {command["descriptor"].usage for command in recorded}


@pytest.mark.parametrize("backend", ["gl", "cl"])
def test_a_dispatch_recorded_on_null_computes_on_another_backend(tmp_path: Path, backend: str) -> None:
    with rhi.create_device("null") as source:
        numbers, doubled = source.storage(int, np.arange(8, dtype=np.int32)), source.storage(int, 8)
        source.dispatch(source.program(Doubled), 2, source=numbers, target=doubled)
        save(source, tmp_path / "t.zip")
    try:
        device = rhi.create_device(backend)
    except rhi.DeviceError as error:
        pytest.skip(f"no {backend} device here: {error.given or error.rule.sentence}")
    with device:
        result = replay(load(tmp_path / "t.zip", trusted=True), on=device)
        data = device._backend.read_buffer(result.ids[doubled.owner.id], 0, 32)
    assert np.frombuffer(data, np.int32).tolist() == list(range(0, 16, 2))


SOURCES = [name for name in ("null", "gl", "cl", "wgpu") if backend_works(name)]
TARGETS = [name for name in SOURCES if name != "null"]


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A trace of the same frames from each backend."""
    files = {name: tmp_path_factory.mktemp("traces") / f"{name}.zip" for name in SOURCES}
    for name, path in files.items():
        with rhi.create_device(name, record=True) as device:
            record_much(device)
            save(device, path)
    return files


@pytest.fixture(scope="module")
def drawn_image() -> NDArray[np.uint8]:
    """The image that the frames give when they are drawn, and not replayed."""
    with rhi.create_device(TARGETS[0]) as device:
        image = record_much(device).read()
    assert len(np.unique(image.reshape(-1, 4), axis=0)) >= 2  # something is drawn
    return image


@pytest.mark.skipif(not TARGETS, reason="no device that draws")
@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("source", SOURCES)
def test_a_trace_of_any_backend_replays_on_any_other(
    recordings: dict[str, Path], drawn_image: NDArray[np.uint8], source: str, target: str
) -> None:
    with rhi.create_device(target) as device:
        result = replay(load(recordings[source], trusted=True), on=device)
    assert result.image is not None
    np.testing.assert_array_equal(result.image, drawn_image)


@pytest.mark.parametrize("source", SOURCES)
def test_a_trace_of_any_backend_replays_on_null(recordings: dict[str, Path], source: str) -> None:
    trace = load(recordings[source])
    with rhi.create_device("null") as device:
        assert replay(trace, on=device).commands == len(trace)


@pytest.mark.parametrize("source", SOURCES)
def test_values_passed_to_draws_replay_on_devices_of_coarser_alignment(tmp_path: Path, source: str) -> None:
    """A device's own alignment may be 16 bytes, another's 256."""
    with rhi.create_device(source, record=True) as device:
        image, mesh = device.texture((4, 4), Format.RGBA8), device.mesh(rectangle())
        tints = device.uniform_array(Tint, 3)
        with device.render_pass(image), device.states(DepthTest.OFF):
            for red in (0.25, 0.5):
                device.draw(device.program(Tinted), mesh, tint=Tint(color=(red, 0, 0, 1)))
            device.draw(device.program(Tinted), mesh, tint=tints[2])
        device.present(image)
        save(device, tmp_path / "t.zip")
    trace = load(tmp_path / "t.zip", trusted=True)
    for name in ("null", *TARGETS):
        with rhi.create_device(name) as device:
            replay(trace, on=device)
    with rhi.create_device("null", profile="gl-4.5") as device:
        replay(trace, on=device)


def test_a_trace_has_texts_in_the_language_of_a_port(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    languages = dict(emitters._LANGUAGES)
    monkeypatch.setattr(emitters, "_LANGUAGES", languages)
    register_language("metal", lambda code, stage: StageText(f"metal {stage.value}"))
    with rhi.create_device("null") as device:
        device.program(Colored)
        save(device, tmp_path / "t.zip")
    del languages["metal"]  # reading a trace doesn't need the port
    (creation,) = load(tmp_path / "t.zip", trusted=True).stream.filter(Op.CREATE_PROGRAM)
    assert creation["descriptor"].emit("metal", Stage.VERTEX).text == "metal vertex"


# -- failures ------------------------------------------------------------------------------------------------


class Full:
    """Makes the null backend's creations of large buffers fail."""

    def __init__(self, device: rhi.Device) -> None:
        backend = device.backend_as(type(device._backend.backend))  # type: ignore[attr-defined]
        create = backend.create_buffer

        def create_buffer(buffer: int, descriptor: BufferDescriptor) -> None:
            if descriptor.size > 1000:
                raise DeviceError(DEVICE_MEMORY, "create_buffer")
            create(buffer, descriptor)

        backend.create_buffer = create_buffer


def failing_trace(tmp_path: Path) -> Path:
    with rhi.create_device("null") as source:
        Full(source)
        with pytest.raises(DeviceError):
            source.buffer(2000)
        source.buffer(10)
        save(source, tmp_path / "t.zip")
    return tmp_path / "t.zip"


def test_failed_calls_are_kept(tmp_path: Path) -> None:
    stream = load(failing_trace(tmp_path)).stream
    failed = stream.filter(where=lambda command: command.failure is not None)
    assert [command.failure.error for command in failed] == ["device-out-of-memory"]
    assert failed[0]["descriptor"].size == 2000


def test_a_failed_call_is_tried_again(tmp_path: Path, null_device: rhi.Device) -> None:
    trace = load(failing_trace(tmp_path))
    (index,) = trace.stream.failures
    assert replay(trace, on=null_device).failures == {index: None}
    Full(null_device)
    failure = replay(trace, on=null_device).failures[index]
    assert failure is not None
    assert failure.error == "device-out-of-memory"


def test_a_new_failure_says_which_command_it_was(file: Path, null_device: rhi.Device) -> None:
    def refuse_textures(*_: object) -> None:
        raise DeviceError(DEVICE_MEMORY, "create_texture")

    null_device.backend_as(type(null_device._backend.backend)).create_texture = refuse_textures  # type: ignore
    with pytest.raises(DeviceError) as caught:
        replay(load(file), on=null_device)
    assert "while replaying command" in caught.value.__notes__[0]
    assert "testing_kit.py" in caught.value.__notes__[0]


def test_a_stream_without_its_beginning_is_refused(null_device: rhi.Device, tmp_path: Path) -> None:
    with rhi.create_device("null") as source:
        source.buffer(4)
        source.stream.clear()
        source.buffer(4)
        with refuses(TRACE_INCOMPLETE):
            save(source, tmp_path / "t.zip")
        with refuses(TRACE_INCOMPLETE):
            replay(source, on=null_device)
    assert not list(tmp_path.iterdir())


def test_a_paused_recording_is_refused(tmp_path: Path) -> None:
    with rhi.create_device("null") as source:
        buffer = source.buffer(4)
        with source._backend.paused():  # type: ignore[attr-defined]
            buffer.write(np.zeros(4, np.uint8))
        with refuses(TRACE_INCOMPLETE):
            save(source, tmp_path / "t.zip")


def test_an_open_pass_is_refused(file: Path, null_device: rhi.Device) -> None:
    trace = load(file)
    image = null_device.texture((2, 2), Format.R8)
    with null_device.render_pass(image), refuses(PASS_OPEN, null_device):
        replay(trace, on=null_device)


@pytest.mark.parametrize(
    ("lacking", "op"),
    [
        ({"max_texture_size": 48}, Op.CREATE_TEXTURE),
        ({"max_texture_layers": 5}, Op.CREATE_TEXTURE),
        ({"unsupported_formats": frozenset({Format.RGBA16F})}, Op.CREATE_TEXTURE),
        ({"compute": False}, Op.CREATE_PROGRAM),
        ({"max_work_group_invocations": 3}, Op.CREATE_PROGRAM),
        ({"occlusion_queries": False}, Op.CREATE_QUERY),
        ({"stencil": False}, Op.SET_STATES),
        ({"max_uniform_slots": 1}, Op.CREATE_PROGRAM),
        ({"max_uniform_bytes": 15}, Op.BIND_UNIFORM),
        ({"max_storage_bytes": 31}, Op.BIND_STORAGE),
        ({"max_texture_slots": 0}, Op.CREATE_PROGRAM),
        ({"max_color_targets": 0}, Op.BEGIN_PASS),
        ({"max_dispatch": (1, 1, 1)}, Op.DISPATCH),
    ],
)
def test_a_device_that_lacks_something_is_refused_before_anything_is_issued(
    file: Path, null_device: rhi.Device, lacking: dict[str, object], op: Op
) -> None:
    trace = load(file)
    check_capabilities(trace.stream, null_device.capabilities)
    null_device._core.capabilities = dataclasses.replace(null_device.capabilities, **lacking)
    with refuses(TRACE_CAPABILITY, null_device) as refusal:
        replay(trace, on=null_device)
    assert f": {op.method}(" in refusal.error.given


@pytest.mark.parametrize(
    ("lacking", "refused"),
    [({"wireframe": False}, True), ({"max_line_width": 2.5}, True), ({"max_line_width": 3.0}, False)],
    ids=str,
)
def test_lines_that_a_device_lacks_are_refused_before_anything_is_issued(
    tmp_path: Path, null_device: rhi.Device, lacking: dict[str, object], refused: bool
) -> None:
    with rhi.create_device("null") as source:
        image, mesh = source.texture((4, 4), Format.R8), source.mesh(rectangle())
        with source.render_pass(image), source.states(PolygonMode.LINE, LineWidth(3.0)):
            source.draw(source.program(Colored), mesh)
        save(source, tmp_path / "t.zip")
    trace = load(tmp_path / "t.zip")
    null_device._core.capabilities = dataclasses.replace(null_device.capabilities, **lacking)
    if refused:
        with refuses(TRACE_CAPABILITY, null_device) as refusal:
            replay(trace, on=null_device)
        assert f": {Op.SET_STATES.method}(" in refusal.error.given
    else:
        replay(trace, on=null_device)


# -- the first version ---------------------------------------------------------------------------------------


def test_a_trace_of_version_1_still_loads_and_replays(null_device: rhi.Device) -> None:
    trace = load(VERSION_1)
    assert len(trace) == 87
    result = replay(trace, on=null_device)
    assert result.image is not None
    assert result.image.shape == (48, 64, 4)
    expect(trace.stream).draws(program="Shadow").within("sun").exactly(2)


@requires_gl
def test_a_trace_of_version_1_still_draws_the_same() -> None:
    with rhi.create_device("gl") as device:
        image = replay(load(VERSION_1, trusted=True), on=device).image
    assert image is not None
    with rhi.create_device("gl") as device:
        assert np.array_equal(image, record_much(device).read())
