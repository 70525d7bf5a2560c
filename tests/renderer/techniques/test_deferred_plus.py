"""Deferred+: what it stores, where materials are shaded, and what it costs."""

from __future__ import annotations

from inspect import signature
from typing import Any

import numpy as np
import pytest
from frames import draw_each, first_view_camera, make_boxes, max_difference, open_renderer, read_colors
from nightly_reasons import ONLY_KERNELS
from numpy.typing import NDArray

import rhi
from renderer import rules
from renderer.content import BUILT_IN, load_scene
from renderer.lab.measure.plan_report import describe_plan
from renderer.renderer import Renderer
from renderer.scene import (
    AlphaMode,
    Camera,
    Scene,
    SceneBuilder,
    TextureMap,
    make_geometry,
    scaling,
    translation,
)
from renderer.techniques import DeferredPlus, Forward, Technique, TiledDeferred
from renderer.techniques.deferred_plus import PackedShading
from renderer.techniques.parts.geometry_buffer import MAX_MATERIALS
from renderer.techniques.parts.material_bins import PixelBins
from renderer.techniques.parts.material_rectangles import MaterialRectangles
from renderer.techniques.parts.packed_geometry import PackedPlain, PackedTextures
from renderer.techniques.technique_settings import TechniqueSettings
from renderer.visibility import FrustumCulling, TwoPassCulling
from rhi import Op, Stage
from rhi.shading import compile_shader

SIZE = (96, 64)
EYE = Camera.look_at((0, 6, 12), (0, 0, 0))


def scatter(materials: int, *, images: bool = True, objects: int = 60, unused: int = 0) -> Scene:
    """Make boxes and spheres on a floor, with materials in turn; `unused` ones come first."""
    random, object_positions = np.random.default_rng(7), np.random.default_rng(8)
    builder = SceneBuilder("scatter")
    texture = builder.add_image(random.integers(0, 256, (32, 32, 4), np.uint8)) if images else -1
    for _ in range(unused):
        builder.add_material()
    rows = [
        builder.add_material(base_color=random.uniform(0.2, 1.0, 3), texture=texture if number % 3 else -1)
        for number in range(materials)
    ]
    meshes = [builder.add_mesh(BUILT_IN[name]()) for name in ("box", "sphere")]
    builder.add_objects(builder.add_node(translation((0, -1, 0)) @ scaling((30, 1, 30))), meshes[0], rows[0])
    for number in range(objects):
        node = builder.add_node(translation(object_positions.uniform((-8, -0.5, -8), (8, 2, 8))))
        builder.add_objects(node, meshes[number % 2], rows[number % materials])
    for position in random.uniform((-8, 1, -8), (8, 4, 8), (6, 3)):
        builder.lights.add_point(position, 6.0, random.uniform(0.3, 1.0, 3), 4.0)
    builder.lights.add_directional((-0.3, -1.0, -0.2), intensity=0.7)
    builder.views["eye"] = EYE
    return builder.build()


def draw(device: rhi.Device, scene: Scene, *, multi_pass: bool) -> dict[str, NDArray[Any]]:
    """Return the contents of a frame, and its rectangles."""
    with open_renderer(device, scene, DeferredPlus(multi_pass=multi_pass), size=SIZE) as renderer:
        targets = renderer.render(EYE).targets
        names = ("image", "depth", "packed", *(("material ids",) if multi_pass else ()))
        resources = {name: targets[name].read() for name in names}
        if multi_pass:
            resources["rectangles"] = renderer.view.workspace(MaterialRectangles).read()
    return resources


# the buffer


@pytest.mark.parametrize("images", [False, True])
def test_a_pixel_takes_at_most_16_bytes_and_depth(images: bool) -> None:
    report = describe_plan(scatter(3, images=images), DeferredPlus(), EYE, SIZE)
    geometry = report.passes[0]
    assert geometry.writes == ["packed", "depth"]
    assert geometry.bytes == SIZE[0] * SIZE[1] * ((16 if images else 8) + 4)


@pytest.mark.parametrize("shader", [PackedPlain, PackedTextures])
def test_no_texel_and_no_material_is_read_when_geometry_is_drawn(shader: type[Any]) -> None:
    names = {binding.name for binding in compile_shader(shader).bindings}
    assert names == {"view", "objects", "object_positions"}


def test_a_scene_without_images_or_local_lights_binds_neither(null: rhi.Device) -> None:
    scene = scatter(3, images=False)
    scene.lights.point = scene.lights.point[:0]
    with open_renderer(null, scene, DeferredPlus(), size=SIZE) as renderer:
        renderer.render(EYE)
        labels = {c["descriptor"].label for c in null.stream.filter(Op.CREATE_BUFFER)}
        assert renderer.plan(EYE)[1].textures[0].format == rhi.Format.RG32UI
    assert not labels & {"point lights", "light rows", "rectangles"}


@pytest.mark.parametrize("technique", [DeferredPlus(), TiledDeferred(normal_bits=8)])
def test_a_buffer_of_16_bits_refuses_more_materials(null: rhi.Device, technique: Technique) -> None:
    scene = scatter(1)
    for count, is_refused in ((MAX_MATERIALS, False), (MAX_MATERIALS + 1, True)):
        scene.materials = np.repeat(scene.materials[:1], count)
        with open_renderer(null, scene, technique, size=SIZE) as renderer:
            if is_refused:
                with pytest.raises(rhi.ValidationError) as refusal:
                    renderer.render(EYE)
                assert refusal.value.rule is rules.TOO_MANY_MATERIALS
            else:
                renderer.render(EYE)


# images


def tiles(uv: float) -> Scene:
    """Make a wall whose texture coordinates begin at `uv`, seen at a slant."""
    random = np.random.default_rng(5)
    builder = SceneBuilder("wall")
    image = np.kron(random.integers(0, 256, (16, 16, 4), np.uint8), np.ones((8, 8, 1), np.uint8))
    corners = np.array([(-4, -3, 0), (4, -3, 0), (4, 3, 0), (-4, 3, 0)], float)
    object_positions = np.array([(0, 2), (3, 2), (3, 0), (0, 0)]) + uv
    mesh = builder.add_mesh(make_geometry(corners, [0, 1, 2, 0, 2, 3], uv=object_positions))
    builder.add_objects(builder.add_node(), mesh, builder.add_material(texture=builder.add_image(image)))
    builder.lights.sky = builder.lights.ground = (0.8, 0.8, 0.8)
    return builder.build()


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("uv", [0.999999, -0.25, 1000.3])
def test_textures_are_filtered_as_in_forward_shading_wherever_they_begin(
    drawing_device: rhi.Device, uv: float
) -> None:
    scene, camera = tiles(uv), Camera.look_at((3.5, 1, 3), (0, 0, 0))
    lit, shaded = draw_each(drawing_device, scene, Forward(), DeferredPlus(), camera=camera, size=SIZE)
    assert np.ptp(lit[..., :3]) > 100
    assert max_difference(lit, shaded) <= 2


# materials


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_rectangles_hold_all_pixels_of_their_material_and_tile(drawing_device: rhi.Device) -> None:
    resources = draw(drawing_device, scatter(20, unused=3), multi_pass=True)
    ids = np.round(resources["material ids"].astype(np.float64) * 65535.0).astype(int)
    expected = {}
    for y in range(0, SIZE[1], 32):
        for x in range(0, SIZE[0], 32):
            part = ids[y : y + 32, x : x + 32]
            for material in np.unique(part[part < 23]).tolist():
                rows, columns = np.nonzero(part == material)
                first = (x + columns.min(), y + rows.min())
                expected[material, x // 32, y // 32] = (*first, np.ptp(columns) + 1, np.ptp(rows) + 1)
    listed = {(m, x // 32, y // 32): (x, y, w, h) for m, x, y, w, h in resources["rectangles"].tolist()}
    assert len(listed) == len(resources["rectangles"]) > 30
    assert listed == expected
    assert min(material for material, _, _ in listed) == 3


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_tiles_with_many_materials_have_all_their_rectangles(drawing_device: rhi.Device) -> None:
    """llvmpipe ends loops after 65,535 turns: with 64 materials in a tile the rest was missing."""
    scene, size = load_scene("bazaar"), (160, 90)
    camera = first_view_camera(scene).with_aspect(size[0] / size[1])
    with open_renderer(drawing_device, scene, DeferredPlus(multi_pass=True), size=size) as renderer:
        result = renderer.render(camera)
        materials = result.targets["packed"].read()[..., 1] & 0xFFFF
        tiles = [materials[y : y + 32, x : x + 32] for y in (0, 32, 64) for x in range(0, 160, 32)]
        assert max(len(np.unique(tile)) for tile in tiles) > 64
        image = read_colors(result)
        renderer.technique = DeferredPlus()
        assert max_difference(image, read_colors(renderer.render(camera))) == 0


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize(
    "spec", ["yard:columns=3,lights=2", "bazaar:instances=400,materials=70,meshes=40,lights=8"]
)
def test_bins_hold_each_pixel_once_by_shader_and_by_material(drawing_device: rhi.Device, spec: str) -> None:
    scene, size = load_scene(spec), (97, 61)
    camera = first_view_camera(scene).with_aspect(size[0] / size[1])
    with open_renderer(drawing_device, scene, DeferredPlus(binned=True), size=size) as renderer:
        for _ in range(2):
            targets = renderer.render(camera).targets
        listed = renderer.view.workspace(PixelBins).read()
        rows = (targets["packed"].read()[..., 1] & 0xFFFF).astype(int)
        covered = targets["depth"].read() > 0.0
    assert len(listed) == 1 + len(scene.shaders)
    together = np.concatenate(listed)
    assert len(together) == len(np.unique(together, axis=0)) == covered.sum() > 1000
    for number, pixels in enumerate(listed):
        assert covered[pixels[:, 1], pixels[:, 0]].all()
        material_indices = rows[pixels[:, 1], pixels[:, 0]]
        assert (scene.materials["shader"][material_indices] == number).all()
        assert (np.diff(material_indices) >= 0).all(), "those of a material side by side"
    # Runs of the pixels of 8 × 8 groups: far fewer than pixels.
    groups = together // 8
    assert 1 + np.count_nonzero((np.diff(groups, axis=0) != 0).any(axis=1)) < len(together) / 4


def test_lists_of_pixels_take_a_dispatch_for_each_shader(null: rhi.Device) -> None:
    for spec, shaders in (("yard", 4), ("grid:count=4", 1)):
        scene = load_scene(spec)
        null.stream.clear()
        with open_renderer(null, scene, DeferredPlus(binned=True), size=SIZE) as renderer:
            renderer.render(first_view_camera(scene))
            assert len(null.stream.filter(Op.DISPATCH_INDIRECT)) == shaders


def test_multi_pass_and_binned_shading_exclude_each_other() -> None:
    with pytest.raises(rhi.ValidationError, match="one of them"):
        DeferredPlus(multi_pass=True, binned=True)
    with pytest.raises(rhi.ValidationError, match="one of them"):
        TechniqueSettings(multi_pass=True, binned=True)
    for choice in ({"multi_pass": True}, {"binned": True}):
        with pytest.raises(rhi.ValidationError, match="samples=1"):
            DeferredPlus(4, **choice)
        with pytest.raises(rhi.ValidationError, match="samples=1"):
            TechniqueSettings("deferred_plus", samples=4, **choice)
        assert TechniqueSettings("forward", samples=4, **choice).samples == 4


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_materials_come_back_from_the_packed_buffer(drawing_device: rhi.Device) -> None:
    resources = draw(drawing_device, scatter(20), multi_pass=True)
    seen = resources["depth"] > 0.0
    ids = np.round(resources["material ids"].astype(np.float64) * 65535.0).astype(int)
    assert (ids[seen] == (resources["packed"][..., 1] & 0xFFFF)[seen]).all()
    assert (ids[~seen] == 65535).all()
    assert 0 < seen.sum() < seen.size


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("multi_pass", [False, True])
def test_a_material_is_shaded_where_it_is_seen_however_many_there_are(
    drawing_device: rhi.Device, monkeypatch: pytest.MonkeyPatch, multi_pass: bool
) -> None:
    """The samples that pass the depth test of the last pass are the fragments that are shaded: nothing is
    discarded later, neither by one pass (the next test) nor where rectangles are drawn, which lie on pixels
    of their material."""
    query = drawing_device.occlusion_query()
    name = "draw_indirect" if multi_pass else "draw"
    draw_once = getattr(rhi.Device, name)

    def counted(device: rhi.Device, program: rhi.Program[...], *args: Any, **bindings: Any) -> None:
        if "packed" not in bindings or "ambient" not in bindings:
            draw_once(device, program, *args, **bindings)
            return
        with query:
            draw_once(device, program, *args, **bindings)

    shaded, areas = [], []
    for materials in (2, 50):
        with monkeypatch.context() as patch:
            patch.setattr(rhi.Device, name, counted)
            resources = draw(drawing_device, scatter(materials), multi_pass=multi_pass)
        shaded.append(query.wait())
        assert shaded[-1] == (resources["depth"] > 0.0).sum() < resources["depth"].size
        if multi_pass:
            areas.append(int((resources["rectangles"][:, 3] * resources["rectangles"][:, 4]).sum()))
    assert shaded[0] == shaded[1] > 1000  # 25 times as many materials, the same fragments
    # depth tests: with one rectangle a material, there are up to 50 images of them
    assert all(area < 8 * count for area, count in zip(areas[1:], shaded[1:], strict=bool(areas)))


def test_pixels_without_a_surface_are_left_out_before_they_are_shaded(null: rhi.Device) -> None:
    """Reading the depth and discarding them would be too late."""
    scene = scatter(2)
    with open_renderer(null, scene, DeferredPlus(), size=SIZE) as renderer:
        renderer.render(EYE)
        targets = renderer.render(EYE).targets
        begun = null.stream.filter(Op.BEGIN_PASS)[-1]["descriptor"]
        assert begun.colors[0].texture == targets["image"].id
        assert begun.depth.texture == targets["depth"].id
        assert begun.depth.clear is None
    assert "discard" not in compile_shader(PackedShading).emit("glsl", Stage.FRAGMENT).text


def test_all_65536_materials_are_those_of_forward_shading(gl: rhi.Device) -> None:
    """Also the last one, which has the depth of the background: that isn't shaded for it."""
    random, parts = np.random.default_rng(12), vars(scatter(1, images=False))
    materials = np.repeat(parts["materials"], MAX_MATERIALS)
    materials["base_color"][:, :3] = random.uniform(0.1, 1.0, (MAX_MATERIALS, 3))
    parts = {name: parts[name] for name in signature(Scene).parameters if name in parts} | {
        "materials": materials
    }
    scene = Scene(**parts)
    rows = scene.objects.material
    rows[:] = random.integers(0, MAX_MATERIALS, len(rows))
    rows[:2] = MAX_MATERIALS - 1, 0  # the floor, and a box
    images = []
    with open_renderer(gl, scene, size=SIZE) as renderer:
        for renderer.technique in (Forward(), DeferredPlus(), DeferredPlus(multi_pass=True)):
            images.append(renderer.render(EYE).image.read().astype(int))
        rectangles = renderer.view.workspace(MaterialRectangles).read()
    assert np.abs(images[1] - images[0]).max() <= 2
    assert (images[2] == images[1]).all()
    assert {0, MAX_MATERIALS - 1} <= set(rectangles[:, 0].tolist()) <= {*rows.tolist(), MAX_MATERIALS - 1}
    assert len(np.unique(images[0].reshape(-1, 4), axis=0)) > 100


def test_the_list_has_room_for_each_material_in_each_tile(null: rhi.Device) -> None:
    with open_renderer(null, scatter(5), DeferredPlus(multi_pass=True), size=(65, 32)) as renderer:
        renderer.render(EYE)
        assert renderer.view.workspace(MaterialRectangles).rectangles.count == 3 * 5  # of 32 × 32 pixels


# two-pass culling


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_the_second_pass_draws_little_and_nothing_is_missing(device: rhi.Device) -> None:
    """A walk through a grid of boxes, of which few are visible: what the first pass misses is under 3 % of
    all, and no pixel is wrong."""
    along = 2.0 * np.arange(-8, 9)
    scene = make_boxes(
        *(translation((x, 0, z)) @ scaling((1.5, 2, 1.5)) for x in along for z in along)
    ).build()
    culling = TwoPassCulling(scene, device)
    first = second = 0
    with (
        Renderer(device, scene, technique=DeferredPlus(), visibility=culling, size=SIZE) as culled,
        Renderer(
            device, scene, technique=DeferredPlus(), visibility=FrustumCulling(scene), size=SIZE
        ) as whole,
    ):
        for frame in range(24):
            camera = Camera.look_at((0.02 * frame, 0.5, 20.0 - 0.05 * frame), (0.02 * frame, 0.4, 0.0))
            image = culled.render(camera).image.read()
            if frame % 6 == 0:
                assert (image == whole.render(camera).image.read()).all()
            if frame:
                first += len(culling.first.read_object_indices())
                second += len(culling.second.read_object_indices())
    culling.destroy()
    instances = 23 * len(scene.objects)
    assert 0 < first < 0.1 * instances
    assert 0 < second <= 0.03 * instances


# materials with maps


def painted(builder: SceneBuilder, random: np.random.Generator, low: int, high: int) -> int:
    """Add an image of 8 × 8 fields."""
    image = np.full((32, 32, 4), 255, np.uint8)
    image[..., :3] = np.kron(random.integers(low, high, (8, 8, 3)), np.ones((4, 4, 1)))
    return builder.add_image(image)


def mapped(scale: float, *, unlike: bool = False, uniform: bool = False) -> Scene:
    """Make things whose materials have all maps, repeated `scale` times, and two sides or one; with `unlike`,
    normals have another scale; `uniform` ones are the same all over an image."""
    random = np.random.default_rng(9)
    builder = SceneBuilder("mapped")
    rows = []
    for number in range(4):
        colors, metals = (painted(builder, random, *limits) for limits in ((80, 255), (60, 255)))
        if uniform:
            bent = builder.add_image(np.full((32, 32, 4), (150, 100, 200, 255), np.uint8))
        else:
            bent = painted(builder, random, 100, 156)
        row = builder.add_material(
            texture=TextureMap(colors, scale=(scale, scale)),
            normal_texture=TextureMap(bent, scale=(2.0 if unlike else scale, scale)),
            metallic_roughness_texture=TextureMap(metals, scale=(scale, scale)),
            occlusion_texture=TextureMap(colors, scale=(scale, scale)),
            emissive=(0.1, 0.0, 0.1),
            double_sided=number % 2 == 1,
        )
        rows.append(row)
    meshes = [builder.add_mesh(BUILT_IN[name]()) for name in ("plane", "sphere")]
    builder.add_objects(builder.add_node(scaling((30, 1, 30))), meshes[0], rows[0])
    for number in range(24):
        position = translation(random.uniform((-7, 0.5, -7), (7, 2.5, 7)))
        turned = scaling((1.5, 1.5, -1.5) if number % 3 else (1.5, 1.5, 1.5))
        builder.add_objects(builder.add_node(position @ turned), meshes[1], rows[number % 4])
    for position in random.uniform((-7, 1, -7), (7, 4, 7), (6, 3)):
        builder.lights.add_point(position, 7.0, random.uniform(0.3, 1.0, 3), 3.0)
    return builder.build()


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("scale", [1.0, 1.7])
def test_maps_are_evaluated_as_in_forward_shading(drawing_device: rhi.Device, scale: float) -> None:
    """On llvmpipe, textures are filtered to 8 bits. So what is stored with an error may make a normal of a
    map that is 0.4° off, which shows in sharp highlights: in a pixel of a thousand."""
    scene, images = mapped(scale), []
    with open_renderer(drawing_device, scene, size=SIZE) as renderer:
        for renderer.technique in (Forward(), DeferredPlus(), DeferredPlus(multi_pass=True)):
            images.append(renderer.render(EYE).image.read().astype(int))
        assert [frame_pass.name for frame_pass in renderer.plan(EYE)[1].passes][-1] == "shading"
    assert np.ptp(images[0][..., :3]) > 100
    off = np.abs(images[1] - images[0]).max(2)
    assert (off > 2).mean() <= 0.001
    assert (images[1] == images[2]).all()


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_normals_that_are_not_filtered_are_those_of_forward_shading(drawing_device: rhi.Device) -> None:
    """The bits of normals and tangents alone make no pixel differ by more than 2."""
    scene = mapped(1.7, uniform=True)
    lit, shaded = draw_each(drawing_device, scene, Forward(), DeferredPlus(), camera=EYE, size=SIZE)
    assert np.ptp(lit[..., :3]) > 100
    assert 0 < max_difference(lit, shaded) <= 2


SQUARE = [(0, 1), (1, 1), (1, 0), (0, 0)]
ODD_SQUARES: dict[str, tuple[list[tuple[float, float]], dict[str, Any]]] = {
    "a map with texels without a direction": (SQUARE, {"normal_texture": "grey"}),
    "a mirrored texture": ([(1, 1), (0, 1), (0, 0), (1, 0)], {"normal_texture": "bumps"}),
    "a texture of no extent": ([(0.3, 0.3)] * 4, {"normal_texture": "bumps"}),
    "a texture of no height": ([(0, 0), (1, 0), (1, 0), (0, 0)], {"normal_texture": "bumps"}),
    "far from 0": ([(u + 1000.3, v - 0.25) for u, v in SQUARE], {"texture": "colors"}),
    "a single texel": (SQUARE, {"texture": "texel", "normal_texture": "flat"}),
    "a line of texels": (SQUARE, {"texture": "line"}),
    "a mirror": (SQUARE, {"texture": "colors", "metallic": 1.0, "roughness": 0.0}),
    "a mask at its cut": (
        SQUARE,
        {"texture": "holes", "alpha_mode": AlphaMode.MASK, "alpha_cutoff": 64 / 255},
    ),
}


def odd_squares() -> Scene:
    """Make a square of each of these, before a dark wall."""
    random = np.random.default_rng(3)
    builder = SceneBuilder("odd squares")
    colors = np.kron(random.integers(60, 255, (4, 4, 4)), np.ones((8, 8, 1))).astype(np.uint8)
    bumps = np.kron(random.integers(100, 156, (4, 4, 4)), np.ones((8, 8, 1))).astype(np.uint8)
    bumps[..., 2] = 220
    grey, holes = bumps.copy(), colors.copy()
    grey[:16] = 128
    holes[..., 3] = np.arange(61, 69).repeat(4)  # the cut, and both sides of it
    pixels = {
        "colors": colors,
        "bumps": bumps,
        "grey": grey,
        "holes": holes,
        "texel": np.full((1, 1, 4), (90, 200, 120, 255), np.uint8),
        "flat": np.full((1, 1, 4), (150, 100, 220, 255), np.uint8),
        "line": random.integers(0, 256, (1, 8, 4), np.uint8).repeat(1024, axis=1),
    }
    images = {name: builder.add_image(image) for name, image in pixels.items()}
    corners = np.array([(-0.95, -0.95, 0), (0.95, -0.95, 0), (0.95, 0.95, 0), (-0.95, 0.95, 0)])
    for number, (uv, values) in enumerate(ODD_SQUARES.values()):
        maps = {name: images.get(value, value) for name, value in values.items()}
        material = builder.add_material(**{"roughness": 0.4, **maps})
        mesh = builder.add_mesh(make_geometry(corners, [0, 1, 2, 0, 2, 3], uv=uv))
        position = translation((2.0 * (number % 3) - 2.0, 2.0 - 2.0 * (number // 3), 0.0))
        builder.add_objects(builder.add_node(position), mesh, material)
    builder.lights.sky = builder.lights.ground = (0.3, 0.3, 0.35)
    builder.lights.add_directional((-0.5, -0.7, -0.6), (1, 0.95, 0.9), 1.2)
    for position in random.uniform((-3, -3, 0.6), (3, 3, 1.5), (6, 3)):
        builder.lights.add_point(position, 3.0, random.uniform(0.2, 1, 3), 1.5)
    return builder.build()


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_odd_squares_are_those_of_forward_shading(drawing_device: rhi.Device) -> None:
    scene, images = odd_squares(), []
    camera = Camera.look_at((0, 0, 6.5), (0, 0, 0)).with_aspect(1.0)
    with open_renderer(drawing_device, scene, size=(96, 96)) as renderer:
        for renderer.technique in (Forward(), DeferredPlus()):
            images.append(renderer.render(camera).image.read().astype(int))
        assert [frame_pass.name for frame_pass in renderer.plan(camera)[1].passes][-1] == "shading"
    off = np.abs(images[1] - images[0]).max(2)
    assert (off > 3).mean() <= (0.001 if drawing_device.backend_name == "gl" else 0.0)  # as above
    squares = [images[0][y : y + 20, x : x + 20, :3] for y in (10, 38, 66) for x in (10, 38, 66)]
    contrasts = dict(
        zip(ODD_SQUARES, (np.ptp(square.reshape(-1, 3), axis=0).max() for square in squares), strict=True)
    )
    assert min(contrasts.values()) > 10, contrasts
    hole = (squares[-1] == images[0][0, 0, :3]).all(2)
    assert 0.2 < hole.mean() < 0.6, "3 of 8 columns are below the cut"


def test_coordinates_that_the_buffer_has_no_room_for_are_drawn_with_another_buffer() -> None:
    for unlike, last in ((False, "shading"), (True, "resolve")):
        scene = mapped(1.7, unlike=unlike)
        report = describe_plan(scene, DeferredPlus(), EYE, SIZE)
        assert report.passes[-1].name == last


def painted_corners(*, uv_set: int, colored: bool) -> SceneBuilder:
    """Make a slanted square whose two sets of texture coordinates are far apart, and whose corners have
    colours."""
    random = np.random.default_rng(5)
    builder = SceneBuilder("corners")
    more = {"color": random.uniform(0.2, 1.0, (4, 4))} if colored else {}
    corners = np.array([(-4, -3, 0), (4, -3, -2), (4, 3, -2), (-4, 3, 0)], float)
    uv = np.array([(0, 1), (1, 1), (1, 0), (0, 0)], float)
    geometry = make_geometry(corners, [0, 1, 2, 0, 2, 3], uv=uv, uv2=3.0 * uv[:, ::-1] + 0.3, **more)
    texture = TextureMap(painted(builder, random, 60, 255), uv_set=uv_set)
    builder.add_objects(builder.add_node(), builder.add_mesh(geometry), builder.add_material(texture=texture))
    builder.lights.sky = builder.lights.ground = (0.7, 0.7, 0.7)
    builder.views["eye"] = EYE
    return builder


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("colored", [False, True])
@pytest.mark.parametrize("uv_set", [0, 1])
def test_second_coordinates_and_colours_of_vertices_are_in_the_buffer(
    drawing_device: rhi.Device, uv_set: int, colored: bool
) -> None:
    scene = painted_corners(uv_set=uv_set, colored=colored).build()
    geometry, *_, last = describe_plan(scene, DeferredPlus(), EYE, SIZE).passes
    assert last.name == "shading"
    assert geometry.bytes == SIZE[0] * SIZE[1] * (16 + 4 + 4 * colored)
    techniques = Forward(), DeferredPlus(), DeferredPlus(multi_pass=True), DeferredPlus(binned=True)
    forward, *others = draw_each(drawing_device, scene, *techniques, size=SIZE)
    assert forward[..., :3].std() > 15
    assert max(max_difference(forward, image) for image in others) <= 3
    other = draw_each(
        drawing_device, painted_corners(uv_set=1 - uv_set, colored=colored).build(), Forward(), size=SIZE
    )
    assert max_difference(forward, other[0]) > 40
