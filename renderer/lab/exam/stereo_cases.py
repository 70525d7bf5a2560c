"""Stereo: parallax by its formula, eyes without distance, and colours of anaglyphs."""

from __future__ import annotations

from functools import cache, partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.content import load_scene
from renderer.lab.exam.case import CaseImage, CaseResult, Measures, largest_error
from renderer.renderer import Renderer
from renderer.scene import Camera, Orthographic, Perspective, Projection, Scene, StereoRig, measure_parallax
from renderer.scene.arrays import Floats
from renderer.stereo import ANAGLYPHS, Stereo, mix_anaglyph
from rhi import Device

SIZE: Final = (97, 55)  # odd: neither halves evenly
RIG: Final = StereoRig(0.3, 6.0)
NATURAL: Final = StereoRig(0.065, 2.5)
PROJECTIONS: Final[dict[str, Projection]] = {
    "perspective": Perspective(1.1, 16 / 9, 0.1),
    "parallel": Orthographic(6.0, 1.5, -2.0, 90.0),
}


def measure_parallaxes(_: Device) -> CaseResult:
    """Measure parallax in float64 by placing points, and compare it with its formula: P00 · e · (1/c -
    1/z)."""
    numbers: dict[str, object] = {}
    error = 0.0
    for name, projection in PROJECTIONS.items():
        camera = Camera.look_at((3.0, 1.7, -4.0), (4.0, 1.5, -6.0), projection=projection)
        right, up, _back = camera.rotation
        scale = float(projection.matrix[0, 0]) * NATURAL.eye_distance
        distances = np.append(np.geomspace(0.5, 1e4, 40), NATURAL.convergence)
        points = camera.position + distances[:, None] * (camera.forward + 0.3 * right + 0.15 * up)
        measured = measure_parallax(NATURAL.place_eyes(camera), points)
        if name == "parallel":
            formula = scale * (distances / NATURAL.convergence - 1.0)
        else:
            formula = scale * (1.0 / NATURAL.convergence - 1.0 / distances)
        off = np.abs(measured - np.column_stack([formula, 0.0 * formula])) / (1.0 + np.abs(formula))[:, None]
        computed = NATURAL.compute_parallax(projection, distances)
        error = largest_error(error, float(off.max()), float(np.abs(computed - formula).max()))
        numbers[f"{name}: at the convergence distance"] = float(measured[-1, 0])
        numbers[f"{name}: largest vertical parallax"] = float(np.abs(measured[:, 1]).max())
    projection = PROJECTIONS["perspective"]
    at_infinity = float(NATURAL.compute_parallax(projection, np.inf))
    expected = float(projection.matrix[0, 0]) * NATURAL.eye_distance / NATURAL.convergence
    numbers["perspective: at infinity"] = f"{at_infinity}, P00 · e / c is {expected}"
    return CaseResult(largest_error(error, abs(at_infinity - expected)), numbers)


@cache
def make_street() -> tuple[Scene, Camera]:
    """Make a small city and a camera in it."""
    scene = load_scene("city:blocks=6")
    return scene, scene.paths["ground"].camera(600)


def render_eyes(device: Device, stereo: Stereo | None) -> tuple[NDArray[Any], list[NDArray[Any]]]:
    """Render the street: the image, and the images of both eyes."""
    scene, camera = make_street()
    with Renderer(device, scene, size=SIZE, visibility="frustum") as renderer:
        renderer.stereo = stereo
        result = renderer.render(camera, 10.0)
        return result.image.read(), [eye_image.read() for eye_image in result.eye_images]


def measure_eyes_without_distance(device: Device) -> CaseResult:
    """Render eyes without distance, and compare their images with that of one eye."""
    mono, _ = render_eyes(device, None)
    wrong: dict[str, object] = {}
    total = 0
    for output in ("dubois", "color"):
        image, eye_images = render_eyes(device, Stereo(StereoRig(0.0, 6.0), output))
        images = [*eye_images, image] if output == "color" else eye_images
        counts = [int((eye_image != mono).any(2).sum()) for eye_image in images]
        wrong[output] = counts
        total += sum(counts)
    apart = render_eyes(device, Stereo(RIG, "color"))[1]
    holds = {"eyes with a distance see differently": not np.array_equal(apart[0], apart[1])}
    return CaseResult(total, wrong, holds, partial(_pair, mono, apart[0]))


def _pair(mono: CaseImage, left: CaseImage) -> dict[str, CaseImage]:
    return {"one eye, and both without a distance": mono, "the left eye with a distance": left}


def measure_grey_anaglyphs(_: Device) -> CaseResult:
    """Mix greys in float64, and compare them with the greys themselves."""
    grey = np.linspace(0.0, 1.0, 256)[:, None] * np.ones(3)
    off = {name: float(np.abs(mix_anaglyph(name, grey, grey) - grey).max()) for name in ANAGLYPHS}
    levels = np.round(_to_levels(grey))
    holds = {
        f"{name}: the same levels": bool(
            (np.round(_to_levels(mix_anaglyph(name, grey, grey))) == levels).all()
        )
        for name in ANAGLYPHS
    }
    return CaseResult(largest_error(*off.values()), dict(off), holds)


def measure_anaglyphs(device: Device) -> CaseResult:
    """Draw anaglyphs, and compare them with both eyes' images mixed in float64."""
    worst: dict[str, object] = {}
    error, maps = 0.0, dict[str, CaseImage]()
    for name in ANAGLYPHS:
        image, (left, right) = render_eyes(device, Stereo(RIG, name))
        want = np.round(_to_levels(mix_anaglyph(name, _to_linear(left), _to_linear(right))))
        off = np.abs(image[..., :3] - want).max(2)
        worst[name] = float(off.max())
        error = largest_error(error, float(off.max()))
        maps |= {name: image, f"{name}: off": off}
        if np.abs(left.astype(int) - right).max() <= 50:
            return CaseResult(np.nan, worst, {"eyes see differently": False})
    return CaseResult(error, worst, {}, lambda: maps)


def measure_two_eyes_in_one_frame(device: Device) -> CaseResult:
    """Draw both eyes in one frame, and each alone, and count the pixels that differ."""
    _, camera = make_street()
    scene, _ = make_street()
    with Renderer(device, scene, size=SIZE, visibility="frustum") as renderer:
        renderer.stereo = Stereo(RIG, "color")
        eye_images = [eye_image.read() for eye_image in renderer.render(camera, 10.0).eye_images]
        renderer.stereo = None
        alone = [renderer.render(eye, 10.0).image.read() for eye in RIG.place_eyes(camera)]
    wrong = [
        int((eye_image != expected).any(2).sum())
        for eye_image, expected in zip(eye_images, alone, strict=True)
    ]
    holds = {"eyes see differently": not np.array_equal(eye_images[0], eye_images[1])}
    return CaseResult(sum(wrong), {"left": wrong[0], "right": wrong[1]}, holds)


def _to_linear(pixels: NDArray[Any]) -> Floats:
    share = pixels[..., :3] / 255.0
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def _to_levels(light: Floats) -> Floats:
    return np.asarray(255.0 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055))


MEASURES: Final[Measures] = {
    45: measure_parallaxes,
    46: measure_eyes_without_distance,
    47: measure_grey_anaglyphs,
    55: measure_two_eyes_in_one_frame,
    56: measure_anaglyphs,
}
