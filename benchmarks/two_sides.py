"""What materials with two sides cost: frames of a scene with one such material beside frames without.

Objects of materials with two sides are a group of their own, so that their faces alone aren't culled; a pass then has
two draws. One material at a time gets two sides: that of the most objects, the median one, and that of the fewest.
Times are processor time of all threads; the two scenes take turns in one process, and ratios are medians of the
rounds', with their first and last tenth.

    python benchmarks/two_sides.py [--scene bazaar] [--backend gl] [--size 960x540] [--rounds 9]
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

os.environ.setdefault("RHI_KERNELS", "optimised")  # what is measured is the speed of a long run

import rhi
from renderer.content import load_scene
from renderer.renderer import Renderer
from renderer.techniques import Forward
from renderer.visibility import make_visibility


def main() -> None:
    parser = argparse.ArgumentParser(description="What materials with two sides cost.")
    parser.add_argument("--scene", default="bazaar")
    parser.add_argument("--backend", default="gl")
    parser.add_argument("--size", default="960x540")
    parser.add_argument("--rounds", type=int, default=9)
    given = parser.parse_args()
    width, height = map(int, given.size.split("x"))
    uses = np.bincount(load_scene(given.scene).objects.material)
    by_use = np.argsort(uses, kind="stable")[np.sort(uses) > 0]
    with rhi.create_device(given.backend) as device:
        for material in by_use[[-1, len(by_use) // 2, 0]].tolist():
            with ExitStack() as stack:
                drawn = []
                for is_double in (False, True):
                    scene = load_scene(given.scene)
                    scene.materials["double_sided"][material] = is_double
                    visibility = make_visibility("frustum", scene, device)
                    stack.callback(visibility.destroy)
                    made = Renderer(device, scene, size=(width, height), visibility=visibility)
                    renderer = stack.enter_context(made)
                    renderer.technique = Forward()
                    camera = next(iter(scene.views.values())).with_aspect(width / height)
                    drawn.append((renderer, camera))
                ratios = []
                for turn in range(given.rounds + 3):
                    times = []
                    for renderer, camera in drawn:
                        began = time.process_time()
                        renderer.render(camera)
                        device.finish()
                        times.append(time.process_time() - began)
                    if turn >= 3:
                        ratios.append(times[1] / times[0])
            low, middle, high = np.percentile(ratios, [10, 50, 90])
            print(
                f"{given.backend}: two sides for {uses[material]} of {uses.sum()} objects: {middle:.2f} times "
                f"({low:.2f} to {high:.2f})",
                flush=True,
            )


if __name__ == "__main__":
    main()
