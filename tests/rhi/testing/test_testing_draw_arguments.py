"""The draws of indirect commands, such as those of `draw_many`, in expectations, texts and differences."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from testing_kit import Corner, backend_works

import rhi
from rhi import Device, Format, Op
from rhi.backends.null import NullBackend
from rhi.contract.descriptors import DRAW_UNINDEXED
from rhi.shading import Shader, StorageRW, global_id, vec4
from rhi.testing import UnknownDataError, expect
from rhi.trace import diff, load, save


class Flat(Shader):
    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, 0.5, 1.0)

    def fragment(self) -> vec4:
        return vec4(1.0)


class Filling(Shader):
    """Writes the arguments of draws on the device."""

    words: StorageRW[int]

    def compute(self) -> None:
        self.words[global_id().x] = 1


class Scene:
    def __init__(self, device: Device) -> None:
        self.device = device
        corners = np.zeros(12, Corner.dtype)
        self.meshes = {
            "plain": device.mesh(corners),
            "indexed": device.mesh(corners, indices=np.arange(12)[::-1].astype(np.uint16)),
        }
        self.image = device.texture((8, 8), Format.RGBA8)
        self.program = device.program(Flat)

    def draw_many(self, draws: np.ndarray[Any, Any], mesh: str = "plain") -> None:
        if mesh == "plain":
            draws = drop_base_vertices(draws)
        with self.device.render_pass(self.image):
            self.device.draw_many(self.program, self.meshes[mesh], draws)

    def latest(self) -> rhi.Command:
        return self.device.stream.draws()[-1]


def drop_base_vertices(draws: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    result = np.zeros(len(draws), DRAW_UNINDEXED)
    for name in ("count", "instances", "first", "base_instance"):
        result[name] = draws[name]
    return result


@pytest.fixture
def scene(null_device: Device) -> Scene:
    return Scene(null_device)


@pytest.fixture(params=["null", "gl", "cl", "wgpu"])
def any_scene(request: pytest.FixtureRequest) -> Iterator[Scene]:
    if not backend_works(request.param):
        pytest.skip(f"no device of {request.param} here")
    with rhi.create_device(request.param, record=True) as device:
        yield Scene(device)


def make_draws(*rows: tuple[int, ...]) -> np.ndarray[Any, Any]:
    draws = np.zeros(len(rows), rhi.DRAW)
    for draw, row in zip(draws, rows, strict=True):
        for name, value in zip(rhi.DRAW.names or (), row, strict=False):
            draw[name] = value
    return draws


@pytest.mark.parametrize("mesh", ["plain", "indexed"])
def test_draws_of_draw_many_are_expected_by_their_numbers(any_scene: Scene, mesh: str) -> None:
    any_scene.draw_many(make_draws((3, 1), (6, 2, 3)), mesh)
    draws = expect(any_scene.device)
    draws.draws(count=3).exactly(1)
    draws.draws(count=6, instances=2, first=3).exactly(1)
    draws.draws(instances=pytest.approx(2)).exactly(1)
    draws.draws(count=3, instances=2).exactly(0)  # each of another draw
    draws.draws(first=1).exactly(0)
    draws.draws(draws=2, count=6).exactly(1)
    draws.commands(Op.DRAW_INDIRECT, count=6).exactly(1)
    draws.draws().exactly(1)  # one command, as before


ROW = st.tuples(st.integers(0, 12), st.integers(0, 3), st.integers(0, 2))


@settings(max_examples=60)
@given(st.lists(st.tuples(st.lists(ROW, max_size=4), st.booleans(), st.booleans()), max_size=5))
def test_arguments_are_those_that_the_device_reads(
    calls: list[tuple[list[tuple[int, ...]], bool, bool]],
) -> None:
    """Also of buffers that the program fills, with and without a count, and after the stream was cleared."""
    with rhi.create_device("null") as device:
        scene, null = Scene(device), device.backend_as(NullBackend)
        expected = []
        for rows, is_indexed, is_own in calls:
            draws = make_draws(
                *((min(count, 12 - first), instances, first) for count, instances, first in rows)
            )
            mesh = scene.meshes["indexed" if is_indexed else "plain"]
            if not is_own:
                scene.draw_many(draws, "indexed" if is_indexed else "plain")
            elif len(rows):
                words = np.zeros((len(draws), 5), np.uint32)
                words[:, :3] = np.array(draws.tolist(), np.uint32)[:, :3]
                buffer = device.storage(int, words.reshape(-1).view(np.int32))
                count = device.storage(int, np.int32([len(draws) // 2]))
                arguments = rhi.IndirectDraws(buffer, len(draws), count=count)
                if not device.capabilities.indirect_count:
                    arguments = rhi.IndirectDraws(buffer, len(draws))
                with device.render_pass(scene.image):
                    device.draw_indirect(scene.program, mesh, arguments)
            if len(rows):
                expected.append(null.indirect_draws[-1].draws.tolist())
        commands = device.stream.draws()
        assert [command.draw_arguments.tolist() for command in commands] == expected
        assert [command.draw_arguments.tolist() for command in list(commands)[::-1]] == expected[::-1]


def test_a_direct_draw_is_one(scene: Scene) -> None:
    with scene.device.render_pass(scene.image):
        scene.device.draw(scene.program, scene.meshes["plain"], 4)
    assert scene.latest().draw_arguments.tolist() == [(12, 4, 0, 0, 0)]


def test_arguments_written_on_the_device_are_unknown(scene: Scene) -> None:
    device = scene.device
    words = device.storage(int, 5)
    device.dispatch(device.program(Filling), 5, words=words)
    with device.render_pass(scene.image):
        device.draw_indirect(scene.program, scene.meshes["plain"], rhi.IndirectDraws(words, 1))
    with pytest.raises(UnknownDataError, match="byte 0 of the arguments was written on the device"):
        _ = scene.latest().draw_arguments
    assert "draws: unknown, byte 0 of the arguments was written on the device" in str(scene.latest())
    with pytest.raises(AssertionError, match="of the arguments was written on the device"):
        expect(device).draws(count=1).exactly(1)


def test_other_commands_have_no_draws(scene: Scene) -> None:
    scene.device.present(scene.image)
    with pytest.raises(rhi.ValidationError, match="command-argument"):
        _ = scene.device.stream[-1].draw_arguments


def test_commands_of_a_cleared_stream_have_no_draws(scene: Scene) -> None:
    scene.draw_many(make_draws((3, 1)))
    command = scene.latest()
    scene.device.stream.clear()
    assert "draws:" not in str(command)
    with pytest.raises(rhi.ValidationError, match="command-cleared"):
        _ = command.draw_arguments
    scene.draw_many(make_draws((6, 1)))  # in rings that are older than the stream
    assert scene.latest().draw_arguments["count"].tolist() == [6]


def test_texts_and_traces_show_the_draws(scene: Scene, tmp_path: Path) -> None:
    scene.draw_many(make_draws((3, 1), (6, 2, 3)), "indexed")
    assert "draws: count=3, instances=1; count=6, instances=2, first=3" in str(scene.latest())
    scene.draw_many(make_draws(*((3, i) for i in range(6))))
    assert (
        str(scene.latest())
        .partition("  draws: ")[2]
        .startswith(
            "count=3, instances=0; count=3, instances=1; count=3, instances=2; count=3, instances=3; … and 2 more"
        )
    )
    save(scene.device, tmp_path / "trace.zip")
    loaded = load(tmp_path / "trace.zip").stream.draws()
    assert [command.draw_arguments.tolist() for command in loaded] == [
        command.draw_arguments.tolist() for command in scene.device.stream.draws()
    ]


def test_a_failure_names_the_nearest_draws(scene: Scene) -> None:
    scene.draw_many(make_draws((3, 1), (6, 2)))
    with pytest.raises(AssertionError, match="of its draws, instances is 1 / instances is 2"):
        expect(scene.device).draws(instances=5).exactly(1)


def test_differences_name_the_draws() -> None:
    devices = [rhi.create_device("null") for _ in range(3)]
    for device, instances in zip(devices, (1, 2, 1), strict=True):
        Scene(device).draw_many(make_draws((3, instances)))
    first, second, same = devices
    assert "draw_indirect: draws: count=3, instances=1 → count=3, instances=2" in str(diff(first, second))
    assert not diff(first, same)
    for device in devices:
        device.close()
