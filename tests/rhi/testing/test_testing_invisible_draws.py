"""`explain_invisible_draw` finds each cause where it applies, and only there."""

from __future__ import annotations

from contextlib import nullcontext

import numpy as np
import pytest
from testing_kit import Corner, SampleFrame, Tint

import rhi
from rhi.testing import explain_invisible_draw


@pytest.fixture
def sample_frame(null_device: rhi.Device) -> SampleFrame:
    return SampleFrame(null_device)


def draw(
    sample_frame: SampleFrame,
    *states: object,
    instances: int = 1,
    mesh=None,
    color=True,
    clear_depth=0.0,
    tint=None,
):
    """Draw once with the lit program and return the command."""
    device = sample_frame.device
    target = {"color": sample_frame.image, "clear": (0, 0, 0, 1)} if color else {}
    with device.render_pass(depth=sample_frame.depth, clear_depth=clear_depth, **target):
        with device.states(*states) if states else nullcontext():
            device.draw(
                sample_frame.lit,
                mesh or sample_frame.walls,
                instances,
                light=sample_frame.light,
                tint=tint or sample_frame.tint,
            )
    return device.stream.draws()[-1]


def certain(command: rhi.Command) -> list[str]:
    return [cause.subject for cause in explain_invisible_draw(command) if cause.certain]


def possible(command: rhi.Command) -> list[str]:
    return [cause.subject for cause in explain_invisible_draw(command) if not cause.certain]


KEEP = rhi.BlendFunction(rhi.BlendFactor.ZERO, rhi.BlendFactor.ONE)
NEVER = (rhi.StencilFront(rhi.Comparison.NEVER), rhi.StencilBack(rhi.Comparison.NEVER))


def test_a_plain_draw_has_only_suspicions(sample_frame) -> None:
    command = draw(sample_frame)
    assert certain(command) == []
    assert possible(command) == ["CullMode", "DepthFunction"]
    assert certain(draw(sample_frame, rhi.CullMode.NONE, rhi.DepthFunction.ALWAYS)) == []
    assert possible(sample_frame.device.stream.draws()[-1]) == []


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
def test_states_that_let_nothing_through_are_certain(sample_frame, states, cause: str) -> None:
    assert certain(draw(sample_frame, *states)) == [cause]


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
def test_states_that_let_something_through_are_not(sample_frame, states) -> None:
    assert certain(draw(sample_frame, *states)) == []


def test_a_stencil_test_that_never_passes_is_certain(sample_frame) -> None:
    assert certain(draw(sample_frame, rhi.StencilTest.ON, *NEVER)) == ["StencilFront"]


def test_depth_cleared_to_the_wrong_end_is_certain(sample_frame) -> None:
    assert certain(draw(sample_frame, clear_depth=1.0)) == ["DepthFunction"]
    assert certain(draw(sample_frame, rhi.DepthFunction.LESS, clear_depth=1.0)) == []


def test_counts_of_nothing_are_certain(sample_frame) -> None:
    assert certain(draw(sample_frame, instances=0)) == ["instances"]
    assert certain(draw(sample_frame, mesh=sample_frame.device.mesh(np.zeros(2, Corner.dtype)))) == ["count"]


def test_a_pass_without_color_and_depth_writes_keeps_nothing(sample_frame) -> None:
    assert certain(draw(sample_frame, rhi.DepthWrite.OFF, color=False)) == ["DepthWrite"]
    assert certain(draw(sample_frame, color=False)) == []


def test_a_program_without_a_fragment_stage_writes_no_color(sample_frame) -> None:
    device = sample_frame.device
    with device.render_pass(sample_frame.image, clear=(0, 0, 0, 1)):
        device.draw(sample_frame.shadow, sample_frame.walls, light=sample_frame.light)
    assert "fragment stage" in certain(device.stream.draws()[-1])


def test_memory_that_nobody_wrote_is_suspicious(sample_frame) -> None:
    unwritten = sample_frame.device.uniform_array(Tint, 2, label="tints")
    causes = explain_invisible_draw(draw(sample_frame, tint=unwritten[0]))
    (cause,) = [cause for cause in causes if cause.subject == "tint"]
    assert "'tints'" in cause.text
    unwritten.write(np.ones(2, unwritten.dtype))
    assert "tint" not in possible(draw(sample_frame, tint=unwritten[0]))


def test_a_later_clear_before_present_wipes_the_draw(sample_frame) -> None:
    device = sample_frame.device
    first = draw(sample_frame)
    assert certain(first) == []
    draw(sample_frame)
    (cause,) = [cause for cause in explain_invisible_draw(first) if cause.certain]
    assert cause.subject == "clear"
    assert "test_testing_invisible_draws.py" in cause.text
    wiped = draw(sample_frame)
    device.present(sample_frame.image)
    draw(sample_frame)
    assert certain(wiped) == []


def test_a_condition_is_suspicious(sample_frame) -> None:
    device = sample_frame.device
    query = device.occlusion_query()
    with device.render_pass(sample_frame.image, sample_frame.depth):
        with query:
            device.draw(
                sample_frame.lit, sample_frame.walls, light=sample_frame.light, tint=sample_frame.tint
            )
        with device.conditional(query):
            device.draw(
                sample_frame.lit, sample_frame.walls, light=sample_frame.light, tint=sample_frame.tint
            )
        device.draw(sample_frame.lit, sample_frame.walls, light=sample_frame.light, tint=sample_frame.tint)
    before, inside, after = device.stream.draws()
    assert ["conditional" in possible(stream) for stream in (before, inside, after)] == [False, True, False]


def test_only_draws_can_be_asked_about(sample_frame) -> None:
    with pytest.raises(AssertionError, match="create_program is not a draw"):
        explain_invisible_draw(sample_frame.device.stream.filter(rhi.Op.CREATE_PROGRAM)[0])


def test_certain_causes_come_first_and_read_as_sentences(sample_frame) -> None:
    causes = explain_invisible_draw(draw(sample_frame, rhi.Scissor(0, 0, 0, 0)))
    assert [cause.certain for cause in causes] == sorted((cause.certain for cause in causes), reverse=True)
    assert str(causes[0]) == "certain: the scissor is empty: Scissor(x=0, y=0, width=0, height=0)"
