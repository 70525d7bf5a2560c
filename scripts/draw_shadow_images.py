"""Draw the images of docs/shadows.md: `python scripts/draw_shadow_images.py [FOLDER] [--backend gl]`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

import rhi
from renderer.cli.output import write_image
from renderer.content import BUILT_IN, load_scene
from renderer.frame import Frame, FrameEffects, FramePass
from renderer.renderer import Renderer
from renderer.scene import Camera, Perspective, Scene, SceneBuilder, rotation, scaling, translation
from renderer.shaders.structs import SurfaceVarying
from renderer.shadows import ShadowFilter, ShadowSettings
from renderer.shadows.local_light_maps import NEAR
from renderer.techniques import Forward, Technique
from renderer.techniques.parts.scene_shader import ForwardShader
from renderer.techniques.parts.variants import Lighting, lit_pass
from rhi.shading import abs, max, vec3, vec4

Pixels = NDArray[np.uint8]

WIDE: Final = (480, 270)
SMALL: Final = (320, 220)
ATLAS_SIDE: Final = 640
GAP: Final = 4
"""White pixels between two images."""


class CascadeColors(ForwardShader):
    """Tints surfaces by the map in which the shadow of the sun is looked up: red, green, blue, yellow."""

    def fragment(self, v: SurfaceVarying) -> vec4:
        lit = self.light(v, self.materials[v.material])
        number = 0
        for i in range(self.cascade_table.count):
            there = self.cascade_table.maps[i].axes @ v.position - self.cascade_table.maps[i].middle
            is_inside = max(abs(there.x), abs(there.y)) < self.cascade_table.maps[i].inner
            if number == 0 and is_inside and -there.z < self.cascade_table.maps[i].length:
                number = i + 1
        tint = vec3(1.0)
        if number == 1:
            tint = vec3(1.0, 0.3, 0.25)
        if number == 2:
            tint = vec3(0.3, 0.8, 0.25)
        if number == 3:
            tint = vec3(0.35, 0.4, 1.0)
        if number == 4:
            tint = vec3(0.9, 0.8, 0.2)
        return vec4(lit.xyz * tint, lit.w)


class TintedCascades:
    """Forward shading with `CascadeColors`."""

    name: Final = "tinted_cascades"

    def declare(self, effects: FrameEffects) -> Sequence[FramePass[Frame]]:
        """Return the pass `forward`."""
        return (lit_pass(effects, Lighting((CascadeColors,)), "was asked for"),)


def render(
    device: rhi.Device,
    scene: Scene,
    camera: Camera,
    size: tuple[int, int],
    settings: ShadowSettings | None = None,
    technique: Technique | None = None,
) -> tuple[Pixels, NDArray[np.float32]]:
    """Return the image of a frame, and the atlas of its maps, empty without any."""
    kind = technique or Forward()
    with Renderer(device, scene, technique=kind, visibility="none", size=size) as renderer:
        renderer.shadows.settings = settings or ShadowSettings()
        image = renderer.render(camera).image.read()[..., :3]
        has_maps = bool(renderer.shadows.reports)
        return image, renderer.shadows.atlas.read() if has_maps else np.zeros((0, 0), np.float32)


def arrange(*rows: Sequence[Pixels]) -> Pixels:
    """Return rows of images of one size as one image, with gaps."""
    tall, wide = rows[0][0].shape[:2]
    montage = np.full((len(rows) * (tall + GAP) - GAP, len(rows[0]) * (wide + GAP) - GAP, 3), 255, np.uint8)
    for y, row in enumerate(rows):
        for x, image in enumerate(row):
            montage[y * (tall + GAP) :, x * (wide + GAP) :][:tall, :wide] = image
    return montage


def make_still_life() -> tuple[Scene, Camera]:
    """Make a block, a ring and a pole on a floor, in the sun; return a camera, too."""
    builder = SceneBuilder("still life")
    floor = builder.add_material(base_color=(0.8, 0.78, 0.72, 1.0), specular_color=(0, 0, 0))
    clay = builder.add_material(base_color=(0.75, 0.4, 0.2, 1.0), specular_color=(0, 0, 0))
    box, ring = builder.add_mesh(BUILT_IN["box"]()), builder.add_mesh(BUILT_IN["torus"]())
    for mesh, material, where, size in (
        (box, floor, (0.0, -0.5, 0.0), (12.0, 1.0, 12.0)),
        (box, clay, (1.6, 0.6, 0.9), (1.2, 1.2, 1.2)),
        (box, clay, (0.9, 1.5, 0.0), (0.1, 3.0, 0.1)),
        (ring, clay, (-0.6, 0.9, 0.6), (0.9, 0.9, 0.9)),
    ):
        upright = rotation((1, 0, 0), np.pi / 2 if mesh == ring else 0.0)
        builder.add_objects(builder.add_node(translation(where) @ scaling(size) @ upright), mesh, material)
    builder.lights.add_directional((-0.6, -0.9, -0.5), casts_shadow=True)
    perspective = Perspective(fov=0.75, aspect=SMALL[0] / SMALL[1])
    return builder.build(), Camera.look_at((1.9, 2.5, 4.9), (0.4, 0.75, 0.2), projection=perspective)


def atlas_image(depths: NDArray[np.float32]) -> Pixels:
    """Return an atlas as it is shown: near is bright, nothing dark."""
    used = np.argwhere(depths > 0.0).max(0) + 1
    step = -(-int(used.max()) // ATLAS_SIDE)
    sampled = depths[: used[0] : step, : used[1] : step]
    # Local lights have near planes at NEAR of their range: what is half a range away has a depth of 2 NEAR.
    distances = np.minimum(sampled / (30.0 * NEAR), 1.0)
    shades = np.where(sampled < 1000.0 * NEAR, np.sqrt(distances), 0.15 + 0.85 * sampled) * (sampled > 0.0)
    return np.repeat((255.0 * shades + 0.5).astype(np.uint8)[..., None], 3, -1)


def draw_all(device: rhi.Device, folder: Path) -> None:
    """Draw all images."""
    static, eye = make_still_life()
    near = ShadowSettings(cascades=1, cascade_size=256, distance=12.0)

    def filtered(*filters: ShadowFilter) -> list[Pixels]:
        return [
            render(device, static, eye, SMALL, replace(near, filter=shadow_filter))[0]
            for shadow_filter in filters
        ]

    filters = arrange(
        filtered(ShadowFilter.HARD, ShadowFilter.HARDWARE),
        filtered(ShadowFilter.SMOOTH, ShadowFilter.POISSON),
    )
    write_image(folder / "shadow-filters.png", filters)
    biased = [render(device, static, eye, SMALL, replace(near, bias=bias))[0] for bias in (0.0, 1.0)]
    write_image(folder / "shadow-bias.webp", arrange(biased))
    static.lights.directional["angular_diameter"] = 0.15
    fine = replace(near, cascade_size=1024)
    soft = [
        render(device, static, eye, SMALL, replace(fine, filter=shadow_filter))[0]
        for shadow_filter in (ShadowFilter.SMOOTH, ShadowFilter.PCSS)
    ]
    write_image(folder / "shadow-penumbras.webp", arrange(soft))

    city = load_scene("city:blocks=8,shadows=1")
    street = [
        render(device, city, city.views["street"], WIDE, None, decoration)[0]
        for decoration in (None, TintedCascades())
    ]
    write_image(folder / "shadow-cascades.webp", arrange(street))

    nights = [load_scene(f"night:blocks=6,lights=64,shadows={on}") for on in (0, 1)]
    (plain, _), (shadowed, atlas) = (render(device, scene, scene.views["crossing"], WIDE) for scene in nights)
    write_image(folder / "shadow-night.webp", arrange([plain, shadowed]))
    write_image(folder / "shadow-atlas.png", atlas_image(atlas))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Draw the images of docs/shadows.md.")
    parser.add_argument("folder", type=Path, nargs="?", default=Path(__file__).parents[1] / "docs" / "images")
    parser.add_argument("--backend", default="gl")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    with rhi.create_device(options.backend) as device:
        draw_all(device, options.folder)
