"""Assertions on the contents of uniforms and storage, tracked through the stream."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from testing_kit import Corner, Light, SampleFrame

import rhi
from rhi import Device, Format
from rhi.commands.recorder import Recorder
from rhi.shading import Array, Shader, Storage, StorageRW, Struct, Uniform, array, global_id, mat3, vec3, vec4
from rhi.testing import UnknownDataError, binding_data, expect
from rhi.trace import load, save


class PointLight(Struct):
    color: vec3
    power: float


class Everything(Struct):
    number: int
    rotation: mat3
    point_lights: Array[PointLight] = array(PointLight, 2)


class Reading(Shader):
    all: Uniform[Everything]
    point_lights: Storage[PointLight]

    def vertex(self, v: Corner) -> vec4:
        power = self.all.point_lights[0].power + self.point_lights[0].power
        return vec4(v.position, power, 1.0)


class Copying(Shader):
    point_lights: Storage[PointLight]
    power: StorageRW[float]

    def compute(self) -> None:
        self.power[global_id().x] = self.point_lights[global_id().x].power


class Writing(Shader):
    point_lights: StorageRW[PointLight]

    def compute(self) -> None:
        self.point_lights[global_id().x].power = 2.0


@pytest.fixture
def sample_frame(null_device: Device) -> SampleFrame:
    return SampleFrame(null_device)


def test_the_binding_data_of_a_draw_are_the_last_written_bytes(sample_frame: SampleFrame) -> None:
    device = sample_frame.device
    with device.render_pass(depth=sample_frame.map):
        for x in (1.0, 2.0):
            sample_frame.light.write(Light(offset=(x, 0, 0, 0)))
            device.draw(sample_frame.shadow, sample_frame.walls, light=sample_frame.light)
    sample_frame.light.write(Light(offset=(9, 0, 0, 0)))
    draws = expect(device).draws(program="Shadow")
    draws.with_data("light", {"offset": (1, 0, 0, 0)}).exactly(1)
    draws.with_data("light", Light(offset=(2, 0, 0, 0))).exactly(1)
    draws.with_data("light", {"offset": (9, 0, 0, 0)}).exactly(0)
    (first, second) = draws.exactly(2)
    assert binding_data(second, "light")["offset"].tolist() == [2, 0, 0, 0]
    assert binding_data(first, "light")["offset"].tolist() == [1, 0, 0, 0]


@pytest.mark.parametrize(("tolerance", "matches"), [(0.0, 0), (0.009, 0), (0.011, 1)])
def test_numbers_match_within_a_tolerance(sample_frame: SampleFrame, tolerance: float, matches: int) -> None:
    sample_frame.render()
    draws = expect(sample_frame.device).draws(program="Lit")
    draws.with_data("tint", {"color": (1, 0.51, 0, 1)}, tolerance=tolerance).exactly(matches)


def test_a_failed_expectation_on_data_prints_the_actual_data(sample_frame: SampleFrame) -> None:
    sample_frame.render()
    with pytest.raises(AssertionError) as caught:
        expect(sample_frame.device).draws().with_data("tint", {"color": (1, 0, 0, 1)}, tolerance=0.1).exactly(
            1
        )
    message = str(caught.value)
    assert "with color=(1, 0, 0, 1) in tint within 0.1" in message
    assert "of tint, color is [1. , 0.5, 0. , 1. ]" in message
    assert "the program has no uniform or storage 'tint' (it has: light)" in message


def draw_all(device: Device, value: Everything, point_lights: np.ndarray) -> rhi.Command:
    image = device.texture((4, 4), Format.RGBA8)
    mesh = device.mesh({"position": np.zeros((3, 2), np.float32)})
    uniform, storage = device.uniform(value), device.storage(PointLight, point_lights)
    with device.render_pass(image):
        device.draw(device.program(Reading), mesh, all=uniform, point_lights=storage)
    return device.stream.draws()[-1]


def test_parts_of_arrays_and_structs_are_named_by_paths(null_device: Device) -> None:
    point_lights = np.zeros(3, PointLight.dtype)
    point_lights["power"] = [1, 2, 3]
    rotation = np.arange(9.0).reshape(3, 3)
    value = Everything(
        number=-7,
        rotation=rotation,
        point_lights=(PointLight(color=(1, 2, 3), power=4), PointLight(color=(5, 6, 7), power=8)),
    )
    draw_all(null_device, value, point_lights)
    draws = expect(null_device).draws()
    draws.with_data("all", {"number": -7, "rotation": rotation, "point_lights.1.color": (5, 6, 7)}).exactly(1)
    draws.with_data("point_lights", {"2.power": 3.0}).exactly(1)
    draws.with_data("point_lights", {"2.power": 2.0}).exactly(0)
    for path in ("nothing", "point_lights.2.power", "number.x"):
        with pytest.raises(AssertionError, match="there is no"):
            draws.with_data("all", {path: 0}).exactly(1)


def test_transient_constants_and_copies_are_followed(sample_frame: SampleFrame) -> None:
    device = sample_frame.device
    source = device.uniform(Light(offset=(3, 0, 0, 0)))
    with device.render_pass(depth=sample_frame.map):
        device.draw(
            sample_frame.shadow,
            sample_frame.walls,
            light=device.transient.uniform(Light(offset=(5, 0, 0, 0))),
        )
        source.owner.copy_to(sample_frame.light.owner)
        device.draw(sample_frame.shadow, sample_frame.walls, light=sample_frame.light)
        sample_frame.light.owner.clear(0x40000000)  # 2.0
        device.draw(sample_frame.shadow, sample_frame.walls, light=sample_frame.light)
    values = [binding_data(draw, "light")["offset"][0] for draw in device.stream.draws()]
    assert values == [5, 3, 2]


def test_binding_data_written_by_the_device_are_unknown(null_device: Device) -> None:
    point_lights = null_device.storage(PointLight, 2)
    program = null_device.program(Writing)
    null_device.dispatch(program, 1, point_lights=point_lights)
    null_device.dispatch(program, 1, point_lights=point_lights)
    first, second = null_device.stream.filter(rhi.Op.DISPATCH)
    assert binding_data(first, "point_lights")["power"].tolist() == [0, 0]  # as they were made
    with pytest.raises(UnknownDataError, match="written on the device"):
        binding_data(second, "point_lights")
    expect(null_device).dispatches().with_data("point_lights", {"0.power": 0}).exactly(1)


@pytest.mark.parametrize("point_light", range(3))
def test_texels_copied_to_a_buffer_are_unknown(null_device: Device, point_light: int) -> None:
    storage = null_device.storage(PointLight, np.ones(3, PointLight.dtype))
    program, texture = (
        null_device.program(Writing),
        null_device.texture((4, 1), Format.RGBA8),
    )  # as large as a light
    null_device.dispatch(program, 1, point_lights=storage)
    storage.write(np.ones(3, PointLight.dtype))
    texture.copy_to_buffer(storage.owner, offset=16 * point_light)
    null_device.dispatch(program, 1, point_lights=storage)
    first, second = null_device.stream.filter(rhi.Op.DISPATCH)
    assert binding_data(first, "point_lights")["power"].tolist() == [1, 1, 1]
    with pytest.raises(
        UnknownDataError, match=f"byte {16 * point_light} of 'point_lights' was written on the device"
    ):
        binding_data(second, "point_lights")


def test_all_rows_of_texels_that_were_copied_are_unknown_until_they_are_written(null_device: Device) -> None:
    point_lights, power = null_device.storage(PointLight, 4), null_device.storage(float, 4)
    program, texture = null_device.program(Copying), null_device.texture((4, 2), Format.RGBA8)
    texture.copy_to_buffer(point_lights.owner, offset=16)
    for unknown in (1, 2, None):
        null_device.dispatch(program, 1, point_lights=point_lights, power=power)
        dispatch = null_device.stream.filter(rhi.Op.DISPATCH)[-1]
        if unknown is None:
            assert binding_data(dispatch, "point_lights")["power"].tolist() == [0, 0, 0, 0]
        else:
            with pytest.raises(UnknownDataError, match=f"byte {16 * unknown} of 'point_lights'"):
                binding_data(dispatch, "point_lights")
            point_lights.write(np.zeros(1, PointLight.dtype), first=unknown)


def test_binding_data_written_before_the_stream_are_unknown(sample_frame: SampleFrame) -> None:
    sample_frame.device.stream.clear()
    sample_frame.render()
    with pytest.raises(AssertionError, match="byte 0 of 'tint' was last written before the stream"):
        expect(sample_frame.device).draws().with_data("tint", {"color": (1, 0.5, 0, 1)}).exactly(1)


def test_constants_passed_to_a_draw_are_tracked_in_rings_older_than_the_stream(
    sample_frame: SampleFrame,
) -> None:
    device = sample_frame.device
    for x in (1.0, 2.0):
        device.stream.clear()
        with device.render_pass(depth=sample_frame.map):
            device.draw(sample_frame.shadow, sample_frame.walls, light=Light(offset=(x, 0, 0, 0)))
        draws = expect(device).draws()
        draws.with_data("light", Light(offset=(x, 0, 0, 0))).exactly(1)
        draws.with_data("light", Light(offset=(3 - x, 0, 0, 0))).exactly(0)


def test_a_part_written_after_clear_is_not_the_whole(null_device: Device) -> None:
    storage = null_device.storage(PointLight, np.ones(2, PointLight.dtype))
    program = null_device.program(Writing)
    null_device.stream.clear()
    storage.write(np.ones(1, PointLight.dtype))
    null_device.dispatch(program, 1, point_lights=storage)
    dispatch = null_device.stream.filter(rhi.Op.DISPATCH)[-1]
    with pytest.raises(UnknownDataError, match="byte 16 of 'point_lights' was last written before"):
        binding_data(dispatch, "point_lights")


def test_buffers_written_by_a_program_older_than_the_stream_are_unknown(null_device: Device) -> None:
    storage = null_device.storage(PointLight, np.ones(2, PointLight.dtype))
    program = null_device.program(Writing)
    null_device.dispatch(program, 1, point_lights=storage)  # bound before the stream begins
    null_device.stream.clear()
    storage.write(np.zeros(2, PointLight.dtype))
    null_device.dispatch(program, 1, point_lights=storage)
    null_device.dispatch(program, 1, point_lights=storage)
    first, second = null_device.stream.filter(rhi.Op.DISPATCH)
    assert binding_data(first, "point_lights")["power"].tolist() == [0, 0]
    with pytest.raises(UnknownDataError, match="byte 0 of 'point_lights' was written on the device"):
        binding_data(second, "point_lights")


def test_a_loaded_trace_says_that_it_has_no_layouts(sample_frame: SampleFrame, tmp_path: object) -> None:
    sample_frame.render()
    file = f"{tmp_path}/t.zip"
    save(sample_frame.device, file)
    with pytest.raises(UnknownDataError, match="layout of Tint"):
        binding_data(load(file).stream.draws()[-1], "tint")


def _recorder(device: Device) -> Recorder:
    recorder = device._backend  # type: ignore[attr-defined]
    assert isinstance(recorder, Recorder)
    return recorder


class Doubling(Shader):
    """Writes storage in a draw."""

    powers: StorageRW[float]

    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, 0.5, 1.0)

    def fragment(self) -> vec4:
        self.powers[0] = 2.0 * self.powers[0]
        return vec4(1.0)


class WriteWays:
    """Each method changes the bytes of `storage` in a way of its own."""

    def __init__(self, device: Device) -> None:
        self.device = device
        self.storage = device.storage(float, np.ones(4, np.float32))
        self.other = device.storage(float, np.full(4, 3, np.float32))
        self.texture = device.texture((4, 1), Format.R32F)
        self.image = device.texture((4, 4), Format.RGBA8)
        self.lights = device.storage(PointLight, np.ones(4, PointLight.dtype))
        self.copying, self.doubling = device.program(Copying), device.program(Doubling)
        self.triangle = device.mesh({"position": np.zeros((3, 2), np.float32)})

    def written(self) -> None:
        self.storage.write(np.zeros(4, np.float32))

    def written_in_part(self) -> None:
        self.storage.owner.write(np.float32([5]), 3)

    def locked(self) -> None:
        with self.storage.owner.lock(rhi.Access.WRITE) as bytes:
            bytes[...] = 0

    def copied(self) -> None:
        self.other.write(np.full(4, 4, np.float32))
        self.other.owner.copy_to(self.storage.owner)

    def copied_from_a_texture(self) -> None:
        self.texture.copy_to_buffer(self.storage.owner)

    def dispatched(self) -> None:
        self.device.dispatch(self.copying, 4, point_lights=self.lights, power=self.storage)

    def dispatched_indirectly(self) -> None:
        groups = self.device.storage(int, np.ones(3, np.int32))
        self.device.dispatch_indirect(self.copying, groups, point_lights=self.lights, power=self.storage)

    def submitted(self) -> None:
        with self.device.record() as commands:
            commands.dispatch(self.copying, 4, point_lights=self.lights, power=self.storage)
        self.device.submit(commands)

    def drawn(self) -> None:
        with self.device.render_pass(self.image):
            self.device.draw(self.doubling, self.triangle, powers=self.storage)

    def drawn_many_times(self) -> None:
        draws = self.triangle.draws(np.zeros(2, int), 3)
        with self.device.render_pass(self.image):
            self.device.draw_many(self.doubling, self.triangle, draws, powers=self.storage)


WRITE_WAYS = [name for name, value in vars(WriteWays).items() if callable(value) and name[0] != "_"]


@pytest.mark.parametrize("way", WRITE_WAYS)
@pytest.mark.parametrize("is_cleared", [False, True])
def test_bytes_that_change_while_paused_are_unknown(null_device: Device, way: str, is_cleared: bool) -> None:
    ways = WriteWays(null_device)
    if is_cleared:  # then all buffers are older than the stream
        null_device.stream.clear()
        ways.storage.write(np.ones(4, np.float32))
    with _recorder(null_device).paused():
        getattr(ways, way)()
    null_device.dispatch(ways.copying, 1, point_lights=ways.lights, power=ways.storage)
    dispatch = null_device.stream.filter(rhi.Op.DISPATCH)[-1]
    byte = 12 if way == "written_in_part" else 0
    with pytest.raises(UnknownDataError, match=f"byte {byte} of 'power' was written (while|on the device)"):
        binding_data(dispatch, "power")
    ways.storage.write(np.full(4, 7, np.float32))  # recorded again, so they are known
    null_device.dispatch(ways.copying, 1, point_lights=ways.lights, power=ways.storage)
    assert binding_data(null_device.stream.filter(rhi.Op.DISPATCH)[-1], "power").tolist() == [7] * 4


@pytest.mark.parametrize("name", ["clear", "create"])
def test_zeros_written_while_paused_are_known(null_device: Device, name: str) -> None:
    ways = WriteWays(null_device)
    storage = ways.storage
    with _recorder(null_device).paused():
        if name == "clear":
            storage.owner.clear()
        else:
            storage = null_device.storage(float, 4)
    null_device.dispatch(ways.copying, 1, point_lights=ways.lights, power=storage)
    assert binding_data(null_device.stream.filter(rhi.Op.DISPATCH)[-1], "power").tolist() == [0] * 4


def test_repeated_draws_while_paused_take_no_memory(null_device: Device) -> None:
    sample_frame = SampleFrame(null_device)
    with _recorder(null_device).paused(), null_device.render_pass(depth=sample_frame.map):
        null_device.draw(sample_frame.shadow, sample_frame.walls, light=sample_frame.light)
        before = len(null_device.stream._gaps)
        for _ in range(100):
            null_device.draw(sample_frame.shadow, sample_frame.walls, light=sample_frame.light)
        assert len(null_device.stream._gaps) == before


def test_an_expectation_is_used_again_after_the_stream_was_cleared(sample_frame: SampleFrame) -> None:
    device = sample_frame.device
    lit = expect(device).draws().with_data("light", Light(offset=(1, 0, 0, 0)))
    for length, (x, number) in enumerate([(1.0, 1), (2.0, 0), (1.0, 1)]):
        device.stream.clear()
        sample_frame.light.write(Light(offset=(x, 0, 0, 0)))
        for _ in range(10 * length):  # so the draw comes after all that the last stream had
            device.signal()
        with device.render_pass(depth=sample_frame.map):
            device.draw(sample_frame.shadow, sample_frame.roof, light=sample_frame.light)
        lit.exactly(number)


KINDS = (
    *("write", "copy", "clear", "draw", "draw with a value", "forget"),
    *("write while paused", "copy while paused", "draw while paused"),
)


@settings(max_examples=40)
@given(st.lists(st.tuples(st.sampled_from(KINDS), st.integers(0, 2), st.integers(0, 9)), max_size=30))
def test_tracked_binding_data_equal_the_bytes_on_the_device(steps: list[tuple[str, int, int]]) -> None:
    """Also after the stream was cleared: bytes written since are known, and no others."""
    with rhi.create_device("null") as device:
        sample_frame = SampleFrame(device)
        lights = [device.uniform(Light(offset=(i, 0, 0, 0))) for i in range(3)]
        is_known = np.ones((3, 16), np.bool_)
        expected: list[list[float] | None] = []
        with device.render_pass(depth=sample_frame.map):
            for kind, which, number in steps:
                if kind == "write":
                    lights[which].write(Light(offset=(number, 1, 2, 3)))
                    is_known[which] = True
                elif kind == "write while paused":
                    with _recorder(device).paused():
                        lights[which].write(Light(offset=(number, 1, 2, 3)))
                    is_known[which] = False
                elif kind == "copy while paused":
                    target = (which + 1) % 3
                    with _recorder(device).paused():
                        lights[which].owner.copy_to(lights[target].owner, size=8, offset=4, target_offset=0)
                    is_known[target, :8] = is_known[which, 4:12]
                elif kind == "draw while paused":
                    with _recorder(device).paused():
                        device.draw(sample_frame.shadow, sample_frame.walls, light=lights[which])
                elif kind == "copy":
                    target = (which + 1) % 3
                    lights[which].owner.copy_to(lights[target].owner, size=8, offset=4, target_offset=0)
                    is_known[target, :8] = is_known[which, 4:12]
                elif kind == "clear":
                    lights[which].owner.clear(number)
                    is_known[which] = True
                elif kind == "forget":
                    device.stream.clear()
                    is_known[:] = False
                    expected.clear()
                elif kind == "draw":
                    device.draw(sample_frame.shadow, sample_frame.walls, light=lights[which])
                    content = lights[which].owner.read()["offset"][0].tolist()
                    expected.append(content if is_known[which].all() else None)
                else:
                    device.draw(
                        sample_frame.shadow, sample_frame.walls, light=Light(offset=(number, 4, 5, 6))
                    )
                    expected.append([number, 4, 5, 6])
        assert [_offset(draw) for draw in device.stream.draws()] == expected


def _offset(draw: rhi.Command) -> list[float] | None:
    try:
        offset: list[float] = binding_data(draw, "light")["offset"].tolist()
    except UnknownDataError:
        return None
    return offset


class Blend(Shader):
    strength: Uniform[float]
    tint: Uniform[vec4]

    def vertex(self, v: Corner) -> vec4:
        return vec4(v.position, self.strength, 1.0) * self.tint


def test_a_uniform_that_is_no_struct_contains_numbers(null_device: Device) -> None:
    with null_device.render_pass(null_device.texture((4, 4), Format.RGBA8)):
        mesh = null_device.mesh(np.zeros(3, Corner.dtype))
        null_device.draw(null_device.program(Blend), mesh, strength=0.1, tint=(1, 2, 3, 4))
    draws = expect(null_device).draws()
    draws.with_data("strength", 0.1).exactly(1)
    draws.with_data("strength", 0.2).exactly(0)
    draws.with_data("strength", 0.25, tolerance=0.2).exactly(1)
    draws.with_data("tint", (1, 2, 3, 4)).exactly(1)
    draws.with_data("tint", np.array([1, 2, 3, 5])).exactly(0)
    with pytest.raises(AssertionError, match=r"of strength, it is 0\.1"):
        draws.with_data("strength", 0.2).exactly(1)
    for binding, value in (("strength", (0.1,)), ("tint", 1.0), ("tint", (1, 2)), ("strength", float("nan"))):
        with pytest.raises(rhi.ValidationError, match="assertion-argument"):
            draws.with_data(binding, value).exactly(0)


def test_numbers_alone_are_no_data_of_structs_and_arrays(null_device: Device) -> None:
    value = Everything(number=1, rotation=np.eye(3), point_lights=[PointLight(color=(1, 0, 0), power=1)] * 2)
    draw_all(null_device, value, np.zeros(2, PointLight.dtype))
    for binding in ("all", "point_lights"):
        with pytest.raises(rhi.ValidationError, match="a struct's value, or numbers by name"):
            expect(null_device).draws().with_data(binding, 0.0).exactly(0)
