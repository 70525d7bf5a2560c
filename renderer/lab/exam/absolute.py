"""Pictures as they must be: frames of a device beside those that the judge finds by rays in float64.

Frames are compared pixel by pixel where the judge's picture is smooth. What it sees at the middle of a pixel and an
eighth of a pixel beside it, to the four corners, bounds what a device may show there; where these five are far apart,
there is an edge, on whose side a pixel is depends on rounding, and it is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.content import BUILT_IN
from renderer.lab.exam.case import Found, Measures, Picture, find_largest
from renderer.lab.exam.scenes import look, show_something
from renderer.lab.measure.judge import Judge
from renderer.lab.measure.judge.picture import unmap_tones
from renderer.lab.measure.judge.surfaces import decode_srgb
from renderer.scene import AlphaMode, Camera, Fog, Glow, Orthographic, Scene, SceneBuilder, TextureMap
from renderer.scene.arrays import Floats
from renderer.settings import RenderSettings
from rhi import Device, SamplerDescriptor
from rhi.math import multiply, rotation, scaling, translation

SIZE: Final = (64, 36)
WIDE: Final = (128, 72)
_BESIDE: Final = 0.125  # of a pixel
_EDGE: Final = 6.0
"""Levels by which the five places of a pixel differ at an edge."""


@dataclass(frozen=True, eq=False, slots=True)
class Judged:
    """A picture of the judge: `levels` (h, w, 3), not rounded, and their bounds `low` and `high` around each pixel."""

    levels: Floats
    low: Floats
    high: Floats

    @property
    def is_smooth(self) -> NDArray[np.bool_]:
        """Whether each pixel (h, w) shows no edge."""
        return np.asarray((self.high - self.low).max(axis=2) < _EDGE)


def judge(scene: Scene, camera: Camera, size: tuple[int, int] = SIZE) -> Judged:
    """Return what the judge sees of a scene, without its glow."""
    glow, scene.glow = scene.glow, None
    seen, camera = Judge(scene), camera.with_aspect(size[0] / size[1])
    places = [(0.5, 0.5), *((0.5 + x, 0.5 + y) for x in (-_BESIDE, _BESIDE) for y in (-_BESIDE, _BESIDE))]
    levels = [seen.draw(camera, size, at=place) for place in places]
    scene.glow = glow
    return Judged(levels[0], np.minimum.reduce(levels), np.maximum.reduce(levels))


Sights = dict[str, tuple[Scene, Camera, str]]
"""Scenes to look at, by title, each with a camera and the technique that draws it."""


@cache  # the same for each device
def judge_all(make: Callable[[], Sights]) -> dict[str, tuple[Scene, Camera, str, Judged]]:
    """Return scenes with the judge's pictures."""
    return {title: (*some, judge(some[0], some[1])) for title, some in make().items()}


def draw(
    device: Device, scene: Scene, camera: Camera, size: tuple[int, int] = SIZE, technique: str = "forward",
    changes: Mapping[str, Any] | None = None,
) -> NDArray[Any]:  # fmt: skip
    """Return a frame without culling, with changes of settings by their paths."""
    settings = RenderSettings().change_all({"technique.name": technique, "algorithm": "none", **(changes or {})})
    with settings.open(device, scene, size) as renderer:
        return renderer.render(settings.aim(camera)).image.read()


def compare(make: Callable[[], Sights], device: Device) -> Found:
    """Draw scenes, and find by how many levels pixels are out of their bounds."""
    numbers, holds, pictures = dict[str, object](), dict[str, bool](), dict[str, Picture]()
    error = 0.0
    for title, (scene, camera, technique, judged) in judge_all(make).items():
        image = draw(device, scene, camera, technique=technique)
        shown = image[..., :3].astype(np.float64)
        off = np.maximum(judged.low - shown, shown - judged.high).max(axis=2)
        off = np.where(judged.is_smooth, np.maximum(off, 0.0), 0.0)
        numbers[f"{title}: levels off"] = round(float(off.max()), 3)
        numbers[f"{title}: pixels compared"] = int(judged.is_smooth.sum())
        error = find_largest(error, float(off.max()))
        holds |= {f"{title}: {one}": is_true for one, is_true in show_something([image]).items()}
        holds[f"{title}: most pixels are compared"] = bool(judged.is_smooth.mean() > 0.5)
        pictures |= {title: image, f"{title}, judged": _show(judged.levels), f"{title}, off": off}
    return Found(error, numbers, holds, lambda: pictures)


def _show(levels: Floats) -> Picture:
    picture = np.full((*levels.shape[:2], 4), 255, np.uint8)
    picture[..., :3] = np.round(levels)
    return picture


def _place(builder: SceneBuilder, shape: str, place: Any, size: Any, **material: Any) -> None:
    """Add an object of a built-in shape."""
    node = builder.add_node(multiply(translation(place), scaling(size)))
    builder.add_objects(node, builder.add_mesh(_SHAPES[shape]), builder.add_material(**material))


_SHAPES: Final = {name: make() for name, make in BUILT_IN.items()}
_FLOOR: Final = ("box", (0.0, -0.25, 0.0), (12.0, 0.5, 12.0))
_CHECKS: Final = np.random.default_rng(2).integers(0, 256, (4, 4, 4)).astype(np.uint8)
_CHECKS[..., 3] = np.where(np.arange(16).reshape(4, 4) % 3 == 0, 0, 255)
_BUMPS: Final = np.full((4, 4, 4), 255, np.uint8)
_BUMPS[..., :3] = np.random.default_rng(3).integers(70, 190, (4, 4, 3))
_BUMPS[..., 2] = 220


def make_lit() -> Sights:
    """Make surfaces of all kinds in the light of a sun, lamps and the sky; seen through several lenses, and lit while
    they are drawn and after."""
    builder = SceneBuilder("lit")
    builder.background = (0.2, 0.3, 0.5)
    builder.lights.sky, builder.lights.ground = (0.25, 0.3, 0.4), (0.12, 0.08, 0.05)
    _place(builder, *_FLOOR, base_color=(0.45, 0.42, 0.4))
    _place(builder, "sphere", (-1.6, 0.8, 0.0), (1.6,) * 3, base_color=(0.7, 0.2, 0.1), specular_color=(0.6, 0.6, 0.6),
           shininess=40.0, rim_strength=0.5, rim_power=3.0)  # fmt: skip
    _place(builder, "sphere", (0.3, 0.8, -0.4), (1.6,) * 3, base_color=(0.9, 0.7, 0.3), metallic=1.0, roughness=0.4)
    _place(builder, "sphere", (2.0, 0.6, 0.6), (1.2,) * 3, base_color=(0.2, 0.4, 0.8), metallic=0.2, roughness=0.6)
    _place(builder, "box", (-3.2, 0.7, -1.0), (0.5, 1.4, 0.5), base_color=(0.3, 0.9, 0.4), emission=0.7)
    plain = SamplerDescriptor(mip=None)
    image, bumps = (TextureMap(builder.add_image(one), sampler=plain) for one in (_CHECKS, _BUMPS))
    turned = replace(image, offset=(0.2, 0.1), rotation=0.4, scale=(0.5, 0.7))
    _place(builder, "box", (0.9, 0.75, 2.0), (0.9, 1.5, 0.4), texture=turned, specular_color=(0.0, 0.0, 0.0))
    _place(builder, "box", (-0.6, 0.5, 2.1), (0.9, 1.0, 0.4), normal_texture=bumps, emissive_texture=image,
           emissive=(0.2, 0.1, 0.3), occlusion_texture=image, metallic_roughness_texture=bumps)  # fmt: skip
    _place(builder, "box", (3.4, 1.0, -0.6), (1.2, 2.0, 0.4), texture=image, alpha_mode=AlphaMode.MASK)
    builder.lights.add_directional((-0.5, -1.0, -0.4), (1.0, 0.9, 0.8), 0.8)
    builder.lights.add_point((0.5, 2.5, 1.8), 5.0, (0.4, 0.6, 1.0), 3.0)
    builder.lights.add_spot((-2.5, 3.0, 2.0), (0.3, -1.0, -0.4), 7.0, 0.3, 0.6, (1.0, 0.5, 0.3), 9.0)
    scene = builder.build()
    near, wide = look((1.0, 1.6, 6.0), (0.0, 0.7, 0.0)), look((-2.0, 1.0, 3.2), (0.5, 0.8, 0.0), fov=1.9)
    return {"near": (scene, near, "forward"), "wide": (scene, wide, "forward"), "after": (scene, near, "deferred")}


def make_bright() -> Sights:
    """Make surfaces in the light of lamps that is far beyond white, and beyond the largest half float; in one
    picture light is half floats, of which a billionth glows."""
    builder = SceneBuilder("bright")
    builder.lights.sky = builder.lights.ground = (0.02, 0.02, 0.02)
    _place(builder, *_FLOOR, base_color=(0.5, 0.4, 0.3), specular_color=(0.0, 0.0, 0.0))
    for x, strength in ((-3.0, 20.0), (0.0, 4e4), (3.0, 1e21)):
        _place(builder, "box", (x, 0.5, 0.0), (1.0, 1.0, 1.0), base_color=(0.6, 0.0, 0.9),
               specular_color=(0.0, 0.0, 0.0))  # fmt: skip
        for side in (-0.3, 0.3):
            builder.lights.add_point((x + side, 2.0, 0.9), 3.5, intensity=strength)
    _place(builder, "box", (-1.5, 0.3, 2.0), (0.6, 0.6, 0.6), base_color=(0.9, 0.5, 0.1), emission=3.0)
    camera, scene, glowing = look((0.0, 3.0, 7.0), (0.0, 0.3, 0.0)), builder.build(), builder.build()
    glowing.glow = Glow(1e-9)
    shown = {name: (scene, camera, name) for name in ("forward", "deferred", "light_pre_pass")}
    return shown | {"glow": (glowing, camera, "forward")}


def make_glass() -> Sights:
    """Make panes behind each other, and two that cross, cut in two where they do."""
    rows = SceneBuilder("panes")
    _place(rows, *_FLOOR, base_color=(0.6, 0.6, 0.6))
    for number, (color, alpha) in enumerate((((0.9, 0.2, 0.1), 0.4), ((0.1, 0.3, 0.9), 0.6), ((0.2, 0.9, 0.3), 0.8))):
        _place(rows, "box", (-0.8 + 0.8 * number, 1.0, -2.0 + 2.0 * number), (2.4, 2.0, 0.05),
               base_color=(*color, alpha), alpha_mode=AlphaMode.BLEND)  # fmt: skip
    rows.lights.add_directional((-0.3, -0.8, -0.6))
    crossing = cross_panes(is_cut=True)
    return {"in rows": (rows.build(), look((0.5, 1.6, 6.0), (0.0, 0.8, 0.0)), "forward"),
            "crossing": (crossing, CROSSED, "forward")}  # fmt: skip


CROSSED: Final = look((0.6, 1.5, 4.5), (0.0, 1.0, 0.0))


def cross_panes(*, is_cut: bool) -> Scene:
    """Make two panes that cross, or the four halves of them."""
    builder = SceneBuilder("crossing")
    _place(builder, *_FLOOR, base_color=(0.6, 0.6, 0.6))
    mesh = builder.add_mesh(_SHAPES["box"])
    for angle, color in ((40.0, (0.9, 0.2, 0.1, 0.6)), (-40.0, (0.1, 0.3, 0.9, 0.6))):
        glass = builder.add_material(base_color=color, alpha_mode=AlphaMode.BLEND, double_sided=True)
        for x, width in ((-0.5, 1.0), (0.5, 1.0)) if is_cut else ((0.0, 2.0),):
            stands = multiply(translation((0.0, 1.2, 0.4)), rotation((0, 1, 0), np.radians(angle)))
            pane = multiply(stands, multiply(translation((x, 0.0, 0.0)), scaling((width, 1.6, 0.004))))
            builder.add_objects(builder.add_node(pane), mesh, glass)
    builder.lights.add_directional((-0.3, -0.8, -0.6))
    return builder.build()


def cover(make: Callable[[], Sights], device: Device) -> Found:
    """Compare panes, and find what order by objects loses where whole panes cross."""
    found = compare(make, device)
    whole = draw(device, cross_panes(is_cut=False), CROSSED)[..., :3].astype(np.float64)
    judged = judge_all(make)["crossing"][3].levels
    lost = float(np.abs(whole - judged).max(axis=2).mean())
    numbers = {**found.numbers, "levels lost in the mean where whole panes cross": round(lost, 2)}
    return Found(found.error, numbers, found.holds, found.pictures)


def make_air() -> Sights:
    """Make a road to the horizon with fog on the ground, seen along it, from above and from below; and in haze."""
    views = {}
    for title, fog, haze in (
        ("low fog", Fog(0.12, (0.5, 0.55, 0.6), falloff=0.8, base=0.2), 0.0),
        ("even fog", Fog(0.05, (0.6, 0.5, 0.4)), 0.0),
        ("haze", None, 0.04),
    ):
        builder = SceneBuilder(title)
        builder.background, builder.fog, builder.haze = (0.3, 0.4, 0.6), fog, haze
        builder.lights.add_directional((-0.5, -1.0, -0.4), intensity=1.5)
        _place(builder, "box", (0.0, -0.25, -30.0), (200.0, 0.5, 200.0), base_color=(0.3, 0.1, 0.05))
        for z in (-4.0, -12.0, -30.0):
            _place(builder, "box", (0.3 * z, 1.5, z), (1.5, 3.0, 1.5), base_color=(0.1, 0.6, 0.2))
        views[title] = builder.build(), look((0.0, 1.2, 3.0), (-1.5, 1.25, -9.0)), "forward"
    return views | {"from above": (views["low fog"][0], look((0.0, 9.0, 3.0), (-1.5, 0.0, -9.0)), "deferred")}


def make_turned() -> Sights:
    """Make objects that are mirrored, squeezed and skewed, on nodes of nodes that are."""
    builder = SceneBuilder("turned")
    _place(builder, *_FLOOR, base_color=(0.5, 0.5, 0.5))
    squeezed = builder.add_node(multiply(translation((-2.0, 1.0, 0.0)), scaling((0.4, 1.8, 1.0))))
    skewed = builder.add_node(rotation((0, 0, 1), 0.7), squeezed)
    mirrored = builder.add_node(multiply(translation((1.0, 0.9, 0.0)), scaling((-1.0, 1.0, 1.0))))
    twice = builder.add_node(multiply(translation((-2.0, 0.0, 0.5)), scaling((1.2, -0.5, 0.8))), mirrored)
    bumps = builder.add_image(_BUMPS)
    for node, shape, normals in (
        (skewed, "sphere", -1), (mirrored, "torus", -1), (twice, "cone", -1),
        (mirrored, "box", bumps),
    ):  # fmt: skip
        metal = builder.add_material(base_color=(0.8, 0.6, 0.4), metallic=0.6, roughness=0.5, normal_texture=normals)
        builder.add_objects(node, builder.add_mesh(_SHAPES[shape]), metal)
    sheet = builder.add_node(
        multiply(translation((2.4, 1.0, 0.5)), multiply(rotation((1, 0, 0), 1.2), scaling((-1, 1, 1))))
    )
    green = builder.add_material(base_color=(0.2, 0.8, 0.3))
    builder.add_objects(sheet, builder.add_mesh(_SHAPES["plane"]), green)
    builder.lights.add_directional((-0.5, -0.7, -0.6), intensity=1.2)
    builder.lights.add_point((1.0, 2.5, 2.0), 6.0, intensity=4.0)
    return {"turned": (builder.build(), look((0.3, 1.8, 5.0), (0.0, 0.8, 0.0)), "forward")}


_MAPS: Final = {
    "shadows.cascades": 1, "shadows.cascade_size": 128, "shadows.distance": 20.0, "shadows.smallest": 512,
}  # fmt: skip
"""Settings with texels of 1 cm for lamps, and of 16 cm for the sun."""
SUN: Final = (0.45, -1.0, 0.3)
_HEIGHT: Final = 5.0  # of the picture, in metres


def make_shade(place: float) -> Scene:
    """Make a plate above a floor in red sunlight, in green light of a spot and in blue light of a point, all at `place`
    metres from the origin along x and z."""
    builder = SceneBuilder("shade")
    builder.lights.sky = builder.lights.ground = (0.05, 0.05, 0.05)
    _place(builder, "box", (place, -0.25, place), _FLOOR[2], base_color=(0.6, 0.6, 0.6), specular_color=(0.0, 0.0, 0.0))
    plate = multiply(translation((place, 1.6, place)), multiply(rotation((0, 1, 0), 0.5), scaling((1.1, 0.05, 0.8))))
    grey = builder.add_material(base_color=(0.6, 0.6, 0.6), specular_color=(0.0, 0.0, 0.0))
    builder.add_objects(builder.add_node(plate), builder.add_mesh(_SHAPES["box"]), grey)
    builder.lights.add_directional(SUN, (1, 0, 0), 0.8, casts_shadow=True)
    builder.lights.add_spot(
        (place + 0.9, 4.0, place + 0.2), (0.0, -1.0, 0.1), 8.0, 0.5, 0.7, (0, 1, 0), 8.0, casts_shadow=True
    )
    builder.lights.add_point((place - 1.2, 4.0, place + 0.8), 6.0, (0, 0, 1), 8.0, casts_shadow=True)
    return builder.build()


def look_down(place: float) -> Camera:
    """Return the camera that looks at the floor."""
    lens = Orthographic(_HEIGHT, WIDE[0] / WIDE[1], 0.0, 20.0)
    return Camera.look_at((place, 8.0, place), (place, 0.0, place), (0, 0, -1), lens)


@cache
def judge_shade() -> tuple[Floats, Floats]:
    """Return what the judge sees at the origin, with shadows and without."""
    scene, camera = make_shade(0.0), look_down(0.0)
    return Judge(scene).draw(camera, WIDE), Judge(scene, has_shadows=False).draw(camera, WIDE)


def cast_shadows(place: float, device: Device) -> Found:
    """Draw shadows at a place, and compare with rays the middles of what is dark in each colour, and the whole picture.

    The reference is of the origin. Edges of maps are blurred as far to one side as to the other, so the middle doesn't
    move; a map that is read half a texel beside its place moves by that.
    """
    scene, (judged, bare) = make_shade(place), judge_shade()
    image = draw(device, scene, look_down(place), WIDE, changes=_MAPS)
    scene.lights.cast_shadows(False)
    lit = draw(device, scene, look_down(place), WIDE)[..., :3]
    shown = image[..., :3].astype(np.float64)
    y, x = np.indices(judged.shape[:2])
    pixel = _HEIGHT / WIDE[1]
    numbers, error = dict[str, object](), 0.0
    for channel, name in enumerate(("sun", "spot", "point")):
        middles = []
        for one in (shown, judged):
            light, all_light = (unmap_tones(decode_srgb(some[..., channel] / 255.0)) for some in (one, bare))
            dark = np.where(all_light - light > 0.02 * all_light.max(), all_light - light, 0.0)  # the rest is rounding
            middles.append(np.array([(dark * x).sum(), (dark * y).sum()]) / dark.sum() * pixel)
        off = float(np.abs(middles[0] - middles[1]).max())
        numbers[f"metres between the middles, {name}"] = round(off, 5)
        error = find_largest(error, off)
    mean = float(np.abs(shown - judged).max(axis=2).mean())
    numbers["levels off in the mean"] = round(mean, 3)
    holds = show_something([image]) | {
        "it is as bright without shadows": bool(np.median(np.abs(lit - bare)) < 0.5),
        "shadows differ by less than 3 levels in the mean": mean < 3.0,
    }
    pictures = {"shown": image, "judged": _show(judged), "off": np.abs(shown - judged).max(axis=2)}
    return Found(error, numbers, holds, lambda: pictures)


MEASURES: Final[Measures] = {
    69: partial(compare, make_lit),
    70: partial(compare, make_bright),
    71: partial(cover, make_glass),
    72: partial(compare, make_air),
    73: partial(compare, make_turned),
    74: partial(cast_shadows, 0.0),
    75: partial(cast_shadows, 2.0**23 + 2.0**20),
}
