"""Frames after one that was interrupted: what is made in several steps is made whole or not at all.

Each creation of a resized frame is interrupted once. Then a frame is drawn at the size before, whose
resources may be there still, and at the new size. A resource that was destroyed, and not made again, would be
refused by the first command that names it.
"""

from __future__ import annotations

from typing import Any

import pytest

import rhi
from renderer.renderer import Renderer
from renderer.scene import Scene
from renderer.techniques import TECHNIQUES, DeferredPlus
from rhi.device.core.core import Core

SIZES = [(64, 36), (96, 54), (40, 70)]


class Interruptions:
    """Interrupts the creation whose number `left` counts down to; a negative number interrupts none."""

    left = -1

    def count(self) -> None:
        """Count a creation."""
        self.left -= 1
        if self.left == -1:
            raise KeyboardInterrupt


@pytest.fixture
def interruptions(monkeypatch: pytest.MonkeyPatch) -> Interruptions:
    counter, create = Interruptions(), Core.create

    def count_and_create(core: Core, *arguments: Any) -> None:
        counter.count()
        create(core, *arguments)

    monkeypatch.setattr(Core, "create", count_and_create)
    return counter


def draw_with_interruptions(interruptions: Interruptions, scene: Scene, renderer: Renderer) -> int:
    """Draw frames of changing sizes, of which each is interrupted at a later creation; return how many
    were."""
    camera = scene.views["overview"]
    renderer.render(camera)
    for number in range(200):
        before, size = renderer.size, SIZES[number % len(SIZES)]
        interruptions.left = number
        try:
            renderer.size = size
            renderer.render(camera)
        except KeyboardInterrupt:
            pass
        else:
            return number
        interruptions.left = -1
        for size_or_before in (before, size):
            renderer.size = size_or_before
            assert renderer.render(camera).image.size == size_or_before
    raise AssertionError("creations never end")


@pytest.mark.parametrize("visibility", ["two_pass", "depth_pyramid", "software_depth"])
def test_every_algorithm_draws_the_frame_after_an_interrupted_one(
    null: rhi.Device, city: Scene, interruptions: Interruptions, visibility: str
) -> None:
    with Renderer(null, city, visibility=visibility, size=(48, 48)) as renderer:
        assert draw_with_interruptions(interruptions, city, renderer) > 1


@pytest.mark.parametrize("technique", [*sorted(TECHNIQUES), "deferred_plus, binned"])
def test_every_technique_draws_the_frame_after_an_interrupted_one(
    null: rhi.Device, city: Scene, interruptions: Interruptions, technique: str
) -> None:
    binned = technique.endswith("binned")
    algorithm = DeferredPlus(binned=True) if binned else TECHNIQUES[technique]()
    with Renderer(null, city, technique=algorithm, visibility="frustum", size=(48, 48)) as renderer:
        assert draw_with_interruptions(interruptions, city, renderer) > 1
