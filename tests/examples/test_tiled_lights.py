"""The example renderer: one image on every backend that draws, and the same with culling as without."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nightly_reasons import FEWER_CASES

import rhi
from rhi import CullMode, Op
from rhi.backends.null import NullBackend
from rhi.testing import expect, frames

FOLDER = Path(__file__).parents[2] / "examples"
SIZE = (250, 140)  # not in whole tiles
EYE, TARGET = (15.0, 7.5, 31.0), (-1.0, 0.0, 0.0)
STREET, ALONG = (-3.4, 0.7, 40.0), (-3.4, 0.9, 0.0)


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(FOLDER))
    import tiled_lights

    return tiled_lights


@pytest.fixture(scope="module")
def devices() -> Iterator[dict[str, rhi.Device]]:
    with rhi.create_device("gl") as gl, rhi.create_device("cl") as cl:
        yield {"gl": gl, "cl": cl}


@pytest.mark.nightly_cases("above", reason=FEWER_CASES)
@pytest.mark.parametrize(("eye", "target"), [(EYE, TARGET), (STREET, ALONG)], ids=["above", "street"])
def test_the_same_lines_draw_the_same_image_on_gl_and_cl(
    example: Any,
    devices: dict[str, rhi.Device],
    eye: tuple[float, float, float],
    target: tuple[float, float, float],
) -> None:
    seen, lists, images = [], [], []
    for device in devices.values():
        renderer = example.Renderer(device, SIZE)
        for _ in range(2):
            renderer.render(eye, target)
        seen.append(renderer.visible)
        counts, rows = renderer.counts.read(), renderer.lists.read().reshape(-1, example.LIGHTS)
        lists.append([set(row[:count].tolist()) for row, count in zip(rows, counts, strict=True)])
        images.append(renderer.image.read().astype(int))
    assert 0 < seen[0].sum() < seen[0].size
    assert (seen[0] != seen[1]).sum() <= 2  # where all that shows of a cell are one or two samples
    assert 5 < max(map(len, lists[0])) < example.LIGHTS
    assert sum(a != b for a, b in zip(*lists, strict=True)) <= 0.02 * len(lists[0])  # a light just in reach
    apart = np.abs(images[0] - images[1]).max(axis=-1)
    # A shadow's edge, where the depth of a texel decides, or a sample within 1/256 pixel of a triangle's
    # edge.
    assert (apart > 2).sum() <= 0.001 * apart.size
    assert len(np.unique(images[0].reshape(-1, 4), axis=0)) > 500


@pytest.mark.parametrize("backend", ["gl", "cl"])
def test_culled_houses_change_hardly_a_pixel(
    example: Any, devices: dict[str, rhi.Device], backend: str
) -> None:
    renderer = example.Renderer(devices[backend], SIZE)
    renderer.render(STREET, ALONG)
    assert renderer.visible.all()
    whole = renderer.image.read()
    renderer.render(STREET, ALONG)
    assert renderer.visible.sum() < 0.5 * renderer.visible.size
    apart = (renderer.image.read() != whole).any(axis=-1)
    assert apart.sum() <= 0.001 * apart.size  # samples of a pixel whose centre shows something else
    renderer.visible[:] = False
    renderer.is_queried = False
    renderer.render(STREET, ALONG)
    assert (renderer.image.read() != whole).any(axis=-1).mean() > 0.3


@pytest.fixture
def recorded(null_device: rhi.Device) -> Callable[[Any, list[int]], Any]:
    """`recorded(example, answers)` renders two frames on the null device, whose queries answer so."""

    def render(example: Any, answers: list[int]) -> Any:
        null_device.backend_as(NullBackend).answer_queries(answers)
        renderer = example.Renderer(null_device, SIZE)
        for _ in range(2):
            renderer.render(EYE, TARGET)
        return renderer

    return render


def test_cells_that_were_not_visible_are_not_drawn(
    example: Any, recorded: Any, command_stream: rhi.CommandStream
) -> None:
    recorded(example, [0] * 100 + [7] * 44)
    first, second = frames(command_stream)
    for frame, cells in ((first, 144), (second, 44)):
        for label in ("depth", "view"):
            (draw,) = expect(frame).within(label).commands(Op.DRAW_INDIRECT).exactly(1)
            assert draw["draws"] == cells


def test_shadows_and_lists_are_made_before_they_are_read(
    example: Any, recorded: Any, command_stream: rhi.CommandStream
) -> None:
    renderer = recorded(example, [1] * 144)
    first, _ = frames(command_stream)
    view = expect(first).draws(program="Lit").within("view").with_bindings(shadow=renderer.shadow_map)
    expect(first).draws(program="Shadow").with_states(CullMode.BACK).before(view)
    expect(first).commands(Op.DISPATCH).within("lights").before(view)
    expect(first).costs(max_creations=None, max_hardware_state_changes=12)
