"""Rules of fences, queries, events, recorded commands, and of devices that are closed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from refused_shaders import Passing

import rhi
from rhi import Device, DeviceError, Format, Op, Primitive, SamplerDescriptor, ShaderError
from rhi.conformance.shaders import Colored, Positions, Tint
from rhi.conformance.shapes import rectangle
from rhi.conformance.validation.refusal import refuses
from rhi.errors import rules
from rhi.shading import uint, vec4

SIZE = (4, 4)


@pytest.mark.parametrize("ahead", [1, 1000])
def test_waiting_for_a_fence_value_that_was_not_signalled_is_refused(recording: Device, ahead: int) -> None:
    value = recording.signal()
    with refuses(rules.FENCE_VALUE, recording):
        recording.wait(value + ahead)
    with refuses(rules.FENCE_VALUE, recording):
        recording.wait(-1)
    assert recording.wait(value)


# -- queries -----------------------------------------------------------------------------------------------


def test_queries_do_not_nest(recording: Device, image: Any) -> None:
    first, second = recording.occlusion_query(), recording.occlusion_query()
    with recording.render_pass(image):
        with first, refuses(rules.QUERY_NESTED, recording):
            second.begin()
        with first:
            with refuses(rules.QUERY_NESTED, recording):
                first.begin()
        with second:
            pass


def test_a_query_counts_inside_a_pass(recording: Device, image: Any) -> None:
    query = recording.occlusion_query()
    with refuses(rules.DRAW_OUTSIDE_PASS, recording):
        query.begin()
    with recording.render_pass(image), query:
        pass


def test_a_query_ends_after_it_began(recording: Device, image: Any) -> None:
    query = recording.occlusion_query()
    with refuses(rules.QUERY_STATE, recording):
        query.end()
    with recording.render_pass(image):
        query.begin()
        query.end()
        with refuses(rules.QUERY_STATE, recording):
            query.end()


def test_a_query_has_an_answer_after_its_end(recording: Device, image: Any) -> None:
    query = recording.occlusion_query()
    with refuses(rules.QUERY_STATE, recording):
        query.wait()
    with refuses(rules.QUERY_STATE, recording):
        _ = query.visible_samples
    assert not query.is_finished
    with recording.render_pass(image):
        query.begin()
        with refuses(rules.QUERY_STATE, recording):
            query.wait()
        query.end()


def test_an_open_query_is_not_destroyed(recording: Device, image: Any) -> None:
    query = recording.occlusion_query()
    with recording.render_pass(image):
        query.begin()
        with refuses(rules.QUERY_STATE, recording):
            query.destroy()
        query.end()
    query.destroy()
    with recording.render_pass(image), refuses(rules.RESOURCE_DESTROYED, recording):
        query.begin()


def test_a_condition_needs_an_ended_query(recording: Device, image: Any) -> None:
    query = recording.occlusion_query()
    with recording.render_pass(image):
        with refuses(rules.QUERY_STATE, recording), recording.conditional(query):
            pass
        with query, refuses(rules.QUERY_STATE, recording), recording.conditional(query):
            pass
        with recording.conditional(query):
            pass


def test_conditions_do_not_nest(recording: Device, image: Any) -> None:
    first, second = recording.occlusion_query(), recording.occlusion_query()
    with recording.render_pass(image):
        for query in (first, second):
            with query:
                pass
        with recording.conditional(first):
            for query in (first, second):
                with refuses(rules.CONDITION_NESTED, recording), recording.conditional(query):
                    pass
        with recording.conditional(second):
            pass
        with recording.conditional(second, inverted=True):
            pass


# -- events and commands -----------------------------------------------------------------------------------


def test_a_command_s_arguments_have_names(recording: Device) -> None:
    recording.signal()
    command = recording.stream.filter(Op.SIGNAL)[-1]
    with refuses(rules.COMMAND_ARGUMENT) as refusal:
        _ = command["colour"]
    assert refusal.error.allowed == "value"
    with refuses(rules.COMMAND_ARGUMENT):
        recording.stream.filter(Op.SIGNAL, colour=3)
    with refuses(rules.COMMAND_ARGUMENT):
        recording.stream.filter(value=3)
    assert command["value"] > 0


def test_labels_of_a_command_are_refused_after_its_stream_was_cleared(backend: str) -> None:
    with rhi.create_device(backend, record=True) as device:
        device.signal()
        command = device.stream[-1]
        assert command.labels == ()
        device.stream.clear()
        with refuses(rules.COMMAND_CLEARED):
            _ = command.labels
        assert command["value"] == 1


def test_only_a_recording_device_has_a_stream(backend: str) -> None:
    with rhi.create_device(backend, record=False) as device, refuses(rules.DEVICE_NOT_RECORDING):
        _ = device.stream
    with rhi.create_device(backend, record=True) as device:
        assert len(device.stream) == 0


# -- devices -----------------------------------------------------------------------------------------------


def test_an_unknown_backend_is_refused_with_the_names_of_backends(backend: str) -> None:
    with refuses(rules.DEVICE_UNKNOWN, kind=DeviceError) as refusal:
        rhi.create_device(backend + "x")
    assert backend in str(refusal.error)


def test_a_backend_is_asked_for_by_its_own_type(recording: Device) -> None:
    with refuses(rules.DEVICE_CAPABILITY, recording):
        recording.backend_as(str)


CLOSED_USES: dict[str, Callable[[Device, Any], Any]] = {
    "buffer": lambda d, r: d.buffer(4),
    "uniform": lambda d, r: d.uniform(Tint(color=(0, 0, 0, 0))),
    "uniform array": lambda d, r: d.uniform_array(Tint, 2),
    "storage": lambda d, r: d.storage(uint, 4),
    "texture": lambda d, r: d.texture(SIZE, Format.R8),
    "sampler": lambda d, r: d.sampler(SamplerDescriptor()),
    "mesh": lambda d, r: d.mesh(rectangle()),
    "program": lambda d, r: d.program(Passing),
    "render pass": lambda d, r: d.render_pass(r["texture"]),
    "draw": lambda d, r: d.draw(r["program"], r["mesh"]),
    "draw many": lambda d, r: d.draw_many(r["program"], r["mesh"], r["mesh"].draws()),
    "immediate": lambda d, r: d.immediate(r["program"], Primitive.QUADS).__enter__(),
    "transient": lambda d, r: d.transient.uniform(Tint(color=(0, 0, 0, 0))),
    "signal": lambda d, r: d.signal(),
    "completed": lambda d, r: d.completed,
    "wait": lambda d, r: d.wait(0),
    "finish": lambda d, r: d.finish(),
    "event": lambda d, r: d.event("late").__enter__(),
    "present": lambda d, r: d.present(),
    "query": lambda d, r: d.occlusion_query(),
    "query set": lambda d, r: d.query_set(2),
    "buffer read": lambda d, r: r["buffer"].read(),
    "buffer write": lambda d, r: r["buffer"].write(np.zeros(4, "u1")),
    "buffer lock": lambda d, r: r["buffer"].lock(rhi.Access.READ).__enter__(),
    "texture read": lambda d, r: r["texture"].read(),
    "texture write": lambda d, r: r["texture"].write(np.zeros((4, 4), "u1")),
    "mipmaps": lambda d, r: r["texture"].generate_mipmaps(),
}


@pytest.mark.parametrize("use", CLOSED_USES)
def test_a_closed_device_does_nothing(backend: str, use: str) -> None:
    device = rhi.create_device(backend)
    resources: dict[str, Any] = {
        "buffer": device.buffer(4),
        "texture": device.texture(SIZE, Format.R8),
        "mesh": device.mesh(rectangle()),
        "program": device.program(Colored),
    }
    device.close()
    device.close()
    assert device.closed
    with refuses(rules.DEVICE_CLOSED):
        CLOSED_USES[use](device, resources)


class Mistaken(Positions):
    """A vector where a number is wanted."""

    def fragment(self) -> vec4:
        return vec4(1.0) + vec4(True)


def test_a_shader_that_does_not_type_check_makes_no_program(recording: Device) -> None:
    creations = recording.statistics.creations
    with pytest.raises(ShaderError) as caught:
        recording.program(Mistaken)
    assert caught.value.site is not None
    assert caught.value.site.file == __file__
    assert recording.statistics.creations == creations
    recording.program(Colored)
