"""`diff`: what differs is told where it is, and nothing else is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from testing_kit import Light, SampleFrame

import rhi
from rhi import CullMode, Format, Op
from rhi.trace import Differences, Trace, diff
from rhi.trace.align import align


@contextmanager
def streams(*changes: Callable[[SampleFrame], None]) -> Iterator[list[rhi.CommandStream]]:
    """A stream for each change: a house, the change, a frame."""
    result = []
    for change in changes:
        with rhi.create_device("null") as device:
            sample_frame = SampleFrame(device)
            change(sample_frame)
            sample_frame.render()
            result.append(device.stream)
    yield result


def compare(
    change: Callable[[SampleFrame], None], base: Callable[[SampleFrame], None] = lambda sample_frame: None
) -> Differences:
    with streams(base, change) as (a, b):
        return diff(a, b)


def draw_more(sample_frame: SampleFrame) -> None:
    with sample_frame.device.event("extra"), sample_frame.device.render_pass(sample_frame.image):
        sample_frame.device.draw(
            sample_frame.lit, sample_frame.walls, light=sample_frame.light, tint=sample_frame.tint
        )


def test_equal_streams_have_no_differences() -> None:
    differences = compare(lambda sample_frame: None)
    assert not differences
    assert len(differences) == 0
    assert str(differences) == "no differences"


def test_other_ids_are_no_difference() -> None:
    differences = compare(lambda sample_frame: None, lambda sample_frame: None)
    assert not differences
    with rhi.create_device("null") as device:
        more = device.buffer(4, label="more")
        SampleFrame(device).render()
        with streams(lambda sample_frame: None) as (plain,):
            (only,) = diff(plain, device)
    assert only.a is None
    assert only.b is not None
    assert only.b.op is Op.CREATE_BUFFER
    del more


def test_which_of_several_resources_is_used_is_a_difference() -> None:
    with rhi.create_device("null") as a, rhi.create_device("null") as b:
        for device, reverse in ((a, False), (b, True)):
            images = [device.texture((2, 2), Format.R8) for _ in range(2)]
            for image in images[::-1] if reverse else images:
                device.present(image)
        differences = diff(a, b)
    assert differences
    assert Op.PRESENT in {difference.a.op for difference in differences if difference.a is not None}
    assert not diff(a, a)


def test_an_argument_that_differs_is_named_with_both_values() -> None:
    with rhi.create_device("null") as a, rhi.create_device("null") as b:
        for device, count in ((a, 1), (b, 5)):
            sample_frame = SampleFrame(device)
            with device.event("view"), device.render_pass(sample_frame.image):
                device.draw(
                    sample_frame.lit,
                    sample_frame.walls,
                    count,
                    light=sample_frame.light,
                    tint=sample_frame.tint,
                )
        (difference,) = diff(a, b)
    assert difference.labels == ("view",)
    assert difference.changes == ("instances: 1 → 5",)
    assert "test_trace_diff.py:" in str(difference)


def test_memory_that_differs_is_counted() -> None:
    (difference,) = compare(
        lambda sample_frame: sample_frame.light.write(Light(offset=(0, 0, 1, 0))),
        lambda sample_frame: sample_frame.light.write(Light(offset=(0, 0, 0, 0))),
    )
    assert difference.changes == ("data: 2 of 16 bytes differ, the first at 10",)


def test_data_of_different_sizes_are_reported_by_their_sizes() -> None:
    with rhi.create_device("null") as a, rhi.create_device("null") as b:
        for device, size in ((a, 8), (b, 12)):
            device.buffer(16, label="room").write(np.zeros(size, np.uint8))
        (difference,) = diff(a, b)
    assert difference.changes == ("data: 8 bytes → 12 bytes",)


def test_additional_commands_in_a_label_do_not_shift_the_next_label() -> None:
    differences = compare(draw_more)
    assert any(d.b is not None and d.b.op is Op.PUSH_LABEL and d.a is None for d in differences)
    assert not [
        d for d in differences if d.labels == ("sun", "casters") and d.b is not None and d.b.op is Op.DRAW
    ]


def test_a_change_inside_a_label_is_reported_under_its_path() -> None:
    with rhi.create_device("null") as a, rhi.create_device("null") as b:
        for device, mode in ((a, CullMode.NONE), (b, CullMode.FRONT)):
            sample_frame = SampleFrame(device)
            with device.event("outer"):
                for label in ("one", "two"):
                    with device.event(label), device.render_pass(sample_frame.image):
                        with device.states(mode if label == "two" else CullMode.NONE):
                            device.draw(
                                sample_frame.lit,
                                sample_frame.walls,
                                light=sample_frame.light,
                                tint=sample_frame.tint,
                            )
        differences = diff(a, b)
    assert str(differences).splitlines()[0] == "outer / two"
    assert {difference.labels for difference in differences} == {("outer", "two")}


def test_a_failure_is_a_difference() -> None:
    with streams(lambda sample_frame: None, lambda sample_frame: None) as (a, b):
        index = b.draws()[0].index
        b.failures[index] = rhi.commands.stream.Failure("device-lost", "gone")
        (difference,) = diff(a, b)
    assert difference.changes == ("failure: none → device-lost",)


def test_the_same_sources_under_another_name_are_a_difference() -> None:
    with rhi.create_device("null") as a, rhi.create_device("null") as b:
        for device, tail in ((a, ""), (b, "// more")):
            descriptor = rhi.ProgramDescriptor(
                "p",
                frozenset({rhi.Stage.VERTEX}),
                (),
                (),
                (),
                (1, 1, 1),
                lambda *_, tail=tail: rhi.StageText(f"void f(){{}}{tail}"),
            )
            device.program(descriptor)
        assert len(diff(a, b)) >= 1
        assert not diff(a, Trace(a.stream))


@given(
    st.lists(st.integers(0, 4), max_size=30),
    st.lists(st.integers(0, 4), max_size=30),
    st.sampled_from([0, 1000]),
)
def test_an_alignment_pairs_equal_elements_in_rising_order(a: list[int], b: list[int], short: int) -> None:
    """By either way, that of short sequences and that of long ones."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rhi.trace.align._SHORT", short)
        pairs = align(a, b)
    assert all(a[x] == b[y] for x, y in pairs)
    assert all(x < u and y < v for (x, y), (u, v) in pairwise(pairs))
    if a == b:
        assert len(pairs) == len(a)


@given(st.integers(0, 2**32), st.integers(1, 20))
def test_long_sequences_are_aligned_around_inserted_commands(seed: int, count: int) -> None:
    random = np.random.default_rng(seed)
    a = random.integers(0, 2000, 1200).tolist()
    b = list(a)
    for position in sorted(random.integers(0, len(a), count).tolist(), reverse=True):
        b.insert(position, -1)
    assert len(align(a, b)) == len(a)


def test_long_repetitive_sequences_are_aligned_in_no_time() -> None:
    a = [1, 2] * 20_000
    b = [3, *a[:10_000], 4, *a[10_000:]]
    assert len(align(a, b)) >= 20_000
