"""Ray-traced references: frames of a device compared with the reference ray tracer's float64 images.

Frames are compared pixel by pixel where the reference is smooth. It is traced at the centre of a pixel and an
eighth of a pixel beside it, towards the four corners; these five bound the levels that a device may show
there. Where they are far apart there is an edge: rounding decides on which side a pixel is, so it is left
out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.content import BUILT_IN
from renderer.lab.exam.case import CaseImage, CaseResult, Measures, largest_error
from renderer.lab.exam.scenes import make_camera, shows_something
from renderer.lab.measure.ray_tracer import RayTracer
from renderer.lab.measure.ray_tracer.surfaces import decode_srgb
from renderer.lab.measure.ray_tracer.tracer import inverse_tone_map
from renderer.scene import AlphaMode, Bloom, Camera, Fog, Orthographic, Scene, SceneBuilder, TextureMap
from renderer.scene.arrays import Floats
from renderer.settings import RenderSettings
from rhi import Device, SamplerDescriptor
from rhi.math import multiply, rotation, scaling, translation

SIZE: Final = (64, 36)
WIDE: Final = (128, 72)
_SUBPIXEL_OFFSET: Final = 0.125  # of a pixel
_EDGE: Final = 6.0
"""Levels by which the five samples of a pixel differ at an edge."""


@dataclass(frozen=True, eq=False, slots=True)
class TracedImage:
    """A ray-traced image: `levels` (h, w, 3), not rounded, and their bounds `low` and `high` around each
    pixel."""

    levels: Floats
    low: Floats
    high: Floats

    @property
    def is_smooth(self) -> NDArray[np.bool_]:
        """The pixels (h, w) without an edge, a mask."""
        return np.asarray((self.high - self.low).max(axis=2) < _EDGE)


def trace_image(scene: Scene, camera: Camera, size: tuple[int, int] = SIZE) -> TracedImage:
    """Ray-trace a scene, without its bloom."""
    bloom, scene.bloom = scene.bloom, None
    seen, camera = RayTracer(scene), camera.with_aspect(size[0] / size[1])
    offsets = [
        (0.5, 0.5),
        *(
            (0.5 + x, 0.5 + y)
            for x in (-_SUBPIXEL_OFFSET, _SUBPIXEL_OFFSET)
            for y in (-_SUBPIXEL_OFFSET, _SUBPIXEL_OFFSET)
        ),
    ]
    levels = [seen.draw(camera, size, at=offset) for offset in offsets]
    scene.bloom = bloom
    return TracedImage(levels[0], np.minimum.reduce(levels), np.maximum.reduce(levels))


TestViews = dict[str, tuple[Scene, Camera, str]]
"""Scenes by title, each with a camera and the technique that draws it."""


@cache  # the same for each device
def trace_all(
    make: Callable[[], TestViews], trace: Callable[[Scene, Camera], TracedImage] = trace_image
) -> dict[str, tuple[Scene, Camera, str, TracedImage]]:
    """Scenes with their ray-traced images."""
    return {title: (*view, trace(view[0], view[1])) for title, view in make().items()}


def draw(
    device: Device,
    scene: Scene,
    camera: Camera,
    size: tuple[int, int] = SIZE,
    technique: str = "forward",
    changes: Mapping[str, Any] | None = None,
    seconds: float = 0.0,
) -> NDArray[Any]:
    """Render a frame at a time without culling, with changes of settings by their paths."""
    settings = RenderSettings().change_all(
        {"technique.name": technique, "algorithm": "none", **(changes or {})}
    )
    with settings.open(device, scene, size) as renderer:
        return renderer.render(settings.adapt_camera(camera), seconds).image.read()


def measure_traced_views(
    make: Callable[[], TestViews],
    device: Device,
    trace: Callable[[Scene, Camera], TracedImage] = trace_image,
) -> CaseResult:
    """Draw scenes, and measure by how many levels pixels are out of their bounds."""
    numbers = dict[str, object]()
    holds = dict[str, bool]()
    images = dict[str, CaseImage]()
    error = 0.0
    for title, (scene, camera, technique, traced) in trace_all(make, trace).items():
        image = draw(device, scene, camera, technique=technique)
        levels = image[..., :3].astype(np.float64)
        off = np.maximum(traced.low - levels, levels - traced.high).max(axis=2)
        off = np.where(traced.is_smooth, np.maximum(off, 0.0), 0.0)
        numbers[f"{title}: levels off"] = round(float(off.max()), 3)
        numbers[f"{title}: pixels compared"] = int(traced.is_smooth.sum())
        error = largest_error(error, float(off.max()))
        holds |= {
            f"{title}: {description}": is_true for description, is_true in shows_something([image]).items()
        }
        holds[f"{title}: most pixels are compared"] = bool(traced.is_smooth.mean() > 0.5)
        images |= {title: image, f"{title}, traced": _to_image(traced.levels), f"{title}, off": off}
    return CaseResult(error, numbers, holds, lambda: images)


def _to_image(levels: Floats) -> CaseImage:
    image = np.full((*levels.shape[:2], 4), 255, np.uint8)
    image[..., :3] = np.round(levels)
    return image


def _add_object(builder: SceneBuilder, shape: str, position: Any, size: Any, **material: Any) -> None:
    """Add an object of a built-in shape."""
    node = builder.add_node(multiply(translation(position), scaling(size)))
    builder.add_objects(node, builder.add_mesh(_SHAPES[shape]), builder.add_material(**material))


_SHAPES: Final = {name: make() for name, make in BUILT_IN.items()}
_FLOOR: Final = ("box", (0.0, -0.25, 0.0), (12.0, 0.5, 12.0))
_CHECKS: Final = np.random.default_rng(2).integers(0, 256, (4, 4, 4)).astype(np.uint8)
_CHECKS[..., 3] = np.where(np.arange(16).reshape(4, 4) % 3 == 0, 0, 255)
_BUMPS: Final = np.full((4, 4, 4), 255, np.uint8)
_BUMPS[..., :3] = np.random.default_rng(3).integers(70, 190, (4, 4, 3))
_BUMPS[..., 2] = 220


def make_lit_views() -> TestViews:
    """Make surfaces of all kinds in the light of a sun, local lights and the sky; seen through several
    projections, and lit while they are drawn and afterwards."""
    builder = SceneBuilder("lit")
    builder.background = (0.2, 0.3, 0.5)
    builder.lights.sky, builder.lights.ground = (0.25, 0.3, 0.4), (0.12, 0.08, 0.05)
    _add_object(builder, *_FLOOR, base_color=(0.45, 0.42, 0.4))
    _add_object(builder, "sphere", (-1.6, 0.8, 0.0), (1.6,) * 3, base_color=(0.7, 0.2, 0.1),
           specular_color=(0.6, 0.6, 0.6), shininess=40.0, rim_strength=0.5, rim_power=3.0)  # fmt: skip
    _add_object(
        builder,
        "sphere",
        (0.3, 0.8, -0.4),
        (1.6,) * 3,
        base_color=(0.9, 0.7, 0.3),
        metallic=1.0,
        roughness=0.4,
    )
    _add_object(
        builder,
        "sphere",
        (2.0, 0.6, 0.6),
        (1.2,) * 3,
        base_color=(0.2, 0.4, 0.8),
        metallic=0.2,
        roughness=0.6,
    )
    _add_object(builder, "box", (-3.2, 0.7, -1.0), (0.5, 1.4, 0.5), base_color=(0.3, 0.9, 0.4), emission=0.7)
    plain = SamplerDescriptor(mip=None)
    image, bumps = (TextureMap(builder.add_image(texels), sampler=plain) for texels in (_CHECKS, _BUMPS))
    turned = replace(image, offset=(0.2, 0.1), rotation=0.4, scale=(0.5, 0.7))
    _add_object(
        builder, "box", (0.9, 0.75, 2.0), (0.9, 1.5, 0.4), texture=turned, specular_color=(0.0, 0.0, 0.0)
    )
    _add_object(
        builder,
        "box",
        (-0.6, 0.5, 2.1),
        (0.9, 1.0, 0.4),
        normal_texture=bumps,
        emissive_texture=image,
        emissive=(0.2, 0.1, 0.3),
        occlusion_texture=image,
        metallic_roughness_texture=bumps,
    )
    _add_object(builder, "box", (3.4, 1.0, -0.6), (1.2, 2.0, 0.4), texture=image, alpha_mode=AlphaMode.MASK)
    builder.lights.add_directional((-0.5, -1.0, -0.4), (1.0, 0.9, 0.8), 0.8)
    builder.lights.add_point((0.5, 2.5, 1.8), 5.0, (0.4, 0.6, 1.0), 3.0)
    builder.lights.add_spot((-2.5, 3.0, 2.0), (0.3, -1.0, -0.4), 7.0, 0.3, 0.6, (1.0, 0.5, 0.3), 9.0)
    scene = builder.build()
    near, wide = (
        make_camera((1.0, 1.6, 6.0), (0.0, 0.7, 0.0)),
        make_camera((-2.0, 1.0, 3.2), (0.5, 0.8, 0.0), fov=1.9),
    )
    return {
        "near": (scene, near, "forward"),
        "wide": (scene, wide, "forward"),
        "after": (scene, near, "deferred"),
    }


def make_bright_views() -> TestViews:
    """Make surfaces in light far beyond white, and beyond the largest half float; in one image light is half
    floats, of which a billionth blooms."""
    builder = SceneBuilder("bright")
    builder.lights.sky = builder.lights.ground = (0.02, 0.02, 0.02)
    _add_object(builder, *_FLOOR, base_color=(0.5, 0.4, 0.3), specular_color=(0.0, 0.0, 0.0))
    for x, strength in ((-3.0, 20.0), (0.0, 4e4), (3.0, 1e21)):
        _add_object(builder, "box", (x, 0.5, 0.0), (1.0, 1.0, 1.0), base_color=(0.6, 0.0, 0.9),
               specular_color=(0.0, 0.0, 0.0))  # fmt: skip
        for side in (-0.3, 0.3):
            builder.lights.add_point((x + side, 2.0, 0.9), 3.5, intensity=strength)
    _add_object(builder, "box", (-1.5, 0.3, 2.0), (0.6, 0.6, 0.6), base_color=(0.9, 0.5, 0.1), emission=3.0)
    camera = make_camera((0.0, 3.0, 7.0), (0.0, 0.3, 0.0))
    scene = builder.build()
    glowing = builder.build()
    glowing.bloom = Bloom(1e-9)
    views = {name: (scene, camera, name) for name in ("forward", "deferred", "light_pre_pass")}
    endless = {
        f"lights without end, {name}": (_make_endless_lights(), camera, name)
        for name in ("forward", "deferred", "light_pre_pass")
    }
    return views | {"bloom": (glowing, camera, "forward")} | endless


def _make_endless_lights() -> Scene:
    """Make boxes in lights whose ranges are the longest that float32 has, and others."""
    builder = SceneBuilder("endless")
    builder.lights.sky = builder.lights.ground = (0.02, 0.02, 0.02)
    _add_object(builder, *_FLOOR, base_color=(0.5, 0.4, 0.3))
    _add_object(builder, "box", (0.0, 0.5, 0.0), (1.0, 1.0, 1.0), base_color=(0.6, 0.3, 0.9))
    for x, reach in ((-2.0, 1e12), (0.5, 1e37), (2.0, 3e38)):
        builder.lights.add_point((x, 1.5, 1.0), reach, (1.0, 0.6, 0.3), 0.6)
        builder.lights.add_spot((x, 2.5, -0.5), (0.1, -1.0, 0.2), reach, 0.3, 0.6, (0.3, 0.6, 1.0), 4.0)
    return builder.build()


def make_glass_views() -> TestViews:
    """Make panes behind each other, and two that cross, cut in two where they do."""
    rows = SceneBuilder("panes")
    _add_object(rows, *_FLOOR, base_color=(0.6, 0.6, 0.6))
    for number, (color, alpha) in enumerate(
        (((0.9, 0.2, 0.1), 0.4), ((0.1, 0.3, 0.9), 0.6), ((0.2, 0.9, 0.3), 0.8))
    ):
        _add_object(
            rows,
            "box",
            (-0.8 + 0.8 * number, 1.0, -2.0 + 2.0 * number),
            (2.4, 2.0, 0.05),
            base_color=(*color, alpha),
            alpha_mode=AlphaMode.BLEND,
        )
    rows.lights.add_directional((-0.3, -0.8, -0.6))
    crossing = cross_panes(is_cut=True)
    return {
        "in rows": (rows.build(), make_camera((0.5, 1.6, 6.0), (0.0, 0.8, 0.0)), "forward"),
        "crossing": (crossing, CROSSED, "forward"),
        "two sides": (_make_lanterns(), make_camera((0.6, 2.2, 4.5), (0.0, 0.9, 0.0)), "forward"),
    }


def _make_lanterns() -> Scene:
    """Make boxes of glass with two sides, red, green and blue along the axes, one of them mirrored; and a
    flat pane."""
    builder = SceneBuilder("lanterns")
    _add_object(builder, *_FLOOR, base_color=(0.6, 0.6, 0.6))
    solid = _SHAPES["box"].with_attributes(_SHAPES["box"].attributes | {"color"})
    solid.vertices["color"][:, :3] = 0.15 + 0.7 * (solid.vertices["normal"] > 0.5)
    mesh, pane = builder.add_mesh(solid), builder.add_mesh(_SHAPES["plane"])
    glass = builder.add_material(
        base_color=(1.0, 1.0, 1.0, 0.5), alpha_mode=AlphaMode.BLEND, double_sided=True
    )
    for x, width in ((-1.2, 1.0), (1.2, -1.0)):
        turned = multiply(translation((x, 0.9, 0.0)), rotation((0, 1, 0), 0.5))
        builder.add_objects(builder.add_node(multiply(turned, scaling((width, 1.0, 1.0)))), mesh, glass)
    upright = multiply(translation((0.0, 0.9, -1.5)), rotation((1, 0, 0), -1.3))
    builder.add_objects(builder.add_node(upright), pane, glass)
    builder.lights.add_directional((-0.3, -0.8, -0.6))
    return builder.build()


CROSSED: Final = make_camera((0.6, 1.5, 4.5), (0.0, 1.0, 0.0))


def cross_panes(*, is_cut: bool) -> Scene:
    """Make two panes that cross, or the four halves of them."""
    builder = SceneBuilder("crossing")
    _add_object(builder, *_FLOOR, base_color=(0.6, 0.6, 0.6))
    mesh = builder.add_mesh(_SHAPES["box"])
    for angle, color in ((40.0, (0.9, 0.2, 0.1, 0.6)), (-40.0, (0.1, 0.3, 0.9, 0.6))):
        glass = builder.add_material(base_color=color, alpha_mode=AlphaMode.BLEND, double_sided=True)
        for x, width in ((-0.5, 1.0), (0.5, 1.0)) if is_cut else ((0.0, 2.0),):
            stands = multiply(translation((0.0, 1.2, 0.4)), rotation((0, 1, 0), np.radians(angle)))
            pane = multiply(stands, multiply(translation((x, 0.0, 0.0)), scaling((width, 1.6, 0.004))))
            builder.add_objects(builder.add_node(pane), mesh, glass)
    builder.lights.add_directional((-0.3, -0.8, -0.6))
    return builder.build()


def measure_panes(make: Callable[[], TestViews], device: Device) -> CaseResult:
    """Compare panes, and measure the loss by sorting whole objects where panes cross."""
    result = measure_traced_views(make, device)
    whole = draw(device, cross_panes(is_cut=False), CROSSED)[..., :3].astype(np.float64)
    traced = trace_all(make)["crossing"][3].levels
    lost = float(np.abs(whole - traced).max(axis=2).mean())
    numbers = {**result.numbers, "levels lost in the mean where whole panes cross": round(lost, 2)}
    return CaseResult(result.error, numbers, result.holds, result.images)


def make_fog_views() -> TestViews:
    """Make a road to the horizon with fog on the ground, seen along it, from above and from below; and in
    haze."""
    views = {}
    for title, fog, haze in (
        ("low fog", Fog(0.12, (0.5, 0.55, 0.6), falloff=0.8, base=0.2), 0.0),
        ("even fog", Fog(0.05, (0.6, 0.5, 0.4)), 0.0),
        ("haze", None, 0.04),
    ):
        builder = SceneBuilder(title)
        builder.background, builder.fog, builder.haze = (0.3, 0.4, 0.6), fog, haze
        builder.lights.add_directional((-0.5, -1.0, -0.4), intensity=1.5)
        _add_object(builder, "box", (0.0, -0.25, -30.0), (200.0, 0.5, 200.0), base_color=(0.3, 0.1, 0.05))
        for z in (-4.0, -12.0, -30.0):
            _add_object(builder, "box", (0.3 * z, 1.5, z), (1.5, 3.0, 1.5), base_color=(0.1, 0.6, 0.2))
        views[title] = builder.build(), make_camera((0.0, 1.2, 3.0), (-1.5, 1.25, -9.0)), "forward"
    return views | {
        "from above": (views["low fog"][0], make_camera((0.0, 9.0, 3.0), (-1.5, 0.0, -9.0)), "deferred")
    }


def make_transformed_views() -> TestViews:
    """Make objects that are mirrored, squeezed and skewed, on nodes of nodes that are."""
    builder = SceneBuilder("turned")
    _add_object(builder, *_FLOOR, base_color=(0.5, 0.5, 0.5))
    squeezed = builder.add_node(multiply(translation((-2.0, 1.0, 0.0)), scaling((0.4, 1.8, 1.0))))
    skewed = builder.add_node(rotation((0, 0, 1), 0.7), squeezed)
    mirrored = builder.add_node(multiply(translation((1.0, 0.9, 0.0)), scaling((-1.0, 1.0, 1.0))))
    twice = builder.add_node(multiply(translation((-2.0, 0.0, 0.5)), scaling((1.2, -0.5, 0.8))), mirrored)
    bumps = builder.add_image(_BUMPS)
    for node, shape, normals in (
        (skewed, "sphere", -1),
        (mirrored, "torus", -1),
        (twice, "cone", -1),
        (mirrored, "box", bumps),
    ):
        metal = builder.add_material(
            base_color=(0.8, 0.6, 0.4), metallic=0.6, roughness=0.5, normal_texture=normals
        )
        builder.add_objects(node, builder.add_mesh(_SHAPES[shape]), metal)
    leaf = builder.add_node(
        multiply(translation((2.4, 1.0, 0.5)), multiply(rotation((1, 0, 0), 1.2), scaling((-1, 1, 1))))
    )
    green = builder.add_material(base_color=(0.2, 0.8, 0.3))
    builder.add_objects(leaf, builder.add_mesh(_SHAPES["plane"]), green)
    builder.lights.add_directional((-0.5, -0.7, -0.6), intensity=1.2)
    builder.lights.add_point((1.0, 2.5, 2.0), 6.0, intensity=4.0)
    return {"turned": (builder.build(), make_camera((0.3, 1.8, 5.0), (0.0, 0.8, 0.0)), "forward")}


_MAPS: Final = {
    "shadows.cascades": 1,
    "shadows.cascade_size": 128,
    "shadows.distance": 20.0,
    "shadows.min_size": 512,
}
"""Settings with texels of 1 cm for local lights, and of 16 cm for the sun."""
SUN: Final = (0.45, -1.0, 0.3)
_HEIGHT: Final = 5.0  # of the image, in metres


def make_shadow_scene(offset: float) -> Scene:
    """Make a plate above a floor in red sunlight, in green light of a spot and in blue light of a point, all
    at `offset` metres from the origin along x and z."""
    builder = SceneBuilder("shade")
    builder.lights.sky = builder.lights.ground = (0.05, 0.05, 0.05)
    _add_object(
        builder,
        "box",
        (offset, -0.25, offset),
        _FLOOR[2],
        base_color=(0.6, 0.6, 0.6),
        specular_color=(0.0, 0.0, 0.0),
    )
    plate = multiply(
        translation((offset, 1.6, offset)), multiply(rotation((0, 1, 0), 0.5), scaling((1.1, 0.05, 0.8)))
    )
    grey = builder.add_material(base_color=(0.6, 0.6, 0.6), specular_color=(0.0, 0.0, 0.0))
    builder.add_objects(builder.add_node(plate), builder.add_mesh(_SHAPES["box"]), grey)
    builder.lights.add_directional(SUN, (1, 0, 0), 0.8, casts_shadow=True)
    builder.lights.add_spot(
        (offset + 0.9, 4.0, offset + 0.2), (0.0, -1.0, 0.1), 8.0, 0.5, 0.7, (0, 1, 0), 8.0, casts_shadow=True
    )
    builder.lights.add_point((offset - 1.2, 4.0, offset + 0.8), 6.0, (0, 0, 1), 8.0, casts_shadow=True)
    return builder.build()


def make_top_camera(offset: float) -> Camera:
    """The camera that looks down at the floor."""
    projection = Orthographic(_HEIGHT, WIDE[0] / WIDE[1], 0.0, 20.0)
    return Camera.look_at((offset, 8.0, offset), (offset, 0.0, offset), (0, 0, -1), projection)


@cache
def trace_shadows() -> tuple[Floats, Floats]:
    """The ray-traced images at the origin, with shadows and without."""
    scene, camera = make_shadow_scene(0.0), make_top_camera(0.0)
    return RayTracer(scene).draw(camera, WIDE), RayTracer(scene, has_shadows=False).draw(camera, WIDE)


def measure_shadow_edges(offset: float, device: Device) -> CaseResult:
    """Draw shadows at an offset, and compare with rays the middles of the shadows in each colour, and the
    whole image.

    The reference is of the origin. Edges of maps are blurred as far to one side as to the other, so the
    middle doesn't move; a map that is read half a texel beside its place moves by that.
    """
    scene, (traced, bare) = make_shadow_scene(offset), trace_shadows()
    image = draw(device, scene, make_top_camera(offset), WIDE, changes=_MAPS)
    scene.lights.cast_shadows(False)
    lit = draw(device, scene, make_top_camera(offset), WIDE)[..., :3]
    levels = image[..., :3].astype(np.float64)
    y, x = np.indices(traced.shape[:2])
    pixel = _HEIGHT / WIDE[1]
    numbers, error = dict[str, object](), 0.0
    for channel, name in enumerate(("sun", "spot", "point")):
        middles = []
        for compared in (levels, traced):
            light, all_light = (
                inverse_tone_map(decode_srgb(image_levels[..., channel] / 255.0))
                for image_levels in (compared, bare)
            )
            dark = np.where(
                all_light - light > 0.02 * all_light.max(), all_light - light, 0.0
            )  # the rest is rounding
            middles.append(np.array([(dark * x).sum(), (dark * y).sum()]) / dark.sum() * pixel)
        off = float(np.abs(middles[0] - middles[1]).max())
        numbers[f"metres between the middles, {name}"] = round(off, 5)
        error = largest_error(error, off)
    mean = float(np.abs(levels - traced).max(axis=2).mean())
    numbers["levels off in the mean"] = round(mean, 3)
    holds = shows_something([image]) | {
        "it is as bright without shadows": bool(np.median(np.abs(lit - bare)) < 0.5),
        "shadows differ by less than 3 levels in the mean": mean < 3.0,
    }
    images = {"shown": image, "traced": _to_image(traced), "off": np.abs(levels - traced).max(axis=2)}
    return CaseResult(error, numbers, holds, lambda: images)


MEASURES: Final[Measures] = {
    69: partial(measure_traced_views, make_lit_views),
    70: partial(measure_traced_views, make_bright_views),
    71: partial(measure_panes, make_glass_views),
    72: partial(measure_traced_views, make_fog_views),
    73: partial(measure_traced_views, make_transformed_views),
    74: partial(measure_shadow_edges, 0.0),
    75: partial(measure_shadow_edges, 2.0**23 + 2.0**20),
}
