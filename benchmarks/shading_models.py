"""What Blinn-Phong saves where a material has GGX, and how far its pictures are from those of GGX.

Each scene is drawn twice, with the same geometry, lights and colours: with GGX everywhere, and with highlights of
Blinn-Phong that have the same width and the same peak, `shininess = 2 / roughness⁴ - 2`, on surfaces that scatter and
mirror as much. What the city's materials say in Blinn-Phong is turned into GGX by the same formula; roughness maps of
the others are left out. Each has the shader of its own model, since no material has the other.

- mean, max: the difference of the pictures in levels of 255, the worst channel of each pixel; p99: exceeded by 1 % of
  the pixels.
- clock, processor: the time of Blinn-Phong in that of GGX, drawn in turn in one process; medians of the rounds' ratios.

    python benchmarks/shading_models.py [--json] [--backend gl] [--size 480x270] [--rounds 15]
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))

os.environ.setdefault("RHI_KERNELS", "optimised")  # what is measured is the speed of a long run

import rhi
from renderer.content import load_scene
from renderer.measure.alternate import alternate
from renderer.scene import ShadingModel
from renderer.settings import RenderSettings
from renderer.shaders.metals import SMOOTHEST

SCENES: Final = ("city", "terrain", "bazaar")
_SETTINGS: Final = RenderSettings().change_all({"technique.name": "forward", "algorithm": "frustum"})


@dataclass(frozen=True)
class ModelRow:
    """The figures of a scene, as the module describes them."""

    scene: str
    backend: str
    mean: float
    p99: float
    max: float
    clock: float
    processor: float


def use_metals(materials: NDArray[Any]) -> None:
    """Give all materials the metallic-roughness model, without maps."""
    specular = materials["model"] == ShadingModel.SPECULAR
    materials["roughness"][specular] = (2.0 / (materials["shininess"][specular] + 2.0)) ** 0.25
    materials["metallic"][specular] = 0.0
    for name in ("rim_strength", "emission"):  # the other model has neither
        materials[name] = 0.0
    materials["metallic_roughness_texture"] = -1
    materials["model"] = ShadingModel.METALLIC_ROUGHNESS


def use_highlights(materials: NDArray[Any]) -> None:
    """Give materials without maps, all of the metallic-roughness model, highlights of Blinn-Phong."""
    metallic, base = materials["metallic"][:, None], materials["base_color"][:, :3].copy()
    mirrored = 0.04 + (base - 0.04) * metallic
    materials["specular_color"] = mirrored
    materials["base_color"][:, :3] = base * (1.0 - metallic) * (1.0 - mirrored)
    materials["shininess"] = 2.0 / np.maximum(materials["roughness"], SMOOTHEST) ** 4 - 2.0
    materials["metallic"] = 0.0
    materials["model"] = ShadingModel.SPECULAR


def measure(name: str, backend: str, size: tuple[int, int], rounds: int) -> ModelRow:
    """Return the figures of a scene."""
    with rhi.create_device(backend) as device, ExitStack() as stack:
        renderers = {}
        for model in ("ggx", "blinn_phong"):
            scene = load_scene(name)
            use_metals(scene.materials)
            if model == "blinn_phong":
                use_highlights(scene.materials)
            renderers[model] = stack.enter_context(_SETTINGS.open(device, scene, size))
        cameras = [_SETTINGS.aim(camera) for camera in scene.views.values()]
        cameras += [_SETTINGS.aim(scene.paths["ground"].camera(n)) for n in (300, 900, 1500) if "ground" in scene.paths]

        def draw(model: str, number: int) -> None:
            renderers[model].render(cameras[number % len(cameras)])
            device.finish()

        errors = []
        for camera in cameras:
            ggx, other = (renderers[model].render(camera).image.read()[..., :3].astype(int) for model in renderers)
            errors.append(np.abs(ggx - other).max(axis=2))
        work: dict[str, Callable[[int], object]] = {model: partial(draw, model) for model in renderers}
        times = alternate(work, range(rounds), 2)
    one, base = times["blinn_phong"], times["ggx"]
    ratios = one.ratio_to(base), one.processor_ratio_to(base)
    figures = float(np.mean(errors)), float(np.quantile(errors, 0.99)), float(np.max(errors)), *ratios
    return ModelRow(name, backend, *(round(figure, 3) for figure in figures))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument("--backend", action="append", choices=("cl", "gl"), help="repeatable (default: both)")
    parser.add_argument("--size", default="480x270", help="of the picture (default: %(default)s)")
    parser.add_argument("--rounds", type=int, default=15, help="frames that are timed (default: %(default)s)")
    options = parser.parse_args()
    width, height = (int(side) for side in options.size.split("x"))
    rows = []
    for backend in options.backend or ("gl", "cl"):
        for name in SCENES:
            row = measure(name, backend, (width, height), options.rounds)
            rows.append(row)
            if not options.json:
                print(
                    f"{row.scene:<8} {row.backend}: mean {row.mean:.2f}, p99 {row.p99:.0f}, max {row.max:.0f} levels, "
                    f"clock {row.clock:.2f}, processor {row.processor:.2f}",
                    flush=True,
                )
    if options.json:
        print(json.dumps({"rows": [asdict(row) for row in rows]}, indent=2))


if __name__ == "__main__":
    main()
