"""The techniques, compared with forward shading and with each other, and what `auto` chooses of them.

Scenes: those of the library as they are, such as `hall`, `city` or `night:lights=1024`; `grid:16` to `grid:128`, 64
objects with so many point lights, each object with its own list; and `floor:16` to `floor:512`, one object, whose list
has all of them. `@` and the name of a view or `@path#frame` choose another camera than the path `ground`'s.

All techniques render the same frame in each round, and `auto` does, too, after its trial. Times are those of the
processor, over all threads, and of the clock, from the frame's update until the device is finished; figures are
medians, "x forward" those of the rounds' ratios. "lights" is how often a light is looked at for each pixel with
geometry. The last line of a scene says what `auto` has chosen, and the ratio of that technique's time to the least of
all: `--auto` prints only these, as a table, with the ratio of the time of `auto` to that of the technique.

    python benchmarks/techniques.py [--backend gl] [--rounds 5] [--size 480x270] [--scenes hall,night@crossing,…]
    python benchmarks/techniques.py --auto [--backend cl] [--size 960x540]
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

os.environ.setdefault("RHI_KERNELS", "optimised")  # what is measured is the speed of a long run

import rhi
from renderer.content import BUILT_IN, load_scene, parse_camera
from renderer.lab.measure import Measurement, alternate, format_table, settle
from renderer.lab.measure.light_evaluations import count_light_evaluations
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene, SceneBuilder, scaling
from renderer.techniques import (
    AutoTechnique,
    Clustered,
    ClusteredDeferred,
    Deferred,
    DeferredPlus,
    Forward,
    ForwardMultipass,
    ForwardPlus,
    Inferred,
    LightIndexed,
    LightPrePass,
    Technique,
    TiledDeferred,
)
from renderer.visibility import FrustumCulling
from rhi import Device

SCENES: Final = "hall,city,grid:16,grid:128,floor:16,floor:128,floor:512"
AUTO_SCENES: Final = ",".join(
    (
        "hall@overview", "hall@ground#600", "city@overview", "city@ground#600", "night:lights=64@crossing",
        "night:lights=64@ground#600", "night:lights=1024@crossing", "night:lights=1024@ground#600",
        "night:lights=4096@crossing", "night:lights=4096@overview", "grid@overview", "grid:count=256,lights=128@field",
    )
)  # fmt: skip
TECHNIQUES: Final[dict[str, Technique]] = {
    "forward": Forward(),
    "deferred": Deferred(),
    "deferred, stencil": Deferred(stencil=True),
    "light_pre_pass": LightPrePass(),
    "light_pre_pass, 1 channel": LightPrePass(specular_channels=1),
    "inferred": Inferred(),
    "forward_multipass": ForwardMultipass(),
    "light_indexed": LightIndexed(),
    "forward_plus": ForwardPlus(),
    "clustered": Clustered(),
    "tiled_deferred": TiledDeferred(),
    "clustered_deferred": ClusteredDeferred(),
    "deferred_plus": DeferredPlus(),
}
RIVALS: Final = (
    "forward", "deferred", "forward_plus", "clustered", "tiled_deferred", "clustered_deferred", "deferred_plus",
)  # fmt: skip
"""The techniques that `auto` is compared with: each other one draws more than one of these for the same light."""
_WARM_UPS: Final = 3


@dataclass(frozen=True)
class Result:
    """What was measured of one scene: times by the names of techniques and "auto"."""

    times: dict[str, Measurement]
    chosen: str

    def find_fastest(self) -> str:
        """Return the name of the technique that takes the least time by the clock."""
        return min((name for name in self.times if name != "auto"), key=lambda name: self.times[name].median)

    def find_ratios(self) -> tuple[float, float, float]:
        """Return the ratios of the time of the chosen technique to the least of all, by the clock and by the processor,
        and that of `auto` to the technique that it has chosen, by the processor."""
        times = {name: one for name, one in self.times.items() if name != "auto"}
        chosen = times[self.chosen]
        return (
            max(chosen.compare_to(one).median for one in times.values()),
            max(chosen.compare_to(one, processor=True).median for one in times.values()),
            self.times["auto"].compare_to(chosen, processor=True).median,
        )


def load(text: str) -> tuple[Scene, Camera]:
    """Return a scene and a camera in it."""
    spec, _, view = text.partition("@")
    name, _, lights = spec.partition(":")
    random = np.random.default_rng(1)
    if name == "floor":
        builder = SceneBuilder("floor")
        node = builder.add_node(scaling((60, 1, 60)))
        builder.add_objects(node, builder.add_mesh(BUILT_IN["box"]()), builder.add_material())
        scene, camera, half = builder.build(), Camera.look_at((0, 14, 26), (0, 0, 0)), 25.0
    else:
        is_own = name == "grid" and lights.isdigit()
        scene, half = load_scene("grid:count=64" if is_own else spec), 6.0
        camera = scene.paths["ground"].camera(100 if is_own else 300)
        if view:
            path, _, frame = view.partition("#")
            camera = parse_camera(path, scene, int(frame or 0))
    for _ in range(int(lights) if lights.isdigit() else 0):
        x, z = random.uniform(-half, half, 2)
        scene.lights.add_point((x, 1.0, z), 2.5, random.uniform(0.2, 1.0, 3), 1.5)
    return scene, camera


def split_scenes(text: str) -> list[str]:
    """Split names of scenes at commas, but not at those between options: `grid:count=4,lights=8,hall`."""
    scenes: list[str] = []
    for part in text.split(","):
        if "=" in part.partition("@")[0] and ":" not in part and scenes:
            scenes[-1] += f",{part}"
        else:
            scenes.append(part)
    return scenes


def measure(
    device: Device, text: str, size: tuple[int, int], rounds: int, techniques: dict[str, Technique], *, shows: bool
) -> Result:
    """Measure one scene, and print its rows if it `shows` them."""
    scene, camera = load(text)
    with Renderer(device, scene, visibility=FrustumCulling(scene), size=size) as renderer:
        auto = AutoTechnique(scene, device)
        renderer.technique = auto
        settle(renderer, camera)

        def draw(_: int) -> None:
            renderer.render(camera)
            device.finish()

        def exchange(name: str) -> None:
            renderer.technique = techniques.get(name, auto)
            draw(0)

        work = dict.fromkeys([*techniques, "auto"], draw)
        times = alternate(work, range(rounds), _WARM_UPS, before=exchange)
        result = Result(times, auto.chosen)
        if not shows:
            return result
        needs, _ = renderer.plan(camera)
        print(f"{text}: {needs.lamps_in_view} point and spot lights in view")
        pixels = max(int(np.count_nonzero(renderer.render(camera).depth.read())), 1)
        for name, technique in techniques.items():
            renderer.technique = technique
            _, plan = renderer.plan(camera)
            lights = count_light_evaluations(renderer, camera)
            print(
                f"  {name:26}{1e3 * times[name].processor_median:8.2f} ms{1e3 * times[name].median:8.2f} by the clock"
                f"{times[name].compare_to(times['forward'], processor=True).median:8.2f} x forward"
                f"{plan.count_bytes(size) / (size[0] * size[1]):6.0f} bytes a pixel"
                f"{'' if lights is None else f'{lights / pixels:8.2f} lights'}",
                flush=True,
            )
        by_clock, by_processor, _ = result.find_ratios()
        print(
            f"  auto: {auto.chosen}, {by_clock:.2f} x the fastest by the clock ({result.find_fastest()}), "
            f"{by_processor:.2f} x by the processor"
        )
    return result


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--backend", default="gl")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--size", default="480x270")
    parser.add_argument("--scenes")
    parser.add_argument("--auto", action="store_true")
    given = parser.parse_args()
    width, height = map(int, given.size.split("x"))
    techniques = {name: TECHNIQUES[name] for name in RIVALS} if given.auto else TECHNIQUES
    rows: list[list[object]] = []
    with rhi.create_device(given.backend) as device:
        if "llvmpipe" in device.capabilities.device and given.auto:
            techniques = {name: one for name, one in techniques.items() if name != "tiled_deferred"}
        for text in split_scenes(given.scenes or (AUTO_SCENES if given.auto else SCENES)):
            result = measure(device, text, (width, height), given.rounds, techniques, shows=not given.auto)
            rows.append([text, result.chosen, result.find_fastest(), *result.find_ratios()])
    if given.auto:
        header = ["scene@view", "auto", "fastest", "auto x fastest", "by the processor", "auto x its technique"]
        print(format_table(header, rows, markdown=True))


if __name__ == "__main__":
    main()
