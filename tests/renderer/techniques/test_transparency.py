"""Transparent surfaces: what they show, compared with compositing in float64, and what they cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import frames
import numpy as np
import pytest
from frames import SIZE, count_draws, draw, make_boxes, max_difference, open_renderer, read_colors, record
from lighting_reference import encode, reference_plane_light, tone_map
from nightly_reasons import ONLY_KERNELS
from numpy.typing import NDArray
from test_technique_pixels import EYE, add_random_lights, stage
from tested_devices import open_device

import rhi
from renderer.content import BUILT_IN
from renderer.frame import Blending, Effect, collect_frame_effects
from renderer.frame.frame import sort_back_to_front
from renderer.renderer import Renderer
from renderer.scene import (
    AlphaMode,
    Camera,
    Depth,
    MeshGeometry,
    Orthographic,
    Perspective,
    Scene,
    SceneBuilder,
    make_geometry,
    scaling,
    translation,
)
from renderer.shadows.casters import SceneCasters
from renderer.techniques import TECHNIQUES, Clustered, Forward, ForwardPlus, FxaaTechnique, Inferred, inferred
from renderer.techniques.parts.scene_shader import ForwardShader
from renderer.techniques.parts.transparency import TransparentShader, WeightedShader
from renderer.visibility import ALGORITHMS, NoCulling, TwoPassCulling, list_algorithms
from renderer.visibility.gpu.occludees import DRAWN, OUTSIDE
from rhi import DepthWrite, Op
from rhi.contract.descriptors import Stage
from rhi.shading import Shader, compile_shader

PANE = make_geometry([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [(0, 1, 2), (0, 2, 3)])
FRONT = Camera.look_at((0, 0, 8), (0, 0, 0), projection=Perspective(fov=0.9, aspect=SIZE[0] / SIZE[1]))


def add_pane(
    builder: SceneBuilder, z: float, color: Sequence[float], *, mirrored: bool = False, size: float = 9.0
) -> None:
    """Add a pane before `FRONT`, opaque if the colour has no alpha. It fills the image unless it is small."""
    mode = AlphaMode.BLEND if len(color) == 4 else AlphaMode.OPAQUE
    material = builder.add_material(
        base_color=color, alpha_mode=mode, specular_color=(0.3, 0.3, 0.3), shininess=30.0
    )
    turned = scaling((-size if mirrored else size, size, 1.0))
    builder.add_objects(builder.add_node(translation((0, 0, z)) @ turned), builder.add_mesh(PANE), material)


def panes(*layers: tuple[float, Sequence[float]]) -> SceneBuilder:
    """Make panes at these depths, in this order, in haze, with light that differs from place to place."""
    builder = SceneBuilder("panes")
    for number, (z, color) in enumerate(layers):
        add_pane(builder, z, color, mirrored=number % 3 == 2)
    builder.lights.add_directional((-0.3, -0.5, -1.0), intensity=0.8)
    builder.lights.add_point((2.0, 1.0, 3.0), 9.0, (0.4, 0.9, 0.5), 8.0)
    builder.background, builder.haze = (0.2, 0.3, 0.5), 0.05
    builder.views["front"] = FRONT
    return builder


WALL: tuple[float, Sequence[float]] = (-3.0, (0.5, 0.5, 0.4))

LAYERS: list[tuple[float, Sequence[float]]] = [
    (1.0, (0.9, 0.2, 0.1, 0.4)),
    (-3.0, (0.5, 0.5, 0.4)),
    (4.0, (0.1, 0.3, 0.9, 0.25)),
    (-1.0, (0.1, 0.8, 0.2, 0.7)),
    (3.0, (0.9, 0.9, 0.1, 0.0)),
    (-5.0, (0.9, 0.1, 0.9, 0.9)),  # behind the opaque one
    (2.0, (0.3, 0.3, 0.3, 1.0)),
]
"""Depths and colours of panes, not in order; the last one hides all but two."""


def composite(
    scene: Scene, layers: list[tuple[float, Sequence[float]]], blending: Blending
) -> NDArray[np.float64]:
    """Return the image (h, w, 3), sRGB of 0…255 and not rounded, of panes whose materials are the scene's."""
    seen = []
    for row, (z, color) in enumerate(layers):
        plane, albedo = np.array([0.0, 0.0, 1.0]), np.array(color[:3], np.float32).astype(float)
        color_before, away = reference_plane_light(
            scene, FRONT, SIZE, np.array([0, 0, z]), plane, albedo, material=row
        )
        seen.append((z, color[3] if len(color) == 4 else None, color_before, away))
    image = np.broadcast_to(scene.background, (*SIZE[::-1], 3)).astype(float)
    nearest = -np.inf
    for z, alpha, color_before, _ in seen:
        if alpha is None and z > nearest:
            image, nearest = color_before, z
    visible = sorted(
        (layer for layer in seen if layer[1] is not None and layer[0] > nearest), key=lambda layer: layer[0]
    )
    if blending is Blending.SORTED:
        for _, alpha, color_before, _ in visible:
            image = alpha * color_before + (1 - alpha) * image
        return encode(image)
    weights = [
        alpha * np.clip(0.03 / (1e-5 + (away / 200) ** 4), 1e-2, 1e3)[..., None]
        for _, alpha, _, away in visible
    ]
    mean = sum(w * color_before for w, (_, _, color_before, _) in zip(weights, visible, strict=True)) / sum(
        weights
    )
    left = np.prod([1 - alpha for _, alpha, _, _ in visible])
    return encode((1 - left) * mean + left * image)


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("blending", Blending)
def test_panes_are_within_two_levels_of_compositing_in_float64(
    drawing_device: rhi.Device, blending: Blending
) -> None:
    layers = LAYERS[:-1]
    scene = panes(*layers).build()
    expected = composite(scene, layers, blending)
    assert expected.std() > 3.0  # an image, not one colour
    # Each layer is rounded to 8 bits.
    assert np.abs(draw(drawing_device, scene, blending=blending) - expected).max() <= 2.0
    other = composite(scene, [(-z, color) for z, color in layers], blending)
    assert max_difference(other, expected) > 20.0


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_a_pane_of_opacity_1_hides_surfaces_behind_it(drawing_device: rhi.Device) -> None:
    scene = panes(*LAYERS).build()
    expected = composite(scene, LAYERS, Blending.SORTED)
    assert np.abs(draw(drawing_device, scene) - expected).max() <= 2.0
    alone = draw(drawing_device, panes(*(layer for layer in LAYERS if layer[0] >= 2.0)).build())
    assert (draw(drawing_device, scene) == alone).all()


def test_a_texels_alpha_multiplies_the_materials(gl: rhi.Device) -> None:
    images = []
    for alpha, texel in ((0.5, 128), (0.5 * 128 / 255, 255)):
        builder = panes((-3.0, (0.5, 0.5, 0.4)))
        image = builder.add_image(np.full((2, 2, 4), (255, 255, 255, texel), np.uint8))
        glass = builder.add_material(base_color=(1, 0, 0, alpha), alpha_mode=AlphaMode.BLEND, texture=image)
        builder.add_objects(builder.add_node(scaling((9, 9, 1))), builder.add_mesh(PANE), glass)
        images.append(draw(gl, builder.build()))
    assert max_difference(images[0], images[1]) <= 1
    assert np.abs(images[0] - draw(gl, panes((-3.0, (0.5, 0.5, 0.4))).build())).max() > 10


def test_weighted_surfaces_look_the_same_in_any_order(drawing_device: rhi.Device) -> None:
    scenes = [panes(*LAYERS[:-1]).build(), panes(*LAYERS[-2::-1]).build()]
    first, second = (draw(drawing_device, scene, blending=Blending.WEIGHTED) for scene in scenes)
    assert max_difference(first, second) <= 1


def glassy(seed: int = 0, *, textured: bool = False) -> Scene:
    """Make the stage of the techniques' tests, with lights and with glass of both windings."""
    random, builder = np.random.default_rng(seed), stage(textured=textured)
    add_random_lights(builder, 30, seed)
    meshes = [builder.add_mesh(BUILT_IN[name]()) for name in ("box", "sphere")]
    for number in range(8):
        glass = builder.add_material(
            base_color=(*random.uniform(0.1, 1.0, 3), random.uniform(0.2, 0.8)),
            alpha_mode=AlphaMode.BLEND,
            specular_color=(0.5, 0.5, 0.5),
            shininess=60.0,
        )
        size = (-2.0 if number % 4 == 0 else 2.0, 2.0, 0.1 if number % 2 else 1.5)
        position = random.uniform((-5, 0.3, -3), (5, 2, 6))
        builder.add_objects(
            builder.add_node(translation(position) @ scaling(size)), meshes[number % 2], glass
        )
    builder.haze, builder.background = 0.02, (0.3, 0.4, 0.5)
    builder.views["eye"] = EYE
    return builder.build()


def check_all(device: rhi.Device, scene: Scene, blending: Blending) -> None:
    """Check that each technique gives forward shading's image."""
    expected = draw(device, scene, Forward(), blending=blending)
    off = {}
    for name, make in TECHNIQUES.items():
        if name != "inferred":
            image = draw(device, scene, make(), blending=blending)
            off[name] = int(max_difference(image, expected))
    assert max(off.values()) <= 2, off


def test_every_technique_gives_the_image_of_forward_shading(gl: rhi.Device) -> None:
    check_all(gl, glassy(), Blending.SORTED)


@pytest.mark.nightly
@pytest.mark.parametrize("blending", Blending)
@pytest.mark.parametrize("seed", [1, 2])
def test_every_technique_gives_the_image_of_forward_shading_of_any_glass(
    drawing_device: rhi.Device, seed: int, blending: Blending
) -> None:
    check_all(drawing_device, glassy(seed, textured=seed == 2), blending)


GLASS: list[tuple[float, Sequence[float]]] = [
    (1.0, (0.9, 0.2, 0.1, 0.4)),
    (2.0, (0.1, 0.3, 0.9, 0.25)),
    (3.0, (0.2, 0.8, 0.3, 0.5)),
]


@pytest.mark.parametrize("scale", [0.6, pytest.param(1.0, marks=pytest.mark.nightly)])
def test_inferred_light_reaches_three_transparent_surfaces_behind_each_other(
    gl: rhi.Device, monkeypatch: pytest.MonkeyPatch, scale: float
) -> None:
    builder = panes((-3.0, (0.5, 0.5, 0.4)), *GLASS)
    builder.lights.add_point((0.0, 0.0, 2.5), 9.0, (1.0, 0.6, 0.3), 40.0)  # before two of the three
    scene = builder.build()
    expected = draw(gl, scene)
    image = draw(gl, scene, Inferred(scale=scale))
    frames.forget_variants()
    monkeypatch.setattr(inferred, "_LAYERS", 1)  # the control: all three have the same texel
    wrong = draw(gl, scene, Inferred(scale=scale))
    frames.forget_variants()
    assert max_difference(image, expected) <= 8
    if scale < 1.0:
        assert max_difference(wrong, expected) > 15
    else:  # at full size nothing is stippled
        assert max_difference(wrong, image) == 0


@pytest.mark.nightly
def test_stippled_light_is_near_that_of_forward_shading(drawing_device: rhi.Device) -> None:
    scene = glassy()
    expected, size = draw(drawing_device, scene, size=(240, 160)), (240, 160)
    for technique, least in ((Inferred(stippled=False), 40.0), (Inferred(), 28.0)):
        image = draw(drawing_device, scene, technique, size=size)
        assert 10.0 * np.log10(255.0**2 / ((image - expected) ** 2).mean()) > least


@pytest.mark.parametrize("name", sorted({*ALGORITHMS} - {"auto"}))
def test_every_visibility_algorithm_draws_transparent_objects_and_objects_behind_them(
    gl: rhi.Device, name: str
) -> None:
    if name not in list_algorithms(gl):
        pytest.skip(f"{name} doesn't run here")
    builder = panes((-3.0, (0.5, 0.5, 0.4)), (2.0, (0.2, 0.5, 0.9, 0.5)))
    add_pane(builder, 0.0, (0.9, 0.1, 0.1), size=0.5)  # behind the glass
    add_pane(builder, -4.0, (0.1, 0.9, 0.1, 0.5), size=0.5)  # behind the wall
    scene = builder.build()
    expected = draw(gl, scene)
    with open_renderer(gl, scene, visibility=name) as renderer:
        for _ in range(5):  # until what was hidden has been asked about
            result = renderer.render(FRONT)
            assert max_difference(read_colors(result), expected) <= 1
            assert {0, 1, 2} <= {*result.visible.tolist()}


def test_the_device_lists_no_transparent_object(gl: rhi.Device) -> None:
    scene = panes(WALL, (2.0, (0.2, 0.5, 0.9, 0.5))).build()
    visibility = TwoPassCulling(scene, gl)
    with Renderer(gl, scene, visibility=visibility, size=SIZE) as renderer:
        for _ in range(2):
            renderer.render(FRONT)
        assert visibility._occludees.marks.read().tolist() == [DRAWN, OUTSIDE]
        scene.materials["alpha_mode"] = AlphaMode.OPAQUE
        renderer.render(FRONT)
        assert visibility._occludees.marks.read().tolist() == [DRAWN, DRAWN]
    visibility.destroy()


@pytest.mark.parametrize("name", ["stop_and_wait", "chc", "chc_plus_plus", "software_depth"])
def test_a_transparent_object_behind_a_wall_is_culled_where_the_cpu_knows(gl: rhi.Device, name: str) -> None:
    if name not in list_algorithms(gl):
        pytest.skip(f"{name} doesn't run here")
    builder = panes((2.0, (0.5, 0.5, 0.4)))
    add_pane(builder, -4.0, (0.1, 0.9, 0.1, 0.5), size=0.5)
    with open_renderer(gl, builder.build(), visibility=name) as renderer:
        for _ in range(30):
            visible = renderer.render(FRONT).visible.tolist()
    assert visible == [0]


@pytest.mark.parametrize("blending", Blending)
@pytest.mark.parametrize("name", TECHNIQUES)
def test_a_transparent_object_out_of_view_costs_nothing(
    null: rhi.Device, name: str, blending: Blending
) -> None:
    builder = panes(WALL)
    add_pane(builder, 20.0, (1.0, 1.0, 1.0, 0.5))
    with rhi.create_device("null") as other:
        expected = record(other, panes(WALL).build(), TECHNIQUES[name](), blending=blending)
        stream = record(null, builder.build(), TECHNIQUES[name](), blending=blending)
        assert [c.op for c in stream] == [c.op for c in expected]


def test_transparent_objects_add_a_pass_and_a_draw_for_each_run_of_a_winding(null: rhi.Device) -> None:
    assert count_draws(null, panes(WALL).build()) == (1, 1)
    pane = (1.0, (1.0, 1.0, 1.0, 0.5))
    assert count_draws(null, panes(WALL, pane).build()) == (2, 2)
    builder = panes(WALL)
    for number, mirrored in enumerate((False, False, True, True, True, False)):
        add_pane(builder, number, (1.0, 1.0, 1.0, 0.5), mirrored=mirrored)
    assert count_draws(null, builder.build()) == (2, 1 + 3)
    assert count_draws(null, builder.build(), blending=Blending.WEIGHTED) == (3, 1 + 2 + 1)


@pytest.mark.parametrize(("stippled", "passes"), [(True, 6), (False, 5)])
def test_stippling_is_one_more_pass_where_a_local_light_reaches_something(
    null: rhi.Device, stippled: bool, passes: int
) -> None:
    pane = (1.0, (1.0, 1.0, 1.0, 0.5))
    stream = record(null, panes(WALL, pane).build(), Inferred(stippled=stippled))
    assert len(stream.filter(Op.BEGIN_PASS)) == len(stream.draws()) == passes
    unlit = panes(WALL, pane)
    unlit.lights.point = unlit.lights.point[:0]
    stream = record(null, unlit.build(), Inferred(stippled=stippled))
    assert len(stream.draws()) == 2


def test_transparent_surfaces_write_no_depth_and_are_tested_against_that_of_opaque_ones(
    null: rhi.Device,
) -> None:
    with open_renderer(null, panes(WALL, (1.0, (1.0, 1.0, 1.0, 0.5))).build()) as renderer:
        result = renderer.render(FRONT)
    opaque, transparent = null.stream.draws()
    assert opaque.states[DepthWrite] is DepthWrite.ON
    assert transparent.states[DepthWrite] is DepthWrite.OFF
    assert transparent.states[rhi.DepthFunction] is rhi.DepthFunction.GREATER
    assert transparent.states[rhi.BlendFunction][0] == rhi.BlendFunction.PREMULTIPLIED
    assert result.visible.tolist() == [0, 1]


def test_a_transparent_object_that_is_hidden_is_not_drawn(null: rhi.Device) -> None:
    class Choosing(NoCulling):
        def render(self, camera: Camera, drawer: object) -> object:
            self._rows = np.array([0])
            return super().render(camera, drawer)

    scene = panes(WALL, (1.0, (1.0, 1.0, 1.0, 0.5))).build()
    renderer = Renderer(null, scene, visibility=Choosing(scene), size=SIZE)
    null.stream.clear()
    renderer.render(FRONT)
    assert len(null.stream.draws()) == 1


def test_a_material_that_becomes_transparent_changes_its_objects(null: rhi.Device) -> None:
    scene = panes(WALL, (1.0, (1.0, 1.0, 1.0, 0.5))).build()
    with open_renderer(null, scene) as renderer:
        passes = []
        for mode in (AlphaMode.OPAQUE, AlphaMode.BLEND, AlphaMode.OPAQUE):
            scene.materials["alpha_mode"][1] = mode
            null.stream.clear()
            renderer.render(FRONT)
            passes.append(len(null.stream.filter(Op.BEGIN_PASS)))
    assert passes == [1, 2, 1]


@pytest.mark.parametrize("depth", Depth)
@pytest.mark.parametrize("projection", [Perspective, lambda depth: Orthographic(20.0, depth=depth)])
def test_objects_are_sorted_by_the_distance_of_their_boxes_centres(
    projection: Callable[..., object], depth: Depth
) -> None:
    random = np.random.default_rng(7)
    # Far from the origin, where a step of float32 is half a metre.
    positions = np.add(random.uniform(-30, 30, (200, 3)), (1e7, 0, -1e7))
    camera = Camera.look_at((1e7, 1, -1e7), (1e7 + 3, 2, -1e7 + 5), projection=projection(depth=depth))
    rows = random.permutation(200)[:150]
    away = positions - camera.position
    far = (
        away @ camera.forward if isinstance(camera.projection, Orthographic) else np.linalg.norm(away, axis=1)
    )
    order = sort_back_to_front(make_boxes(*positions).build(), camera, rows)
    assert sorted(order.tolist()) == sorted(rows.tolist())
    assert (np.diff(far[order]) < 1e-6).all()


@pytest.mark.parametrize("name", ["light_pre_pass", "forward_plus"])
def test_nothing_of_the_last_frame_is_left_where_all_objects_are_transparent(
    gl: rhi.Device, name: str
) -> None:
    builder = panes()
    add_pane(builder, 1.0, (0.9, 0.9, 0.9, 0.8), size=1.0)
    scene = builder.build()
    aside = Camera.look_at((2, 0, 8), (2, 0, 0), projection=FRONT.projection)
    expected = draw(gl, scene, camera=aside)
    with open_renderer(gl, scene, TECHNIQUES[name]()) as renderer:
        renderer.render(FRONT)
        assert max_difference(read_colors(renderer.render(aside)), expected) <= 2


def test_transparent_objects_cast_no_shadows() -> None:
    casters = SceneCasters(panes(WALL, (1.0, (1.0, 1.0, 1.0, 0.5)), (2.0, (1.0, 1.0, 1.0))).build())
    assert casters.static.tolist() == [0, 2]
    assert not len(casters.dynamic)


def test_a_material_that_becomes_transparent_casts_no_shadow_from_then_on(null: rhi.Device) -> None:
    builder = panes(WALL, (1.0, (1.0, 1.0, 1.0, 0.5)))
    builder.lights.add_directional((0.0, 0.0, -1.0), (1.0, 1.0, 1.0), 1.0, casts_shadow=True)
    scene = builder.build()
    with open_renderer(null, scene) as renderer:
        cast = []
        for mode in (AlphaMode.OPAQUE, AlphaMode.BLEND, AlphaMode.OPAQUE):
            scene.materials["alpha_mode"][1] = mode
            renderer.render(FRONT)
            cast.append({report.casters for report in renderer.shadows.reports})
    assert cast == [{2}, {1}, {2}]


def test_a_frame_says_why_it_has_a_pass_of_transparent_surfaces() -> None:
    builder = panes(WALL, (1.0, (1.0, 1.0, 1.0, 0.5)))
    add_pane(builder, 20.0, (1.0, 1.0, 1.0, 0.5))
    scene = builder.build()
    assert (
        collect_frame_effects(scene, FRONT).explain(Effect.TRANSPARENCY)
        == "1 of 2 transparent objects is in view"
    )
    away = Camera.look_at((0, 0, 30), (0, 0, 40))
    assert (
        collect_frame_effects(scene, away).explain(Effect.TRANSPARENCY)
        == "none of 2 transparent objects are in view"
    )
    assert (
        collect_frame_effects(panes(WALL).build(), FRONT).explain(Effect.TRANSPARENCY)
        == "the scene has no transparent object"
    )


@pytest.mark.parametrize("blending", Blending)
def test_smooth_edges_go_with_transparent_surfaces(gl: rhi.Device, blending: Blending) -> None:
    builder = panes(WALL, (1.0, (0.2, 0.9, 0.3, 0.5)))
    plain = draw(gl, builder.build(), blending=blending)
    for technique in (FxaaTechnique(Forward()), Forward(4), ForwardPlus(4), Clustered(4)):
        # Without edges they change nothing.
        assert np.abs(draw(gl, builder.build(), technique, blending=blending) - plain).max() <= 1


@pytest.mark.parametrize("shader", [ForwardShader, TransparentShader, WeightedShader])
def test_a_fragment_reads_its_texture_and_tests_its_mask_once(shader: type[Shader]) -> None:
    switches = {"has_images": True, "has_masks": True}
    text = (
        compile_shader(type("Variant", (shader,), {"__module__": __name__, **switches}))
        .emit("glsl", Stage.FRAGMENT)
        .text
    )
    assert text.count("sample_base_color(") == text.count("evaluate(") == 2, (
        "where it is defined, and one call"
    )
    assert text.count("discard;") == 1


SOLID = make_geometry(
    [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)],
    [
        *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)),
        *((2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
    ],
    color=[(1, 0, 0, 0.5) if z < 0 else (0, 1, 0, 0.5) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)],
)
"""A box whose far end is red, and its near one green, seen from `FRONT`."""


def two_sided(*meshes: tuple[MeshGeometry, float], mirrored: bool = False, reverses: bool = False) -> Scene:
    """Return objects of glass with two sides, beside each other at these places along x."""
    builder = SceneBuilder("two sides")
    glass = builder.add_material(
        base_color=(1, 1, 1, 1), alpha_mode=AlphaMode.BLEND, double_sided=True, specular_color=(0, 0, 0)
    )
    for mesh, x in meshes:
        order = slice(None, None, -1) if reverses else slice(None)
        turned = MeshGeometry(
            mesh.vertices, np.ascontiguousarray(mesh.indices.reshape(-1, 3)[order]).reshape(-1)
        )
        size = scaling((-0.8 if mirrored else 0.8, 0.8, 0.8))
        builder.add_objects(builder.add_node(translation((x, 0, 0)) @ size), builder.add_mesh(turned), glass)
    builder.lights.sky = builder.lights.ground = (1.0, 1.0, 1.0)
    builder.background = (0.0, 0.0, 0.0)
    builder.views["front"] = FRONT
    return builder.build()


@pytest.mark.nightly_cases("cl*", "wgpu*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu"])
@pytest.mark.parametrize("mirrored", [False, True])
def test_far_sides_of_glass_are_behind_near_ones(backend: str, mirrored: bool) -> None:
    """Whatever the order of its triangles: one order had shown the far end in front."""
    with open_device(backend) as device:
        images = [
            draw(device, two_sided((SOLID, 0.0), mirrored=mirrored, reverses=reverses))
            for reverses in (False, True)
        ]
    far, near = tone_map(np.eye(3)[:2])
    expected = encode(0.5 * near + 0.5 * 0.5 * far)
    for image in images:
        assert np.abs(image[SIZE[1] // 2, SIZE[0] // 2] - expected).max() <= 2.0


def test_flat_glass_is_drawn_once_and_solid_glass_in_two_calls(null: rhi.Device) -> None:
    def count(*meshes: tuple[MeshGeometry, float]) -> int:
        return count_draws(null, two_sided(*meshes))[1]

    assert [count((PANE, 0.0)), count((SOLID, 0.0))] == [1, 2]
    assert count((PANE, 0.0), (PANE, 0.1)) == 1
    mixed = count((PANE, 0.0), (PANE, 0.1), (SOLID, 2.0), (SOLID, 4.0))
    assert mixed == 1 + 2 * 2 + 1, "the last one puts so many layers over the image"
    assert count_draws(null, two_sided((SOLID, 0.0)), blending=Blending.WEIGHTED)[1] == 2, "one, and the mean"
