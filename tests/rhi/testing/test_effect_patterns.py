"""Patterns of effects: what belongs to them, that a stream is free of it, and that two streams are the
same."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from testing_kit import Light, Lit, SampleFrame, Shadow

import rhi
from rhi import CullMode, DepthBias, Op
from rhi.shading import vec4
from rhi.testing import EffectPattern, assert_free, assert_same, expect, frames

SHADOWS = EffectPattern(
    "shadows", programs=(Shadow,), resources=("shadow *",), events=("sun",), states=(CullMode.FRONT,)
)


def failure(check: Callable[[], object]) -> str:
    with pytest.raises(AssertionError) as caught:
        check()
    return str(caught.value)


def draw_view(sample_frame: SampleFrame) -> None:
    """Draw the frame without its shadow pass."""
    device = sample_frame.device
    with device.event("view"), device.render_pass(sample_frame.image, clear=(0, 0, 0, 1)):
        device.draw(sample_frame.lit, sample_frame.walls, light=sample_frame.light, tint=sample_frame.tint)
    device.present(sample_frame.image)


@pytest.fixture
def sample_frame(null_device: rhi.Device) -> SampleFrame:
    """A house whose resources are made, and forgotten by the stream."""
    sample = SampleFrame(null_device)
    null_device.stream.clear()
    return sample


PARTS: dict[str, tuple[EffectPattern, set[Op]]] = {
    "shader": (EffectPattern("it", programs=(Shadow,)), {Op.BIND_PROGRAM, Op.DRAW}),
    "name": (EffectPattern("it", programs=("Sha*",)), {Op.BIND_PROGRAM, Op.DRAW}),
    "word": (EffectPattern("it", words=("Tint",)), {Op.BIND_PROGRAM, Op.DRAW}),
    "field": (EffectPattern("it", words=(".color",)), {Op.BIND_PROGRAM, Op.DRAW}),
    "binding": (EffectPattern("it", bindings=("tin?",)), {Op.BIND_PROGRAM, Op.DRAW}),
    "target": (EffectPattern("it", resources=("shadow map",)), {Op.BEGIN_PASS, Op.DRAW}),
    "buffer": (EffectPattern("it", resources=("tint",)), {Op.BIND_UNIFORM, Op.DRAW}),
    "event": (
        EffectPattern("it", events=("casters",)),
        {Op.PUSH_LABEL, Op.CREATE_VERTEX_ARRAY, Op.SET_STATES, Op.BIND_PROGRAM, Op.BIND_UNIFORM, Op.DRAW},
    ),
    "state": (EffectPattern("it", states=(DepthBias(-2.0),)), {Op.DRAW}),
    "kind": (EffectPattern("it", ops=(Op.PRESENT,)), {Op.PRESENT}),
    "predicate": (
        EffectPattern("it", where={"four of them": lambda command: command.arguments.get("instances") == 4}),
        {Op.DRAW},
    ),
}


@pytest.mark.parametrize("kind", PARTS)
def test_commands_that_have_a_part_of_an_effect_belong_to_it(sample_frame: SampleFrame, kind: str) -> None:
    effect, ops = PARTS[kind]
    sample_frame.render()
    expectation = expect(sample_frame.device).of(effect).at_least(1)
    assert {command.op for command in expectation} == ops
    assert len(expectation) < len(sample_frame.device.stream)
    assert [part for command in expectation for part, _ in effect.match_parts(command)].count(
        effect.parts[0]
    ) >= len(expectation)


NONE = {
    "shader": EffectPattern("it", programs=("Shado",)),
    "word": EffectPattern("it", words=("Tin", "ight")),
    "field": EffectPattern("it", words=(".colo", ".Tint")),
    "binding": EffectPattern("it", bindings=("tin", "lights")),
    "resource": EffectPattern("it", resources=("shadow", "map")),
    "event": EffectPattern("it", events=("caster", "ast")),
    "state": EffectPattern("it", states=(DepthBias(-2.5), CullMode.NONE)),
    "kind": EffectPattern("it", ops=(Op.DISPATCH,)),
    "predicate": EffectPattern(
        "it", where={"five of them": lambda command: command.arguments.get("instances") == 5}
    ),
}


@pytest.mark.parametrize("kind", NONE)
def test_names_that_are_parts_of_others_are_others(sample_frame: SampleFrame, kind: str) -> None:
    sample_frame.render()
    assert_free(NONE[kind], sample_frame.device)
    message = failure(lambda: assert_free(NONE[kind], sample_frame.device, control=sample_frame.device))
    assert "the control lacks parts of the pattern" in message
    assert len(message.splitlines()) == 1 + len(NONE[kind].parts)


def test_creation_writes_and_destruction_of_a_resource_belong_to_its_effect(null_device: rhi.Device) -> None:
    effect = EffectPattern("it", resources=("bloom",))
    bloom, other = (
        null_device.uniform(Light(offset=(0, 0, 0, 0)), label=label) for label in ("bloom", "other")
    )
    bloom.write(Light(offset=(1, 0, 0, 0)))
    for resource in (bloom, other):
        resource.destroy()
    null_device.finish()
    expectation = expect(null_device).of(effect).exactly(4)
    assert [command.op for command in expectation] == [
        Op.CREATE_BUFFER,
        Op.WRITE_BUFFER,
        Op.WRITE_BUFFER,
        Op.DESTROY,
    ]


def test_a_frame_without_an_effect_is_free_of_it(sample_frame: SampleFrame) -> None:
    draw_view(sample_frame)
    sample_frame.render()
    without, with_shadows = frames(sample_frame.device)
    assert_free(SHADOWS, without, control=with_shadows)
    with pytest.raises(AssertionError):
        assert_free(SHADOWS, with_shadows)


def test_a_failure_names_the_commands_of_an_effect_and_their_lines(sample_frame: SampleFrame) -> None:
    sample_frame.light.write(Light(offset=(1, 0, 0, 0)))
    sample_frame.render()
    effect = EffectPattern("shadows", programs=(Shadow,), resources=("light", "shadow map"), events=("sun",))
    message = failure(lambda: assert_free(effect, sample_frame.device))
    first, cost, *lines = message.splitlines()
    assert first == f"expected nothing of shadows, found 15 among {len(sample_frame.device.stream)} commands"
    assert cost == (
        "events: 2, passes: 1, programs: 1, resources: 2, uploads: 1, bindings: 2, draws: 3, others: 1, "
        "bytes: 16"
    )
    where = next(line for line in lines if "write_buffer" in line)
    assert Path(__file__).name in where
    assert "in sun / casters" in message
    assert "uses 'shadow map'" in message
    assert "program Shadow" in message


def test_a_failure_names_the_matching_words_and_bindings_of_programs(null_device: rhi.Device) -> None:
    null_device.program(Lit)
    message = failure(
        lambda: assert_free(EffectPattern("tints", words=("Tint",), bindings=("tint",)), null_device)
    )
    assert "Tint in the text of Lit; binding tint of Lit" in message


@pytest.mark.parametrize("effect", [EffectPattern("nothing"), SHADOWS], ids=["empty pattern", "empty stream"])
def test_an_assertion_that_could_not_fail_does(sample_frame: SampleFrame, effect: EffectPattern) -> None:
    if not effect.parts:
        sample_frame.render()
        assert "is empty" in failure(lambda: assert_free(effect, sample_frame.device))
    else:
        assert "no commands" in failure(lambda: assert_free(effect, sample_frame.device))
        assert "both streams are empty" in failure(
            lambda: assert_same(sample_frame.device, sample_frame.device)
        )


# -- the same streams ----------------------------------------------------------------------------------------


def test_frames_of_two_devices_are_the_same_whatever_their_ids(sample_frame: SampleFrame) -> None:
    with rhi.create_device("null") as other:
        more = other.buffer(4, label="more")
        second = SampleFrame(other)
        other.stream.clear()
        for frame in (sample_frame, second):
            draw_view(frame)
        assert sample_frame.lit.id != second.lit.id
        assert_same(sample_frame.device, other)
        assert_same(frames(sample_frame.device)[0], frames(other)[0])
        del more


def bind_another(sample_frame: SampleFrame) -> None:
    sample_frame.light = sample_frame.device.uniform(Light(offset=(0, 0, 0, 0)), label="moonlight")
    sample_frame.device.stream.clear()


def swap_meshes(sample_frame: SampleFrame) -> None:
    sample_frame.walls = sample_frame.roof


def darken(sample_frame: SampleFrame) -> None:
    class Darker(Lit):
        def fragment(self) -> vec4:
            return self.tint.color * 0.5

    Darker.__name__ = "Lit"
    sample_frame.lit = sample_frame.device.program(Darker)
    sample_frame.device.stream.clear()


CHANGES: dict[str, Callable[[SampleFrame], object]] = {
    "a byte": lambda sample_frame: sample_frame.light.write(Light(offset=(0, 0, 0, 1))),
    "another buffer": bind_another,
    "another mesh": swap_meshes,
    "a program's text": darken,
    "a pass": lambda sample_frame: sample_frame.render(),
}


@pytest.mark.parametrize("change", CHANGES)
def test_the_difference_between_two_streams_is_named(sample_frame: SampleFrame, change: str) -> None:
    with rhi.create_device("null") as other:
        second = SampleFrame(other)
        other.stream.clear()
        CHANGES[change](second)
        draw_view(sample_frame)
        draw_view(second)
        message = failure(lambda: assert_same(sample_frame.device, other, description="frames"))
    assert message.startswith("frames differ in ")
    assert Path(__file__).name in message


def test_the_same_frame_twice_is_the_same(sample_frame: SampleFrame) -> None:
    for _ in range(3):  # the first one also sets states
        draw_view(sample_frame)
    first, second, third = frames(sample_frame.device)
    assert_same(second, third)
    with pytest.raises(AssertionError):
        assert_same(first, second)
