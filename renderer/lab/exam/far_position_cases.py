"""Far positions and wide ranges of depth: images depend on positions relative to the eye, not on the world's
origin."""

from __future__ import annotations

from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.content.shapes import box
from renderer.lab.exam.case import CaseResult, Measures
from renderer.lab.exam.scenes import make_boxes
from renderer.renderer import Renderer
from renderer.scene import Camera, Depth, Perspective, Scene, SceneBuilder, StereoRig, scaling, translation
from renderer.stereo import Stereo
from renderer.techniques import TECHNIQUES
from rhi import Device
from rhi.math import multiply

SIZE: Final = (96, 54)
TWO_EYES: Final = "two eyes"
FAR_TECHNIQUES: Final = ("forward", "deferred", TWO_EYES)
"""Techniques that light surfaces while they are drawn and afterwards, and two eyes."""
CLUSTERED_TECHNIQUES: Final = ("forward_plus", "clustered", "tiled_deferred", "clustered_deferred")


def make_pillars(offset: float) -> Scene:
    """Make pillars in the light of a sun and a point light, all at `offset` metres from the world's origin
    along x and z."""
    builder = SceneBuilder("pillars")
    mesh = builder.add_mesh(box())
    rng = np.random.default_rng(5)
    object_positions = rng.integers(-64 * 64, 64 * 64, (40, 3)) / 1024.0 + (offset, 0.0, offset - 8.0)
    nodes = builder.add_nodes(multiply(translation(object_positions), scaling((0.25, 1.0, 0.25))))
    colors = rng.uniform(0.1, 1.0, (40, 4))
    builder.add_objects(nodes, mesh, [builder.add_material(base_color=tuple(color)) for color in colors])
    builder.lights.add_directional((-0.4, -1.0, -0.3), (1.0, 1.0, 1.0), 1.5)
    builder.lights.add_point((offset + 0.5, 1.0, offset - 6.0), 6.0, intensity=4.0)
    return builder.build()


def draw_pillars(
    device: Device, offset: float, technique: str, stereo: Stereo | None = None
) -> list[NDArray[Any]]:
    """The images of all eyes."""
    scene = make_pillars(offset)
    camera = Camera.look_at(
        (offset, 1.0, offset + 2.0), (offset, 0.5, offset - 8.0), projection=Perspective()
    )
    with Renderer(
        device, scene, technique=TECHNIQUES[technique](), size=SIZE, visibility="frustum"
    ) as renderer:
        renderer.stereo = stereo
        return [eye_image.read() for eye_image in renderer.render(camera).eye_images]


def measure_far_scene(offset: float, techniques: tuple[str, ...], device: Device) -> CaseResult:
    """Draw pillars at the origin and far from it with several techniques, maybe `TWO_EYES` among them, and
    count the pixels that differ."""
    wrong, frames = dict[str, int](), dict[str, NDArray[Any]]()
    for name in techniques:
        stereo = Stereo(StereoRig(0.125, 8.0), "color") if name == TWO_EYES else None
        technique = "forward" if stereo else name
        here, there = (draw_pillars(device, where, technique, stereo) for where in (0.0, offset))
        wrong[name] = sum(
            int((near_image != far_image).any(2).sum())
            for near_image, far_image in zip(here, there, strict=True)
        )
        frames |= {f"{name}, at the origin": here[0], f"{name}, far": there[0]}
    off = float(np.float32(offset + 1 / 1024)) - (offset + 1 / 1024)
    seen = len(np.unique(here[0])) > 50
    holds = {"float32 can't hold the places": abs(off) > 5e-4, "there is something to see": seen}
    return CaseResult(sum(wrong.values()), wrong, holds, lambda: frames)


_COLUMNS: Final = 8
_GAP: Final = 1e-5


def draw_layers(device: Device, depth: Depth) -> tuple[NDArray[np.bool_], NDArray[Any]]:
    """Draw eight columns at distances of 0.01 to 100,000 m, each of a red layer and, behind it by a
    hundred-thousandth of the distance, a blue one. Return where blue shows (height, width), and the image."""
    builder = SceneBuilder("columns")
    mesh = builder.add_mesh(box())
    red, blue = (builder.add_material(base_color=color, specular_color=(0, 0, 0)) for color in _COLORS)
    object_positions, sizes, materials = [], [], []
    for column in range(_COLUMNS):
        distance = 10.0 ** (column - 2)
        width = 2.0 / _COLUMNS
        for material, away in ((red, 1.0), (blue, 1.0 + _GAP)):
            thick = 1e-7 * distance
            x = (-1.0 + (column + 0.5) * width) * distance
            object_positions.append((x, 0.0, -distance * away - 0.5 * thick))
            sizes.append((0.6 * width * distance, 1.2 * distance, thick))
            materials.append(material)
    nodes = builder.add_nodes(multiply(translation(object_positions), scaling(sizes)))
    builder.add_objects(nodes, mesh, materials)
    builder.lights.sky = builder.lights.ground = (1.0, 1.0, 1.0)
    scene = builder.build()
    projection = Perspective(np.pi / 2, 1.0, near=1e-3, far=1e7, depth=depth)
    camera = Camera.look_at((0, 0, 0), (0, 0, -1), projection=projection)
    with Renderer(device, scene, visibility="none", size=(64, 64)) as renderer:
        image: NDArray[Any] = renderer.render(camera).image.read()
    return image[..., 2].astype(int) > image[..., 0].astype(int) + 40, image


_COLORS: Final = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))


def measure_depth_layers(device: Device) -> CaseResult:
    """Count the pixels in which a layer shows through the one before it, with reversed and with standard
    depth."""
    wrong, image = draw_layers(device, Depth.REVERSED)
    standard, other = draw_layers(device, Depth.STANDARD)
    red = int((image[..., 0].astype(int) > image[..., 2].astype(int) + 40).sum())
    holds = {"standard depth can't tell them apart": bool(standard.any()), "sheets are seen": red > 1000}
    numbers = {"reversed depth": int(wrong.sum()), "standard depth": int(standard.sum())}
    return CaseResult(
        int(wrong.sum()), dict(numbers), holds, lambda: {"reversed depth": image, "standard depth": other}
    )


def measure_denormals(device: Device) -> CaseResult:
    """Add objects of denormal sizes and positions, and lights of denormal range and intensity, and count the
    pixels that they change. The sun has a denormal direction in float64, and is compared with one of the same
    direction."""
    tiny = 1e-40
    object_positions, sizes = [(0.0, 0.0, -5.0), (1.0, 0.5, -7.0)], [(1.0, 1.0, 1.0), (2.0, 1.0, 1.0)]
    plain = make_boxes(object_positions, sizes)
    more = make_boxes(
        [*object_positions, (tiny, tiny, tiny), (0.3, tiny, -3.0), (0.0, 0.2, -2.0)],
        [*sizes, (1.0, tiny, tiny), (tiny, tiny, tiny), (tiny, 0.0, tiny)],
    )
    more.materials["base_color"][:2] = plain.materials["base_color"]
    more.lights.add_point((0.0, 0.0, -3.0), tiny, intensity=tiny)
    more.lights.add_point((0.0, 0.0, -4.5), tiny, intensity=4.0)  # on a surface
    more.lights.add_point((0.5, 1.0, -3.0), 9.0, intensity=tiny)
    direction = np.array((0.25, -0.5, -0.75))  # the same one after any division by a power of two
    plain.lights.add_directional(direction.tolist())
    more.lights.add_directional((direction * 2.0**-1060).tolist())
    more.lights.directional["color"][:, 0], plain.lights.directional["color"][:, 0] = tiny, 0.0
    camera = Camera.look_at((0, 0, 0.5), (0, 0, -5.0), projection=Perspective())
    images = []
    for scene in (plain, more):
        with Renderer(device, scene, size=SIZE, visibility="none") as renderer:
            images.append(renderer.render(camera).image.read())
    wrong = (images[0] != images[1]).any(2)
    numbers = {"pixels that differ": int(wrong.sum())}
    seen = len(np.unique(images[0].reshape(-1, 4), axis=0)) > 3
    holds = {"there is something to see": seen}
    return CaseResult(int(wrong.sum()), dict(numbers), holds, partial(_pair_frames, images))


def _pair_frames(frames: list[NDArray[Any]]) -> dict[str, NDArray[Any]]:
    return dict(zip(("without", "with denormal numbers"), frames, strict=True))


_FAR: Final = 2.0**23 + 2.0**20  # ten million metres
MEASURES: Final[Measures] = {
    43: partial(measure_far_scene, 2.0**20, FAR_TECHNIQUES),
    44: measure_depth_layers,
    57: partial(measure_far_scene, _FAR, FAR_TECHNIQUES),
    58: measure_denormals,
    68: partial(measure_far_scene, _FAR, CLUSTERED_TECHNIQUES),
}
