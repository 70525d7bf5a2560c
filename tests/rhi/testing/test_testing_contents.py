"""Assertions on the contents of uniforms and storage, tracked through the stream."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from testing_kit import Corner, House, Light

import rhi
from rhi import Device, Format
from rhi.shading import Array, Shader, Storage, StorageRW, Struct, Uniform, array, global_id, mat3, vec3, vec4
from rhi.testing import UnknownContentsError, contents, expect
from rhi.trace import load, save


class Lamp(Struct):
    color: vec3
    power: float


class Everything(Struct):
    number: int
    turn: mat3
    lamps: Array[Lamp] = array(Lamp, 2)


class Reading(Shader):
    all: Uniform[Everything]
    lamps: Storage[Lamp]

    def vertex(self, v: Corner) -> vec4:
        power = self.all.lamps[0].power + self.lamps[0].power
        return vec4(v.position, power, 1.0)


class Copying(Shader):
    lamps: Storage[Lamp]
    power: StorageRW[float]

    def compute(self) -> None:
        self.power[global_id().x] = self.lamps[global_id().x].power


class Writing(Shader):
    lamps: StorageRW[Lamp]

    def compute(self) -> None:
        self.lamps[global_id().x].power = 2.0


@pytest.fixture
def house(null_device: Device) -> House:
    return House(null_device)


def test_a_draw_holds_what_was_written_last(house: House) -> None:
    device = house.device
    with device.render_pass(depth=house.map):
        for x in (1.0, 2.0):
            house.light.write(Light(offset=(x, 0, 0, 0)))
            device.draw(house.shadow, house.walls, light=house.light)
    house.light.write(Light(offset=(9, 0, 0, 0)))
    draws = expect(device).draws(program="Shadow")
    draws.with_contents("light", {"offset": (1, 0, 0, 0)}).exactly(1)
    draws.with_contents("light", Light(offset=(2, 0, 0, 0))).exactly(1)
    draws.with_contents("light", {"offset": (9, 0, 0, 0)}).exactly(0)
    (first, second) = draws.exactly(2)
    assert contents(second, "light")["offset"].tolist() == [2, 0, 0, 0]
    assert contents(first, "light")["offset"].tolist() == [1, 0, 0, 0]


@pytest.mark.parametrize(("tolerance", "matches"), [(0.0, 0), (0.009, 0), (0.011, 1)])
def test_numbers_match_within_a_tolerance(house: House, tolerance: float, matches: int) -> None:
    house.render()
    draws = expect(house.device).draws(program="Lit")
    draws.with_contents("tint", {"color": (1, 0.51, 0, 1)}, tolerance=tolerance).exactly(matches)


def test_a_failure_says_what_is_there_instead(house: House) -> None:
    house.render()
    with pytest.raises(AssertionError) as caught:
        expect(house.device).draws().with_contents("tint", {"color": (1, 0, 0, 1)}, tolerance=0.1).exactly(1)
    message = str(caught.value)
    assert "with color=(1, 0, 0, 1) in tint within 0.1" in message
    assert "of tint, color is [1. , 0.5, 0. , 1. ]" in message
    assert "the program has no uniform or storage 'tint' (it has: light)" in message


def draw_all(device: Device, value: Everything, lamps: np.ndarray) -> rhi.Command:
    image = device.texture((4, 4), Format.RGBA8)
    mesh = device.mesh({"position": np.zeros((3, 2), np.float32)})
    uniform, storage = device.uniform(value), device.storage(Lamp, lamps)
    with device.render_pass(image):
        device.draw(device.program(Reading), mesh, all=uniform, lamps=storage)
    return device.stream.draws()[-1]


def test_parts_of_arrays_and_structs_are_named_by_paths(null_device: Device) -> None:
    lamps = np.zeros(3, Lamp.dtype)
    lamps["power"] = [1, 2, 3]
    turn = np.arange(9.0).reshape(3, 3)
    value = Everything(number=-7, turn=turn, lamps=(Lamp(color=(1, 2, 3), power=4), Lamp(color=(5, 6, 7), power=8)))
    draw_all(null_device, value, lamps)
    draws = expect(null_device).draws()
    draws.with_contents("all", {"number": -7, "turn": turn, "lamps.1.color": (5, 6, 7)}).exactly(1)
    draws.with_contents("lamps", {"2.power": 3.0}).exactly(1)
    draws.with_contents("lamps", {"2.power": 2.0}).exactly(0)
    for path in ("nothing", "lamps.2.power", "number.x"):
        with pytest.raises(AssertionError, match="there is no"):
            draws.with_contents("all", {path: 0}).exactly(1)


def test_transient_constants_and_copies_are_followed(house: House) -> None:
    device = house.device
    source = device.uniform(Light(offset=(3, 0, 0, 0)))
    with device.render_pass(depth=house.map):
        device.draw(house.shadow, house.walls, light=device.transient.uniform(Light(offset=(5, 0, 0, 0))))
        source.owner.copy_to(house.light.owner)
        device.draw(house.shadow, house.walls, light=house.light)
        house.light.owner.clear(0x40000000)  # 2.0
        device.draw(house.shadow, house.walls, light=house.light)
    values = [contents(draw, "light")["offset"][0] for draw in device.stream.draws()]
    assert values == [5, 3, 2]


def test_what_the_device_wrote_is_not_known(null_device: Device) -> None:
    lamps = null_device.storage(Lamp, 2)
    program = null_device.program(Writing)
    null_device.dispatch(program, 1, lamps=lamps)
    null_device.dispatch(program, 1, lamps=lamps)
    first, second = null_device.stream.filter(rhi.Op.DISPATCH)
    assert contents(first, "lamps")["power"].tolist() == [0, 0]  # as they were made
    with pytest.raises(UnknownContentsError, match="written on the device"):
        contents(second, "lamps")
    expect(null_device).dispatches().with_contents("lamps", {"0.power": 0}).exactly(1)


@pytest.mark.parametrize("lamp", range(3))
def test_texels_that_were_copied_to_a_buffer_are_not_known(null_device: Device, lamp: int) -> None:
    storage = null_device.storage(Lamp, np.ones(3, Lamp.dtype))
    program, texture = null_device.program(Writing), null_device.texture((4, 1), Format.RGBA8)  # as large as a lamp
    null_device.dispatch(program, 1, lamps=storage)
    storage.write(np.ones(3, Lamp.dtype))
    texture.copy_to_buffer(storage.owner, offset=16 * lamp)
    null_device.dispatch(program, 1, lamps=storage)
    first, second = null_device.stream.filter(rhi.Op.DISPATCH)
    assert contents(first, "lamps")["power"].tolist() == [1, 1, 1]
    with pytest.raises(UnknownContentsError, match=f"byte {16 * lamp} of 'lamps' was written on the device"):
        contents(second, "lamps")


def test_all_rows_of_texels_that_were_copied_are_unknown_until_they_are_written(null_device: Device) -> None:
    lamps, power = null_device.storage(Lamp, 4), null_device.storage(float, 4)
    program, texture = null_device.program(Copying), null_device.texture((4, 2), Format.RGBA8)
    texture.copy_to_buffer(lamps.owner, offset=16)
    for unknown in (1, 2, None):
        null_device.dispatch(program, 1, lamps=lamps, power=power)
        dispatch = null_device.stream.filter(rhi.Op.DISPATCH)[-1]
        if unknown is None:
            assert contents(dispatch, "lamps")["power"].tolist() == [0, 0, 0, 0]
        else:
            with pytest.raises(UnknownContentsError, match=f"byte {16 * unknown} of 'lamps'"):
                contents(dispatch, "lamps")
            lamps.write(np.zeros(1, Lamp.dtype), first=unknown)


def test_what_is_older_than_the_stream_is_not_known(house: House) -> None:
    house.device.stream.clear()
    house.render()
    with pytest.raises(AssertionError, match="older than the stream"):
        expect(house.device).draws().with_contents("tint", {"color": (1, 0.5, 0, 1)}).exactly(1)


def test_a_loaded_trace_says_that_it_has_no_layouts(house: House, tmp_path: object) -> None:
    house.render()
    file = f"{tmp_path}/t.zip"
    save(house.device, file)
    with pytest.raises(UnknownContentsError, match="layout of Tint"):
        contents(load(file).stream.draws()[-1], "tint")


@settings(max_examples=40)
@given(st.lists(st.tuples(st.sampled_from(["write", "copy", "clear", "draw"]), st.integers(0, 2), st.integers(0, 9))))
def test_what_is_followed_is_what_the_device_has(steps: list[tuple[str, int, int]]) -> None:
    with rhi.create_device("null") as device:
        house = House(device)
        lights = [device.uniform(Light(offset=(i, 0, 0, 0))) for i in range(3)]
        expected = []
        with device.render_pass(depth=house.map):
            for kind, which, number in steps:
                if kind == "write":
                    lights[which].write(Light(offset=(number, 1, 2, 3)))
                elif kind == "copy":
                    lights[which].owner.copy_to(lights[(which + 1) % 3].owner, size=8, offset=4, target_offset=0)
                elif kind == "clear":
                    lights[which].owner.clear(number)
                else:
                    device.draw(house.shadow, house.walls, light=lights[which])
                    expected.append(lights[which].owner.read()["offset"][0].tolist())
        found = [contents(draw, "light")["offset"].tolist() for draw in device.stream.draws()]
        assert found == expected
