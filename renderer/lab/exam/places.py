"""Far places and wide ranges of depth: what is drawn depends on the eye, not on the
world."""

from __future__ import annotations

from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.content.shapes import box
from renderer.lab.exam.case import Found, Measures
from renderer.lab.exam.scenes import make_boxes
from renderer.renderer import Renderer
from renderer.scene import Camera, Depth, Perspective, Scene, SceneBuilder, StereoRig, scaling, translation
from renderer.stereo import Stereo
from renderer.techniques import TECHNIQUES
from rhi import Device
from rhi.math import multiply

SIZE: Final = (96, 54)
TWO_EYES: Final = "two eyes"
DRAWN_BY: Final = ("forward", "deferred", TWO_EYES)
"""Techniques that light surfaces while they are drawn and after, and two eyes."""
LIT_BY_CELLS: Final = ("forward_plus", "clustered", "tiled_deferred", "clustered_deferred")


def make_pillars(place: float) -> Scene:
    """Make pillars in the light of a sun and a lamp, all at `place` metres from the world's origin along x and z."""
    builder = SceneBuilder("pillars")
    mesh = builder.add_mesh(box())
    rng = np.random.default_rng(5)
    places = rng.integers(-64 * 64, 64 * 64, (40, 3)) / 1024.0 + (place, 0.0, place - 8.0)
    nodes = builder.add_nodes(multiply(translation(places), scaling((0.25, 1.0, 0.25))))
    colors = rng.uniform(0.1, 1.0, (40, 4))
    builder.add_objects(nodes, mesh, [builder.add_material(base_color=tuple(color)) for color in colors])
    builder.lights.add_directional((-0.4, -1.0, -0.3), (1.0, 1.0, 1.0), 1.5)
    builder.lights.add_point((place + 0.5, 1.0, place - 6.0), 6.0, intensity=4.0)
    return builder.build()


def draw_pillars(device: Device, place: float, technique: str, stereo: Stereo | None = None) -> list[NDArray[Any]]:
    """Return the pictures of all eyes."""
    scene = make_pillars(place)
    camera = Camera.look_at((place, 1.0, place + 2.0), (place, 0.5, place - 8.0), projection=Perspective())
    with Renderer(device, scene, technique=TECHNIQUES[technique](), size=SIZE, visibility="frustum") as renderer:
        renderer.stereo = stereo
        return [picture.read() for picture in renderer.render(camera).pictures]


def move_away(place: float, techniques: tuple[str, ...], device: Device) -> Found:
    """Draw pillars at the origin and far from it with several techniques, `TWO_EYES` among them or not, and count the
    pixels that differ."""
    wrong, frames = dict[str, int](), dict[str, NDArray[Any]]()
    for name in techniques:
        stereo = Stereo(StereoRig(0.125, 8.0), "color") if name == TWO_EYES else None
        technique = "forward" if stereo else name
        here, there = (draw_pillars(device, where, technique, stereo) for where in (0.0, place))
        wrong[name] = sum(int((one != other).any(2).sum()) for one, other in zip(here, there, strict=True))
        frames |= {f"{name}, at the origin": here[0], f"{name}, far": there[0]}
    off = float(np.float32(place + 1 / 1024)) - (place + 1 / 1024)
    seen = len(np.unique(here[0])) > 50
    holds = {"float32 can't hold the places": abs(off) > 5e-4, "there is something to see": seen}
    return Found(sum(wrong.values()), wrong, holds, lambda: frames)


_COLUMNS: Final = 8
_GAP: Final = 1e-5


def draw_layers(device: Device, depth: Depth) -> tuple[NDArray[np.bool_], NDArray[Any]]:
    """Draw eight columns at distances of 0.01 to 100,000 m, each of a red sheet and, behind it by a
    hundred-thousandth of the distance, a blue one. Return where blue shows (height, width), and the image."""
    builder = SceneBuilder("columns")
    mesh = builder.add_mesh(box())
    red, blue = (builder.add_material(base_color=color, specular_color=(0, 0, 0)) for color in _COLORS)
    places, sizes, materials = [], [], []
    for column in range(_COLUMNS):
        distance = 10.0 ** (column - 2)
        width = 2.0 / _COLUMNS
        for material, away in ((red, 1.0), (blue, 1.0 + _GAP)):
            thick = 1e-7 * distance
            x = (-1.0 + (column + 0.5) * width) * distance
            places.append((x, 0.0, -distance * away - 0.5 * thick))
            sizes.append((0.6 * width * distance, 1.2 * distance, thick))
            materials.append(material)
    nodes = builder.add_nodes(multiply(translation(places), scaling(sizes)))
    builder.add_objects(nodes, mesh, materials)
    builder.lights.sky = builder.lights.ground = (1.0, 1.0, 1.0)
    scene = builder.build()
    lens = Perspective(np.pi / 2, 1.0, near=1e-3, far=1e7, depth=depth)
    camera = Camera.look_at((0, 0, 0), (0, 0, -1), projection=lens)
    with Renderer(device, scene, visibility="none", size=(64, 64)) as renderer:
        image: NDArray[Any] = renderer.render(camera).image.read()
    return image[..., 2].astype(int) > image[..., 0].astype(int) + 40, image


_COLORS: Final = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))


def layer_depths(device: Device) -> Found:
    """Count the pixels in which a sheet shows through the one before it, with reversed and with standard depth."""
    wrong, image = draw_layers(device, Depth.REVERSED)
    standard, other = draw_layers(device, Depth.STANDARD)
    red = int((image[..., 0].astype(int) > image[..., 2].astype(int) + 40).sum())
    holds = {"standard depth can't tell them apart": bool(standard.any()), "sheets are seen": red > 1000}
    numbers = {"reversed depth": int(wrong.sum()), "standard depth": int(standard.sum())}
    return Found(int(wrong.sum()), dict(numbers), holds, lambda: {"reversed depth": image, "standard depth": other})


def draw_without_size(device: Device) -> Found:
    """Add objects whose sizes and places are denormal, and lamps of denormal range and intensity, and count the pixels
    that they change; beside a sun whose direction is denormal, in float64, and one that has the same direction."""
    tiny = 1e-40
    places, sizes = [(0.0, 0.0, -5.0), (1.0, 0.5, -7.0)], [(1.0, 1.0, 1.0), (2.0, 1.0, 1.0)]
    plain = make_boxes(places, sizes)
    more = make_boxes(
        [*places, (tiny, tiny, tiny), (0.3, tiny, -3.0), (0.0, 0.2, -2.0)],
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
    shown = []
    for scene in (plain, more):
        with Renderer(device, scene, size=SIZE, visibility="none") as renderer:
            shown.append(renderer.render(camera).image.read())
    wrong = (shown[0] != shown[1]).any(2)
    numbers = {"pixels that differ": int(wrong.sum())}
    seen = len(np.unique(shown[0].reshape(-1, 4), axis=0)) > 3
    holds = {"there is something to see": seen}
    return Found(int(wrong.sum()), dict(numbers), holds, partial(_pair_frames, shown))


def _pair_frames(frames: list[NDArray[Any]]) -> dict[str, NDArray[Any]]:
    return dict(zip(("without", "with denormal numbers"), frames, strict=True))


_FAR: Final = 2.0**23 + 2.0**20  # ten million metres
MEASURES: Final[Measures] = {
    43: partial(move_away, 2.0**20, DRAWN_BY),
    44: layer_depths,
    57: partial(move_away, _FAR, DRAWN_BY),
    58: draw_without_size,
    68: partial(move_away, _FAR, LIT_BY_CELLS),
}
