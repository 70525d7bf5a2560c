"""Late query results: available after a number of looks at them, or only when waited for."""

from __future__ import annotations

import numpy as np
import pytest
from occlusion_scenes import OCCLUSION, Oracle, delay_answers, draw_with, make_boxes, visible

import rhi
from renderer.renderer import Renderer
from renderer.scene import Camera, Perspective
from renderer.visibility import make_visibility

NEVER = 10**9


@pytest.fixture(params=[0, 1, 20, NEVER])
def latency(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """The number of looks at a query (`is_finished`) before its result is available; waiting always works."""
    looks: int = request.param
    delay_answers(monkeypatch, looks)
    return looks


@pytest.mark.parametrize("name", OCCLUSION)
def test_late_answers_lose_nothing(null: rhi.Device, latency: int, name: str) -> None:
    rng = np.random.default_rng(5)
    scene = make_boxes(rng.uniform(-6.0, 6.0, (40, 3)), rng.uniform(0.1, 0.8, (40, 3)))
    camera = Camera.look_at((0.0, 0.0, 30.0), (0.0, 0.0, 0.0), projection=Perspective(near=0.1))
    oracle = Oracle(null, scene, name)
    algorithm = make_visibility(name, scene, null)
    with Renderer(null, scene, size=(64, 36)) as renderer:
        for seen in (range(40), range(10), range(30, 40), (), (7,), *[(7, 8)] * 60):
            oracle.seen = set(seen)
            drawn = visible(draw_with(renderer, algorithm, camera))
            assert drawn >= oracle.seen
    if name in ("stop_and_wait", "chc") or (name == "chc_plus_plus" and latency < 20):
        # CHC++ looks once a frame at answers that it doesn't wait for, and conditional culling never waits.
        assert drawn == {7, 8}
