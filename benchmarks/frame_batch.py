"""Costs of a frame of one batch for the CPU: recorded once and submitted, compared with drawn at once.

The processor time of the main thread in `Renderer.render`, in microseconds, and the median of the ratios. Both variants
render the same frames in turns, on one device; the GPU is idle when a frame begins. `still`: the camera rests.
`walking`: it follows the scene's path, so that the order of the objects and (`frustum`) their number change.

    python benchmarks/frame_batch.py [--backend gl] [--scene city:blocks=8,detail=2] [--rounds 200] [--timers]

With `--timers` it prints the timer trees of frames that aren't waited for, and of others that are.
"""

from __future__ import annotations

import argparse
import os
from contextlib import ExitStack
from itertools import pairwise
from statistics import median
from time import thread_time
from typing import Final

os.environ.setdefault("RHI_KERNELS", "optimised")  # what is measured is the speed of a long run

import rhi
from renderer.content import load_scene
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene
from renderer.visibility import (
    CallbackPass,
    ScenePass,
    VisibilityAlgorithm,
    VisibilityStatistics,
    make_visibility,
)


class AtOnce:
    """Draws what another algorithm draws, but in an open pass, command by command."""

    opens_pass: Final = False

    def __init__(self, algorithm: VisibilityAlgorithm) -> None:
        self._algorithm = algorithm

    def render(self, camera: Camera, scene_pass: ScenePass) -> VisibilityStatistics:
        """Draw the objects."""
        return self._algorithm.render(camera, CallbackPass(scene_pass.draw))

    def destroy(self) -> None:
        """Destroy the algorithm."""
        self._algorithm.destroy()


def measure(backend: str, scene: Scene, name: str, rounds: int, *, walks: bool) -> tuple[float, float, float]:
    """Return the median microseconds of a frame that is drawn at once, of one that is submitted, and of the ratios."""
    path = scene.paths["ground"]
    times: dict[bool, list[float]] = {False: [], True: []}
    with rhi.create_device(backend) as device, ExitStack() as stack:
        algorithm = make_visibility(name, scene, device)
        renderers = {
            submits: stack.enter_context(
                Renderer(device, scene, visibility=algorithm if submits else AtOnce(algorithm), size=(64, 36))
            )
            for submits in times
        }
        for number in range(-5, rounds):
            camera = path.camera(600 + (number + 5) % 900 if walks else 600)
            for submits in (number % 2 == 0, number % 2 == 1):
                if backend == "null":  # it records all commands
                    device.stream.clear()
                began = thread_time()
                renderers[submits].render(camera)
                taken = thread_time() - began
                device.finish()
                if number >= 0:
                    times[submits].append(1e6 * taken)
    ratios = [new / old for old, new in zip(times[False], times[True], strict=True)]
    return median(times[False]), median(times[True]), median(ratios)


def show_timers(backend: str, scene: Scene, *, waits: bool, frames: int = 12) -> None:
    """Print the timer trees of the last frames, and how many began before the GPU had ended the one before."""
    trees: list[list[rhi.TimerNode]] = []
    with rhi.create_device(backend, timing=True) as device:
        visibility = make_visibility("none", scene, device)
        with Renderer(device, scene, visibility=visibility, size=(640, 360)) as renderer:
            for frame in range(frames):
                renderer.render(scene.paths["ground"].camera(600 + frame))
                if waits:
                    device.finish()
                if device.timers and (not trees or device.timers is not trees[-1]):
                    trees.append(device.timers)
            device.finish()
    early = 0
    for (before,), (node,) in pairwise(trees):
        if before.gpu_span is None or node.cpu_span is None:
            print(f"{backend} doesn't date timestamps")
            return
        early += node.cpu_span[0] < before.gpu_span[1]
    print(f"{'waiting for each frame' if waits else 'not waiting'}: {early} of {len(trees) - 1} frames overlap")
    for (root,) in trees[-4:]:
        print(root.format())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--backend", default="gl", help="backend to measure (default: %(default)s)")
    parser.add_argument("--scene", default="city:blocks=8,detail=2", help="scene (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=200, help="frames of each kind (default: %(default)s)")
    parser.add_argument("--timers", action="store_true", help="print timer trees instead")
    arguments = parser.parse_args()
    scene = load_scene(arguments.scene)
    if arguments.timers:
        for waits in (False, True):
            show_timers(arguments.backend, scene, waits=waits)
        return
    for name in ("none", "frustum"):
        for walks in (False, True):
            old, new, ratio = measure(arguments.backend, scene, name, arguments.rounds, walks=walks)
            kind = "walking" if walks else "still"
            print(f"{name:8} {kind:8} at once {old:8.1f} µs  submitted {new:8.1f} µs  ratio {ratio:5.2f}")


if __name__ == "__main__":
    main()
