"""Images of what was culled and why."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import rhi
from renderer.cli import main
from renderer.cli.debug_visibility import compose
from renderer.content import BUILT_IN
from renderer.lab.measure.culling_images import (
    COLORS,
    CullingOutcome,
    compute_outcomes,
    make_overhead_camera,
    render_culling_from_above,
    render_culling_from_camera,
    view_outline,
)
from renderer.renderer import Renderer
from renderer.scene import Camera, Depth, Perspective, Scene, SceneBuilder, scaling, translation
from renderer.visibility import FrustumCulling, StopAndWait
from rhi.math import multiply

PROJECTION = Perspective(np.pi / 2, 1.0, near=0.1)
POSITIONS = {
    CullingOutcome.OUTSIDE: (0.0, 0.0, 8.0),
    CullingOutcome.CROSSING: (9.0, 0.0, -10.0),
    CullingOutcome.INSIDE: (0.0, 0.0, -6.0),
    CullingOutcome.OCCLUDED: (0.0, 0.0, -12.0),
    CullingOutcome.NEAR: (0.0, -2.5, 0.0),
}
SIZES = dict.fromkeys(CullingOutcome, (2.0, 2.0, 2.0)) | {
    CullingOutcome.INSIDE: (6.0, 6.0, 2.0),
    CullingOutcome.NEAR: (4.0, 4.9, 4.0),
}


def make_scene() -> Scene:
    """An object of each outcome, row by row, seen from the origin along -z."""
    builder = SceneBuilder("outcomes")
    local = [multiply(translation(POSITIONS[outcome]), scaling(SIZES[outcome])) for outcome in CullingOutcome]
    mesh = builder.add_mesh(BUILT_IN["box"]())
    builder.add_objects(builder.add_nodes(np.array(local)), mesh, builder.add_material())
    builder.lights.add_directional((-0.4, -1.0, -0.3), (1.0, 1.0, 1.0), 1.5)
    return builder.build()


EYE = Camera.look_at((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), projection=PROJECTION)


def test_each_object_has_its_fate() -> None:
    drawn = np.array([CullingOutcome.CROSSING, CullingOutcome.INSIDE, CullingOutcome.NEAR])
    assert compute_outcomes(make_scene(), EYE, drawn).tolist() == list(CullingOutcome)


def test_drawn_objects_are_never_occluded_and_objects_outside_of_the_frustum_stay_outside_even_if_drawn() -> (
    None
):
    outcomes = compute_outcomes(make_scene(), EYE, np.arange(5))
    assert outcomes.tolist() == [
        CullingOutcome.OUTSIDE,
        CullingOutcome.CROSSING,
        CullingOutcome.INSIDE,
        CullingOutcome.INSIDE,
        CullingOutcome.NEAR,
    ]


@pytest.fixture
def renderer(gl: rhi.Device):
    scene = make_scene()
    with Renderer(gl, scene, visibility=StopAndWait(scene, gl), size=(120, 120)) as renderer_of_scene:
        yield renderer_of_scene


def hue(pixel: np.ndarray) -> CullingOutcome:
    """The outcome whose colour is the nearest."""
    linear = (pixel[:3] / 255.0) ** 2.2
    linear = linear / max(linear.max(), 1e-9)
    return min(
        CullingOutcome,
        key=lambda outcome: float(np.abs(np.array(COLORS[outcome]) / max(COLORS[outcome]) - linear).sum()),
    )


def test_from_above_boxes_have_the_colors_of_their_fates(renderer: Renderer) -> None:
    outcomes = compute_outcomes(renderer.scene, EYE, renderer.render(EYE).visible)
    assert outcomes.tolist() == list(CullingOutcome)
    image = render_culling_from_above(renderer, EYE, outcomes)
    rows, above = make_overhead_camera(renderer.scene, 1.0)
    for row in rows.tolist():
        x, y, z = POSITIONS[CullingOutcome(row)]
        position = np.array((x + 0.6, y, z + 0.6, 1.0))  # beside the lines
        x, y = (above.view_projection @ position)[:2]
        pixel = image[int(60 * (1.0 - y)), int(60 * (1.0 + x))]
        assert hue(pixel) == row
    assert (image[:, :, :3] == 255).all(axis=2).sum() > 50  # the lines
    assert set(rows.tolist()) >= {CullingOutcome.OUTSIDE, CullingOutcome.OCCLUDED}


def test_the_view_from_the_camera_shows_hidden_objects_through_their_occluders(renderer: Renderer) -> None:
    result = renderer.render(EYE)
    outcomes = compute_outcomes(renderer.scene, EYE, result.visible)
    plain = result.image.read()
    image = render_culling_from_camera(renderer, EYE, result, outcomes)
    changed = (plain != image).any(axis=2)
    seen = {hue(pixel) for pixel in image[changed]}
    assert seen >= {CullingOutcome.CROSSING, CullingOutcome.INSIDE, CullingOutcome.OCCLUDED}
    assert CullingOutcome.OUTSIDE not in seen
    corner = (EYE.view_projection @ (-1.0, 1.0, -11.0, 1.0))[:2] / 11.0  # of the hidden box
    x, y = int(60 * (1.0 + corner[0])), int(60 * (1.0 - corner[1]))
    around = image[y - 1 : y + 2, x - 1 : x + 2].reshape(-1, 4)
    assert CullingOutcome.OCCLUDED in {hue(pixel) for pixel in around}


def test_drawing_the_image_changes_no_later_frame(renderer: Renderer) -> None:
    before = renderer.render(EYE).image.read()
    result = renderer.render(EYE)
    render_culling_from_camera(renderer, EYE, result, compute_outcomes(renderer.scene, EYE, result.visible))
    assert (renderer.render(EYE).image.read() == before).all()


def test_standard_depth_hides_edges_as_well(gl: rhi.Device) -> None:
    scene = make_scene()
    projection = Perspective(np.pi / 2, 1.0, near=0.1, far=100.0, depth=Depth.STANDARD)
    with Renderer(gl, scene, visibility=FrustumCulling(scene), size=(120, 120)) as renderer:
        images = []
        for camera in (EYE, EYE.with_projection(projection)):
            result = renderer.render(camera)
            outcomes = compute_outcomes(scene, camera, result.visible)
            images.append(render_culling_from_camera(renderer, camera, result, outcomes))
    assert (images[0] != images[1]).any(axis=2).sum() < 60


def test_the_view_from_above_omits_objects_that_would_cover_the_image() -> None:
    builder = SceneBuilder("ground")
    mesh = builder.add_mesh(BUILT_IN["box"]())
    rng = np.random.default_rng(1)
    sizes = np.ones((30, 3))
    sizes[7] = (1000.0, 0.1, 1000.0)
    local = multiply(translation(rng.uniform(-30.0, 30.0, (30, 3))), scaling(sizes))
    builder.add_objects(builder.add_nodes(local), mesh, builder.add_material())
    rows, above = make_overhead_camera(builder.build(), 1.0)
    assert sorted(set(range(30)) - set(rows.tolist())) == [7]
    assert above.projection.height < 70.0


def test_the_outline_of_the_view_leads_from_the_eye_along_its_frustum() -> None:
    _, above = make_overhead_camera(make_scene(), 1.0)
    lines = view_outline(EYE, above)
    assert np.abs(lines[:, 0, [0, 2]]).max() < 0.2
    slopes = lines[:4, 1, 0] / lines[:4, 1, 2]
    assert np.abs(slopes) == pytest.approx(1.0)  # 90°, level
    inside = above.position[1] - lines[:, :, 1]
    assert (inside > 0.0).all()
    assert (inside < above.projection.far).all()


@pytest.mark.usefixtures("gl")
def test_debug_visibility_writes_an_image_and_counts(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / "new" / "culled.png"
    command = ["debug", "visibility", "city:blocks=6,detail=2", "--size", "160x90", "--output", str(path)]
    assert main([*command, "--frame", "900", "--warm-up", "2", "--backend", "gl", "--json"]) == 0
    counts = json.loads(capsys.readouterr().out)
    assert counts.pop("image") == str(path)
    assert list(counts) == [outcome.name.lower() for outcome in CullingOutcome]
    assert counts["occluded"] > 0 < counts["outside"]
    assert np.asarray(Image.open(path)).shape == (112, 320, 3)
    assert main([*command, "--algorithm", "frustum", "--camera", "overview"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[3].split() == ["0", "hidden", "by", "others"]


def test_the_legend_has_the_colors_of_the_image() -> None:
    empty = np.zeros((4, 600, 4), np.uint8)
    legend = np.asarray(compose((empty, empty), dict.fromkeys(CullingOutcome, 1)))
    for column, outcome in enumerate(CullingOutcome):
        levels = legend[4 + 10, 6 + column * 1200 // len(CullingOutcome) + 5]
        light = [x / 12.92 if x <= 0.04045 else ((x + 0.055) / 1.055) ** 2.4 for x in levels / 255.0]
        assert light == pytest.approx(COLORS[outcome], abs=0.005)  # half of a step between levels
