"""Cameras of screens, fixed steps, statistics, screenshots and videos, on a canvas that needs no display."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import rhi
from rhi import Format, ValidationError

pytest.importorskip("rendercanvas", reason="no rendercanvas: pip install rhi[viewer]")

from rhi.math import Perspective, look_at
from rhi_screen import FixedSteps, FlyCamera, FrameCounter, OrbitCamera, Screen, VideoWriter, open_screen


@pytest.fixture
def screen() -> Iterator[Screen]:
    with open_screen("null", canvas="offscreen", size=(60, 40)) as opened:
        yield opened


def test_an_orbit_begins_at_its_arguments_with_the_aspect_ratio_of_the_screen(screen: Screen) -> None:
    camera = OrbitCamera(
        screen, (1.0, 2.0, 3.0), 7.0, yaw=0.4, pitch=-0.3, projection=Perspective(fov=0.8)
    ).update()
    assert np.allclose(camera.view, rhi.math.orbit((1.0, 2.0, 3.0), 7.0, 0.4, -0.3))
    assert np.allclose(camera.projection.matrix, rhi.math.perspective(0.8, 60 / 40))


def test_a_drag_turns_an_orbit_by_half_a_turn_for_the_height_of_the_screen(screen: Screen) -> None:
    orbit = OrbitCamera(screen, distance=2.0, yaw=0.0, pitch=0.0)
    screen.send("pointer_down", x=30.0, y=20.0, button=1, buttons=(1,))
    screen.send("pointer_move", x=10.0, y=20.0, buttons=(1,))
    turned = orbit.update()
    assert np.allclose(turned.position, 2.0 * np.array([np.sin(np.pi / 2), 0.0, np.cos(np.pi / 2)]))
    orbit.is_enabled = False
    screen.send("pointer_move", x=50.0, y=20.0, buttons=(1,))
    assert np.array_equal(orbit.update().position, turned.position)


def test_a_key_flies_ahead_as_long_as_it_is_held(screen: Screen) -> None:
    fly = FlyCamera(screen, (0.0, 1.0, 4.0), (0.0, 1.0, 0.0), speed=2.0)
    assert np.allclose(fly.update().view, look_at((0.0, 1.0, 4.0), (0.0, 1.0, 0.0)))
    screen.send("key_down", key="w")
    for _ in range(60):
        camera = fly.update(1 / 30)
    assert camera.position[2] == pytest.approx(4.0 - 2.0 * (2.0 - 1 / 12), abs=1e-3), (
        "two seconds, the first begins slowly"
    )
    screen.send("key_up", key="w")
    for _ in range(60):
        rest = fly.update(1 / 30)
    assert np.array_equal(fly.update(1.0).position, rest.position)


def test_without_a_time_a_clock_says_it_and_a_long_frame_moves_a_quarter_of_a_second(
    screen: Screen, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [10.0]
    monkeypatch.setattr("rhi_screen.cameras.perf_counter", lambda: now[0])
    ways = []
    for gap in (0.1, 0.25, 1000.0):
        fly = FlyCamera(screen, (0.0, 0.0, 4.0), speed=2.0)
        screen.send("key_down", key="w")
        now[0] += gap
        ways.append(4.0 - fly.update().position[2])
        fly.close()
    assert 0.0 < ways[0] < ways[1] == ways[2]


def test_an_event_that_was_stopped_moves_no_camera_and_a_closed_one_listens_no_more(screen: Screen) -> None:
    orbit = OrbitCamera(screen, distance=2.0)
    begin = orbit.camera.position

    def stop(event: dict[str, Any]) -> None:
        event["stop_propagation"] = True

    screen.canvas.add_event_handler(stop, "wheel", order=-1)
    screen.send("wheel", dx=0.0, dy=-100.0)
    assert np.array_equal(orbit.camera.position, begin)
    screen.canvas.remove_event_handler(stop, "wheel")
    screen.send("wheel", dx=0.0, dy=-100.0)
    nearer = orbit.camera.position
    assert np.linalg.norm(nearer) < np.linalg.norm(begin)
    orbit.close()
    screen.send("wheel", dx=0.0, dy=-100.0)
    assert np.array_equal(orbit.camera.position, nearer)


@pytest.mark.parametrize("frames", [1, 7, 10, 100])
def test_a_second_has_as_many_steps_in_any_number_of_frames(frames: int) -> None:
    steps = FixedSteps(60, max_steps=60)
    assert sum(len(steps.advance(1 / frames)) for _ in range(frames)) == 60
    assert steps.part == pytest.approx(0.0, abs=1e-6)


def test_part_is_the_elapsed_fraction_of_a_step_and_a_slow_frame_drops_time() -> None:
    steps = FixedSteps(10, max_steps=3)
    assert (list(steps.advance(0.25)), steps.part) == ([0, 1], pytest.approx(0.5))
    assert list(steps.advance(10.0)) == [0, 1, 2]
    assert len(steps.advance(0.1)) == 1, "the rest of ten seconds isn't made up for"


def test_steps_follow_a_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    now, steps = [5.0], FixedSteps(10)
    monkeypatch.setattr("rhi_screen.time_steps.perf_counter", lambda: now[0])
    counts = []
    for gap in (0.0, 0.2, 0.05, 0.05):
        now[0] += gap
        counts.append(len(steps.advance()))
    assert counts == [0, 2, 0, 1]


def test_statistics_are_of_the_last_second() -> None:
    counter = FrameCounter()
    for number in range(200):
        counter.add(number / 50, number / 100)
    assert counter.rate == pytest.approx(50.0)
    assert counter.processor == pytest.approx(0.01)
    assert counter.frames == 200


def test_a_shown_frame_is_counted(screen: Screen) -> None:
    targets = screen.targets()
    screen.canvas.request_draw(lambda: screen.show(targets.image))
    screen.canvas.draw()
    assert screen.counter.frames == 1


def test_a_screenshot_is_the_next_image_that_is_shown(tmp_path: Path) -> None:
    texels = np.random.default_rng(3).integers(0, 256, (4, 6, 4), np.uint8)
    with open_screen("gl", canvas="offscreen", size=(6, 4)) as screen:
        image = screen.device.texture(texels)
        screen.canvas.request_draw(lambda: screen.show(image))
        screen.screenshot(tmp_path / "one.png")
        screen.canvas.draw()
        image.write(255 - texels)
        screen.canvas.draw()
    assert np.array_equal(rhi.load_image(tmp_path / "one.png"), texels)


def test_only_a_window_fills_its_display(screen: Screen) -> None:
    assert not screen.is_full_screen
    with pytest.raises(ValidationError, match="screen-window"):
        screen.is_full_screen = True


def test_a_recorded_video_has_the_frames_that_were_shown(tmp_path: Path) -> None:
    av = pytest.importorskip("av", reason="no PyAV: pip install rhi[video]")
    colors = [(200, 40, 40), (40, 200, 40), (40, 40, 200)]
    with open_screen("gl", canvas="offscreen", size=(65, 48)) as screen:
        video = screen.record(tmp_path / "videos" / "three.mp4", 25)
        for color in colors:
            image = screen.device.texture(np.full((48, 65, 4), (*color, 255), np.uint8))
            screen.canvas.request_draw(lambda image=image: screen.show(image))
            screen.canvas.draw()
        video.close()
        screen.canvas.draw()
        assert video.frames == 3
        with pytest.raises(ValidationError, match="video-size"), VideoWriter(tmp_path / "two.mp4") as two:
            two.add(image)
            two.add(screen.device.texture((32, 48), Format.RGBA8))
    with av.open(str(video.path)) as file:
        assert float(file.streams.video[0].average_rate) == 25
        frames = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
    assert [frame.shape for frame in frames] == [(48, 64, 3)] * 3
    assert np.abs(np.array([frame[24, 32] for frame in frames]).astype(int) - colors).max() < 12, (
        "H.264, 4:2:0"
    )


@pytest.mark.parametrize("count", [1, 10])
@pytest.mark.parametrize("mode", ["ondemand", "continuous", "fastest"])
def test_offscreen_a_recorded_run_writes_all_frames_until_the_canvas_is_closed(
    tmp_path: Path, mode: str, count: int
) -> None:
    with open_screen("gl", canvas="offscreen", size=(16, 16), update_mode=mode) as screen:
        image = screen.device.texture(np.zeros((16, 16, 4), np.uint8), rhi.Format.RGBA8)
        video = screen.record(tmp_path / "film.mp4", 25)

        def draw() -> None:
            screen.show(image)
            if video.frames == count:
                screen.canvas.close()
            if mode == "ondemand":
                screen.canvas.request_draw()

        screen.run(draw)
        assert video.frames == count


def test_offscreen_a_recorded_run_ends_when_no_frame_is_requested(tmp_path: Path) -> None:
    with open_screen("gl", canvas="offscreen", size=(16, 16)) as screen:
        image = screen.device.texture(np.zeros((16, 16, 4), np.uint8), rhi.Format.RGBA8)
        video = screen.record(tmp_path / "four.mp4", 25)

        def draw() -> None:
            screen.show(image)
            if video.frames % 4:
                screen.canvas.request_draw()

        screen.run(draw)
        assert video.frames == 4
        video.close()
        screen.run(draw)  # nothing is recorded: one frame
        assert screen.counter.frames == 5


def test_offscreen_a_run_draws_as_many_frames_as_it_is_asked_for(tmp_path: Path) -> None:
    with open_screen("gl", canvas="offscreen", size=(16, 16)) as screen:
        image = screen.device.texture(np.zeros((16, 16, 4), np.uint8), rhi.Format.RGBA8)
        screen.run(lambda: screen.show(image), frames=3)
        assert screen.counter.frames == 3
        with screen.record(tmp_path / "five.mp4", 25) as video:
            screen.run(lambda: screen.show(image), frames=5)
        assert video.frames == 5
        with pytest.raises(ValidationError, match="frames"):
            screen.run(lambda: screen.show(image), frames=0)
        with pytest.raises(ZeroDivisionError):
            screen.run(lambda: 1 / 0, frames=2)  # type: ignore[arg-type, return-value]
        assert "request_draw" not in vars(screen.canvas)
