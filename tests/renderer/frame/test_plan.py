"""Plans: the order of passes, which of them run, and the textures that they share."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import rhi
from renderer.frame import FramePass, Plan, Target, make_plan
from renderer.lab.exam.plan_cases import count_faults
from rhi import Format

IMAGE, DEPTH = Target("image", Format.RGBA8_SRGB), Target("depth", Format.D32F)
LIT, NORMALS = Target("lit", Format.RGBA16F), Target("normals", Format.RG16)


def nothing(_: object) -> None:
    """Run nothing."""


def step(
    name: str,
    reads: str = "",
    writes: Sequence[Target] = (),
    changes: dict[str, str] | None = None,
    reads_previous: str = "",
    side: bool = False,
) -> FramePass[object]:
    return FramePass(
        name,
        nothing,
        "the test needs it",
        reads=tuple(reads.split()),
        writes=tuple(writes),
        changes=changes or {},
        reads_previous=tuple(reads_previous.split()),
        has_side_effects=side,
    )


def names(plan: Plan[object]) -> list[str]:
    return [frame_pass.name for frame_pass in plan.passes]


GEOMETRY = step("geometry", writes=[DEPTH, NORMALS])
LIGHTS = step("lights", "depth normals", [LIT])
RESOLVE = step("resolve", "lit", [IMAGE])


@pytest.mark.parametrize("passes", list(itertools.permutations([GEOMETRY, LIGHTS, RESOLVE])))
def test_contents_are_written_before_they_are_read(passes: Sequence[FramePass[object]]) -> None:
    assert names(make_plan(passes)) == ["geometry", "lights", "resolve"]


def test_independent_passes_keep_the_order_of_their_declaration() -> None:
    shadow, mask = (step(name, writes=[Target(name, Format.R8)]) for name in ("shadow", "mask"))
    final = step("final", "shadow mask", [IMAGE, DEPTH])
    assert names(make_plan([shadow, mask, final])) == ["shadow", "mask", "final"]
    assert names(make_plan([mask, shadow, final])) == ["mask", "shadow", "final"]


def test_contents_are_read_before_they_are_drawn_over() -> None:
    over = step("over", changes={"lit": "lit and hazy"})
    bloom = step("bloom", "lit", [Target("bloom", Format.R8)])
    final = step("final", "bloom", [IMAGE, DEPTH], {"lit and hazy": "final"})
    first = step("first", writes=[LIT])
    assert names(make_plan([over, final, bloom, first])) == ["first", "bloom", "over", "final"]


def test_a_pass_whose_target_nobody_reads_is_dropped_with_the_passes_that_only_it_reads() -> None:
    blurred = step("blur", "normals", [Target("blurred", Format.R8)])
    edges = step("edges", "blurred", [Target("edges", Format.R8)])
    plan = make_plan([GEOMETRY, LIGHTS, blurred, edges, RESOLVE])
    assert names(plan) == ["geometry", "lights", "resolve"]
    assert [(dropped.name, dropped.reason) for dropped in plan.dropped] == [
        ("blur", "nothing reads blurred"),
        ("edges", "nothing reads edges"),
    ]


def test_a_pass_with_side_effects_runs_and_keeps_its_inputs() -> None:
    blurred = step("blur", "normals", [Target("blurred", Format.R8)])
    count = step("count", "blurred", side=True)
    assert names(make_plan([GEOMETRY, LIGHTS, blurred, count, RESOLVE])) == [
        "geometry",
        "lights",
        "blur",
        "count",
        "resolve",
    ]


def test_an_output_is_the_texture_of_the_last_pass_that_changes_it() -> None:
    haze, smooth = step("haze", changes={"image": "hazy"}), step("smooth", changes={"hazy": "smooth"})
    plan = make_plan([smooth, GEOMETRY, LIGHTS, RESOLVE, haze])
    assert names(plan) == ["geometry", "lights", "resolve", "haze", "smooth"]
    (texture,) = (shared for shared in plan.textures if "image" in shared.names)
    assert texture.names == ("image", "hazy", "smooth")


def test_a_target_that_the_next_frame_reads_is_drawn() -> None:
    history = step("remember", "lit", [Target("history", Format.RGBA16F)])
    without = make_plan([GEOMETRY, LIGHTS, history, RESOLVE])
    resolve = step("resolve", "lit", [IMAGE], reads_previous="history")
    plan = make_plan([GEOMETRY, LIGHTS, history, resolve])
    assert names(without) == ["geometry", "lights", "resolve"]
    assert names(plan) == ["geometry", "lights", "remember", "resolve"]
    (has_history,) = (texture for texture in plan.textures if texture.has_history)
    assert has_history.names == ("history",)
    assert has_history.count_bytes((10, 10)) == 2 * 100 * 8


def refused(*passes: FramePass[object]) -> tuple[str, str]:
    with pytest.raises(rhi.ValidationError) as error:
        make_plan(passes)
    return error.value.rule.id, str(error.value.given)


def test_a_circle_is_refused_by_the_names_of_its_passes() -> None:
    egg = step("egg", "hen", [Target("egg", Format.R8)])
    hen = step("hen", "egg", [Target("hen", Format.R8)])
    final = step("final", "hen", [IMAGE, DEPTH])
    rule, value = refused(egg, hen, final)
    assert rule == "plan-cycle"
    assert value == "'egg' waits for 'hen' waits for 'egg'"
    assert names(make_plan([step("egg", "", [Target("egg", Format.R8)]), hen, final])) == [
        "egg",
        "hen",
        "final",
    ]


def test_a_pass_that_reads_its_own_result_waits_for_itself() -> None:
    assert refused(step("final", "image", [IMAGE, DEPTH]))[0] == "plan-cycle"
    assert names(make_plan([step("final", "", [IMAGE, DEPTH], reads_previous="image")])) == ["final"]


def test_a_circle_of_dropped_passes_is_no_obstacle() -> None:
    egg = step("egg", "hen", [Target("egg", Format.R8)])
    hen = step("hen", "egg", [Target("hen", Format.R8)])
    assert names(make_plan([egg, hen, step("final", "", [IMAGE, DEPTH])])) == ["final"]


def test_contents_have_one_writer() -> None:
    rule, value = refused(step("one", writes=[IMAGE, DEPTH]), step("two", writes=[IMAGE]))
    assert (rule, value) == ("plan-two-writers", "'image', written by 'one' and 'two'")


def test_contents_are_drawn_over_once() -> None:
    first = step("first", writes=[LIT, DEPTH])
    passes = [step(name, changes={"lit": name}) for name in ("haze", "bloom")]
    assert refused(first, *passes)[0] == "plan-drawn-over-twice"
    chain = [step("haze", changes={"lit": "hazy"}), step("bloom", "hazy", [IMAGE])]
    assert names(make_plan([first, *chain])) == ["first", "haze", "bloom"]


@pytest.mark.parametrize("outputs", [("image",), ("image", "depth")])
def test_a_resource_that_is_read_but_never_written_is_refused(outputs: tuple[str, ...]) -> None:
    with pytest.raises(rhi.ValidationError, match="plan-unwritten") as error:
        make_plan([step("final", "shadows", [IMAGE, DEPTH])], outputs)
    assert "'shadows', read by the pass 'final'" in str(error.value.given)
    with pytest.raises(rhi.ValidationError) as error:
        make_plan([step("final", "", [IMAGE])], ("image", "depth"))
    assert "read by the frame's outputs" in str(error.value.given)


def group_names(plan: Plan[object]) -> list[set[str]]:
    return [set(texture.names) for texture in plan.textures]


def test_contents_that_are_not_needed_at_the_same_time_share_a_texture() -> None:
    a, b, c = (Target(name, Format.RGBA16F) for name in "abc")
    chain = [step("a", "", [a]), step("b", "a", [b]), step("c", "b", [c]), step("end", "c", [IMAGE, DEPTH])]
    assert group_names(make_plan(chain)) == [{"a", "c"}, {"b"}, {"image"}, {"depth"}]


@pytest.mark.parametrize(
    "other",
    [Target("c", Format.RGBA8), Target("c", Format.RGBA16F, 0.5), Target("c", Format.RGBA16F, samples=4)],
)
def test_contents_of_another_kind_share_nothing(other: Target) -> None:
    a, b = (Target(name, Format.RGBA16F) for name in "ab")
    chain = [
        step("a", "", [a]),
        step("b", "a", [b]),
        step("c", "b", [other]),
        step("end", "c", [IMAGE, DEPTH]),
    ]
    assert group_names(make_plan(chain)) == [{"a"}, {"b"}, {"c"}, {"image"}, {"depth"}]


def test_contents_that_are_drawn_over_stay_in_their_texture() -> None:
    chain = [
        step("first", writes=[LIT, DEPTH]),
        step("haze", changes={"lit": "hazy"}),
        step("bloom", changes={"hazy": "glowing"}),
        step("end", "glowing", [IMAGE]),
    ]
    assert group_names(make_plan(chain)) == [{"lit", "hazy", "glowing"}, {"depth"}, {"image"}]


@pytest.mark.parametrize(
    ("size", "scale", "expected"),
    [((100, 50), 1.0, (100, 50)), ((101, 51), 0.5, (51, 26)), ((1, 1), 0.4, (1, 1)), ((10, 10), 0.4, (4, 4))],
)
def test_sizes_are_rounded_up(size: tuple[int, int], scale: float, expected: tuple[int, int]) -> None:
    assert Target("light", Format.R8, scale).fit(size) == expected


@st.composite
def declarations(draw: st.DrawFn) -> list[FramePass[object]]:
    """Passes in any order, each of which reads contents of earlier ones, and may draw over some."""
    count = draw(st.integers(1, 9))
    passes: list[FramePass[object]] = []
    intact: list[str] = []
    for number in range(count):
        subset = st.lists(st.sampled_from(intact), unique=True, max_size=3) if intact else st.just([])
        reads = draw(subset)
        over = draw(subset)[:1] if draw(st.booleans()) else []
        kind = draw(st.sampled_from([Format.R8, Format.RGBA16F]))
        new = f"c{number}"
        passes.append(
            step(
                f"p{number}",
                " ".join(reads),
                [] if over else [Target(new, kind)],
                {over[0]: new} if over else {},
                side=draw(st.integers(0, 5)) == 0,
            )
        )
        intact = [name for name in intact if name not in over] + [new]
    passes.append(
        step("last", " ".join(draw(st.lists(st.sampled_from(intact), unique=True))), [IMAGE, DEPTH])
    )
    return draw(st.permutations(passes))


@settings(max_examples=200, deadline=None)
@given(declarations())
def test_contents_are_intact_when_they_are_read(passes: list[FramePass[object]]) -> None:
    plan = make_plan(passes)
    assert count_faults(plan, passes) == 0
    where = {name: number for number, texture in enumerate(plan.textures) for name in texture.names}
    assert len(plan.passes) + len(plan.dropped) == len(passes)
    for target in (target for frame_pass in plan.passes for target in frame_pass.writes):
        texture = plan.textures[where[target.name]]
        assert (texture.format, texture.scale, texture.samples) == (
            target.format,
            target.scale,
            target.samples,
        )
