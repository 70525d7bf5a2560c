"""Recording and replay: in real time, whatever frames took."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from renderer.scene import Camera, CameraPath
from renderer.viewer.camera_recording import CameraRecorder, CameraReplay


def turn(seconds: float) -> Camera:
    position = np.array((np.sin(0.4 * seconds), 0.3, np.cos(0.4 * seconds)))
    return Camera.look_at(position, (0.0, 0.0, 0.0))


def record(rate: float, seconds: float = 2.0) -> CameraPath:
    recorder = CameraRecorder()
    for number in range(round(rate * seconds) + 1):
        recorder.add(100.0 + number / rate, turn(number / rate))
    return recorder.make_path()


@pytest.mark.parametrize("rate", [20.0, 60.0, 144.0])
def test_a_recording_has_sixty_cameras_a_second(rate: float) -> None:
    path = record(rate)
    assert len(path) == 121
    for frame in (0, 33, 120):
        assert np.allclose(path.camera(frame).position, turn(frame / 60).position, atol=2e-4)
        assert np.allclose(path.camera(frame).rotation, turn(frame / 60).rotation, atol=2e-4)


def test_frames_that_take_unequal_times_are_replayed_in_the_same_time() -> None:
    rng = np.random.default_rng(3)
    recorder = CameraRecorder()
    for seconds in np.cumsum(rng.uniform(0.005, 0.04, 100)):
        recorder.add(float(seconds), turn(float(seconds)))
    path = recorder.make_path()
    assert len(path) == int(recorder.seconds * 60) + 1


def test_one_frame_is_a_recording_and_a_second_at_the_same_time_replaces_it() -> None:
    recorder = CameraRecorder()
    recorder.add(1.0, turn(0.0))
    recorder.add(1.0, turn(1.0))
    assert len(recorder) == 1
    assert recorder.make_path().camera(0).position == pytest.approx(turn(1.0).position)


def test_a_replay_follows_the_time_and_ends_with_the_last_camera(tmp_path: Path) -> None:
    record(60.0).save(tmp_path / "walk.json")
    replay = CameraReplay(CameraPath.load(tmp_path / "walk.json"), "walk")
    assert np.allclose(replay.camera.position, turn(0.0).position)
    replay.seconds = 1.0
    assert np.allclose(replay.camera.position, turn(1.0).position)
    assert not replay.is_over
    replay.seconds = 7.0
    assert replay.is_over
    assert np.allclose(replay.camera.position, turn(2.0).position)
