"""Films of scenes: a frame is the same whatever was drawn before it, and whoever draws it."""

from __future__ import annotations

import os
import random
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nightly_reasons import FEWER_CASES, ONLY_KERNELS

import renderer
import rhi
from renderer.content import load_scene
from renderer.frame import Frame
from renderer.scene import Camera, Scene, StereoRig
from renderer.settings import RenderSettings
from renderer.stereo import Stereo
from renderer.techniques import TECHNIQUES, TechniqueSettings
from renderer.viewer.scene_films import FilmLayers, SceneFilm, film, identify, make_repeatable
from renderer.visibility import list_algorithms
from rhi import Device, ValidationError

SIZE = (96, 54)
SCENES = {
    "cloth and fountains": "hall:columns=4,rows=2,flags=4,cloths=2,fountains=2,shadows=1",
    "water": "yard:pools=2,shadows=1",
    "terrain": "terrain:cells=64,trees=100",
    "night": "night:blocks=4,shadows=1,lights=32",
    "glass": "glass:panes=8",
    "fog": "city:blocks=4,detail=2,shadows=1,fog=0.01,bloom=0.1",
}
SMALL = "hall:columns=2,rows=2,flags=2,cloths=1,fountains=1,detail=3"
FRAMES = (20, 21, 22, 50)


def draw(render: SceneFilm, order: Sequence[int]) -> dict[int, np.ndarray]:
    """Draw frames in an order, by a worker of their own."""
    with render as worker:
        return {frame: worker(frame) for frame in order}


def assert_same(frames: dict[int, np.ndarray], others: dict[int, np.ndarray]) -> None:
    for number in frames.keys() & others.keys():
        assert np.array_equal(frames[number], others[number]), number


def make_film(scene: Scene | str, backend: str = "gl", **options: Any) -> SceneFilm:
    opened = load_scene(scene) if isinstance(scene, str) else scene
    path = next(iter(opened.paths.values()))
    return SceneFilm(opened, path, SIZE, backend=backend, **options)


@pytest.mark.nightly_cases("cl-*", "wgpu-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu"])
def test_a_frame_doesnt_depend_on_earlier_frames(backend: str, name: str) -> None:
    layers = FilmLayers(particles=True, overlay=True)
    frames = draw(make_film(SCENES[name], backend, layers=layers), FRAMES)
    assert len({image.tobytes() for image in frames.values()}) == len(FRAMES)
    backwards = draw(make_film(SCENES[name], backend, layers=layers), FRAMES[::-1])
    assert_same(frames, backwards)
    assert_same(frames, draw(make_film(SCENES[name], backend, layers=layers), FRAMES[-1:]))


@pytest.mark.nightly_cases(reason=FEWER_CASES)
@pytest.mark.parametrize("technique", TECHNIQUES)
def test_no_technique_depends_on_earlier_frames(technique: str) -> None:
    settings = RenderSettings(technique=TechniqueSettings(technique))
    for name in ("cloth and fountains", "night"):
        frames = draw(make_film(SCENES[name], settings=settings), FRAMES)
        assert_same(frames, draw(make_film(SCENES[name], settings=settings), FRAMES[::-1]))


@pytest.mark.nightly_cases(reason=FEWER_CASES)
@pytest.mark.parametrize("backend", ["gl", "cl"])
def test_no_visibility_algorithm_depends_on_earlier_frames(backend: str) -> None:
    with rhi.create_device(backend) as device:
        names = [name for name in list_algorithms(device) if name != "auto"]
    for algorithm in names:
        settings = RenderSettings(algorithm=algorithm)
        frames = draw(make_film(SCENES["fog"], backend, settings=settings), FRAMES)
        assert_same(frames, draw(make_film(SCENES["fog"], backend, settings=settings), FRAMES[::-1]))


def test_frames_in_a_random_order_with_repetitions_are_the_same() -> None:
    scene = load_scene(SMALL)
    expected = draw(make_film(scene), range(0, 40, 8))
    for seed in range(3):
        order = random.Random(seed).choices(range(0, 40, 8), k=8)
        with make_film(scene) as worker:  # the same scene, whose nodes are where the last film left them
            for frame in order:
                assert np.array_equal(worker(frame), expected[frame]), (seed, order, frame)


def test_cloth_takes_each_step_whoever_draws_it() -> None:
    """The control: with the policy of its scene, cloth that was away has leapt, and looks different."""

    @dataclass
    class Leaping:
        scene: Scene

        def draw(self, order: Sequence[int], *, takes_all_steps: bool) -> np.ndarray:
            simulator = self.scene.make_simulator()
            simulator.takes_all_steps = takes_all_steps
            for frame in order:
                simulator.begin_frame(frame / 60.0)
                simulator.advance(simulator.objects)
            return np.concatenate(
                [simulator.read_vertices(row)["position"] for row in simulator.deformed.tolist()]  # type: ignore[index]
            )

    leaping = Leaping(load_scene("hall:columns=2,rows=2,flags=0,cloths=1,detail=3"))
    all_frames, once = range(400), [399]
    exact = leaping.draw(all_frames, takes_all_steps=True)
    assert np.array_equal(exact, leaping.draw(once, takes_all_steps=True))
    assert not np.array_equal(exact, leaping.draw(once, takes_all_steps=False))


def test_films_of_processes_have_the_bytes_of_one_process(tmp_path: Path) -> None:
    contents = []
    for executor in ("serial", "processes:2"):
        output = tmp_path / executor[:4] / "%d.png"
        result = film(SMALL, "ground", range(30, 36), output, size=SIZE, backend="gl", executor=executor)
        assert [source.partition(":")[0] for source in result.sources] == ["gl"]
        contents.append([path.read_bytes() for path in sorted(output.parent.iterdir())])
    assert len(contents[0]) == 6
    assert contents[0] == contents[1]


@pytest.mark.parametrize("output", ["side_by_side", "dubois"])
def test_two_eyes_are_drawn_for_the_rig_of_the_paths_first_frame(output: str) -> None:
    scene = load_scene(SMALL)
    images = film(scene, "ground", [30, 31], size=SIZE, backend="gl", stereo=output).images
    alone = film(scene, "ground", [31], size=SIZE, backend="gl", stereo=output).images
    assert np.array_equal(images[1], alone[0])
    one_eye = film(scene, "ground", [31], size=SIZE, backend="gl").images
    assert not np.array_equal(alone[0], one_eye[0])
    wide = Stereo(StereoRig(1.0, 4.0), output)
    assert not np.array_equal(
        film(scene, "ground", [31], size=SIZE, backend="gl", stereo=wide).images[0], alone[0]
    )


class Corner:
    """A layer that paints a corner white."""

    def render(self, device: Device, frame: Frame) -> None:
        frame.targets.image.write(np.full((4, 4, 4), 255, np.uint8))

    def destroy(self) -> None:
        """There is nothing to destroy."""


def make_corner(device: Device) -> list[Any]:
    return [Corner()]


def test_layers_of_an_author_are_drawn_over_each_frame() -> None:
    scene = load_scene(SMALL)
    plain = film(scene, "ground", [5, 6], size=SIZE, backend="gl").images
    for image, other in zip(
        plain, film(scene, "ground", [5, 6], size=SIZE, backend="gl", layers=make_corner).images, strict=True
    ):
        assert (other[:4, :4] == 255).all()
        assert np.array_equal(image[4:], other[4:])


def test_algorithms_that_measure_times_are_replaced_by_fixed_ones() -> None:
    settings = make_repeatable(RenderSettings())
    assert (settings.technique.name, settings.algorithm, settings.animation_lag) == (
        "forward",
        "frustum",
        0.0,
    )
    named = RenderSettings(technique=TechniqueSettings("clustered", samples=4), algorithm="chc_plus_plus")
    assert make_repeatable(named) == named.change("animation_lag", 0.0)


def test_frames_beyond_the_path_are_refused_before_anything_is_drawn(tmp_path: Path) -> None:
    with pytest.raises(ValidationError, match="camera-frame-range"):
        film(SMALL, "ground", [0, 99999], tmp_path / "%d.png", backend="null")
    assert list(tmp_path.iterdir()) == []
    scene = load_scene(SMALL)
    with pytest.raises(ValidationError, match="camera-frame-range"):
        film(scene, next(iter(scene.views.values())), backend="null")


def test_a_camera_that_stays_shows_moving_objects() -> None:
    scene = load_scene(SMALL)
    camera = Camera.look_at(
        (0.0, 2.0, 6.0), (0.0, 2.0, 0.0), projection=next(iter(scene.views.values())).projection
    )
    images = film(scene, camera, [0, 30], size=SIZE, backend="gl").images
    assert not np.array_equal(*images)


def test_the_package_has_the_function() -> None:
    result = renderer.film(SMALL, "ground", range(2), size=(8, 6), backend="null")
    assert [image.shape for image in result.images] == [(6, 8, 4)] * 2


def test_an_identity_differs_with_all_that_frames_depend_on() -> None:
    scene = load_scene(SMALL)
    path, other_path = list(scene.paths.values())[:2]
    view = next(iter(scene.views.values()))
    films = [
        SceneFilm(scene, path, SIZE),
        SceneFilm(load_scene(SMALL + ",seed=1"), path, SIZE),
        SceneFilm(scene, other_path, SIZE),
        SceneFilm(scene, view, SIZE),
        SceneFilm(scene, path, (97, 54)),
        SceneFilm(scene, path, SIZE, backend="cl"),
        SceneFilm(scene, path, SIZE, settings=RenderSettings(technique=TechniqueSettings(samples=4))),
        SceneFilm(scene, path, SIZE, stereo=Stereo(StereoRig(), "dubois")),
        SceneFilm(scene, path, SIZE, stereo=Stereo(StereoRig(0.1), "dubois")),
        SceneFilm(scene, path, SIZE, layers=FilmLayers()),
        SceneFilm(scene, path, SIZE, layers=FilmLayers(overlay=True)),
        SceneFilm(scene, path, SIZE, layers=make_corner),
    ]
    identities = [identify(one_film) for one_film in films]
    assert len(set(identities)) == len(films)
    assert identities[0] == identify(SceneFilm(load_scene(SMALL), path, SIZE))
    assert identify(films[0], "a.glb") != identities[0]


def test_an_error_in_a_frame_leaves_the_worker_usable() -> None:
    scene = load_scene(SMALL)
    with make_film(scene) as worker:
        expected = worker(20)
        with pytest.raises(ValidationError, match="camera-frame-range"):
            worker(99999)
        assert np.array_equal(worker(20), expected)


CITY = """
import os, signal, sys, threading, time
from contextlib import suppress
from pathlib import Path
import dask.config
from distributed import LocalCluster
import renderer
import rhi_screen.executors

if __name__ == "__main__":
    # A busy machine takes minutes to start a worker again. Dask gives it up after 15 seconds.
    dask.config.set({"distributed.deploy.lost-worker-timeout": "900s"})
    rhi_screen.executors.NO_WORKER_SECONDS = 900.0
    folder, frames = Path(sys.argv[1]), range(int(sys.argv[2]))
    options = {"size": (96, 54), "backend": "gl"}
    start = time.perf_counter()
    renderer.film("city", "ground", frames, folder / "serial" / "%d.png", **options)
    serial = time.perf_counter() - start
    cluster = LocalCluster(n_workers=4, threads_per_worker=1, processes=True, dashboard_address=None)
    killed = []

    def kill():
        while len(list((folder / "dask").glob("*.png"))) < 5:
            time.sleep(0.01)
        killed.append(next(iter(cluster.workers.values())).pid)
        os.kill(killed[0], signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    start = time.perf_counter()
    address = f"dask:{cluster.scheduler_address}"
    result = renderer.film("city", "ground", frames, folder / "dask" / "%d.png", executor=address, **options)
    killer.join()
    print(f"serial {serial:.1f} s, cluster {time.perf_counter() - start:.1f} s", file=sys.stderr)
    with suppress(TimeoutError):  # a busy machine doesn't end the workers in Dask's four seconds
        cluster.close(timeout=60)
    print(result.drawn, len(killed), flush=True)
"""


@pytest.mark.nightly
@pytest.mark.usefixtures("gl")
def test_the_city_is_the_same_film_from_four_dask_workers_of_which_one_is_killed(tmp_path: Path) -> None:
    """Runs in a process of its own, so that warnings of dask on a slow machine don't fail the test."""
    pytest.importorskip("distributed", reason="no dask: pip install rhi[dask]")
    frames = 40
    program = tmp_path / "city.py"
    program.write_text(CITY, encoding="utf-8")
    command = [sys.executable, str(program), str(tmp_path), str(frames)]
    environment = os.environ | {"LP_NUM_THREADS": "1"}
    run = subprocess.run(
        command, capture_output=True, text=True, check=False, env=environment, encoding="utf-8"
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.splitlines() == [f"{frames} 1"]
    serial, cluster = (
        {file.name: file.read_bytes() for file in (tmp_path / name).glob("*.png")}
        for name in ("serial", "dask")
    )
    assert len(serial) == frames
    assert len(set(serial.values())) == frames, "the camera moves"
    assert cluster == serial
