"""The look of shadow maps: filters against NumPy, acne and detached shadows, on each device that draws."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
from depth_textures import create_depth_texture
from filter_reference import lit_fraction
from frames import make_boxes, open_renderer, read_colors
from nightly_reasons import FEWER_CASES, ONLY_KERNELS
from numpy.typing import NDArray

import rhi
import rhi.shading as sl
from renderer import scene as scenes
from renderer.content import BUILT_IN
from renderer.lab.exam import CASES
from renderer.lab.exam.shadow_cases import FLOOR_CAMERA, SETTINGS, SLOPES, make_slope, measure_shadow_acne
from renderer.renderer import Renderer
from renderer.scene import (
    AlphaMode,
    Camera,
    Orthographic,
    Perspective,
    Scene,
    SceneBuilder,
    scaling,
    translation,
)
from renderer.shadows import ShadowFilter, ShadowSettings
from renderer.shadows.filters import FILTERS, ShadowFilterShader
from renderer.shadows.maps import FarDepth
from renderer.techniques import TECHNIQUES, Deferred

Pixels = NDArray[np.int64]
TILE = (16, 32, 16)


class Compared(sl.Struct):
    """A point to be compared with a map."""

    at: sl.vec2
    slope: sl.vec2
    depth: float


class FilterCheck(FarDepth, ShadowFilterShader):
    """Shows the lit share of points, one in each pixel."""

    points: sl.Storage[Compared]

    def fragment(self) -> sl.vec4:
        pixel = sl.fragment_coordinate().xy
        point = self.points[int(pixel.x) + 64 * int(pixel.y)]
        share = self.lit_fraction(point.at, point.depth, point.slope, sl.vec2(24.0, 40.0), 8.0)
        return sl.vec4(sl.vec3(share), 1.0)


@cache
def check_variant(filter: ShadowFilter) -> Any:
    return type("FilterCheck", (FILTERS[filter], FilterCheck), {"__module__": __name__})


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("filter", ShadowFilter)
def test_filters_are_those_of_a_numpy_reference(drawing_device: rhi.Device, filter: ShadowFilter) -> None:
    """Compare 4,096 random points, in a tile and at its edges, with the reference."""
    random = np.random.default_rng(7)
    depths = random.uniform(0.3, 0.7, (64, 64)).astype(np.float32)
    points = np.zeros(4096, Compared.dtype)
    points["at"] = random.uniform((14, 30), (34, 50), (4096, 2))
    points["slope"] = random.uniform(-0.05, 0.05, (4096, 2))
    points["depth"] = random.uniform(0.3, 0.7, 4096)
    arguments = (points["at"].astype(float), points["depth"].astype(float), points["slope"].astype(float))
    want, doubt = lit_fraction(filter, depths.astype(float), *arguments, TILE)
    atlas = create_depth_texture(drawing_device, depths)
    image = drawing_device.texture((64, 64), rhi.Format.RGBA32F)
    bindings: dict[str, Any] = {"shadow_atlas": atlas}
    if filter is ShadowFilter.HARDWARE:
        sampler = rhi.SamplerDescriptor(mip=None, compare=rhi.Comparison.GREATER_EQUAL)
        bindings = {"shadow_compare": atlas.sampled(sampler)}
    with drawing_device.render_pass(image), drawing_device.states(rhi.CullMode.NONE, rhi.DepthTest.OFF):
        storage = drawing_device.storage(Compared, points)
        drawing_device.draw(
            drawing_device.program(check_variant(filter)), drawing_device.mesh(3), points=storage, **bindings
        )
    shadowed = image.read()[..., 0].reshape(-1).astype(float)
    sure = doubt > 1e-5
    assert sure.mean() > 0.99
    wrong = np.abs(shadowed - want)[sure]
    # The turned texels of the Poisson disc are others where a point is at the edge of a texel.
    bound = 0.998 if filter is ShadowFilter.POISSON else 1.0
    assert (wrong < 1 / 255).mean() >= bound
    assert 0.2 < want.mean() < 0.8


def render(
    device: rhi.Device,
    scene: Scene,
    camera: Camera,
    settings: ShadowSettings | None = None,
    size: int = 64,
    *,
    casts: bool | None = None,
    technique: str = "forward",
) -> Pixels:
    """Return the image (h, w, 3); all lights cast shadows or none does, unless `casts` is None."""
    for lights in (scene.lights.directional, scene.lights.point, scene.lights.spot):
        if casts is not None:
            lights["casts_shadow"] = casts
    with open_renderer(device, scene, TECHNIQUES[technique](), size=(size, size)) as renderer:
        renderer.shadows.settings = settings or SETTINGS
        return read_colors(renderer.render(camera))


@pytest.mark.parametrize("filter", [filter for filter in ShadowFilter if filter is not SETTINGS.filter])
def test_a_lit_plane_has_no_acne_at_any_slope_with_the_other_filters(
    gl: rhi.Device, filter: ShadowFilter
) -> None:
    acne = measure_shadow_acne(gl, replace(SETTINGS, filter=filter))
    assert CASES[48].passes(acne), acne


def block_scene(
    degrees: float, normal_map: NDArray[np.uint8] | None = None
) -> tuple[Scene, NDArray[np.float64]]:
    """Make a block on a floor and a sun; return the scene and the sun's direction."""
    scene_builder = make_boxes((0, 0.5, 0), name="block", specular_color=(0, 0, 0))
    floor = scene_builder.add_node(translation((0, -0.5, 0)) @ scaling((30, 1, 30)))
    maps = {} if normal_map is None else {"normal_texture": scene_builder.add_image(normal_map)}
    scene_builder.add_objects(floor, 0, scene_builder.add_material(specular_color=(0, 0, 0), **maps))
    angle, turn = np.radians(degrees), 0.7
    down = np.array((np.sin(angle) * np.cos(turn), -np.cos(angle), np.sin(angle) * np.sin(turn)))
    scene_builder.lights.add_directional(down, intensity=1.0 / np.cos(angle))
    scene_builder.lights.sky = scene_builder.lights.ground = (0.0, 0.0, 0.0)
    return scene_builder.build(), down


def is_blocked(points: NDArray[np.float64], down: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether the unit block on the floor is between points (n, 3) and the sun."""
    with np.errstate(divide="ignore"):
        ends = np.stack([(corner - points) / -down for corner in ((-0.5, 0, -0.5), (0.5, 1, 0.5))])
    enters, leaves = ends.min(0).max(-1), ends.max(0).min(-1)
    return np.asarray(leaves > np.maximum(enters, 0.0))


@pytest.mark.parametrize("filter", [ShadowFilter.HARD, ShadowFilter.SMOOTH])
@pytest.mark.parametrize("degrees", [20.0, 60.0])
def test_shadows_touch_their_casters_and_end_within_a_texel(
    gl: rhi.Device, filter: ShadowFilter, degrees: float
) -> None:
    scene, down = block_scene(degrees)
    above = Camera.look_at(
        (0, 10, 0), (0, 0, 0), (0, 0, -1), Orthographic(height=8.0, aspect=1.0, near=1.0, far=10.5)
    )
    shadowed = render(
        gl, scene, above, replace(SETTINGS, filter=filter, cascade_size=256), size=256, casts=True
    )
    scene.lights.directional["intensity"] *= 0.5
    lit = shadowed[..., 0] >= render(gl, scene, above, size=256, casts=False)[..., 0]
    across = (np.arange(256) + 0.5) / 256 * 8 - 4
    floor = np.stack(np.meshgrid(across, across), -1) @ np.array(((1, 0, 0), (0, 0, 1)))
    floor = floor.reshape(-1, 3)
    on_floor = (np.abs(floor[:, [0, 2]]) > 0.5).any(1)
    texel = 2 * np.linalg.norm((4.0, 4.0, 5.0)) / 248  # at most: the slice's sphere, in this map
    axes = Camera.look_at((0, 0, 0), down).rotation
    angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    moved = [floor + texel * (np.cos(a) * axes[0] + np.sin(a) * axes[1]) for a in angles]
    blocked = np.stack([is_blocked(points, down) for points in moved])
    sure = on_floor & (blocked.all(0) | ~blocked.any(0))
    assert sure.sum() > 0.9 * on_floor.sum()
    assert np.array_equal(lit.reshape(-1)[sure], ~blocked[0][sure])


def test_shadows_fade_at_the_edge_of_the_last_cascade_alone(gl: rhi.Device) -> None:
    """A wall of blocks throws a shadow along the view, through all cascades; it is whole up to where the last
    fades."""
    builder = make_boxes(
        translation((0, -0.5, 0)) @ scaling((60, 1, 60)), translation((-2, 1, 0)) @ scaling((1, 2, 60)),
        name="wall", specular_color=(0, 0, 0),
    )  # fmt: skip
    builder.lights.add_directional((1, -0.5, 0))
    builder.lights.sky = builder.lights.ground = (0.0, 0.0, 0.0)
    eye = Camera.look_at((0.2, 6, 20), (0.2, 0, 8), projection=Perspective(fov=0.9, aspect=1.0, near=0.1))
    settings = ShadowSettings(cascades=3, cascade_size=256, distance=24.0)
    shadowed, lit = (
        render(gl, builder.build(), eye, settings, casts=casts)[..., 0] for casts in (True, False)
    )
    # The floor that the wall is between it and the sun of, below the middle of the image: x from -1.3 to 1.5.
    shares = shadowed[:, 32] / np.maximum(lit[:, 32], 1)
    whole = int(np.argmax(shares <= 0.0))
    assert 4 < whole < 20, "most of the floor in the image is nearer than shadows end"
    assert not shares[whole:].any(), "a shadow ends at the edge of a cascade that isn't the last"
    assert 0.05 < shares[whole - 1] < 0.95, "shadows end without fading"
    assert (shares[: whole - 2] == 1.0).all()


def leaf_scene(*, turned: bool = False, **material: Any) -> Scene:
    """Make a square leaf of 2 × 2 m, 2 m above a floor. The shadow that a sun throws of it is 2 m to its
    right. With `turned`, its front is below."""
    builder = SceneBuilder("leaf")
    corners = [(-1, 2, 1), (1, 2, 1), (1, 2, -1), (-1, 2, -1)]
    uv, order = [(0, 1), (1, 1), (1, 0), (0, 0)], [0, 1, 2, 0, 2, 3]
    leaf = builder.add_mesh(scenes.make_geometry(corners, order[::-1] if turned else order, uv=uv))
    images = {
        name: builder.add_image(value) for name, value in material.items() if isinstance(value, np.ndarray)
    }
    builder.add_objects(builder.add_node(), leaf, builder.add_material(**{**material, **images}))
    floor = builder.add_node(translation((0, -0.5, 0)) @ scaling((30, 1, 30)))
    plain = builder.add_material(specular_color=(0, 0, 0))
    builder.add_objects(floor, builder.add_mesh(BUILT_IN["box"]()), plain, casts_shadow=False)
    builder.lights.add_directional((1, -1, 0))
    return builder.build()


def measure_shadow(device: rhi.Device, scene: Scene) -> tuple[bool, bool]:
    """Return whether the shadow of the leaf's left half is on the floor, and that of its right half."""
    above = Camera.look_at(
        (0, 10, 0), (0, 0, 0), (0, 0, -1), Orthographic(height=8.0, aspect=1.0, near=1.0, far=10.5)
    )
    shadowed, lit = (render(device, scene, above, casts=casts)[24:40, :, 0] for casts in (True, False))
    halves = [columns < lit[:, :-1][:, :1] for columns in (shadowed[:, 42:45], shadowed[:, 51:54])]
    for half in halves:
        assert half.all() == half.any()
    return bool(halves[0].all()), bool(halves[1].all())


RIGHT_HALF = np.repeat(np.array([(255, 255, 255, 0), (255, 255, 255, 255)], np.uint8), 8, axis=0)[
    None
].repeat(16, 0)
CUT = {"alpha_mode": AlphaMode.MASK, "alpha_cutoff": 0.5, "texture": RIGHT_HALF}


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_a_masked_object_casts_the_shadow_of_its_opaque_texels(drawing_device: rhi.Device) -> None:
    assert measure_shadow(drawing_device, leaf_scene(**CUT)) == (False, True)


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_an_opaque_material_casts_the_shadow_of_its_whole_surface(drawing_device: rhi.Device) -> None:
    assert measure_shadow(drawing_device, leaf_scene(texture=RIGHT_HALF)) == (True, True)


@pytest.mark.parametrize("two_sides", [False, True])
def test_a_surface_turned_away_from_the_sun_casts_a_shadow_if_it_is_double_sided(
    gl: rhi.Device, two_sides: bool
) -> None:
    scene = leaf_scene(turned=True, double_sided=two_sides)
    assert measure_shadow(gl, scene) == (two_sides, two_sides)


ROOM = 4.0  # half its width


def light_scene(
    *, block: tuple[float, float, float] | None, at: tuple[float, float, float] = (0, 0, 0)
) -> SceneBuilder:
    """Make a room, of walls that are boxes, around `at`, with a block in it or not. It has no light yet."""
    boxes = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            middle, size = np.zeros(3), np.full(3, 2 * ROOM + 2)
            middle[axis], size[axis] = side * (ROOM + 0.5), 1.0
            boxes.append(translation(middle + at) @ scaling(size))
    blocks = [] if block is None else [np.add(block, at)]
    builder = make_boxes(*boxes, *blocks, name="room", specular_color=(0, 0, 0))
    builder.lights.sky = builder.lights.ground = (0.1, 0.1, 0.1)
    return builder


def add_light(
    builder: SceneBuilder, kind: str, at: tuple[float, ...], range: float = 16.0, casts: bool = True
) -> None:
    if kind == "point":
        builder.lights.add_point(at, range, intensity=6.0, casts_shadow=casts)
    else:
        outer = 0.6 if kind == "spot" else 1.4
        builder.lights.add_spot(
            at, (0.3, -1.0, 0.2), range, 0.8 * outer, outer, intensity=30.0, casts_shadow=casts
        )


def look_around(at: tuple[float, ...] = (0, 0, 0)) -> list[Camera]:
    """Return views of the corners of the room, in which three walls and seams of cube maps meet."""
    projection = Perspective(fov=1.6, aspect=1.0, near=0.05)
    directions = [np.array(corner, float) for corner in ((1, 1, 1), (-1, -1, 1), (1, -1, -1))]
    return [
        Camera.look_at(at - 1.5 * direction, at + direction, projection=projection)
        for direction in directions
    ]


LIGHTS = ShadowSettings(min_size=64, max_size=64)


render_lights = partial(render, size=48)


@pytest.mark.parametrize("filter", ShadowFilter)
@pytest.mark.parametrize("kind", ["point", "spot", "wide spot"])
def test_lit_walls_have_neither_acne_nor_seams(gl: rhi.Device, filter: ShadowFilter, kind: str) -> None:
    for at in ((0.3, 0.5, -0.2), (3.5, -3.9, 3.0)):  # in the middle, and where light grazes two walls
        for camera in look_around():
            images = []
            for casts in (False, True):
                builder = light_scene(block=None)
                add_light(builder, kind, at, casts=casts)
                images.append(render_lights(gl, builder.build(), camera, replace(LIGHTS, filter=filter)))
            flat = ~is_at_corner(camera, np.array(at), 48)
            assert flat.mean() > 0.5
            assert np.array_equal(images[0][flat], images[1][flat])


def is_at_corner(camera: Camera, light: NDArray[np.float64], size: int) -> NDArray[np.bool_]:
    """Return (size, size), where another wall of the room is within four texels of a map, seen from a light:
    there a filter finds that wall's depth."""
    across = ((np.arange(size) + 0.5) / size * 2 - 1) * np.tan(0.8)
    rays = np.stack(np.broadcast_arrays(across, -across[:, None], -1.0), -1) @ camera.rotation
    ends = (np.sign(rays) * ROOM - camera.position) / rays
    hit = camera.position + rays * ends.min(-1, keepdims=True)
    near = np.zeros((size, size), bool)
    for axis in range(3):
        edge = hit.copy()
        edge[..., axis] = np.sign(hit[..., axis]) * ROOM
        ways = [point - light for point in (hit, edge)]
        sine = np.linalg.norm(np.cross(*ways), axis=-1) / np.prod(
            [np.linalg.norm(way, axis=-1) for way in ways], 0
        )
        near |= (sine < 4 / 29) & (ends.argmin(-1) != axis)
    return near


@pytest.mark.parametrize("kind", ["point", "spot", "wide spot"])
def test_without_bias_walls_shade_themselves(gl: rhi.Device, kind: str) -> None:
    builder = light_scene(block=None)
    add_light(builder, kind, (0.3, 0.5, -0.2))
    scene, camera = builder.build(), look_around()[1]
    want, shadowed = (render_lights(gl, scene, camera, replace(LIGHTS, bias=bias)) for bias in (1.0, 0.0))
    assert (shadowed < want - 8).any(-1).mean() > 0.05


@pytest.mark.parametrize("away", [0.0, 1e5], ids=["at the origin", "100 km from it"])
@pytest.mark.parametrize("kind", ["point", "spot"])
def test_shadows_of_local_lights_end_within_a_texel_also_over_seams(
    gl: rhi.Device, kind: str, away: float
) -> None:
    at, light_position = (away, 0.0, away), np.array((-0.6, 1.5, -0.4))
    images, halves = [], []
    for casts in (False, True):
        builder = light_scene(block=(0.0, -1.0, 0.0), at=at)
        add_light(builder, kind, tuple(light_position + at), casts=casts)
        scene = builder.build()
        camera = Camera.look_at(
            np.add(at, (0, -1.6, 0)),
            np.add(at, (0, -2, 0)),
            (0, 0, -1),
            Orthographic(height=8.0, aspect=1.0, near=0.0, far=5.0),
        )
        images.append(
            render_lights(gl, scene, camera, replace(LIGHTS, min_size=128, max_size=128), size=128)[..., 0]
        )
        scene.lights.point["intensity"] *= 0.5
        scene.lights.spot["intensity"] *= 0.5
        halves.append(render_lights(gl, scene, camera, LIGHTS, size=128)[..., 0])
    half = halves[0]
    across = (np.arange(128) + 0.5) / 128 * 8 - 4
    floor = np.stack(np.meshgrid(across, across), -1).reshape(-1, 2)
    floor = np.stack([floor[:, 0], np.full(len(floor), -ROOM), floor[:, 1]], 1)
    to_light = light_position - floor
    texel = np.linalg.norm(to_light, axis=1, keepdims=True) / 61  # at most: of half a map, to the side
    aside = np.stack([np.cross(to_light, (1, 0, 0)), np.cross(to_light, (0, 0, 1))])
    aside /= np.linalg.norm(aside, axis=-1, keepdims=True)
    angles = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    blocked = np.stack(
        [
            is_between(
                floor + texel * (np.cos(a) * aside[0] + np.sin(a) * aside[1]),
                light_position,
                (0.0, -1.0, 0.0),
            )
            for a in angles
        ]
    )
    is_lit = images[0].reshape(-1) > half.reshape(-1) + 1
    is_middle = (np.abs(floor[:, [0, 2]]) < ROOM - 0.6).all(1)
    sure = is_lit & is_middle & (blocked.all(0) | ~blocked.any(0))
    lit = (images[1] >= half).reshape(-1)
    assert sure.sum() > 0.6 * is_lit.sum()
    assert (blocked.all(0) & sure).sum() > 100
    assert np.array_equal(lit[sure], ~blocked[0][sure])


def is_between(
    points: NDArray[np.float64], light: NDArray[np.float64], block: tuple[float, ...]
) -> NDArray[np.bool_]:
    """Return whether a unit block is between points (n, 3) and a light."""
    way = light - points
    with np.errstate(divide="ignore", invalid="ignore"):
        ends = np.stack([(np.array(block) + side - points) / way for side in (-0.5, 0.5)])
    enters, leaves = ends.min(0).max(-1), ends.max(0).min(-1)
    return np.asarray((leaves > np.maximum(enters, 0.0)) & (enters < 1.0))


@pytest.mark.nightly_cases("6[34]", reason=FEWER_CASES)
@pytest.mark.parametrize("number", [0, 63, 64, 130])
def test_each_of_many_local_lights_has_its_own_shadows(gl: rhi.Device, number: int) -> None:
    """One of 131 shines; the others have maps as well, 786 in all, and are too dim to be seen."""
    images = []
    for casts in (False, True):
        builder = light_scene(block=(0.0, -1.0, 0.0))
        for light_index in range(131):
            is_lit = light_index == number
            position = (-0.6, 1.5, -0.4) if is_lit else (3.0, 3.0, 3.0)
            builder.lights.add_point(position, 12.0, intensity=6.0 if is_lit else 1e-6, casts_shadow=casts)
        images.append(
            render_lights(gl, builder.build(), Camera.look_at((0, 3, 3), (0, -3, 0)), LIGHTS)[..., 0]
        )
    assert not (images[1] > images[0]).any()
    assert (images[1] < images[0] - 8).mean() > 0.03
    assert (images[1] == images[0]).mean() > 0.3


def test_a_spot_light_beside_point_lights_has_its_own_shadows(gl: rhi.Device) -> None:
    images = []
    for points, casts in ((0, False), (0, True), (3, True)):
        builder = light_scene(block=(0.0, -1.0, 0.0))
        for _ in range(points):
            builder.lights.add_point((3.0, 3.0, 3.0), 12.0, intensity=0.0, casts_shadow=True)
        add_light(builder, "spot", (-0.6, 1.5, -0.4), casts=casts)
        images.append(render_lights(gl, builder.build(), Camera.look_at((0, 3, 3), (0, -3, 0)), LIGHTS))
    plain, alone, beside = images
    assert (alone < plain - 8).any(-1).mean() > 0.03
    assert np.array_equal(beside, alone)


@pytest.mark.parametrize(("back_faces", "blocks"), [(False, False), (True, True)])
def test_a_light_inside_a_closed_caster_shines_through_unless_back_faces_are_drawn(
    gl: rhi.Device, back_faces: bool, blocks: bool
) -> None:
    builder = light_scene(block=(0, 0, 0))
    add_light(builder, "point", (0.1, 0.2, 0.0))
    scene, camera = builder.build(), look_around()[2]
    settings = replace(LIGHTS, back_faces=back_faces)
    shadowed = render_lights(gl, scene, camera, settings)
    scene.lights.point["casts_shadow"] = False
    plain = render_lights(gl, scene, camera, settings)
    assert ((shadowed < plain - 20).any(-1).mean() > 0.3) == blocks
    flat = ~is_at_corner(camera, np.array((0.1, 0.2, 0.0)), 48)
    assert (
        blocks or np.abs(shadowed[flat] - plain[flat]).max() <= 1
    )  # another program, which may round otherwise


@pytest.mark.parametrize("at", [(0.0, 0.501, 0.0), (0.501, 0.2, 0.0)], ids=["above it", "beside it"])
def test_a_caster_a_millimetre_from_a_local_light_casts_a_shadow(
    gl: rhi.Device, at: tuple[float, ...]
) -> None:
    builder = light_scene(block=(0, 0, 0))
    add_light(builder, "spot", at)  # beside the block, the near plane cuts through it
    scene, camera = builder.build(), Camera.look_at((0, -0.6, 0), (0, -4, 0), (0, 0, -1))
    shadowed = render_lights(gl, scene, camera, LIGHTS)
    scene.lights.spot["casts_shadow"] = False
    plain = render_lights(gl, scene, camera, LIGHTS)
    assert not (shadowed > plain).any()
    assert (shadowed < plain - 20).any(-1).mean() > 0.1


@pytest.mark.parametrize("size", [1, 2, 4])
def test_maps_of_few_texels_are_looked_up(gl: rhi.Device, size: int) -> None:
    scene, _ = block_scene(30.0)
    scene.lights.add_point((1.5, 2.0, 0.5), 8.0, intensity=4.0, casts_shadow=True)
    small = replace(SETTINGS, cascade_size=size, min_size=size, max_size=size)
    shadowed = render(gl, scene, Camera.look_at((3, 4, 5), (0, 0, 0)), small, casts=True)
    assert len(np.unique(shadowed)) > 4


def test_a_map_is_the_same_to_the_bit_after_a_move_below_a_texel(gl: rhi.Device) -> None:
    scene, _ = block_scene(30.0)
    scene.lights.directional["casts_shadow"] = True
    with open_renderer(gl, scene, size=(64, 64)) as renderer:
        renderer.shadows.settings = SETTINGS
        renderer.render(FLOOR_CAMERA)
        first, tiles = renderer.shadows.atlas.read().copy(), renderer.shadows.tiles
        moved = [
            replace(FLOOR_CAMERA, position=FLOOR_CAMERA.position + share * 0.3)
            for share in np.linspace(0.0, 1.0, 7)
        ]
        for camera in moved:
            renderer.render(camera)
            drawn = renderer.shadows.count("drawn")
            depths = renderer.shadows.atlas.read()
            assert renderer.shadows.tiles == tiles
            assert drawn or np.array_equal(depths, first)
            first = depths.copy()


def lit_block() -> Scene:
    """Make the block under a weak sun, beside a point light and a spot light."""
    scene, _ = block_scene(50.0)
    scene.lights.directional["intensity"] *= 0.3
    scene.lights.add_point((1.2, 1.5, 0.8), 6.0, intensity=2.0)
    scene.lights.add_spot((-1.5, 2.5, 1.0), (0.5, -1.0, -0.3), 8.0, 0.4, 0.7, intensity=8.0)
    return scene


def test_all_techniques_show_the_same_shadows(gl: rhi.Device) -> None:
    scene, camera = lit_block(), Camera.look_at((3, 4, 5), (0, 0, 0))
    images = {name: render(gl, scene, camera, casts=True, technique=name) for name in TECHNIQUES}
    for name, pixels in images.items():
        # Inferred lighting has light for 36 % of the pixels.
        assert (np.abs(pixels - images["forward"]).max(-1) > 3).mean() < (
            0.05 if name == "inferred" else 0.01
        ), name
    assert len(np.unique(images["forward"][..., 0])) > 2


def test_shadows_are_the_same_on_each_device(drawing_device: rhi.Device) -> None:
    scene, camera = lit_block(), Camera.look_at((3, 4, 5), (0, 0, 0))
    pixels, plain = (render(drawing_device, scene, camera, size=32, casts=casts) for casts in (True, False))
    darker = plain[..., 0] - pixels[..., 0]
    assert 0.03 < (darker > 4).mean() < 0.2
    assert len(np.unique(darker)) > 10
    assert not (pixels > plain).any()


BUMPS = np.random.default_rng(3).normal(size=(64, 64, 3))
BUMPS[..., 2] = np.abs(BUMPS[..., 2]) * 0.5
BUMPS /= np.linalg.norm(BUMPS, axis=-1, keepdims=True)
BUMPS = np.concatenate([np.round(127.5 + 127.5 * BUMPS), np.full((64, 64, 1), 255)], -1).astype(np.uint8)
"""A normal map whose normals are up to 90° beside the surface's own, 52° at the median."""


def render_plain_and_shadowed(
    device: rhi.Device,
    scene: Scene,
    camera: Camera,
    technique: str = "forward",
    filter: ShadowFilter = SETTINGS.filter,
) -> list[Pixels]:
    """Return a frame of a scene without shadows, and one with those of all lights."""
    settings = replace(SETTINGS, filter=filter, min_size=64, max_size=64)
    return [
        render(device, scene, camera, settings, casts=casts, technique=technique) for casts in (False, True)
    ]


def make_bumps(degrees: float) -> Scene:
    """Make a floor whose normals are bent, under a sun of this slope."""
    scene = make_slope(degrees, BUMPS)
    scene.lights.directional["intensity"] = 1.0
    return scene


def test_normal_maps_bring_no_acne_at_any_slope(gl: rhi.Device) -> None:
    scene = make_bumps(0.0)
    with open_renderer(gl, scene, size=(64, 64)) as renderer:
        renderer.shadows.settings = SETTINGS
        for degrees in SLOPES:
            scene.lights.directional["direction"] = make_bumps(degrees).lights.directional["direction"]
            images = []
            for casts in (False, True):
                scene.lights.directional["casts_shadow"] = casts
                images.append(read_colors(renderer.render(FLOOR_CAMERA)))
            assert (images[0] > images[0].min() + 20).any(-1).mean() > 0.1
            assert np.abs(images[1] - images[0]).max() <= 1, degrees


@pytest.mark.nightly_cases("*_*", "inferred", "clustered", reason=FEWER_CASES)
@pytest.mark.parametrize("technique", TECHNIQUES)
def test_normal_maps_bring_no_acne_with_any_technique_and_light(gl: rhi.Device, technique: str) -> None:
    scene = make_bumps(75.0)
    scene.lights.directional["intensity"] = 0.3
    scene.lights.add_point((2.0, 0.5, 1.0), 8.0, intensity=2.0)
    scene.lights.add_spot((-2.0, 0.5, 1.0), (1.0, -0.3, 0.0), 8.0, 0.4, 0.7, intensity=8.0)
    plain, shadowed = render_plain_and_shadowed(gl, scene, FLOOR_CAMERA, technique)
    assert np.abs(shadowed - plain).max() <= 1


def test_normal_maps_neither_detach_shadows_nor_widen_them(gl: rhi.Device) -> None:
    camera = Camera.look_at((3, 4, 5), (0, 0, 0))
    shadows = []
    for normal_map in (None, BUMPS):
        scene, _ = block_scene(60.0, normal_map)
        plain, shadowed = render_plain_and_shadowed(gl, scene, camera, filter=ShadowFilter.HARD)
        shadows.append((shadowed < plain - 1).any(-1))
        is_lit = plain[..., 0] > np.median(shadowed[..., 0][shadows[-1]]) + 20
    flat, bumpy = shadows
    assert (flat & is_lit).sum() > 50
    assert np.array_equal(flat[is_lit], bumpy[is_lit])


@pytest.mark.parametrize("technique", ["forward", "deferred", "deferred_plus"])
@pytest.mark.parametrize("above", [True, False])
def test_normal_maps_let_no_light_through_a_leaf(gl: rhi.Device, technique: str, above: bool) -> None:
    scene = leaf_scene(double_sided=True, normal_texture=BUMPS, specular_color=(0, 0, 0))
    eye = (0.0, 2.0 + (1.2 if above else -1.2), 0.0)
    camera = Camera.look_at(eye, (0, 2, 0), (0, 0, -1))
    plain, shadowed = render_plain_and_shadowed(gl, scene, camera, technique)
    scene.lights.directional["intensity"] = 0.0
    dark = render_plain_and_shadowed(gl, scene, camera, technique)[0]
    assert ((plain > dark + 8).any(-1)).mean() > 0.05
    assert np.abs(shadowed - (plain if above else dark)).max() <= 1


@pytest.mark.parametrize(("bends", "casts"), [(False, False), (False, True), (True, False), (True, True)])
def test_only_shadows_on_normal_maps_take_a_second_normal(bends: bool, casts: bool) -> None:
    scene, _ = block_scene(60.0, BUMPS if bends else None)
    scene.lights.add_point((2.0, 0.5, 1.0), 8.0)
    if casts:
        scene.lights.cast_shadows()
    small = partial(Deferred, normal_bits=8)
    for make in (*map(TECHNIQUES.__getitem__, ("deferred", "light_pre_pass", "inferred")), small):
        with (
            rhi.create_device("null") as device,
            Renderer(device, scene, technique=make(), size=(32, 16)) as renderer,
        ):
            renderer.render(FLOOR_CAMERA)
            _, plan = renderer.plan(FLOOR_CAMERA)
            formats = {
                texture.format
                for texture in plan.textures
                if any(name.endswith("surface") for name in texture.names)
            }
        words = (1 if make is small else 2) * (2 if bends and casts else 1)
        assert [format.channels for format in formats] == [words]


def build_wall(lights: int, spots: int = 0, *, walled: bool = True) -> Scene:
    """Make a floor and a wall across it, behind which, at x < 0, all lights are."""
    builder = make_boxes(base_color=(0.8, 0.8, 0.8))
    floor = builder.add_node(translation((0, -0.5, 0)) @ scaling((60, 1, 60)))
    builder.add_objects(floor, 0, 0, casts_shadow=False)
    # Without the wall there is a caster in the range of each, in the way of nothing that is seen.
    caster = scaling((0.5, 20, 60)) if walled else translation((-2, -3, 0)) @ scaling((0.5, 0.5, 40))
    builder.add_objects(builder.add_node(caster), 0, 0)
    positions = np.random.default_rng(1).uniform((-4, 1, -8), (-1, 4, 2), (lights + spots, 3))
    builder.lights.add_points(positions[:lights], 8.0, intensity=6.0, casts_shadow=True)
    if spots:
        builder.lights.add_spots(
            positions[lights:], (1, -0.5, 0), 8.0, 0.3, 0.7, intensity=6.0, casts_shadow=True
        )
    builder.lights.sky = builder.lights.ground = builder.background = (0.0, 0.0, 0.0)
    return builder.build()


TIGHT = ShadowSettings(cascades=1, cascade_size=16, min_size=64, max_size=64, max_atlas_size=256)
"""Settings that have room for 16 maps: those of two point lights."""
BESIDE_THE_WALL = Camera.look_at((6, 5, 5), (2, 0, -4))


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("name", ["forward", "deferred", "clustered"])
def test_local_lights_without_room_for_maps_shine_through_no_wall(
    drawing_device: rhi.Device, name: str, caplog: pytest.LogCaptureFixture
) -> None:
    technique = TECHNIQUES[name]()
    for lights, spots, dark in ((2, 0, 0), (3, 0, 1), (12, 0, 10), (2, 4, 0), (2, 5, 1), (12, 6, 11)):
        caplog.clear()
        scene = build_wall(lights, spots)
        with open_renderer(drawing_device, scene, technique, size=(64, 36)) as renderer:
            renderer.shadows.settings = TIGHT
            image = read_colors(renderer.render(BESIDE_THE_WALL))
            assert renderer.shadows.unshadowed_lights == dark, (lights, spots)
            warnings = [record for record in caplog.records if record.name == "rhi.shadows"]
            assert len(warnings) == (renderer.shadows.unshadowed_lights > 0)
            renderer.render(BESIDE_THE_WALL)
            assert len([record for record in caplog.records if record.name == "rhi.shadows"]) == len(warnings)
        assert (image.sum(2) > 30).sum() == 0, (lights, spots)
    with open_renderer(drawing_device, build_wall(2, walled=False), technique, size=(64, 36)) as renderer:
        lit = read_colors(renderer.render(BESIDE_THE_WALL))
    assert (lit.sum(2) > 30).mean() > 0.1  # the control: without the wall they light the floor


@pytest.mark.parametrize("width", [64, 128])
def test_the_foot_of_a_thin_wall_keeps_the_light_of_coarse_maps_off(
    drawing_device: rhi.Device, width: int
) -> None:
    with open_renderer(
        drawing_device, build_wall(250), TECHNIQUES["clustered"](), size=(128, 72)
    ) as renderer:
        renderer.shadows.settings = ShadowSettings(min_size=width, max_size=width)
        image = read_colors(renderer.render(BESIDE_THE_WALL))
    # Of the filter, up to 2/3 may find the floor in front of the wall: its edge is drawn half a texel off.
    assert (image.sum(2) > 30).sum() == 0


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_local_lights_that_nothing_shades_are_lit_however_many_there_are(drawing_device: rhi.Device) -> None:
    scene = build_wall(12)
    scene.objects.casts_shadow[:] = False
    with open_renderer(drawing_device, scene, size=(64, 36)) as renderer:
        renderer.shadows.settings = TIGHT
        image = read_colors(renderer.render(BESIDE_THE_WALL))
        assert renderer.shadows.unshadowed_lights == 0
    assert (image.sum(2) > 30).mean() > 0.1
