"""Resources that nobody holds any more: they are destroyed as by `destroy`, once the GPU no longer uses
them."""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from rhi import Device, Format, Op
from rhi.conformance.shaders import Colored, Tint, Tinted
from rhi.conformance.shapes import rectangle
from rhi.shading import vec4

pytestmark = pytest.mark.usefixtures("quick_collections")
CREATORS: dict[str, Callable[[Device], Any]] = {
    "texture": lambda device: device.texture((4, 4), Format.RGBA8),
    "buffer": lambda device: device.buffer(np.zeros(4)),
    "storage": lambda device: device.storage(float, 4),
    "uniform": lambda device: device.uniform(Tint(color=vec4(1.0))),
    "uniform array": lambda device: device.uniform_array(Tint, 4),
    "mesh": lambda device: device.mesh(rectangle()),
    "query": lambda device: device.occlusion_query(),
    "query set": lambda device: device.query_set(3),
    "binding of a texture": lambda device: device.texture((4, 4), Format.RGBA8).image(),
    "view of a mesh": lambda device: device.mesh(rectangle()).view(0, 3),
    "element of an array": lambda device: device.uniform_array(Tint, 4)[2],
}
_CREATIONS = (Op.CREATE_BUFFER, Op.CREATE_TEXTURE, Op.CREATE_QUERY, Op.CREATE_VERTEX_ARRAY)


def make(device: Device, kind: str) -> Any:
    """Make a resource, and skip where the device has none of this kind."""
    if "query" in kind and not device.capabilities.occlusion_queries:
        pytest.skip("the device declares no occlusion_queries")
    if "image" in kind and not device.capabilities.shading:
        pytest.skip("the device declares no shading")
    return CREATORS[kind](device)


def created(device: Device, since: int) -> list[int]:
    """Return the ids of what was created since a place in the stream, in ascending order."""
    return sorted(command.values[0] for command in device.stream[since:] if command.op in _CREATIONS)


def destroyed(device: Device, since: int) -> list[int]:
    """Return those that were destroyed, in ascending order. What other tests have left behind doesn't
    count."""
    created_now = created(device, since)
    return sorted(
        command.values[0]
        for command in device.stream[since:].filter(Op.DESTROY)
        if command.values[0] in created_now
    )


@pytest.fixture
def since(recording: Device) -> int:
    """Where a test begins in the stream: what was dropped before it is destroyed."""
    recording.finish()
    return len(recording.stream)


@pytest.mark.parametrize("kind", CREATORS)
def test_an_unreferenced_resource_is_destroyed(recording: Device, since: int, kind: str) -> None:
    make(recording, kind)
    recording.finish()
    assert destroyed(recording, since) == created(recording, since) != []


@pytest.mark.parametrize("kind", CREATORS)
def test_a_referenced_resource_is_not_destroyed(recording: Device, since: int, kind: str) -> None:
    resource = make(recording, kind)
    gc.collect()
    recording.finish()
    assert not destroyed(recording, since)
    del resource


@pytest.mark.parametrize("kind", ["texture", "buffer", "mesh", "query"])
def test_a_resource_that_is_destroyed_and_then_dropped_is_destroyed_once(
    recording: Device, since: int, kind: str
) -> None:
    make(recording, kind).destroy()
    recording.finish()
    assert destroyed(recording, since) == created(recording, since)


@pytest.mark.threads
def test_another_thread_may_drop_a_resource(recording: Device, since: int) -> None:
    resources = [recording.texture((4, 4), Format.RGBA8)]
    thread = threading.Thread(target=resources.clear)
    thread.start()
    thread.join()
    assert not destroyed(recording, since)
    recording.finish()
    assert destroyed(recording, since) == created(recording, since)


def test_the_garbage_collector_may_drop_a_resource(recording: Device, since: int) -> None:
    circle: list[object] = [recording.buffer(np.zeros(4))]
    circle.append(circle)
    del circle
    gc.collect()
    recording.finish()
    assert destroyed(recording, since) == created(recording, since)


def test_creations_destroy_dropped_resources_in_a_program_without_frames(
    recording: Device, since: int
) -> None:
    """They wait for two lots of 64 MiB at most, so of 600 buffers of 1 MiB at least 400 are gone at the
    end."""
    for _ in range(600):
        recording.buffer(1 << 18, np.dtype("u4"))
    assert len(destroyed(recording, since)) >= 400


@pytest.mark.requires("draws", "shading")
def test_a_draw_uses_resources_that_are_dropped_right_after_it(device: Device) -> None:
    with device.texture((4, 4), Format.RGBA8) as image:
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw(
                device.program(Tinted),
                device.mesh(rectangle()),
                tint=device.uniform(Tint(color=vec4(0.0, 1.0, 0.0, 1.0))),
            )
            for _ in range(8):  # creations take back what was dropped, and use the memory again
                device.uniform(Tint(color=vec4(1.0, 0.0, 0.0, 1.0)))
        assert (image.read() == (0, 255, 0, 255)).all()


@pytest.mark.requires("draws", "shading")
def test_a_pass_holds_its_targets(device: Device) -> None:
    with device.texture((4, 4), Format.RGBA8) as copy:
        with device.render_pass(
            [device.texture((4, 4), Format.RGBA8, label="dropped"), copy], clear=(0, 0, 0, 0)
        ):
            device.signal()
            device.finish()
            device.draw(device.program(Colored), device.mesh(rectangle()))
        device.finish()


@pytest.mark.requires("draws", "shading")
def test_a_command_buffer_keeps_its_resources_alive(device: Device) -> None:
    with device.texture((4, 4), Format.RGBA8) as image:
        with device.record() as commands:
            tint = device.uniform(Tint(color=vec4(0.0, 0.0, 1.0, 1.0)))
            mesh = device.mesh(rectangle())
            with commands.render_pass(image, clear=(0, 0, 0, 0)):
                commands.draw(device.program(Tinted), mesh, tint=tint)
        del tint, mesh
        for _ in range(3):
            device.finish()
            image.write(np.zeros((4, 4, 4), np.uint8))
            device.submit(commands)
            assert (image.read() == (0, 0, 255, 255)).all()


@pytest.mark.requires("draws", "shading")
def test_a_mesh_that_is_dropped_takes_its_vertex_arrays_with_it(recording: Device) -> None:
    recording.program(Colored)
    recording.finish()
    since = len(recording.stream)
    with recording.texture((4, 4), Format.RGBA8) as image, recording.render_pass(image):
        recording.draw(recording.program(Colored), recording.mesh(rectangle()))
    recording.finish()
    assert destroyed(recording, since) == created(recording, since)
    assert len(recording.stream[since:].filter(Op.CREATE_VERTEX_ARRAY)) == 1
