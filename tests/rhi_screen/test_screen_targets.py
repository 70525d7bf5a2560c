"""Render targets of a screen's size: formats, samples, resizes, and what they leave on the device."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from rhi import Format, Op

pytest.importorskip("rendercanvas", reason="no rendercanvas: pip install rhi[viewer]")

from rhi_screen import Screen, open_screen


@pytest.fixture
def screen() -> Iterator[Screen]:
    with open_screen("null", canvas="offscreen", size=(60, 40)) as opened:
        yield opened


def test_they_have_the_screens_size_after_a_resize_and_are_the_same_textures_before(screen: Screen) -> None:
    targets = screen.targets(depth=Format.D32F)
    first = targets.image
    assert (first.size, targets.image) == ((60, 40), first)
    screen.canvas.set_logical_size(30, 20)
    assert targets.image.size == (30, 20)
    assert targets.depth is not None
    assert targets.depth.size == (30, 20)
    assert first.destroyed


def test_a_pass_clears_color_depth_and_stencil_together_or_nothing(screen: Screen) -> None:
    targets = screen.targets((Format.RGBA16F, Format.RGBA8), Format.D32FS8)
    for clear in ((0, 0, 0, 1), None):
        with targets.render_pass(clear, label="scene"):
            pass
    first, second = (
        command.arguments["descriptor"] for command in screen.device.stream.filter(Op.BEGIN_PASS)
    )
    assert [target.clear for target in first.colors] == [(0, 0, 0, 1)] * 2
    assert (first.depth.clear, first.depth.clear_stencil, first.label) == (0.0, 0, "scene")
    assert [target.clear for target in second.colors] == [None, None]
    assert (second.depth.clear, second.depth.clear_stencil) == (None, None)


@pytest.mark.parametrize("backend", ["gl", pytest.param("cl", marks=pytest.mark.nightly)])
def test_samples_are_resolved_at_the_end_of_a_pass(backend: str) -> None:
    with open_screen(backend, canvas="offscreen", size=(8, 4)) as screen:
        targets = screen.targets(samples=4)
        with targets.render_pass((1.0, 0.5, 0.0, 1.0)):
            pass
        assert targets.image.samples == 1
        assert np.abs(targets.image.read().astype(int) - (255, 128, 0, 255)).max() <= 1


def test_nothing_is_left_of_them_when_a_screen_of_anothers_device_is_closed() -> None:
    with open_screen("null", canvas="offscreen") as first:
        with open_screen(first.device, canvas="offscreen", size=(6, 4)) as screen:
            targets = screen.targets(depth=Format.D32F, samples=4)
            assert targets.image.size == (6, 4)
            for size in ((10, 10), (20, 20), (6, 4)):
                screen.canvas.set_logical_size(*size)
                assert targets.image.size == size
        first.device.finish()
        stream = first.device.stream
        assert len(stream.filter(Op.CREATE_TEXTURE)) == len(stream.filter(Op.DESTROY)) == 4 * 3
