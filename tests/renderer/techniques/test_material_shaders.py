"""Materials with shaders of their own: the same in all techniques, by all algorithms, and what they cost."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import frames
import numpy as np
import pytest
from nightly_reasons import ONLY_KERNELS
from numpy.typing import NDArray

import rhi
import rhi.shading as sl
from renderer.content import load_scene, material_shaders
from renderer.frame import Effect, collect_frame_effects
from renderer.lab.accuracy.float64 import shade_in_float64
from renderer.scene import AlphaMode, Camera, Scene, SceneBuilder, scaling, translation
from renderer.shaders import MaterialShader, SurfaceInput, SurfaceParameters
from renderer.techniques import (
    TECHNIQUES,
    Deferred,
    DeferredPlus,
    Forward,
    Inferred,
    LightPrePass,
    ResourceCapture,
    Technique,
)
from rhi import Op
from rhi.commands.ops import DRAWS
from rhi.shading import run_compute
from tests.renderer.conftest import open_device

COMPARED: dict[str, Callable[[], Technique]] = {
    **{name: make for name, make in TECHNIQUES.items() if name != "forward"},
    "inferred": lambda: Inferred(scale=1.0),
    "multi_pass": lambda: DeferredPlus(multi_pass=True),
    "binned": lambda: DeferredPlus(binned=True),
}
SIZE = (120, 90)
NEAR = Camera.look_at((0, 0, 3), (0, 0, 0)).with_aspect(SIZE[0] / SIZE[1])
YARD = "yard:columns=2,lights=2,shadows=1"


class Halves(MaterialShader):
    """Red, and nothing where u is below a half: alpha is 0 there."""

    def describe(self, at: SurfaceInput) -> SurfaceParameters:
        described = super().describe(at)
        described.color = sl.vec4(1.0, 0.0, 0.0, sl.step(0.5, at.uv.x))
        return described


class EmissiveMaterial(MaterialShader):
    """Says all that a shader can."""

    def describe(self, at: SurfaceInput) -> SurfaceParameters:
        return SurfaceParameters(
            color=sl.vec4(0.5, 0.25, 1.0, 1.0),
            normal=at.normal,
            metallic=at.uv.x,
            roughness=0.2 + 0.6 * at.uv.y,
            occlusion=0.5,
            emissive=sl.vec3(at.uv, 0.0),
        )


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_all_techniques_draw_materials_with_shaders_alike(drawing_device: rhi.Device) -> None:
    scene = load_scene(YARD)
    names = (
        COMPARED
        if drawing_device.backend_name == "gl"
        else ("deferred", "deferred_plus", "forward_multipass")
    )
    camera = frames.first_view_camera(scene).with_aspect(4 / 3)
    techniques = (Forward(), *(COMPARED[name]() for name in names))
    expected, *images = frames.draw_each(drawing_device, scene, *techniques, camera=camera, size=SIZE)
    assert expected[..., :3].std() > 30.0
    off = {name: frames.max_difference(image, expected) for name, image in zip(names, images, strict=True)}
    assert max(off.values()) <= 2, off


@pytest.mark.parametrize(
    "name", ["none", "frustum", "chc_plus_plus", "conditional", "depth_pyramid", "two_pass"]
)
def test_all_algorithms_draw_each_object_by_its_shader(drawing_device: rhi.Device, name: str) -> None:
    frames.require_algorithm(drawing_device, name)
    scene = load_scene(YARD)
    expected = frames.draw(drawing_device, scene, size=SIZE)
    with frames.open_renderer(drawing_device, scene, visibility=name, size=SIZE) as renderer:
        results = [renderer.render(frames.first_view_camera(scene)) for _ in range(3)]
        assert frames.max_difference(frames.read_colors(results[-1]), expected) == 0
        assert set(results[-1].visible.tolist()) <= set(range(len(scene.objects)))


def test_gl_and_cl_agree() -> None:
    images = []
    for backend in ("gl", "cl"):
        with open_device(backend) as device:
            images.append(frames.draw(device, load_scene(YARD), size=SIZE))
    apart = np.abs(images[0] - images[1]).max(axis=2)
    assert np.count_nonzero(apart > 3) <= 0.005 * apart.size, "edges alone"


def stand(*shaders: type[MaterialShader] | None, repeats: int = 1, **material: Any) -> Scene:
    """Make boxes side by side, `repeats` for each shader, in turns."""
    builder = SceneBuilder("side by side")
    builder.lights.sky = builder.lights.ground = (0.5, 0.5, 0.5)
    first = frames.make_boxes()
    mesh = builder.add_mesh(first._geometries[0])
    rows = [builder.add_material(shader=shader, **material) for shader in shaders]
    for number in range(repeats * len(rows)):
        node = builder.add_node(translation((1.1 * number - 0.55 * (repeats * len(rows) - 1), 0, 0)))
        builder.add_objects(node, mesh, rows[number % len(rows)])
    builder.views["eye"] = first.views["eye"]
    return builder.build()


def count_calls(device: rhi.Device, scene: Scene, **options: Any) -> tuple[int, int]:
    """Return the numbers of draw calls, and of programs that they use."""
    ops = [command.op for command in frames.record(device, scene, Forward(), frames=1, **options)]
    return sum(op in DRAWS for op in ops), ops.count(Op.BIND_PROGRAM)


def test_objects_are_drawn_by_shader(null: rhi.Device) -> None:
    """A call and a program for each shader, however many objects there are, and in whatever order they
    are."""
    assert count_calls(null, stand(None, repeats=6)) == (1, 1)
    assert count_calls(null, stand(EmissiveMaterial, repeats=6)) == (1, 1)
    assert count_calls(null, stand(None, EmissiveMaterial, Halves, repeats=6)) == (3, 3)


def test_a_scene_without_material_shaders_has_none_of_their_cost(null: rhi.Device) -> None:
    plain, custom = stand(None), stand(None, EmissiveMaterial)
    assert (
        Effect.MATERIAL_SHADERS not in collect_frame_effects(plain, frames.first_view_camera(plain)).enabled
    )
    assert Effect.MATERIAL_SHADERS in collect_frame_effects(custom, frames.first_view_camera(custom)).enabled
    assert (
        Effect.MATERIAL_SHADERS
        not in collect_frame_effects(custom, Camera.look_at((0, 0, 10), (0, 0, 20))).enabled
    )
    assert "material ids" not in frames.list_passes(null, plain, DeferredPlus())
    assert "material ids" in frames.list_passes(null, custom, DeferredPlus())


def test_depth_alone_is_drawn_without_shaders_of_materials(null: rhi.Device) -> None:
    """Unless they cut masks."""
    for masks, programs in ((AlphaMode.OPAQUE, 1), (AlphaMode.MASK, 2)):
        scene = stand(None, Halves, alpha_mode=masks)
        stream = frames.record(null, scene, DeferredPlus(), frames=1)
        first = list(stream)[
            : next(index for index, command in enumerate(stream) if command.op is Op.END_PASS)
        ]
        assert len({command["program"] for command in first if command.op is Op.BIND_PROGRAM}) == programs


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_all_that_a_shader_says_is_drawn_by_techniques_that_store_it(drawing_device: rhi.Device) -> None:
    scene = stand(
        None, EmissiveMaterial, base_color=(1, 1, 1), metallic=0.5, roughness=0.5, emissive=(0.6, 0.3, 0.1)
    )
    scene.lights.add_point((0, 2, 3), 8.0, intensity=3.0)
    forward, *others = frames.draw_each(
        drawing_device, scene, Forward(), Deferred(), LightPrePass(), DeferredPlus(), size=SIZE
    )
    assert np.abs(forward[:, : SIZE[0] // 2] - forward[:, : SIZE[0] // 2 - 1 : -1]).max() > 40
    assert max(frames.max_difference(forward, image) for image in others) <= 2


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_a_shader_cuts_masks_from_images_and_from_shadows(drawing_device: rhi.Device) -> None:
    def show(technique: Technique, alpha_mode: AlphaMode, casts: bool) -> NDArray[Any]:
        builder = frames.make_boxes(translation((0, 0, -2)) @ scaling((20, 20, 0.1)))
        material = builder.add_material(shader=Halves, alpha_mode=alpha_mode, base_color=(1, 1, 1, 1))
        builder.add_objects(builder.add_node(translation((1, 0, 0)) @ scaling((2.0, 2.0, 0.05))), 0, material)
        builder.lights.add_directional((-1.0, 0.0, -1.0), casts_shadow=casts)
        return frames.draw(drawing_device, builder.build(), technique, size=SIZE)

    cut, whole = (show(Forward(), mode, True) for mode in (AlphaMode.MASK, AlphaMode.OPAQUE))
    red = [np.count_nonzero((image[..., 0] > 60) & (image[..., 1] < 40)) for image in (cut, whole)]
    assert 0.4 < red[0] / red[1] < 0.6
    unshadowed = show(Forward(), AlphaMode.MASK, False)
    shadows = [np.count_nonzero((unshadowed - image)[..., 1] > 20) for image in (cut, whole)]
    assert 0.3 < shadows[0] / shadows[1] < 0.7, "the half that is cut casts none"
    for technique in (Deferred(), DeferredPlus(), DeferredPlus(multi_pass=True)):
        assert frames.max_difference(show(technique, AlphaMode.MASK, True), cut) <= 2


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_transparent_surfaces_have_the_opacity_that_a_shader_says(drawing_device: rhi.Device) -> None:
    solid = frames.draw(drawing_device, stand(Halves, base_color=(1, 1, 1, 1)), camera=NEAR, size=SIZE)
    glass = stand(Halves, base_color=(1, 1, 1, 0.5), alpha_mode=AlphaMode.BLEND)
    half = frames.draw(drawing_device, glass, camera=NEAR, size=SIZE)
    left, right = (slice(SIZE[0] // 2 - 8, SIZE[0] // 2 - 2), slice(SIZE[0] // 2 + 2, SIZE[0] // 2 + 8))
    row = SIZE[1] // 2
    assert (solid[row, left, 0] > 100).all()
    assert (half[row, left, 0] < 50).all(), "nothing but the background"
    assert ((half[row, right, 0] > 70) & (half[row, right, 0] < solid[row, right, 0])).all()


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_parameters_and_instances_may_change_between_frames(drawing_device: rhi.Device) -> None:
    builder = frames.make_boxes()
    parent = builder.add_material(
        shader=material_shaders.Checker, second_color=(1, 0, 0), base_color=(1, 1, 1)
    )
    child = builder.add_material(parent=parent)
    builder.add_objects(builder.add_node(), 0, child)
    builder.lights.sky = builder.lights.ground = (1, 1, 1)
    scene = builder.build()
    with frames.open_renderer(drawing_device, scene, size=SIZE) as renderer:
        red = frames.read_colors(renderer.render(NEAR))
        scene.set_material(parent, second_color=(0.0, 0.0, 1.0))
        blue = frames.read_colors(renderer.render(NEAR))
        scene.parameters[0]["second_color"][child] = (0.0, 1.0, 0.0)
        green = frames.read_colors(renderer.render(NEAR))
    for image, channel in ((red, 0), (blue, 2), (green, 1)):
        pure = (image[..., channel] > 100) & (np.delete(image, channel, axis=2).max(axis=2) < 40)
        assert np.count_nonzero(pure) > 100


# -- the shaders of the yard, against other ways to compute the same


class BoardProbe(material_shaders.Checker):
    """Describes points of a checkerboard."""

    points: sl.Storage[sl.vec4]
    results: sl.StorageRW[float]

    def compute(self) -> None:
        i = sl.global_id().x
        at = SurfaceInput(
            position=sl.vec3(0.0),
            normal=sl.vec3(0.0, 0.0, 1.0),
            uv=self.points[2 * i].xy,
            uv2=sl.vec2(0.0),
            uv_gradients=self.points[2 * i + 1],
            uv2_gradients=sl.vec4(0.0),
            tangent=sl.vec4(1.0),
            color=sl.vec4(1.0),
            material=0,
        )
        self.results[i] = self.describe(at).color.r


def test_a_checkerboard_is_its_mean_over_the_pixel() -> None:
    """Against 400 × 400 points of each pixel's box, of which 1/400 of each side may lie beyond an edge."""
    rng = np.random.default_rng(4)
    count, squares = 40, np.array([6.0, 4.0])
    uv, size = rng.random((count, 2)), 10.0 ** rng.uniform(-2.5, 0.2, (count, 2))
    points = np.zeros((2 * count, 4), np.float32)
    points[::2, :2], points[1::2, 0], points[1::2, 3] = uv, size[:, 0], size[:, 1]
    board = np.zeros(1, material_shaders.CheckerParameters.dtype)
    board["squares"] = squares
    materials = np.zeros(1, load_scene("grid:mesh=box,count=1").materials.dtype)
    results = run_compute(
        BoardProbe, count, points=points, results=count, parameters=board, materials=materials
    )["results"]
    share = (np.arange(400) + 0.5) / 400 - 0.5
    for index in range(count):
        u, v = ((uv[index, axis] + share * size[index, axis]) * squares[axis] for axis in (0, 1))
        white = (np.floor(u)[:, None] + np.floor(v)[None, :]) % 2 == 0
        assert abs(results[index] - white.mean()) < 0.02


class ReliefProbe(material_shaders.Parallax):
    """Follows rays into waves of height, instead of into a texture."""

    points: sl.Storage[sl.vec4]
    results: sl.StorageRW[float]

    def read_data(self, texture: int, at: SurfaceInput) -> sl.vec4:
        return sl.vec4(0.5 + 0.5 * sl.sin(6.2831853 * at.uv.x))

    def compute(self) -> None:
        i = sl.global_id().x
        point = self.points[i]
        at = SurfaceInput(
            position=point.xyz,
            normal=sl.vec3(0.0, 0.0, 1.0),
            uv=sl.vec2(point.w, 0.0),
            uv2=sl.vec2(0.0),
            uv_gradients=sl.vec4(0.0),
            uv2_gradients=sl.vec4(0.0),
            tangent=sl.vec4(1.0, 0.0, 0.0, 1.0),
            color=sl.vec4(1.0),
            material=0,
        )
        self.results[i] = self.intersect_relief(at, self.parameters[0]).x


@pytest.mark.parametrize(("steps", "tolerance"), [(16, 0.012), (64, 0.001), (256, 0.0001)])
def test_parallax_finds_where_the_ray_meets_the_heights(steps: int, tolerance: float) -> None:
    """Against 100,000 steps in float64. The last step is linear, so the error falls with the square of the
    steps."""
    rng, count, depth = np.random.default_rng(7), 60, 0.05
    to_eye = np.stack([rng.uniform(-1.2, 1.2, count), rng.uniform(-0.5, 0.5, count), np.ones(count)], axis=1)
    start = rng.random(count)
    points = np.concatenate([-to_eye, start[:, None]], axis=1).astype(np.float32)
    relief = np.zeros(1, material_shaders.ParallaxParameters.dtype)
    relief["depth"], relief["steps"] = depth, steps
    results = run_compute(ReliefProbe, count, points=points, results=count, parameters=relief)["results"]
    down = np.linspace(0.0, 1.0, 100_001)
    for index in range(count):
        u = start[index] - to_eye[index, 0] / to_eye[index, 2] * depth * down
        met = np.argmax(1.0 - down <= 0.5 + 0.5 * np.sin(2 * np.pi * u))
        assert abs(results[index] - u[met]) < tolerance * depth * 2 + 1e-5


class NoiseProbe(sl.Shader):
    """Looks noise up."""

    work_group = (64,)
    positions: sl.Storage[sl.vec4]
    results: sl.StorageRW[float]

    def compute(self) -> None:
        i = sl.global_id().x
        self.results[i] = material_shaders.value_noise(self.positions[i].xyz)


@pytest.mark.parametrize("name", ["light_pre_pass", "inferred"])
def test_a_pre_pass_stores_the_normals_of_relief(gl: rhi.Device, name: str) -> None:
    # Lights are added up by them before materials are known, so the ray must be followed there already.
    def read_surface(technique: str, depth: float) -> NDArray[Any]:
        scene = load_scene("yard")
        for parameters in scene.parameters:
            if "steps" in (parameters.dtype.names or ()):
                parameters["depth"] = depth
        capture = ResourceCapture(TECHNIQUES[technique](), "surface")
        with frames.open_renderer(gl, scene, capture, visibility="frustum", size=(96, 54)) as renderer:
            renderer.render(frames.first_view_camera(scene))
        assert capture.texels is not None
        return capture.texels[..., 1]

    stored = read_surface(name, 0.05)
    np.testing.assert_array_equal(stored, read_surface("deferred", 0.05))
    assert np.count_nonzero(stored != read_surface(name, 0.0)) > 500  # the control


def test_noise_is_smooth_within_its_bounds_and_has_no_direction() -> None:
    rng = np.random.default_rng(1)
    positions = np.zeros((4096, 4), np.float32)
    positions[:, :3] = rng.uniform(-50, 50, (4096, 3))
    positions[2048:] = positions[:2048]
    positions[2048:, 0] += np.float32(1 / 64)
    results = run_compute(NoiseProbe, 64, positions=positions, results=4096)["results"]
    assert np.abs(results).max() <= 1.0
    assert abs(results.mean()) < 0.05
    assert results.std() > 0.15
    assert np.abs(results[2048:] - results[:2048]).max() < 2.0 * 1.875 / 64 + 1e-3, (
        "the steepest that the weights allow"
    )


def test_marble_goes_through_objects(gl: rhi.Device) -> None:
    """Two boxes whose faces meet have the veins of one."""
    builder = frames.make_boxes()
    stone = builder.add_material(
        shader=material_shaders.Marble, base_color=(1, 1, 1), vein_color=(0, 0, 0), frequency=2.0
    )
    for x in (-0.5, 0.5):
        builder.add_objects(builder.add_node(translation((x, 0, 0))), 0, stone)
    wide = frames.make_boxes()
    whole = wide.add_material(
        shader=material_shaders.Marble, base_color=(1, 1, 1), vein_color=(0, 0, 0), frequency=2.0
    )
    wide.add_objects(wide.add_node(scaling((2, 1, 1))), 0, whole)
    for boxes in (builder, wide):
        boxes.lights.sky = boxes.lights.ground = (1, 1, 1)
    halves, whole_box = (frames.draw(gl, part.build(), camera=NEAR, size=SIZE) for part in (builder, wide))
    assert whole_box.std() > 20.0
    assert frames.max_difference(halves, whole_box) <= 1


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_images_are_those_of_float64(drawing_device: rhi.Device) -> None:
    """The same shaders by NumPy, from what the device has in its buffers: arithmetic is all that differs."""
    scene = load_scene("yard:columns=2,lights=2")
    with frames.open_renderer(drawing_device, scene, size=(80, 60)) as renderer:
        exact = shade_in_float64(renderer, frames.first_view_camera(scene))
        drawn = frames.read_colors(renderer.render(frames.first_view_camera(scene)))
    is_covered = exact.objects >= 0
    assert 0.5 < is_covered.mean() < 1.0
    shaders = scene.materials["shader"][scene.objects.material[exact.objects[is_covered]]]
    assert np.unique(shaders).tolist() == [0, 1, 2, 3]
    off = np.abs(exact.levels - drawn).max(axis=2)[is_covered]
    assert np.quantile(off, 0.97) <= 1.5
    assert np.count_nonzero(off > 4.0) <= 0.005 * len(off), "steps of parallax that end elsewhere"
