"""Images of what a frame is made of."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from frames import draw, first_view_camera, make_boxes, open_renderer, read_colors
from nightly_reasons import ONLY_KERNELS
from numpy.typing import NDArray
from PIL import Image

import rhi
from renderer.cli import main
from renderer.scene import Camera, Scene, scaling, translation
from renderer.techniques import Forward
from renderer.techniques.inspection import INSPECTIONS, Inspection, heat_color
from renderer.techniques.parts.light_list_reader import TILES, ClusterSettings
from rhi.shading import evaluate

SIZE = (32, 24)
BLUE, CYAN = (0, 0, 255), (0, 255, 255)
CELL = 149  # 0.3 in sRGB: what cells are of their colour over black


def tower(points: int = 0, spots: int = 0) -> Scene:
    """Make a floor seen from straight above, with lights above its middle, and one that reaches nothing in
    view."""
    builder = make_boxes(translation((0, -0.5, 0)) @ scaling((8, 1, 8)), name="tower")
    for _ in range(points):
        builder.lights.add_point((0, 1, 0), 1.5)
    for _ in range(spots):
        builder.lights.add_spot((0, 1, 0), (0, -1, 0), 1.5, 0.2, 0.3)
    builder.views["eye"] = Camera.look_at((0, 6, 0), (0, 0, 0), up=(0, 0, -1))
    return builder.build()


def show(device: rhi.Device, scene: Scene, name: str) -> NDArray[Any]:
    """Return the image (height, width, 3)."""
    return draw(device, scene, Inspection(name), size=SIZE)


def darken(scene: Scene) -> Scene:
    """Make everything black, with its lights."""
    scene.lights.sky = scene.lights.ground = scene.background = (0.0, 0.0, 0.0)
    for lights in (scene.lights.directional, scene.lights.point, scene.lights.spot):
        lights["intensity"] = 1e-25  # not 0, nor so faint that nothing near would show it: they are left out
    return scene


def find_linear(image: NDArray[Any]) -> NDArray[np.float64]:
    """Return the light of an image in sRGB."""
    share = np.asarray(image, float) / 255.0
    return np.where(share > 0.04045, ((share + 0.055) / 1.055) ** 2.4, share / 12.92)


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_normals_are_colours_along_the_worlds_axes(drawing_device: rhi.Device) -> None:
    middle = show(drawing_device, tower(), "normals")[SIZE[1] // 2, SIZE[0] // 2]
    assert np.abs(middle - (188, 255, 188)).max() <= 1  # (0, 1, 0): halves in sRGB are 188


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_depth_gets_darker_with_distance(drawing_device: rhi.Device) -> None:
    scene = tower()
    image = show(drawing_device, scene, "depth")
    shade = (1 - np.log10(6.0 / 0.1) / 4) ** 2
    expected = 255 * (1.055 * shade ** (1 / 2.4) - 0.055)
    assert np.abs(image[SIZE[1] // 2, SIZE[0] // 2] - expected).max() <= 2.0


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize(
    ("points", "spots", "color"), [(0, 0, (0, 0, 0)), (1, 0, BLUE), (0, 7, BLUE), (5, 3, CYAN)]
)
def test_lights_are_counted_where_they_reach(
    drawing_device: rhi.Device, points: int, spots: int, color: tuple[int, int, int]
) -> None:
    image = show(drawing_device, tower(points, spots), "lights")
    assert image[SIZE[1] // 2, SIZE[0] // 2].tolist() == list(color)
    assert not image[1, 1].any()  # out of their range


@pytest.mark.nightly_cases("cl", reason=ONLY_KERNELS)
def test_overdraw_counts_each_fragment(drawing_device: rhi.Device) -> None:
    scene = tower()
    with open_renderer(drawing_device, scene, Inspection("overdraw"), size=SIZE) as renderer:
        result = renderer.render(first_view_camera(scene))
        image, fragments = read_colors(result), result.targets["fragments"].read()
        assert (fragments == (result.depth.read() > 0.0)).all()
    assert image[SIZE[1] // 2, SIZE[0] // 2].tolist() == list(BLUE)


def test_colours_of_counts_change_where_they_double() -> None:
    counts = np.array([0, 1, 7, 8, 15, 16, 31, 32, 63, 64, 127, 128, 4096], np.float32)
    colors = evaluate(heat_color, counts, np.full(len(counts), 8.0, np.float32))
    black, blue, cyan, green = [0, 0, 0], [0, 0, 1], [0, 1, 1], [0, 1, 0]
    yellow, red, white = [1, 1, 0], [1, 0, 0], [1, 1, 1]
    assert colors.tolist() == [
        black,
        blue,
        blue,
        cyan,
        cyan,
        green,
        green,
        yellow,
        yellow,
        red,
        red,
        white,
        white,
    ]


def test_tiles_have_the_colours_of_their_lists(gl: rhi.Device) -> None:
    scene = tower(9)
    scene.lights.add_spot((2, 1, 0), (0, -1, 0), 1.2, 0.2, 0.3)
    darken(scene)
    with open_renderer(gl, scene, Inspection("tiles"), size=(64, 48)) as renderer:
        image = read_colors(renderer.render(first_view_camera(scene)))
        lists = renderer.view.workspace(TILES).read()
    counts = (lists.ends - lists.begins).reshape(3, 4)
    assert {0, 9} <= {*counts.ravel().tolist()} <= {0, 1, 9, 10}
    blue, cyan = (0, 0, CELL), (0, CELL, CELL)
    expected = {0: (0, 0, 0), 1: blue, 9: cyan, 10: cyan}
    for row in range(3):
        for column in range(4):
            inside = image[16 * row + 1 : 16 * row + 16, 16 * column + 1 : 16 * column + 16]
            assert np.abs(inside - expected[counts[row, column]]).max() <= 1
    rows = 16 * np.arange(3)
    assert not (image[rows, 1:16] == image[rows + 1, 1:16]).all(-1).any()  # a line between tiles


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize(("name", "tile"), [("tiles", 8), ("clusters", 4)])
def test_cells_are_those_of_the_settings(name: str, tile: int, tmp_path: Any) -> None:
    settings, output = tmp_path / "s.json", tmp_path / "shown.png"
    settings.write_text(
        '{"rendering": {"technique": {"tiles": {"tile": 8}, "clusters": {"tile": 4}}}}', encoding="utf-8"
    )
    command = ["render", "grid:count=1", "--size", "64x48", "--backend", "gl", "--technique", "forward"]
    light = []
    for options in ([], ["--show", name]):
        assert main([*command, *options, "--settings", str(settings), "--output", str(output)]) == 0
        light.append(find_linear(np.asarray(Image.open(output).convert("RGB"))))
    colors = (light[1] - 0.7 * light[0]) / 0.3
    edges = (np.abs(np.diff(colors, axis=1)) > 0.08).any(
        (0, 2)
    )  # between the column and the one to its right
    assert edges[tile - 1 :: tile].sum() >= 4
    inside = np.ones(63, bool)
    inside[tile - 1 :: tile] = inside[::tile] = False
    assert not edges[inside].any() or name == "clusters"


def test_clusters_have_the_colours_of_their_lists(gl: rhi.Device) -> None:
    scene, cells = darken(tower(9)), ClusterSettings(16, 8)
    with open_renderer(gl, scene, Inspection("clusters", cells), size=(64, 48)) as renderer:
        result = renderer.render(first_view_camera(scene))
        image, depth = read_colors(result), result.targets["depth"].read()
        grid = renderer.view.workspace(cells)
        lists = grid.read()
    assert (image[depth == 0] == 0).all()
    counts = (lists.ends - lists.begins).reshape(8, 3, 4)
    inside = np.ones((48, 64), bool)
    inside[::16], inside[:, ::16] = False, False
    rows, columns = np.nonzero(inside & (depth > 0))
    possible = counts[:, rows // 16, columns // 16]
    colors = image[rows, columns]
    blue, cyan = (0, 0, CELL), (0, CELL, CELL)
    for color, low, high in (((0, 0, 0), 0, 0), (blue, 1, 7), (cyan, 8, 15)):
        is_color = (np.abs(colors - color) <= 1).all(-1)
        fits = ((possible >= low) & (possible <= high)).any(0)
        assert fits[is_color].all()
    assert (np.abs(colors - cyan) <= 1).all(-1).any()


@pytest.mark.parametrize("name", ["tiles", "clusters"])
def test_the_image_shows_through_cells_and_is_as_it_was_without_lights(
    drawing_device: rhi.Device, name: str
) -> None:
    lit, (x, y) = tower(1), (SIZE[0] // 2 + 3, SIZE[1] // 2 + 3)  # between lines
    plain, cells = draw(drawing_device, lit, Forward(), size=SIZE), show(drawing_device, lit, name)
    light = find_linear(plain[y, x])
    assert light.max() > 0.05
    assert np.abs(find_linear(cells[y, x]) - (0.7 * light + (0.0, 0.0, 0.3))).max() < 0.006
    assert (draw(drawing_device, tower(), Forward(), size=SIZE) == show(drawing_device, tower(), name)).all()


@pytest.mark.parametrize("lights", [1, 2, 512])
def test_the_overlay_of_light_volumes_covers_the_pixels_that_they_reach(
    drawing_device: rhi.Device, lights: int
) -> None:
    scene = darken(tower(lights))
    scene.background = (0.9, 0.9, 0.9)
    scene.lights.sky = scene.lights.ground = (0.6, 0.6, 0.6)
    volumes, plain = show(drawing_device, scene, "volumes"), draw(drawing_device, scene, Forward(), size=SIZE)
    middle = SIZE[1] // 2, SIZE[0] // 2
    turns = 2.0 * np.pi * (0.61803399 * np.arange(lights)[:, None] + np.arange(3) / 3.0)
    color = (0.5 + 0.4 * np.cos(turns)).mean(0)
    opacity = 0.6 * (1.0 - np.exp(-0.1 * lights))  # the floor hides the backs of volumes
    light = (1.0 - opacity) * find_linear(plain[middle]) + opacity * color
    assert np.abs(find_linear(volumes[middle]) - light).max() < 0.01
    assert (volumes == plain)[1, 1].all()


def test_volumes_are_a_draw_for_each_kind_of_lights_and_one_for_their_mean(null: rhi.Device) -> None:
    scene = tower(512, 3)
    with open_renderer(null, scene, Forward(), size=SIZE) as renderer:
        counts = [null.statistics.draws]
        for technique in (Forward(), Inspection("volumes")):
            renderer.technique = technique
            renderer.render(first_view_camera(scene))
            counts.append(null.statistics.draws)
    lit, inspected = np.diff(counts)
    assert inspected - lit == 2 + 1  # point lights, spot lights, their mean


@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize("name", INSPECTIONS)
def test_render_shows_each_of_them(name: str, tmp_path: Any, capsys: pytest.CaptureFixture[str]) -> None:
    output = str(tmp_path / "shown.png")
    common = ["--size", "40x30", "--backend", "gl", "--visibility", "frustum", "--output", output]
    assert main(["render", "hall:columns=4,flags=2", "--show", name, *common]) == 0
    assert "shown.png" in capsys.readouterr().out
