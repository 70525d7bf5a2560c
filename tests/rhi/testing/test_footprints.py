"""Footprints of effects: what belongs to them, that a stream is free of it, and that two streams are the same."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from testing_kit import House, Light, Lit, Shadow

import rhi
from rhi import CullMode, DepthBias, Op
from rhi.shading import vec4
from rhi.testing import Footprint, assert_free, assert_same, expect, frames

SHADOWS = Footprint("shadows", programs=(Shadow,), resources=("shadow *",), events=("sun",), states=(CullMode.FRONT,))


def failure(check: Callable[[], object]) -> str:
    with pytest.raises(AssertionError) as caught:
        check()
    return str(caught.value)


def draw_view(house: House) -> None:
    """Draw the frame without its shadow pass."""
    device = house.device
    with device.event("view"), device.render_pass(house.image, clear=(0, 0, 0, 1)):
        device.draw(house.lit, house.walls, light=house.light, tint=house.tint)
    device.present(house.image)


@pytest.fixture
def house(null_device: rhi.Device) -> House:
    """A house whose resources are made, and forgotten by the stream."""
    made = House(null_device)
    null_device.stream.clear()
    return made


PARTS: dict[str, tuple[Footprint, set[Op]]] = {
    "shader": (Footprint("it", programs=(Shadow,)), {Op.BIND_PROGRAM, Op.DRAW}),
    "name": (Footprint("it", programs=("Sha*",)), {Op.BIND_PROGRAM, Op.DRAW}),
    "word": (Footprint("it", words=("Tint",)), {Op.BIND_PROGRAM, Op.DRAW}),
    "field": (Footprint("it", words=(".color",)), {Op.BIND_PROGRAM, Op.DRAW}),
    "binding": (Footprint("it", bindings=("tin?",)), {Op.BIND_PROGRAM, Op.DRAW}),
    "target": (Footprint("it", resources=("shadow map",)), {Op.BEGIN_PASS, Op.DRAW}),
    "buffer": (Footprint("it", resources=("tint",)), {Op.BIND_UNIFORM, Op.DRAW}),
    "event": (
        Footprint("it", events=("casters",)),
        {Op.PUSH_LABEL, Op.CREATE_VERTEX_ARRAY, Op.SET_STATES, Op.BIND_PROGRAM, Op.BIND_UNIFORM, Op.DRAW},
    ),
    "state": (Footprint("it", states=(DepthBias(-2.0),)), {Op.DRAW}),
    "kind": (Footprint("it", ops=(Op.PRESENT,)), {Op.PRESENT}),
    "predicate": (Footprint("it", where={"four of them": lambda one: one.arguments.get("instances") == 4}), {Op.DRAW}),
}


@pytest.mark.parametrize("kind", PARTS)
def test_commands_that_have_a_part_of_an_effect_belong_to_it(house: House, kind: str) -> None:
    effect, ops = PARTS[kind]
    house.render()
    found = expect(house.device).of(effect).at_least(1)
    assert {command.op for command in found} == ops
    assert len(found) < len(house.device.stream)
    assert [part for command in found for part, _ in effect.find_parts(command)].count(effect.parts[0]) >= len(found)


NONE = {
    "shader": Footprint("it", programs=("Shado",)),
    "word": Footprint("it", words=("Tin", "ight")),
    "field": Footprint("it", words=(".colo", ".Tint")),
    "binding": Footprint("it", bindings=("tin", "lights")),
    "resource": Footprint("it", resources=("shadow", "map")),
    "event": Footprint("it", events=("caster", "ast")),
    "state": Footprint("it", states=(DepthBias(-2.5), CullMode.NONE)),
    "kind": Footprint("it", ops=(Op.DISPATCH,)),
    "predicate": Footprint("it", where={"five of them": lambda one: one.arguments.get("instances") == 5}),
}


@pytest.mark.parametrize("kind", NONE)
def test_names_that_are_parts_of_others_are_others(house: House, kind: str) -> None:
    house.render()
    assert_free(NONE[kind], house.device)
    message = failure(lambda: assert_free(NONE[kind], house.device, control=house.device))
    assert "declares what its control hasn't" in message
    assert len(message.splitlines()) == 1 + len(NONE[kind].parts)


def test_what_makes_and_writes_and_destroys_a_resource_belongs_to_it(null_device: rhi.Device) -> None:
    effect = Footprint("it", resources=("glow",))
    glow, other = (null_device.uniform(Light(offset=(0, 0, 0, 0)), label=label) for label in ("glow", "other"))
    glow.write(Light(offset=(1, 0, 0, 0)))
    for one in (glow, other):
        one.destroy()
    null_device.finish()
    found = expect(null_device).of(effect).exactly(4)
    assert [one.op for one in found] == [Op.CREATE_BUFFER, Op.WRITE_BUFFER, Op.WRITE_BUFFER, Op.DESTROY]


def test_a_frame_without_an_effect_is_free_of_it(house: House) -> None:
    draw_view(house)
    house.render()
    without, with_shadows = frames(house.device)
    assert_free(SHADOWS, without, control=with_shadows)
    with pytest.raises(AssertionError):
        assert_free(SHADOWS, with_shadows)


def test_a_failure_says_what_the_effect_costs_and_where(house: House) -> None:
    house.light.write(Light(offset=(1, 0, 0, 0)))
    house.render()
    effect = Footprint("shadows", programs=(Shadow,), resources=("light", "shadow map"), events=("sun",))
    message = failure(lambda: assert_free(effect, house.device))
    first, cost, *lines = message.splitlines()
    assert first == f"expected nothing of shadows, found 15 among {len(house.device.stream)} commands"
    assert cost == (
        "events: 2, passes: 1, programs: 1, resources: 2, uploads: 1, bindings: 2, draws: 3, others: 1, bytes: 16"
    )
    where = next(line for line in lines if "write_buffer" in line)
    assert Path(__file__).name in where
    assert "in sun / casters" in message
    assert "uses 'shadow map'" in message
    assert "program Shadow" in message


def test_programs_are_named_by_what_they_have(null_device: rhi.Device) -> None:
    null_device.program(Lit)
    message = failure(lambda: assert_free(Footprint("tints", words=("Tint",), bindings=("tint",)), null_device))
    assert "Tint in the text of Lit; binding tint of Lit" in message


@pytest.mark.parametrize("effect", [Footprint("nothing"), SHADOWS], ids=["empty footprint", "empty stream"])
def test_an_assertion_that_could_not_fail_does(house: House, effect: Footprint) -> None:
    if not effect.parts:
        house.render()
        assert "declares nothing" in failure(lambda: assert_free(effect, house.device))
    else:
        assert "no commands" in failure(lambda: assert_free(effect, house.device))
        assert "no commands" in failure(lambda: assert_same(house.device, house.device))


# -- the same streams ----------------------------------------------------------------------------------------


def test_frames_of_two_devices_are_the_same_whatever_their_ids(house: House) -> None:
    with rhi.create_device("null") as other:
        more = other.buffer(4, label="more")
        second = House(other)
        other.stream.clear()
        for one in (house, second):
            draw_view(one)
        assert house.lit.id != second.lit.id
        assert_same(house.device, other)
        assert_same(frames(house.device)[0], frames(other)[0])
        del more


def bind_another(house: House) -> None:
    house.light = house.device.uniform(Light(offset=(0, 0, 0, 0)), label="moonlight")
    house.device.stream.clear()


def swap_meshes(house: House) -> None:
    house.walls = house.roof


def darken(house: House) -> None:
    class Darker(Lit):
        def fragment(self) -> vec4:
            return self.tint.color * 0.5

    Darker.__name__ = "Lit"
    house.lit = house.device.program(Darker)
    house.device.stream.clear()


CHANGES: dict[str, Callable[[House], object]] = {
    "a byte": lambda house: house.light.write(Light(offset=(0, 0, 0, 1))),
    "another buffer": bind_another,
    "another mesh": swap_meshes,
    "a program's text": darken,
    "a pass": lambda house: house.render(),
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_differs_between_two_streams_is_named(house: House, change: str) -> None:
    with rhi.create_device("null") as other:
        second = House(other)
        other.stream.clear()
        CHANGES[change](second)
        draw_view(house)
        draw_view(second)
        message = failure(lambda: assert_same(house.device, other, what="frames"))
    assert message.startswith("frames differ in ")
    assert Path(__file__).name in message


def test_the_same_frame_twice_is_the_same(house: House) -> None:
    for _ in range(3):  # the first one also sets states
        draw_view(house)
    first, second, third = frames(house.device)
    assert_same(second, third)
    with pytest.raises(AssertionError):
        assert_same(first, second)
