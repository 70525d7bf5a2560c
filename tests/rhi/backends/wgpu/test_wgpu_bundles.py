"""Recorded draws are executed as bundles of WebGPU from the second submission on, where a bundle can have them.

`rhi.conformance.operation.test_repeated_submissions` compares the images of random ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import rhi
from rhi import BufferUsage, Format, Primitive
from rhi.backends.webgpu.webgpu_recorded_draws import LEAST_DRAWS
from rhi.backends.wgpu.wgpu_backend import WgpuBackend
from rhi.conformance.shaders import Colored, Tint, Tinted
from rhi.conformance.shapes import corners, rectangle

SIZE = (8, 8)
MANY = 2 * LEAST_DRAWS


@pytest.fixture
def bundles(device: rhi.Device, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of the calls that begin and execute bundles."""
    calls: list[str] = []
    functions = device.backend_as(WgpuBackend)._implementation.bundles

    def note(name: str) -> None:
        function: Callable[..., Any] = getattr(functions, name)

        def call(*arguments: Any) -> Any:
            calls.append(name)
            return function(*arguments)

        monkeypatch.setattr(functions, name, call)

    note("begin")
    note("execute")
    return calls


@pytest.fixture
def image(device: rhi.Device) -> rhi.Texture:
    return device.texture(SIZE, Format.RGBA8)


def submit(device: rhi.Device, commands: rhi.CommandBuffer, bundles: list[str]) -> list[str]:
    """Submit commands; return the calls of bundles that this makes."""
    bundles.clear()
    device.submit(commands)
    device.finish()
    return list(bundles)


def record_draws(device: rhi.Device, image: rhi.Texture, mesh: Any, count: int = MANY) -> rhi.CommandBuffer:
    program = device.program(Colored)
    with device.record() as commands, commands.render_pass(image, clear=(0, 0, 0, 0)):
        for _ in range(count):
            commands.draw(program, mesh)
    return commands


def test_the_second_submission_records_a_bundle_and_later_ones_execute_it(
    device: rhi.Device, image: rhi.Texture, bundles: list[str]
) -> None:
    commands = record_draws(device, image, device.mesh(rectangle()))
    calls = [submit(device, commands, bundles) for _ in range(4)]
    assert calls == [[], ["begin", "execute"], ["execute"], ["execute"]]
    assert image.read().min() == 255


def test_a_few_draws_have_no_bundle(device: rhi.Device, image: rhi.Texture, bundles: list[str]) -> None:
    commands = record_draws(device, image, device.mesh(rectangle()), LEAST_DRAWS - 1)
    assert [submit(device, commands, bundles) for _ in range(3)] == [[], [], []]


def test_states_of_a_pass_and_queries_are_set_between_bundles(
    device: rhi.Device, image: rhi.Texture, bundles: list[str]
) -> None:
    """Each half of the image has its scissor, the blend color of its bundle, and its count."""
    program, mesh = device.program(Colored), device.mesh(rectangle())
    queries = [device.occlusion_query(), device.occlusion_query()]
    constant = rhi.BlendFunction(rhi.BlendFactor.CONSTANT, rhi.BlendFactor.ZERO)
    with device.record() as commands, commands.render_pass(image, clear=(0, 0, 0, 0)):
        for half, query in enumerate(queries):
            states = rhi.Scissor(4 * half, 0, 4, 8), rhi.BlendColor(half, 1 - half, 0, 1), constant
            with commands.states(*states), commands.query(query):
                for _ in range(MANY):
                    commands.draw(program, mesh)
    calls = [submit(device, commands, bundles) for _ in range(3)]
    assert calls == [[], ["begin", "execute"] * 2, ["execute"] * 2]
    assert [query.wait() for query in queries] == [32 * MANY] * 2
    assert image.read()[:, :4].reshape(-1, 4).tolist() == [[0, 255, 0, 255]] * 32
    assert image.read()[:, 4:].reshape(-1, 4).tolist() == [[255, 0, 0, 255]] * 32


def test_a_draw_after_a_bundle_binds_all_anew(
    device: rhi.Device, image: rhi.Texture, bundles: list[str]
) -> None:
    """The second bundle binds what the first has bound, and so does the draw after it, although one before them has."""
    program, mesh = device.program(Colored), device.mesh(rectangle())
    with device.record() as commands, commands.render_pass(image, clear=(0, 0, 0, 0)):
        for left, width, draws in ((0, 1, 1), (1, 2, MANY), (3, 3, MANY), (6, 2, 1)):
            with commands.states(rhi.Scissor(left, 0, width, 8)):
                for _ in range(draws):
                    commands.draw(program, mesh)
    for calls in ([], ["begin", "execute"] * 2, ["execute"] * 2):
        assert submit(device, commands, bundles) == calls
        assert image.read().min() == 255


def test_indices_that_begin_to_restart_lists_end_the_use_of_a_bundle(
    device: rhi.Device, image: rhi.Texture, bundles: list[str]
) -> None:
    indices = device.buffer(np.arange(6, dtype="u2"))
    commands = record_draws(device, image, device.mesh(rectangle(), indices))
    submit(device, commands, bundles)
    assert "execute" in submit(device, commands, bundles)
    indices.write(np.array([0, 1, 2, 0xFFFF, 4, 5], "u2"))
    assert submit(device, commands, bundles) == []
    assert 0 < np.count_nonzero(image.read()[..., 0]) < 64  # the first triangle alone
    indices.write(np.arange(6, dtype="u2"))
    assert submit(device, commands, bundles) == ["execute"]
    assert image.read().min() == 255


@pytest.mark.parametrize(
    ("primitive", "usage"),
    [(Primitive.QUADS, BufferUsage.STATIC), (Primitive.TRIANGLES, BufferUsage.STREAM)],
    ids=["expanded", "streamed"],
)
def test_indices_that_each_draw_looks_at_have_no_bundle(
    device: rhi.Device,
    image: rhi.Texture,
    bundles: list[str],
    primitive: Primitive,
    usage: BufferUsage,
) -> None:
    indices = device.buffer(8, np.dtype("u2"), usage=usage)
    indices.write(np.array([0, 1, 2, 2, 3, 0, 0, 0], "u2")[[0, 1, 2, 4, 4, 4, 4, 4]])
    square = corners([(-1, -1), (1, -1), (1, 1), (-1, 1)])
    commands = record_draws(device, image, device.mesh(square, indices, primitive=primitive).view(0, 4))
    assert [submit(device, commands, bundles) for _ in range(3)] == [[], [], []]


def test_a_bundle_reads_the_buffers_as_they_are_at_the_submission(
    device: rhi.Device, image: rhi.Texture, bundles: list[str]
) -> None:
    program, mesh = device.program(Tinted), device.mesh(rectangle())
    tints = device.uniform_array(Tint, MANY)
    with device.record() as commands, commands.render_pass(image):
        for number in range(MANY):
            commands.draw(program, mesh, tint=tints[number])
    rows = np.zeros(MANY, tints.dtype)
    for red in (10, 20, 30):
        rows["color"] = (red / 255, 0, 0, 1)
        tints.write(rows)
        device.submit(commands)
        tints.write(np.zeros(MANY, tints.dtype))  # after the draws
        assert image.read()[3, 3].tolist() == [red, 0, 0, 255]
    assert bundles.count("execute") == 2


def test_a_bundle_that_cannot_be_recorded_leaves_bindings_and_states_to_its_calls(
    device: rhi.Device, image: rhi.Texture, bundles: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each submission draws alike, and nothing is tried a second time."""
    functions = device.backend_as(WgpuBackend)._implementation.bundles

    def refuse(encoder: object) -> None:
        raise OverflowError("refused")

    monkeypatch.setattr(functions, "finish", refuse)
    program, mesh = device.program(Tinted), device.mesh(rectangle())
    first, last = (device.uniform(Tint(color=(red, 0, 0, 1))) for red in (1, 0))
    with device.record() as commands, commands.render_pass(image, clear=(0, 0, 0, 0)):
        with commands.states(rhi.BlendFunction.ADDITIVE):
            for number in range(MANY):
                commands.draw(program, mesh, tint=last if number else first)
    for calls in ([], ["begin"], []):
        assert submit(device, commands, bundles) == calls
        assert image.read()[3, 3].tolist() == [255, 0, 0, 255]


def test_a_buffer_whose_resource_is_destroyed_is_refused_although_its_bundle_is_there(
    device: rhi.Device, image: rhi.Texture, bundles: list[str]
) -> None:
    mesh = device.mesh(rectangle())
    commands = record_draws(device, image, mesh)
    for _ in range(2):
        device.submit(commands)
    mesh.destroy()
    with pytest.raises(rhi.ValidationError, match="resource-destroyed"):
        device.submit(commands)
    device.finish()
