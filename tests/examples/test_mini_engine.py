"""The small engine: its commands on null, and what its images show on the backends that draw."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nightly_reasons import FEWER_CASES, ONLY_KERNELS
from tested_devices import open_device

import rhi
from rhi import CullMode, Op, Reloader, ShaderError
from rhi.math import Camera, Orthographic, rotation, scaling, translation
from rhi.testing import assert_same, expect, frames
from rhi.testing.portability import check_portability

FILE = Path(__file__).parents[2] / "examples" / "mini_engine.py"
SIZE = (160, 120)
ABOVE = Camera.look_at((0, 20, 0), (0, 0, 0), (0, 0, -1), projection=Orthographic(12, 4 / 3, 1, 50))
"""Ten pixels a metre, with x to the right and z downwards."""


@pytest.fixture
def example(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(FILE.parent))
    import mini_engine

    return mini_engine


@pytest.fixture
def engine(example: Any, null_device: rhi.Device) -> Any:
    return example.Engine(null_device, SIZE, example.make_scene())


def render(engine: Any, camera: Camera = ABOVE) -> None:
    engine.device.present(engine.render(camera))


# -- commands ------------------------------------------------------------------------------------------------


def test_a_frame_is_six_passes_and_one_draw_each(engine: Any) -> None:
    render(engine)
    (frame,) = frames(engine.device)
    expect(frame).commands(Op.BEGIN_PASS).exactly(6)
    for label, draws in (("shadows", 1), ("forward", 1), ("bloom", 3), ("tone map", 1)):
        expect(frame).draws().within(label).exactly(draws)


def test_each_entity_is_an_instance_of_its_mesh_in_both_scene_passes(engine: Any) -> None:
    render(engine)
    for program in ("Caster", "Forward"):
        (command,) = expect(engine.device).draws(program=program).exactly(1)
        assert command.draw_arguments["instances"].tolist() == [26, 25], "a floor, 25 columns and balls"
        assert command.draw_arguments["base_instance"].tolist() == [0, 26]


def test_shadows_are_drawn_before_they_are_read_and_without_culling(engine: Any) -> None:
    render(engine)
    expect(engine.device).draws(program="Caster").with_states(CullMode.NONE).exactly(1)
    expect(engine.device).draws(program="Caster").before(expect(engine.device).draws(program="Forward"))
    expect(engine.device).draws(program="Forward").with_states(CullMode.BACK).exactly(1)


def test_a_frame_without_changes_uploads_no_entity_and_creates_nothing(engine: Any) -> None:
    for _ in range(3):
        render(engine)
    assert_same(*frames(engine.device)[1:])
    expect(frames(engine.device)[2]).costs(max_draws=6, max_creations=0, max_upload_bytes=1024)


def test_a_moved_entity_is_uploaded_once(engine: Any) -> None:
    render(engine)
    before = engine.entities.read()
    engine.scene.move(2, translation((1, 2, 3)) @ rotation((0, 1, 0), 0.5))
    render(engine)
    changed = [a != b for a, b in zip(before, engine.entities.read(), strict=True)]
    assert sum(changed) == 1
    assert engine.entities.read()["model"][changed][0, :3, 3].tolist() == [1, 2, 3]


def test_ids_stay_when_entities_come_and_go(engine: Any) -> None:
    scene = engine.scene
    scene.remove(3)
    added = scene.add("sphere", np.eye(4), (1, 0, 0))
    render(engine)
    ids = sorted(engine.entities.read()["id"].tolist())
    assert added == 52
    assert ids == [*range(1, 3), *range(4, 53)]


def test_an_empty_scene_draws_its_sky(example: Any, null_device: rhi.Device) -> None:
    engine = example.Engine(null_device, SIZE, example.Scene())
    render(engine)
    (frame,) = frames(null_device)
    expect(frame).commands(Op.BEGIN_PASS).exactly(6)


def test_targets_of_an_earlier_size_are_destroyed(engine: Any) -> None:
    before = engine.targets
    render(engine)
    engine.resize((64, 48))
    render(engine)
    assert engine.image.size == (64, 48)
    with pytest.raises(rhi.ValidationError, match="destroyed"):
        before[0].read()


def test_the_engine_runs_where_webgpu_does(example: Any) -> None:
    report = check_portability(lambda device: render(example.Engine(device, SIZE, example.make_scene())))
    assert "webgpu" in report.runs_on


# -- reload --------------------------------------------------------------------------------------------------


def test_a_saved_edit_changes_one_program_and_a_faulty_one_none(example: Any, engine: Any) -> None:
    text = FILE.read_text(encoding="utf-8")
    reloader = Reloader(engine.device)
    try:
        assert reloader.reload(example, text.replace("2.51", "2.25")) == 1
        with pytest.raises(ShaderError) as caught:
            reloader.reload(example, text.replace("sl.saturate(x", "sl.saturate(y"))
        line = next(number for number, line in enumerate(text.splitlines(), 1) if "sl.saturate(x" in line)
        assert caught.value.site is not None
        assert caught.value.site.line == line
        render(engine)
    finally:
        reloader.reload(example, text)


# -- images --------------------------------------------------------------------------------------------------


def make_test_scene(example: Any) -> Any:
    """A white floor with a box, a bright ball far from it, and the sun low in the west."""
    scene = example.Scene(sun=(-1, 1, 0))
    scene.add("cube", translation((0, -0.5, 0)) @ scaling((10, 0.5, 10)), (0.5, 0.5, 0.5))
    scene.add("cube", translation((-2, 1, 0)), (0.2, 0.2, 0.8))
    scene.add("sphere", translation((5, 0.5, -3)) @ scaling((0.3, 0.3, 0.3)), (1, 0.6, 0.2), 20.0)
    return scene


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu"])
def test_a_pixel_knows_its_entity_its_shadow_and_its_bloom(example: Any, backend: str) -> None:
    with open_device(backend, validation=True) as device:
        engine = example.Engine(device, SIZE, make_test_scene(example))
        image = engine.render(ABOVE).read().astype(int)
        assert [engine.pick(x, y) for x, y in ((60, 60), (130, 30), (100, 90))] == [2, 3, 1]
        lit, shadow = image[90, 80, :3], image[60, 82, :3]
        assert shadow.max() < 0.6 * lit.min(), "the box, two metres high, throws its shadow east"
        near, far = image[30, 124, :3], image[90, 140, :3]
        assert near[0] > far[0] + 10, "the ball's light reaches beyond its edge"
        engine.selected = 2
        selected = engine.render(ABOVE).read().astype(int)
        assert selected[60, 60, 0] > image[60, 60, 0] + 20
        assert np.array_equal(selected[90, 80], image[90, 80])


@pytest.mark.nightly_cases("wgpu", reason=FEWER_CASES)
@pytest.mark.parametrize("backend", ["cl", "wgpu"])
def test_the_image_is_the_same_as_on_gl(example: Any, backend: str) -> None:
    images = []
    for name in ("gl", backend):
        with open_device(name) as device:
            images.append(example.render(device, (320, 240)).read().astype(int))
    assert len(np.unique(images[0].reshape(-1, 4), axis=0)) > 1000
    apart = np.abs(images[0] - images[1]).max(axis=-1) > 3
    assert apart.mean() <= 0.001, "edges of shadows"


def test_the_engine_is_shown_on_a_screen_until_it_is_closed(
    example: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rendercanvas", reason="no rendercanvas: pip install rhi[viewer]")
    pytest.importorskip("watchfiles", reason="no watchfiles: pip install rhi[viewer]")
    from rhi_screen import open_screen

    with open_screen("null", canvas="offscreen", size=SIZE) as screen:
        picked: list[tuple[int, int]] = []
        monkeypatch.setattr(example.Engine, "pick", lambda _, x, y: picked.append((x, y)) or 7)
        run = screen.run

        def run_and_click(draw: Any) -> None:
            run(draw)
            screen.send("double_click", x=30.0, y=20.0)
            screen.canvas._process_events()

        monkeypatch.setattr(screen, "run", run_and_click)
        example.run(screen)
        assert len(frames(screen.device)) >= 1
        assert picked == [(30, 20)]
