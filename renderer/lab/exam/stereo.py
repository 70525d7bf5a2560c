"""Stereo: parallax by its formula, eyes that are one, and colours of anaglyphs."""

from __future__ import annotations

from functools import cache, partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.content import load_scene
from renderer.lab.exam.case import Found, Measures, Picture, find_largest
from renderer.renderer import Renderer
from renderer.scene import Camera, Orthographic, Perspective, Projection, Scene, StereoRig, measure_parallax
from renderer.scene.arrays import Floats
from renderer.stereo import ANAGLYPHS, Stereo, mix_anaglyph
from rhi import Device

SIZE: Final = (97, 55)  # odd: neither halves evenly
RIG: Final = StereoRig(0.3, 6.0)
NATURAL: Final = StereoRig(0.065, 2.5)
LENSES: Final[dict[str, Projection]] = {
    "perspective": Perspective(1.1, 16 / 9, 0.1),
    "parallel": Orthographic(6.0, 1.5, -2.0, 90.0),
}


def find_parallaxes(_: Device) -> Found:
    """Measure parallax in float64 by placing points, and compare it with its formula: P00 · e · (1/c - 1/z)."""
    numbers: dict[str, object] = {}
    error = 0.0
    for name, lens in LENSES.items():
        camera = Camera.look_at((3.0, 1.7, -4.0), (4.0, 1.5, -6.0), projection=lens)
        right, up, _back = camera.rotation
        scale = float(lens.matrix[0, 0]) * NATURAL.eye_distance
        distances = np.append(np.geomspace(0.5, 1e4, 40), NATURAL.convergence)
        points = camera.position + distances[:, None] * (camera.forward + 0.3 * right + 0.15 * up)
        measured = measure_parallax(NATURAL.place_eyes(camera), points)
        if name == "parallel":
            formula = scale * (distances / NATURAL.convergence - 1.0)
        else:
            formula = scale * (1.0 / NATURAL.convergence - 1.0 / distances)
        off = np.abs(measured - np.column_stack([formula, 0.0 * formula])) / (1.0 + np.abs(formula))[:, None]
        said = NATURAL.find_parallax(lens, distances)
        error = find_largest(error, float(off.max()), float(np.abs(said - formula).max()))
        numbers[f"{name}: at the convergence distance"] = float(measured[-1, 0])
        numbers[f"{name}: largest vertical parallax"] = float(np.abs(measured[:, 1]).max())
    lens = LENSES["perspective"]
    at_infinity = float(NATURAL.find_parallax(lens, np.inf))
    wanted = float(lens.matrix[0, 0]) * NATURAL.eye_distance / NATURAL.convergence
    numbers["perspective: at infinity"] = f"{at_infinity}, P00 · e / c is {wanted}"
    return Found(find_largest(error, abs(at_infinity - wanted)), numbers)


@cache
def make_street() -> tuple[Scene, Camera]:
    """Make a small city and a camera in it."""
    scene = load_scene("city:blocks=6")
    return scene, scene.paths["ground"].camera(600)


def show_eyes(device: Device, stereo: Stereo | None) -> tuple[NDArray[Any], list[NDArray[Any]]]:
    """Return the image of the street, and the pictures of the eyes."""
    scene, camera = make_street()
    with Renderer(device, scene, size=SIZE, visibility="frustum") as renderer:
        renderer.stereo = stereo
        result = renderer.render(camera, 10.0)
        return result.image.read(), [picture.read() for picture in result.pictures]


def join_eyes(device: Device) -> Found:
    """Let eyes have no distance, and compare their pictures with that of one eye."""
    mono, _ = show_eyes(device, None)
    wrong: dict[str, object] = {}
    total = 0
    for output in ("dubois", "color"):
        image, pictures = show_eyes(device, Stereo(StereoRig(0.0, 6.0), output))
        shown = [*pictures, image] if output == "color" else pictures
        counts = [int((one != mono).any(2).sum()) for one in shown]
        wrong[output] = counts
        total += sum(counts)
    apart = show_eyes(device, Stereo(RIG, "color"))[1]
    holds = {"eyes with a distance see differently": not np.array_equal(apart[0], apart[1])}
    return Found(total, wrong, holds, partial(_pair, mono, apart[0]))


def _pair(mono: Picture, left: Picture) -> dict[str, Picture]:
    return {"one eye, and both without a distance": mono, "the left eye with a distance": left}


def keep_grey(_: Device) -> Found:
    """Mix greys in float64, and compare them with themselves."""
    grey = np.linspace(0.0, 1.0, 256)[:, None] * np.ones(3)
    off = {name: float(np.abs(mix_anaglyph(name, grey, grey) - grey).max()) for name in ANAGLYPHS}
    levels = np.round(_to_levels(grey))
    holds = {
        f"{name}: the same levels": bool((np.round(_to_levels(mix_anaglyph(name, grey, grey))) == levels).all())
        for name in ANAGLYPHS
    }
    return Found(find_largest(*off.values()), dict(off), holds)


def mix_pictures(device: Device) -> Found:
    """Draw anaglyphs, and compare them with the mix of both eyes' pictures in float64."""
    worst: dict[str, object] = {}
    error, maps = 0.0, dict[str, Picture]()
    for name in ANAGLYPHS:
        image, (left, right) = show_eyes(device, Stereo(RIG, name))
        want = np.round(_to_levels(mix_anaglyph(name, _to_linear(left), _to_linear(right))))
        off = np.abs(image[..., :3] - want).max(2)
        worst[name] = float(off.max())
        error = find_largest(error, float(off.max()))
        maps |= {name: image, f"{name}: off": off}
        if np.abs(left.astype(int) - right).max() <= 50:
            return Found(np.nan, worst, {"eyes see differently": False})
    return Found(error, worst, {}, lambda: maps)


def draw_each_eye(device: Device) -> Found:
    """Draw both eyes in one frame, and each alone, and count the pixels that differ."""
    _, camera = make_street()
    scene, _ = make_street()
    with Renderer(device, scene, size=SIZE, visibility="frustum") as renderer:
        renderer.stereo = Stereo(RIG, "color")
        both = [picture.read() for picture in renderer.render(camera, 10.0).pictures]
        renderer.stereo = None
        alone = [renderer.render(eye, 10.0).image.read() for eye in RIG.place_eyes(camera)]
    wrong = [int((one != other).any(2).sum()) for one, other in zip(both, alone, strict=True)]
    holds = {"eyes see differently": not np.array_equal(both[0], both[1])}
    return Found(sum(wrong), {"left": wrong[0], "right": wrong[1]}, holds)


def _to_linear(pixels: NDArray[Any]) -> Floats:
    share = pixels[..., :3] / 255.0
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)


def _to_levels(light: Floats) -> Floats:
    return np.asarray(255.0 * np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055))


MEASURES: Final[Measures] = {
    45: find_parallaxes,
    46: join_eyes,
    47: keep_grey,
    55: draw_each_eye,
    56: mix_pictures,
}
