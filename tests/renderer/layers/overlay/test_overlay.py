"""The overlay: what it shows, what it draws to, and that a long run costs no more than a short one."""

from __future__ import annotations

import gc
import sys
from dataclasses import replace

import numpy as np
import pytest

from renderer.content import load_scene
from renderer.frame import Frame
from renderer.layers.canvas import Canvas, Font, srgb
from renderer.layers.overlay import Overlay, panels
from renderer.layers.overlay.history import History
from renderer.layers.overlay.overlay import name_algorithm
from renderer.layers.overlay.panels import (
    Rectangle,
    compute_ground_bounds,
    draw_graph,
    draw_legend,
    draw_map,
    draw_timers,
)
from renderer.renderer import Renderer
from renderer.scene import Camera, Perspective, Scene
from renderer.visibility import (
    AutoCulling,
    CullingTraversal,
    FrustumCulling,
    NoCulling,
    TraversalOutcome,
    make_visibility,
)
from rhi import Device, Format, Op, TimerNode
from tests.renderer.conftest import open_device

SIZE = (960, 540)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("city:blocks=3")


class Catch:
    """A layer that keeps the frame."""

    def render(self, device: Device, frame: Frame) -> None:
        self.frame = frame

    def destroy(self) -> None:
        pass


@pytest.fixture
def drawn_texts(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The texts that canvases are given."""
    texts: list[str] = []
    plain = Canvas.text

    def text(canvas: Canvas, x: float, y: float, text: str, *rest: object) -> tuple[int, int]:
        texts.append(text)
        return plain(canvas, x, y, text, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(Canvas, "text", text)
    return texts


def get_value(texts: list[str], name: str) -> str:
    """Return the value beside the name in the last two-column text that has it."""
    number = max(index for index, text in enumerate(texts) if name in text.split("\n"))
    return texts[number + 1].split("\n")[texts[number].split("\n").index(name)]


def test_an_overlay_is_two_draws_and_1000_frames_create_and_grow_nothing(null: Device, scene: Scene) -> None:
    camera = scene.paths["ground"].camera(600)
    catch, overlay = Catch(), Overlay(null)
    with Renderer(null, scene, visibility=FrustumCulling(scene), size=SIZE) as renderer:
        renderer.layers.append(catch)
        renderer.render(camera)
        least, most = 1 << 40, 0
        blocks = []  # of memory that Python has allocated
        for number in range(1100):
            before = null.statistics
            null.stream.clear()
            overlay.render(null, catch.frame)
            assert sum(command.op is Op.DRAW for command in null.stream) == overlay.draws == 2
            null.present(catch.frame.targets.image)
            after = null.statistics
            if number == 100:  # the graph is being filled until the 144th frame, by two more bars each
                settled = after.creations, null.transient.capacity
            if number >= 200:
                assert (after.creations, null.transient.capacity) == settled
                uploaded = after.upload_bytes - before.upload_bytes
                least, most = min(least, uploaded), max(most, uploaded)
            if number in (399, 1099):
                null.stream.clear()
                gc.collect()
                blocks.append(sys.getallocatedblocks())
    overlay.destroy()
    assert most < 200_000
    assert most - least < 4_800  # texts have some glyphs more or less
    assert blocks[1] - blocks[0] < 350  # of 700 frames; a number that is kept in each would be 700


def test_the_counters_are_those_of_the_frame_without_its_layers(
    null: Device, scene: Scene, drawn_texts: list[str]
) -> None:
    camera = scene.paths["ground"].camera(600)
    with Renderer(null, scene, visibility=NoCulling(scene), size=SIZE) as renderer:
        overlay = Overlay(null)
        renderer.layers.append(overlay)
        for _ in range(3):
            result = renderer.render(camera)
        overlay.destroy()
    statistics = result.statistics
    assert get_value(drawn_texts, "objects drawn") == f"{len(scene.objects):,} of {len(scene.objects):,}"
    assert get_value(drawn_texts, "triangles") == f"{statistics.triangles:,}"
    assert get_value(drawn_texts, "draw calls") == "1"
    changes = statistics.software_state_changes, statistics.hardware_state_changes
    assert get_value(drawn_texts, "states set / sent") == "{} / {}".format(*changes)
    assert get_value(drawn_texts, "uploaded") == f"{statistics.upload_bytes / 1024:,.1f} KiB"
    assert statistics.upload_bytes < 20 * len(scene.objects) + 64


def test_statistics_of_a_frame_are_the_same_with_and_without_layers(null: Device, scene: Scene) -> None:
    camera = scene.paths["ground"].camera(600)
    with Renderer(null, scene, visibility=FrustumCulling(scene), size=SIZE) as renderer:
        renderer.render(camera)
        plain = renderer.render(camera).statistics
        overlay = Overlay(null)
        renderer.layers.append(overlay)
        assert renderer.render(camera).statistics == plain
        changed = renderer.render(camera).statistics  # the overlay has left other states on the device
        assert replace(changed, hardware_state_changes=plain.hardware_state_changes) == plain
        overlay.destroy()


def test_the_overlay_covers_its_panels_and_changes_no_other_pixel(
    drawing_device: Device, scene: Scene, drawn_texts: list[str]
) -> None:
    camera = scene.paths["ground"].camera(600)
    with Renderer(drawing_device, scene, visibility=FrustumCulling(scene), size=SIZE) as renderer:
        plain = renderer.render(camera).image.read()
        overlay = Overlay(drawing_device)
        renderer.layers.append(overlay)
        for _ in range(3):
            result = renderer.render(camera)
            drawing_device.finish()
        covered = (result.image.read() != plain).any(axis=2)
        overlay.destroy()
    rows, columns = np.nonzero(covered)
    assert covered[8:300, 8:200].mean() > 0.95
    assert covered[8:300, 700:940].mean() > 0.95
    assert not covered[:, 330:640].any()
    assert not covered[450:].any()
    assert (rows.min(), columns.min()) == (8, 8)
    names = next(text for text in reversed(drawn_texts) if text.startswith("forward"))
    assert names == "forward\noverlay"
    assert overlay.milliseconds > 0.0


@pytest.mark.parametrize(("size", "most"), [((640, 360), 0.25), ((900, 640), 0.12), ((960, 500), 0.12)])
def test_the_overlay_covers_a_quarter_of_a_small_image(
    drawing_device: Device, scene: Scene, drawn_texts: list[str], size: tuple[int, int], most: float
) -> None:
    camera = scene.paths["ground"].camera(600)
    with Renderer(
        drawing_device, scene, visibility=make_visibility("chc", scene, drawing_device), size=size
    ) as renderer:
        overlay = Overlay(drawing_device)
        for _ in range(3):
            plain = renderer.render(camera).image.read()
        renderer.layers.append(overlay)
        covered = (renderer.render(camera).image.read() != plain).any(axis=2)
        overlay.destroy()
    assert 0.5 * most < covered.mean() <= most
    assert int(get_value(drawn_texts, "queries").split(" ")[0]) > 0


@pytest.mark.parametrize(("size", "panels"), [((901, 501), 2), ((900, 501), 1), ((901, 500), 1)])
def test_the_map_is_drawn_over_images_large_enough_for_it(
    null: Device, scene: Scene, drawn_texts: list[str], size: tuple[int, int], panels: int
) -> None:
    with Renderer(null, scene, visibility=FrustumCulling(scene), size=size) as renderer:
        overlay = Overlay(null)
        renderer.layers.append(overlay)
        renderer.render(scene.paths["ground"].camera(600))
        overlay.destroy()
    assert sum("objects from above" in text for text in drawn_texts) == panels - 1


def draw_panels(device: Device, scale: int) -> np.ndarray:
    """Return the panels with values that don't change."""
    rng = np.random.default_rng(5)
    times = rng.uniform(1.0, 60.0, 100)
    tree = [
        TimerNode("frame", 12.0, 3.0, [TimerNode("shadows", 4.5, 1.0), TimerNode("forward", 7.0, 2.0)]),
        TimerNode("overlay", 0.5, 2.5),
    ]
    corners = rng.uniform(-50.0, 50.0, (60, 3))
    traversal = CullingTraversal(
        True, corners, corners + rng.uniform(1.0, 9.0, (60, 3)), rng.integers(0, 4, 60).astype(np.uint8)
    )
    camera = Camera.look_at((0, 2, 0), (10, 2, 4), projection=Perspective(1.0))
    size = (600 * scale, 260 * scale)
    canvas = Canvas(device, Font.load())
    with device.texture(size, Format.RGBA8) as image:
        draw_graph(canvas, Rectangle(8, 8, 240 * scale, 60 * scale), times, 0.1 * times, 2 * scale)
        draw_timers(canvas, Rectangle(8, 80 * scale, 280 * scale, 0), tree, 120 * scale, scale)
        draw_legend(canvas, 8, 170 * scale, traversal, scale)
        ground = np.array((-50.0, -50.0)), np.array((59.0, 59.0))
        draw_map(canvas, Rectangle(320 * scale, 8, 240 * scale, 240 * scale), ground, traversal, camera)
        with device.render_pass(image, clear=(0.1, 0.1, 0.1, 1)):
            canvas.draw(size)
        pixels = np.asarray(image.read())
    canvas.destroy()
    return pixels


@pytest.mark.parametrize("scale", [1, 2])
def test_panels_are_the_same_on_gl_and_cl(scale: int) -> None:
    images = []
    for name in ("gl", "cl"):
        with open_device(name) as device:
            images.append(draw_panels(device, scale).astype(int))
    difference = np.abs(images[0] - images[1]).max(axis=2)
    # llvmpipe blends in 8 bits; a pixel centre on the edge of a slanted line may fall to either side.
    assert (difference > 2).sum() <= 4
    assert images[0].std() > 10


@pytest.mark.parametrize(("count", "more"), [(12, ""), (13, "\n... 1 more"), (40, "\n... 28 more")])
def test_a_large_timer_tree_is_cut_off(null: Device, drawn_texts: list[str], count: int, more: str) -> None:
    leaves = [TimerNode(f"event {number}", 1.0, 2.0) for number in range(1, count)]
    canvas = Canvas(null, Font.load())
    height = draw_timers(canvas, Rectangle(0, 0, 280, 0), [TimerNode("frame", 9.0, 9.0, leaves)], 90, 1)
    names = "frame\n" + "\n".join(f"  event {number}" for number in range(1, 12))
    assert drawn_texts[0] == names + more
    assert height == canvas.font.line_height * (12 + bool(more))


def test_the_graph_shows_each_frame_as_high_as_its_time(gl: Device) -> None:
    frames, python_times = np.array([10.0, 50.0, 200.0]), np.array([0.0, 25.0, 200.0])
    canvas = Canvas(gl, Font.load())
    with gl.texture((40, 120), Format.RGBA16F) as image:
        draw_graph(canvas, Rectangle(2, 10, 30, 100), frames, python_times, 3)
        with gl.render_pass(image, clear=(0, 0, 0, 1)):
            canvas.draw((40, 120))
        pixels = image.read().astype(float)
    canvas.destroy()
    top = 16.0 * 1000.0 / 60.0  # the least power of two times 1/60 s that is above 200 ms
    rules = [110 - round(100 * budget / top) for budget in (1000.0 / 60.0, 2000.0 / 60.0)]
    violet = np.abs(pixels[:, :, :3] - srgb("#c77dff")[:3]).max(axis=2) < 0.01
    for column, (time, foot) in zip((23, 26, 29), zip(frames, python_times, strict=True), strict=True):
        lit = np.flatnonzero(pixels[:, column, :3].max(axis=1) > 0.3)
        assert lit.max() == 109
        assert lit.min() == 110 - np.ceil(100 * time / top)
        under = np.arange(110 - int(np.ceil(100 * foot / top)), 110)
        assert np.flatnonzero(violet[:, column]).tolist() == [row for row in under if row not in rules]
    assert not violet[:, :23].any()


def test_a_history_keeps_the_latest_values_in_their_order() -> None:
    history = History(4)
    assert history.values.tolist() == []
    for number in range(1, 11):
        history.add(number)
        assert history.values.tolist() == list(range(max(1, number - 3), number + 1))


def test_the_ground_of_a_city_leaves_out_the_land_around_it(scene: Scene) -> None:
    low, high = compute_ground_bounds(scene)
    everything = np.stack(scene.bounds)[:, ::2]
    assert np.prod(high - low) < 0.5 * np.prod(everything[1] - everything[0])
    lower, upper = scene.objects.lower[:, ::2], scene.objects.upper[:, ::2]
    small = np.prod(upper - lower, axis=1) <= 0.05 * np.prod(high - low)
    assert small.any()
    assert (lower[small] >= low).all()
    assert (upper[small] <= high).all()


def test_a_camera_that_sees_nothing_and_an_image_smaller_than_the_panels_are_fine(
    null: Device, scene: Scene
) -> None:
    away = Camera.look_at((0, 5000, 0), (0, 6000, 0))
    with Renderer(null, scene, visibility=FrustumCulling(scene), size=(40, 30)) as renderer:
        overlay = Overlay(null, scale=2)
        renderer.layers.append(overlay)
        renderer.render(away)
        assert overlay.draws >= 1
        overlay.destroy()


def test_auto_is_named_with_its_choice(null: Device, scene: Scene) -> None:
    with Renderer(null, scene, size=(40, 30)) as renderer:
        assert isinstance(renderer.visibility, AutoCulling)
        renderer.render(scene.paths["ground"].camera(600))
        assert name_algorithm(renderer.visibility) == "auto, FrustumCulling"
    assert name_algorithm(make_visibility("none", scene, null)) == "NoCulling"


def draw_ground(gl: Device, traversal: CullingTraversal) -> np.ndarray:
    """Return a map of 100 × 100 texels, of which two at its edges are left free."""
    canvas, camera = Canvas(gl, Font.load()), Camera.look_at((-900, 0, 900), (-1000, 0, 1000))
    with gl.texture((100, 100), Format.RGBA8) as image:
        draw_map(canvas, Rectangle(0, 0, 100, 100), (np.zeros(2), np.full(2, 98.0)), traversal, camera)
        with gl.render_pass(image, clear=(0, 0, 0, 1)):
            canvas.draw((100, 100))
        pixels = image.read()
    canvas.destroy()
    return np.asarray(pixels[:, :, :3].any(axis=2))


@pytest.mark.parametrize("outcome", list(TraversalOutcome))
def test_every_outcome_has_its_color_on_the_map(gl: Device, outcome: TraversalOutcome) -> None:
    corners = np.array([(10.0, 0.0, 10.0)])
    rows, columns = np.nonzero(
        draw_ground(gl, CullingTraversal(False, corners, corners + 20.0, np.array([outcome], "u1")))
    )
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (11, 30, 11, 30)


def test_of_too_many_boxes_the_map_shows_the_largest(gl: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(panels, "MAX_BOXES", 2)
    corners, sides = (
        np.array([(x, 0.0, 10.0) for x in (10.0, 30.0, 50.0, 70.0)]),
        np.array([4.0, 9.0, 5.0, 8.0]),
    )
    traversal = CullingTraversal(
        False, corners, corners + sides[:, None], np.full(4, TraversalOutcome.HIDDEN, np.uint8)
    )
    assert draw_ground(gl, traversal)[13, [12, 32, 52, 72]].tolist() == [False, True, False, True]


@pytest.mark.parametrize("count", [2000, 2048, 2050])
def test_the_map_shows_2048_boxes_at_most(gl: Device, count: int) -> None:
    numbers = np.arange(count)
    corners = np.stack([2.0 * (numbers % 48), np.zeros(count), 2.0 * (numbers // 48)], axis=1)
    traversal = CullingTraversal(
        False, corners, corners + 1.0, np.full(count, TraversalOutcome.HIDDEN, np.uint8)
    )
    assert draw_ground(gl, traversal).sum() == min(count, 2048)
