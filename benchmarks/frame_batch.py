"""Costs of a frame of one batch for the CPU: recorded once and submitted, compared with drawn at once.

The processor time of the main thread in `Renderer.render`, in microseconds, and the median of the ratios.
Both variants render the same frames in turns, on one device; the GPU is idle when a frame begins. `still`:
the camera rests. `walking`: it follows the scene's path, so that the order of the objects and (`frustum`)
their number change.

    python benchmarks/frame_batch.py [--backend gl] [--scene city:blocks=8,detail=2] [--rounds 200] [--timers]
    [--json]

With `--timers` it shows how many frames begin before the GPU has ended the one before, when none is waited
for and when all are, and prints the last timer trees on stderr.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import pairwise
from time import thread_time
from typing import Final

import rhi
from renderer.cli import options
from renderer.cli.comparison import run_benchmark
from renderer.cli.output import note
from renderer.content import load_scene
from renderer.lab.comparison import Column, Record, Subject, compare, count_ratio, median_of
from renderer.renderer import Renderer
from renderer.scene import Camera, CameraPath, Scene
from renderer.visibility import (
    CallbackDrawer,
    SceneDrawer,
    VisibilityAlgorithm,
    VisibilityStatistics,
    make_visibility,
)

COLUMNS: Final[dict[str, Column]] = {
    "microseconds": median_of(digits=1),
    "ratio": count_ratio("microseconds"),
}
_WARM_UPS: Final = 5


class DirectDraws:
    """Draws what another algorithm draws, but in an open pass, command by command."""

    opens_pass: Final = False

    def __init__(self, algorithm: VisibilityAlgorithm) -> None:
        self._algorithm = algorithm

    def render(self, camera: Camera, scene_drawer: SceneDrawer) -> VisibilityStatistics:
        """Draw the objects."""
        return self._algorithm.render(camera, CallbackDrawer(scene_drawer.draw))

    def destroy(self) -> None:
        """Destroy the algorithm."""
        self._algorithm.destroy()


class FrameVariant:
    """A way to draw frames of a path, of which the first `_WARM_UPS` aren't timed."""

    def __init__(self, renderer: Renderer, path: CameraPath, *, walks: bool) -> None:
        self.renderer, self._path, self._walks, self._frame = renderer, path, walks, 0

    def draw(self, _: int) -> None:
        """Draw the next frame, by the clock of this thread."""
        camera = self._path.camera(600 + self._frame % 900 if self._walks else 600)
        self._frame += 1
        began = thread_time()
        self.renderer.render(camera)
        self._taken = thread_time() - began

    def count(self) -> Record:
        return {"microseconds": 1e6 * self._taken}


def measure_frames(backend: str, scene: Scene, name: str, rounds: int, *, walks: bool) -> Iterator[Record]:
    """Yield the rows of a frame that is drawn at once, and of one that is submitted."""
    with rhi.create_device(backend) as device, ExitStack() as stack:
        algorithm = make_visibility(name, scene, device)
        subjects = []
        for variant, visibility in {"at once": DirectDraws(algorithm), "submitted": algorithm}.items():
            renderer = stack.enter_context(Renderer(device, scene, visibility=visibility, size=(64, 36)))
            way = FrameVariant(renderer, scene.paths["ground"], walks=walks)
            labels = {"visibility": name, "camera": "walking" if walks else "still", "frames are": variant}
            subjects.append(Subject(labels, way.draw, device.finish, way.count, device))
        yield from compare(subjects, COLUMNS, range(rounds), warm_ups=_WARM_UPS)


def count_overlapping_frames(backend: str, scene: Scene, *, waits: bool, frames: int = 12) -> Record:
    """Return the number of frames that began before the GPU had ended the one before; print their last timer
    trees."""
    trees: list[list[rhi.TimerNode]] = []
    with (
        rhi.create_device(backend, timing=True) as device,
        Renderer(device, scene, visibility="none", size=(640, 360)) as renderer,
    ):
        for frame in range(frames):
            renderer.render(scene.paths["ground"].camera(600 + frame))
            if waits:
                device.finish()
            if device.timers and (not trees or device.timers is not trees[-1]):
                trees.append(device.timers)
        device.finish()
    for (root,) in trees[-4:]:
        note(root.format())
    spans = [(before.gpu_span, node.cpu_span) for (before,), (node,) in pairwise(trees)]
    early = [gpu and cpu and cpu[0] < gpu[1] for gpu, cpu in spans]
    dated = None not in early  # timestamps of some devices have no date
    return {
        "frames are waited for": waits,
        "overlap": sum(map(bool, early)) if dated else None,
        "of": len(spans),
    }


def measure(arguments: argparse.Namespace) -> Iterator[Record]:
    """Yield the rows of all algorithms, cameras and ways to draw; or of what timers find."""
    scene = load_scene(arguments.scene)
    if arguments.timers:
        yield from (
            count_overlapping_frames(arguments.backend, scene, waits=waits) for waits in (False, True)
        )
        return
    for name in ("none", "frustum"):
        for walks in (False, True):
            yield from measure_frames(arguments.backend, scene, name, arguments.rounds, walks=walks)


OPTIONS: Final = (
    options.option("--backend", "backend to measure", "gl"),
    options.option("--scene", "scene with a path `ground`", "city:blocks=8,detail=2"),
    options.rounds("frames of each kind", 200),
    options.switch("--timers", "show what timers find instead"),
)


if __name__ == "__main__":
    run_benchmark(__doc__, OPTIONS, measure)
