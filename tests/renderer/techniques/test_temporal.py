"""Temporal anti-aliasing: compared with images of many samples and with motion in float64, alike in all techniques, and
for nothing where it is off."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from frames import make_boxes
from nightly_reasons import ONLY_KERNELS
from numpy.typing import NDArray

import rhi
from renderer.content import BUILT_IN
from renderer.frame import TemporalSettings
from renderer.frame.temporal import TemporalHistory, compute_offset, is_cut, shift_samples
from renderer.layers.ground_grid import GroundGrid
from renderer.renderer import FrameResult, Renderer
from renderer.scene import (
    Camera,
    Depth,
    Orthographic,
    Perspective,
    Recompute,
    Scene,
    StereoRig,
    rotation,
    scaling,
    translation,
)
from renderer.scene.arrays import Floats
from renderer.settings import RenderSettings
from renderer.stereo import Stereo
from renderer.techniques import TECHNIQUES, Forward, TechniqueSettings
from renderer.viewer.scene_films import SceneFilm
from rhi import ValidationError
from tests.renderer.conftest import open_device

SIZE = (64, 40)
EYE = Camera.look_at((0.6, 0.8, 5.0), (0.0, 0.0, 0.0), projection=Perspective(1.0, 1.6, 0.1))
ON = TemporalSettings(is_on=True)
FINE = TemporalSettings(is_on=True, frames=32, still_frames=256, bits=32)
GREY = {"base_color": (0.5, 0.5, 0.5, 1.0), "specular_color": (0.0, 0.0, 0.0), "rim_strength": 0.0}
BARS = [
    translation((0.25 * i - 1.4, 0.3, 0.0)) @ rotation((0, 0, 1), 0.3) @ scaling((0.1, 2.0, 0.1))
    for i in range(12)
]
PASSES = ["temporal anti-aliasing", "temporal image"]


def make_bars(*, dynamic: bool = False) -> Scene:
    """Make thin bars before a plate."""
    builder = make_boxes(**GREY)
    mesh, dark = (
        builder.add_mesh(BUILT_IN["box"]()),
        builder.add_material(**GREY | {"base_color": (0.05, 0.1, 0.3)}),
    )
    for bar in BARS:
        builder.add_objects(builder.add_node(bar, dynamic=dynamic), mesh, 0)
    builder.add_objects(
        builder.add_node(translation((0.0, 0.0, -3.0)) @ scaling((9.0, 9.0, 0.1))), mesh, dark
    )
    builder.lights.sky, builder.lights.ground = (1.0, 1.0, 1.0), (0.4, 0.3, 0.2)
    builder.lights.add_directional((-0.4, -1.0, -0.6), intensity=1.2)
    return builder.build()


def decode(levels: Any) -> Floats:
    share = np.asarray(levels, np.float64) / 255.0
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def encode(light: Floats) -> Floats:
    return 255.0 * np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1.0 / 2.4) - 0.055)


def read_levels(result: FrameResult) -> Floats:
    return result.image.read()[..., :3].astype(np.float64)


def draw_exactly(device: rhi.Device, scene: Scene, camera: Camera = EYE, finer: int = 8) -> Floats:
    """Draw an image of `finer` × `finer` samples a pixel, without a history."""
    width, height = SIZE
    with Renderer(device, scene, visibility="frustum", size=(width * finer, height * finer)) as renderer:
        light = decode(read_levels(renderer.render(camera)))
    return encode(light.reshape(height, finer, width, finer, 3).mean(axis=(1, 3)))


def draw_frames(
    device: rhi.Device, scene: Scene, count: int, camera: Camera = EYE, **options: Any
) -> list[Floats]:
    """Draw a view a few times; return the levels of all frames."""
    options.setdefault("temporal", ON)
    with Renderer(device, scene, visibility="frustum", size=SIZE, **options) as renderer:
        return [read_levels(renderer.render(camera)) for _ in range(count)]


def measure(image: Floats, exact: Floats) -> float:
    return float(np.abs(image - exact).mean())


@pytest.fixture(params=["gl", "cl", "wgpu"])
def device(request: pytest.FixtureRequest) -> Any:
    with open_device(request.param) as opened:
        yield opened


@pytest.fixture
def gl() -> Any:
    with open_device("gl") as opened:
        yield opened


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_still_frames_approach_the_image_of_many_samples(device: rhi.Device) -> None:
    scene = make_bars()
    exact = draw_exactly(device, scene)
    single = measure(draw_frames(device, scene, 1, temporal=TemporalSettings())[0], exact)
    frames = draw_frames(device, scene, 64)
    errors = [measure(frames[count - 1], exact) for count in (4, 16, 64)]
    assert single > 3.0, "the control: a sample a pixel is off"
    assert errors == sorted(errors, reverse=True)
    assert errors[1] < 0.3 * single
    assert errors[2] < 0.12 * single


def test_more_frames_and_bits_come_nearer(gl: rhi.Device) -> None:
    scene = make_bars()
    exact = draw_exactly(gl, scene, finer=16)
    coarse, fine = (draw_frames(gl, scene, 256, temporal=settings)[-1] for settings in (ON, FINE))
    assert measure(fine, exact) < measure(coarse, exact)
    assert measure(fine, exact) < 0.5


@pytest.mark.parametrize(
    "projection",
    [Orthographic(4.0, 1.6, 0.1, 50.0), Perspective(1.0, 1.6, 0.1, 30.0, Depth.STANDARD)],
    ids=["parallel", "standard depth"],
)
def test_each_projection_converges(gl: rhi.Device, projection: Any) -> None:
    scene, camera = make_bars(), EYE.with_projection(projection)
    exact = draw_exactly(gl, scene, camera)
    single = measure(draw_frames(gl, scene, 1, camera, temporal=TemporalSettings())[0], exact)
    assert measure(draw_frames(gl, scene, 32, camera)[-1], exact) < 0.25 * single


@pytest.mark.parametrize("name", sorted(TECHNIQUES))
def test_techniques_converge_alike(gl: rhi.Device, name: str) -> None:
    scene = make_bars()
    technique = TechniqueSettings(name).make(scene, gl)
    image = draw_frames(gl, scene, 24, technique=technique)[-1]
    forward = draw_frames(gl, scene, 24)[-1]
    assert np.abs(image - forward).mean() < 0.5
    assert np.abs(image - forward).max() <= 8.0


def test_backends_draw_alike() -> None:
    images = []
    for name in ("gl", "cl", "wgpu"):
        with open_device(name) as opened:
            images.append(draw_frames(opened, make_bars(), 6)[-1])
    for image in images[1:]:
        difference = np.abs(image - images[0])
        assert difference.mean() < 0.3
        assert np.percentile(difference, 97.0) <= 3.0  # a sample on an edge may be on its other side


def test_a_moving_view_is_nearer_to_the_exact_image_and_flickers_less(gl: rhi.Device) -> None:
    scene = make_bars()
    cameras = [
        Camera.look_at((0.6 + 0.02 * i, 0.8, 5.0), (0.02 * i, 0.0, 0.0), projection=EYE.projection)
        for i in range(24)
    ]
    exact = [draw_exactly(gl, scene, camera) for camera in cameras[16:]]
    errors, flicker = [], []
    for settings in (TemporalSettings(), ON):
        with Renderer(gl, scene, visibility="frustum", size=SIZE, temporal=settings) as renderer:
            drawn = [read_levels(renderer.render(camera)) for camera in cameras]
        lost = np.stack(drawn[16:]) - np.stack(exact)
        errors.append(np.abs(lost).mean())
        flicker.append(np.abs(np.diff(lost, axis=0)).mean())
    assert errors[1] < 0.7 * errors[0]
    assert flicker[1] < 0.6 * flicker[0]


class Drift:
    """A simulation that moves all vertices by a metre a second to the right."""

    def __init__(self, vertices: NDArray[Any]) -> None:
        self._vertices = vertices
        self._seconds = 0.0

    catch_up = Recompute()

    def set_time(self, members: NDArray[np.int64], seconds: float) -> None:
        """Keep the time."""
        self._seconds = seconds

    def vertices(self, members: NDArray[np.int64]) -> NDArray[Any]:
        """The vertices of all members, one after another."""
        moved = self._vertices.copy()
        moved["position"][:, 0] += self._seconds
        return np.tile(moved, len(members))


def make_drift() -> Scene:
    """Make a box whose vertices drift, and one that stands still."""
    builder = make_boxes((-1.2, 0.0, 0.0), **GREY)
    box = BUILT_IN["box"]()
    mesh = builder.add_mesh(box, bounds=((-9.0, -1.0, -1.0), (9.0, 1.0, 1.0)))
    row = builder.add_objects(builder.add_node(translation((0.2, 0.0, 0.5))), mesh, 0)
    builder.simulate(row, Drift(_pack(box)))
    return builder.build()


def _pack(box: Any) -> NDArray[Any]:
    """The vertices of a built-in mesh as scenes have them."""
    builder = make_boxes((0, 0, 0), **GREY)
    builder.add_mesh(box)
    meshes = builder.build().meshes
    first, count = int(meshes.ranges["base_vertex"][1]), int(meshes.vertex_counts[1])
    return meshes.vertices[first : first + count].copy()


def compute_motion(result: FrameResult, last: Camera, undo: Floats, pixel: tuple[int, int]) -> Floats:
    """The motion (2,) in float64 of the surface in a pixel (x, y), which the matrix `undo` brings back."""
    view, (width, height) = result.frames[0].view, SIZE
    x, y = pixel
    depth = float(result.depth.read()[y, x])
    clip = np.array([2.0 * (x + 0.5) / width - 1.0, 1.0 - 2.0 * (y + 0.5) / height, depth, 1.0])
    world = np.linalg.inv(view.camera.view_projection) @ clip
    before = last.view_projection @ (undo @ (world / world[3]))
    offset = view.workspace(TemporalHistory).offset
    there = 0.5 * np.array([1.0 + before[0] / before[3], 1.0 - before[1] / before[3]]) * SIZE
    motion: Floats = there - (np.array([x, y]) + 0.5 + offset)
    return motion


@pytest.mark.nightly_cases("cl", "wgpu", reason=ONLY_KERNELS)
@pytest.mark.parametrize("at", [0.0, 3e6])
def test_motion_of_a_turning_box_is_that_of_float64(device: rhi.Device, at: float) -> None:
    builder = make_boxes(**GREY)
    shift = translation((at, 0.0, 0.0))
    mesh = builder.add_mesh(BUILT_IN["box"]())
    poses = [
        shift @ rotation((0.2, 1.0, 0.1), angle) @ translation((0.1 * angle, 0.0, 0.0))
        for angle in (0.4, 0.5)
    ]
    node = builder.add_node(poses[0], dynamic=True)
    builder.add_objects(node, mesh, 0)
    builder.add_objects(builder.add_node(shift @ translation((1.5, 0.0, 0.0))), mesh, 0)
    scene = builder.build()
    cameras = [
        Camera.look_at((at + x, 0.8, 5.0), (at, 0.0, 0.0), projection=EYE.projection) for x in (0.6, 0.65)
    ]
    with Renderer(device, scene, visibility="frustum", size=SIZE, temporal=ON) as renderer:
        renderer.render(cameras[0])
        scene.nodes.set_local([node], poses[1][None])
        result = renderer.render(cameras[1])
        motion = result.targets["motion"].read().astype(np.float64)
        undo = poses[0] @ np.linalg.inv(poses[1])
        is_moved = motion[..., 3] > 0.5
        rows, columns = np.nonzero(is_moved)
        assert 50 < len(rows) < 1000
        for y, x in zip(rows[::7], columns[::7], strict=True):
            assert motion[y, x, :2] == pytest.approx(
                compute_motion(result, cameras[0], undo, (x, y)), abs=0.02
            )
        assert not is_moved[:, 48:].any(), "the other box stands still"


def test_motion_of_deformed_vertices_is_that_of_float64(gl: rhi.Device) -> None:
    with Renderer(gl, make_drift(), visibility="frustum", size=SIZE, temporal=ON) as renderer:
        for number in range(4):
            result = renderer.render(EYE, number / 60.0)
        motion = result.targets["motion"].read().astype(np.float64)
        rows, columns = np.nonzero(motion[..., 3] > 0.5)
        assert len(rows) > 50
        undo = translation((-1.0 / 60.0, 0.0, 0.0))
        for y, x in zip(rows[::7], columns[::7], strict=True):
            assert motion[y, x, :2] == pytest.approx(compute_motion(result, EYE, undo, (x, y)), abs=0.02)


@pytest.mark.nightly_cases("cl", "wgpu", reason=ONLY_KERNELS)
def test_a_moving_box_leaves_no_trail(device: rhi.Device) -> None:
    builder = make_boxes(**GREY | {"base_color": (0.9, 0.9, 0.9, 1.0)})
    mesh, dark = (
        builder.add_mesh(BUILT_IN["box"]()),
        builder.add_material(**GREY | {"base_color": (0.02, 0.03, 0.06)}),
    )
    node = builder.add_node(dynamic=True)
    builder.add_objects(node, mesh, 0)
    builder.add_objects(
        builder.add_node(translation((0.0, 0.0, -3.0)) @ scaling((20.0, 20.0, 0.1))), mesh, dark
    )
    builder.lights.sky = builder.lights.ground = (1.0, 1.0, 1.0)
    scene = builder.build()

    def move(number: int) -> None:
        scene.nodes.set_local([node], translation((0.06 * number - 1.2, 0.0, 0.0))[None])

    with Renderer(device, scene, visibility="frustum", size=SIZE, temporal=ON) as renderer:
        for number in range(20):
            move(number)
            image = read_levels(renderer.render(EYE))
    exact = draw_exactly(device, scene)
    brightest = exact.max()
    is_background = exact.max(axis=2) < 0.5 * brightest
    padded = np.pad(is_background, 1, mode="edge")  # a pixel away from the box's own edge
    is_background &= padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    assert is_background.sum() > 1000
    assert np.abs(image - exact)[is_background].max() < 6.0
    assert measure(image, exact) < 1.5


def test_surfaces_that_appear_are_shown_at_once(gl: rhi.Device) -> None:
    """A wall that hid a bar has gone: the bar isn't mixed with the wall."""
    builder = make_boxes((0.0, 0.0, 0.0), **GREY | {"base_color": (0.9, 0.1, 0.1, 1.0)})
    wall = builder.add_material(**GREY | {"base_color": (0.1, 0.9, 0.1)})
    node = builder.add_node(translation((0.0, 0.0, 2.0)) @ scaling((6.0, 6.0, 0.1)), dynamic=True)
    builder.add_objects(node, builder.add_mesh(BUILT_IN["box"]()), wall)
    builder.lights.sky = builder.lights.ground = (1.0, 1.0, 1.0)
    scene = builder.build()
    with Renderer(gl, scene, visibility="frustum", size=SIZE, temporal=ON) as renderer:
        for _ in range(8):
            renderer.render(EYE)
        scene.nodes.set_local([node], translation((90.0, 0.0, 2.0))[None])
        image = read_levels(renderer.render(EYE))
        index = renderer._sample_index - 1
    shifted = shift_samples(EYE, compute_offset(index), SIZE)
    with Renderer(gl, scene, visibility="frustum", size=SIZE) as renderer:
        renderer._fit = lambda camera: camera  # type: ignore[method-assign]
        fresh = read_levels(renderer.render(shifted))
    assert np.abs(image - fresh).max() <= 1.0


def count_kept(renderer: Renderer, camera: Camera, seconds: float = 0.0) -> int:
    """The most frames in a pixel of the next frame's history."""
    return int(renderer.render(camera, seconds).targets["temporal_history"].read()[..., 3].max())


def test_a_cut_begins_anew(gl: rhi.Device) -> None:
    with Renderer(gl, make_bars(), visibility="frustum", size=SIZE, temporal=ON) as renderer:
        assert [count_kept(renderer, EYE) for _ in range(3)] == [1, 2, 3]
        assert count_kept(renderer, EYE, 1.0) == 1, "time goes on by a second"
        assert count_kept(renderer, EYE, 1.1) == 2
        assert count_kept(renderer, EYE, 1.0) == 1, "time goes back"
        renderer.forget_history()
        assert count_kept(renderer, EYE, 1.0) == 1
        assert count_kept(renderer, EYE, 1.0) == 2
        assert (
            count_kept(renderer, Camera.look_at((5.0, 0.8, 0.6), (0, 0, 0), projection=EYE.projection), 1.0)
            == 1
        )
        renderer.size = (48, 32)
        assert count_kept(renderer, EYE, 1.0) == 1
        renderer.temporal = TemporalSettings()
        renderer.render(EYE, 1.0)
        renderer.temporal = ON
        assert count_kept(renderer, EYE, 1.0) == 1


def test_a_view_is_cut_beyond_30_degrees_and_a_16th_of_the_scene() -> None:
    scene = make_bars()
    diagonal = float(np.linalg.norm(np.subtract(*scene.bounds[::-1])))
    ahead = Camera.look_at((0, 0, 5), (0, 0, 0))

    def turn(degrees: float) -> Camera:
        angle = np.radians(degrees)
        return Camera.look_at((0, 0, 5), (np.sin(angle), 0.0, 5.0 - np.cos(angle)))

    assert not is_cut(scene, ahead, turn(29.0))
    assert is_cut(scene, ahead, turn(31.0))
    for share, cuts in ((0.06, False), (0.065, True)):
        assert (
            is_cut(scene, ahead, Camera.look_at((share * diagonal, 0, 5), (share * diagonal, 0, 0))) is cuts
        )
    assert is_cut(scene, ahead, ahead.with_projection(Orthographic(4.0)))
    assert is_cut(scene, ahead, ahead.with_projection(Perspective(depth=Depth.STANDARD)))


def test_a_history_outlives_another_plan(gl: rhi.Device) -> None:
    scene = make_bars()
    with Renderer(gl, scene, visibility="frustum", size=SIZE, temporal=ON) as renderer:
        assert [count_kept(renderer, EYE) for _ in range(3)] == [1, 2, 3]
        renderer.technique = TechniqueSettings("deferred").make(scene, gl)
        assert count_kept(renderer, EYE) == 4
        renderer.technique = Forward()
        assert count_kept(renderer, EYE) == 5


def test_offsets_are_spread_evenly() -> None:
    offsets = np.array([compute_offset(index) for index in range(64)])
    assert np.abs(offsets).max() <= 0.5
    assert np.abs(offsets.mean(axis=0)).max() < 0.02
    cells = np.floor((offsets + 0.5) * 4.0).astype(int)
    counts = np.bincount(cells[:, 0] * 4 + cells[:, 1], minlength=16)
    assert counts.min() >= 2
    assert compute_offset(0) == compute_offset(1024)


@pytest.mark.parametrize("projection", [Perspective(1.0, 1.6), Orthographic(4.0, 1.6)])
def test_shifted_cameras_sample_pixels_at_their_offset(projection: Any) -> None:
    camera = EYE.with_projection(projection)
    shifted = shift_samples(camera, (0.25, -0.4), SIZE)
    for point in ((0.3, 0.2, 0.0), (-1.0, 0.5, -3.0)):
        there, here = (c.view_projection @ (*point, 1.0) for c in (shifted, camera))
        pixels = [
            0.5 * np.array([1 + clip[0] / clip[3], 1 - clip[1] / clip[3]]) * SIZE for clip in (there, here)
        ]
        assert pixels[0] == pytest.approx(pixels[1] - (0.25, -0.4))
        assert there[2] == here[2]


def test_both_eyes_have_histories_of_their_own(gl: rhi.Device) -> None:
    scene, rig = make_bars(), StereoRig(0.2, 5.0)
    with Renderer(gl, scene, visibility="frustum", size=SIZE, temporal=ON) as renderer:
        renderer.stereo = Stereo(rig, "dubois")
        for _ in range(32):
            result = renderer.render(EYE)
        images = [image.read()[..., :3].astype(np.float64) for image in result.eye_images]
    for image, eye in zip(images, rig.place_eyes(EYE.with_aspect(SIZE[0] / SIZE[1])), strict=True):
        exact = draw_exactly(gl, scene, eye)
        single = measure(draw_frames(gl, scene, 1, eye, temporal=TemporalSettings())[0], exact)
        assert measure(image, exact) < 0.25 * single


def test_layers_of_the_scene_are_smoothed_too(gl: rhi.Device) -> None:
    scene = make_bars()
    layer = GroundGrid(gl)
    with Renderer(gl, scene, visibility="frustum", size=SIZE, temporal=ON) as renderer:
        renderer.layers.append(layer)
        images = [read_levels(renderer.render(EYE)) for _ in range(33)]
    layer.destroy()
    bare = draw_frames(gl, scene, 33)
    lines = np.abs(images[-1] - bare[-1])
    assert lines.max() > 5.0, "the control: the grid is drawn"
    change = [np.abs((images[i] - bare[i]) - (images[i - 1] - bare[i - 1])).mean() for i in (1, 32)]
    assert change[1] < 0.2 * change[0], "lines come to rest"


def list_passes(scene: Scene, camera: Camera = EYE, **options: Any) -> list[str]:
    with (
        rhi.create_device("null") as device,
        Renderer(device, scene, visibility="frustum", size=SIZE, **options) as renderer,
    ):
        return [frame_pass.name for frame_pass in renderer.plan(camera)[1].passes]


def count_commands(scene: Scene, **options: Any) -> list[object]:
    """The commands of the third frame on a null device."""
    with (
        rhi.create_device("null", record=True) as device,
        Renderer(device, scene, visibility="frustum", size=SIZE, **options) as renderer,
    ):
        for _ in range(2):
            renderer.render(EYE)
        before = len(device.stream)
        renderer.render(EYE)
        return [command.op for command in list(device.stream)[before:]]


def test_without_it_frames_are_as_before() -> None:
    scene = make_bars(dynamic=True)
    assert list_passes(scene) == ["forward"]
    settings = TemporalSettings(frames=99, still_frames=99, deviations=9.0, bits=32)
    assert count_commands(scene, temporal=settings) == count_commands(scene)


def test_passes_are_those_that_are_needed() -> None:
    assert list_passes(make_bars(), temporal=ON) == ["forward", *PASSES]
    assert list_passes(make_bars(dynamic=True), temporal=ON) == ["forward", "motion", *PASSES]
    assert list_passes(make_drift(), temporal=ON) == ["forward", "motion", *PASSES]


def test_a_view_of_the_background_alone_needs_nothing() -> None:
    away = Camera.look_at((0, 0, 5), (0, 0, 9), projection=EYE.projection)
    assert list_passes(make_bars(), away, temporal=ON) == ["forward"]


def test_objects_that_stand_still_draw_no_motion() -> None:
    def list_draws(*, moves: bool) -> int:
        scene = make_bars(dynamic=True)
        with (
            rhi.create_device("null", record=True) as device,
            Renderer(device, scene, visibility="frustum", size=SIZE, temporal=ON) as renderer,
        ):
            renderer.render(EYE)
            renderer.render(EYE)
            if moves:
                scene.nodes.set_local([0], (translation((0.1, 0.0, 0.0)) @ BARS[0])[None])
            before = device.statistics.draws
            renderer.render(EYE)
            return device.statistics.draws - before

    assert list_draws(moves=True) == list_draws(moves=False) + 1


def test_memory_is_that_of_the_history() -> None:
    with rhi.create_device("null") as device:
        plans = []
        for settings in (TemporalSettings(), ON, replace(ON, bits=32)):
            with Renderer(
                device, make_bars(), visibility="frustum", size=SIZE, temporal=settings
            ) as renderer:
                plans.append(renderer.plan(EYE)[1].count_bytes(SIZE))
    pixels = SIZE[0] * SIZE[1]
    assert plans[1] - plans[0] == 2 * (8 + 4) * pixels
    assert plans[2] - plans[0] == 2 * (16 + 4) * pixels


def test_films_refuse_it_by_name() -> None:
    with pytest.raises(ValidationError, match="film-temporal"):
        SceneFilm(make_bars(), EYE, settings=RenderSettings(temporal=ON))
    assert not SceneFilm(make_bars(), EYE).settings.temporal.is_on


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("frames", 1),
        ("frames", 1025),
        ("frames", 8.0),
        ("still_frames", 1),
        ("still_frames", 1025),
        ("deviations", -0.1),
        ("deviations", 10.1),
        ("deviations", float("nan")),
        ("bits", 8),
        ("is_on", 1.5),
    ],
)
def test_settings_out_of_range_are_refused(name: str, value: Any) -> None:
    with pytest.raises(ValidationError, match="temporal-bad-settings"):
        replace(TemporalSettings(), **{name: value})


def test_the_ends_of_ranges_are_settings() -> None:
    for values in ({"frames": 2, "still_frames": 2, "deviations": 0.0}, {"frames": 1024, "deviations": 10.0}):
        assert replace(ON, **values).is_on


def test_settings_are_kept_in_files(tmp_path: Any) -> None:
    settings = RenderSettings(temporal=TemporalSettings(True, 4, 99, 2.0, 32))
    settings.save(tmp_path / "settings.json")
    assert RenderSettings.load(tmp_path / "settings.json") == settings


def test_several_samples_a_pixel_are_no_hindrance(gl: rhi.Device) -> None:
    scene = make_bars()
    exact = draw_exactly(gl, scene)
    plain = draw_frames(gl, scene, 1, technique=Forward(samples=4), temporal=TemporalSettings())[0]
    smooth = draw_frames(gl, scene, 16, technique=Forward(samples=4))[-1]
    assert measure(smooth, exact) < 0.5 * measure(plain, exact)
