"""`why_nothing` finds each cause where it applies, and only there."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest
from testing_kit import Corner, House, Tint

import rhi
from rhi.testing import why_nothing


@pytest.fixture
def house(null_device: rhi.Device) -> House:
    return House(null_device)


def draw(house: House, *states: object, instances: int = 1, mesh=None, color=True, clear_depth=0.0, tint=None):
    """Draw once with the lit program and return the command."""
    device = house.device
    target = {"color": house.image, "clear": (0, 0, 0, 1)} if color else {}
    with device.render_pass(depth=house.depth, clear_depth=clear_depth, **target):
        with device.states(*states) if states else nullcontext():
            device.draw(house.lit, mesh or house.walls, instances, light=house.light, tint=tint or house.tint)
    return device.stream.draws()[-1]


def certain(command: rhi.Command) -> list[str]:
    return [cause.what for cause in why_nothing(command) if cause.certain]


def possible(command: rhi.Command) -> list[str]:
    return [cause.what for cause in why_nothing(command) if not cause.certain]


KEEP = rhi.BlendFunction(rhi.BlendFactor.ZERO, rhi.BlendFactor.ONE)
NEVER = (rhi.StencilFront(rhi.Comparison.NEVER), rhi.StencilBack(rhi.Comparison.NEVER))


def test_a_plain_draw_has_only_suspicions(house) -> None:
    command = draw(house)
    assert certain(command) == []
    assert possible(command) == ["CullMode", "DepthFunction"]
    assert certain(draw(house, rhi.CullMode.NONE, rhi.DepthFunction.ALWAYS)) == []
    assert possible(house.device.stream.draws()[-1]) == []


@pytest.mark.parametrize(
    ("states", "cause"),
    [
        ((rhi.Scissor(0, 0, 0, 8),), "Scissor"),
        ((rhi.Scissor(0, 0, 8, 0),), "Scissor"),
        ((rhi.Scissor(64, 0, 8, 8),), "Scissor"),
        ((rhi.Scissor(0, 48, 8, 8),), "Scissor"),
        ((rhi.Scissor(-8, 0, 8, 8),), "Scissor"),
        ((rhi.Scissor(0, 0, 8, 8), rhi.Viewport(8, 0, 8, 8)), "Scissor"),
        ((rhi.Viewport(0, 0, 0, 8),), "Viewport"),
        ((rhi.Viewport(64, 0, 8, 8),), "Viewport"),
        ((rhi.ColorWrite.OFF, rhi.DepthWrite.OFF), "ColorWrite"),
        ((KEEP, rhi.DepthWrite.OFF), "BlendFunction"),
        ((rhi.DepthFunction.NEVER,), "DepthFunction"),
        ((rhi.DepthFunction.LESS,), "DepthFunction"),
        ((rhi.AlphaTest.ON, rhi.AlphaFunction.NEVER), "AlphaFunction"),
    ],
)
def test_states_that_let_nothing_through_are_certain(house, states, cause: str) -> None:
    assert certain(draw(house, *states)) == [cause]


@pytest.mark.parametrize(
    "states",
    [
        (rhi.Scissor(63, 47, 8, 8),),
        (rhi.Scissor(-7, 0, 8, 8),),
        (rhi.Scissor(0, 0, 9, 8), rhi.Viewport(8, 0, 8, 8)),
        (rhi.Viewport(63, 47, 8, 8),),
        (rhi.ColorWrite.OFF,),  # depth is written
        (rhi.ColorWrite(False, False, False, True), rhi.DepthWrite.OFF),
        (KEEP,),
        (rhi.DepthFunction.NEVER, rhi.DepthTest.OFF),
        (rhi.DepthFunction.GREATER,),
        (rhi.AlphaTest.ON,),
        (rhi.AlphaFunction.NEVER,),
        (rhi.StencilTest.ON, *NEVER[:1]),
    ],
)
def test_states_that_let_something_through_are_not(house, states) -> None:
    assert certain(draw(house, *states)) == []


def test_a_stencil_test_that_never_passes_is_certain(house) -> None:
    assert certain(draw(house, rhi.StencilTest.ON, *NEVER)) == ["StencilFront"]


def test_depth_cleared_to_the_wrong_end_is_certain(house) -> None:
    assert certain(draw(house, clear_depth=1.0)) == ["DepthFunction"]
    assert certain(draw(house, rhi.DepthFunction.LESS, clear_depth=1.0)) == []


def test_counts_of_nothing_are_certain(house) -> None:
    assert certain(draw(house, instances=0)) == ["instances"]
    assert certain(draw(house, mesh=house.device.mesh(np.zeros(2, Corner.dtype)))) == ["count"]


def test_a_pass_without_color_and_depth_writes_keeps_nothing(house) -> None:
    assert certain(draw(house, rhi.DepthWrite.OFF, color=False)) == ["DepthWrite"]
    assert certain(draw(house, color=False)) == []


def test_a_program_without_a_fragment_stage_writes_no_color(house) -> None:
    device = house.device
    with device.render_pass(house.image, clear=(0, 0, 0, 1)):
        device.draw(house.shadow, house.walls, light=house.light)
    assert "fragment stage" in certain(device.stream.draws()[-1])


def test_memory_that_nobody_wrote_is_suspicious(house) -> None:
    unwritten = house.device.uniform_array(Tint, 2, label="tints")
    causes = why_nothing(draw(house, tint=unwritten[0]))
    (cause,) = [cause for cause in causes if cause.what == "tint"]
    assert "'tints'" in cause.text
    unwritten.write(np.ones(2, unwritten.dtype))
    assert "tint" not in possible(draw(house, tint=unwritten[0]))


def test_a_later_clear_before_present_wipes_the_draw(house) -> None:
    device = house.device
    first = draw(house)
    assert certain(first) == []
    draw(house)
    (cause,) = [cause for cause in why_nothing(first) if cause.certain]
    assert cause.what == "clear"
    assert "test_testing_nothing.py" in cause.text
    kept = draw(house)
    device.present(house.image)
    draw(house)
    assert certain(kept) == []


def test_a_condition_is_suspicious(house) -> None:
    device = house.device
    query = device.occlusion_query()
    with device.render_pass(house.image, house.depth):
        with query:
            device.draw(house.lit, house.walls, light=house.light, tint=house.tint)
        with device.conditional(query):
            device.draw(house.lit, house.walls, light=house.light, tint=house.tint)
        device.draw(house.lit, house.walls, light=house.light, tint=house.tint)
    before, inside, after = device.stream.draws()
    assert ["conditional" in possible(each) for each in (before, inside, after)] == [False, True, False]


def test_only_draws_can_be_asked_about(house) -> None:
    with pytest.raises(AssertionError, match="create_program is not a draw"):
        why_nothing(house.device.stream.filter(rhi.Op.CREATE_PROGRAM)[0])


def test_certain_causes_come_first_and_read_as_sentences(house) -> None:
    causes = why_nothing(draw(house, rhi.Scissor(0, 0, 0, 0)))
    assert [cause.certain for cause in causes] == sorted((cause.certain for cause in causes), reverse=True)
    assert str(causes[0]) == "certain: the scissor is empty: Scissor(x=0, y=0, width=0, height=0)"
