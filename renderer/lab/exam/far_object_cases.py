"""Far objects drawn once for two eyes: panels near and far, whose pixels follow from rays in float64."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from renderer.content.shapes import plane
from renderer.lab.exam.case import CaseImage, CaseResult, Measures
from renderer.lab.exam.scenes import shows_something
from renderer.renderer import FrameResult, Renderer
from renderer.scene import Camera, Perspective, Scene, SceneBuilder, StereoRig
from renderer.scene.arrays import Floats, Indices
from renderer.stereo import Stereo
from renderer.stereo.pair import compute_far_rig
from renderer.techniques import TECHNIQUES
from rhi import Device

SIZE: Final = (97, 55)
RIG: Final = StereoRig(0.3, 6.0)
_FIELD_OF_VIEW: Final = 0.9
_EYE: Final = np.array((3.0, 1.7, -4.0))
_COLOR_RANGE: Final = 12  # levels by which the highlight of the light changes the colour of a panel
_UNSURE: Final = 0.02  # of a pixel: which side of an edge a pixel's middle is on


class Panels(NamedTuple):
    """Upright rectangles: their middles (k, 3), and their widths and heights (k, 2)."""

    middles: Floats
    sizes: Floats


def make_panels(seed: int = 5) -> Panels:
    """Make panels: eight near ones, 60 behind them, and a wall of panels side by side from near to far."""
    rng = np.random.default_rng(seed)
    distances = np.concatenate([rng.uniform(3.0, 14.0, 8), np.geomspace(40.0, 400.0, 60)])
    aside = rng.uniform(-0.8, 0.8, (len(distances), 2)) * (0.9, 0.5) * distances[:, None]
    sizes = rng.uniform(0.05, 0.3, aside.shape) * distances[:, None]
    return Panels(_EYE + np.column_stack([aside, -distances]), sizes)


def make_panel_scene(panels: Panels) -> tuple[Scene, Camera]:
    """Make a scene of panels in light, each of a colour of its own."""
    builder = SceneBuilder("panels")
    mesh = builder.add_mesh(plane())
    count = len(panels.middles)
    transforms = np.zeros((count, 4, 4))
    transforms[:, 0, 0], transforms[:, 1, 2] = panels.sizes[:, 0], -panels.sizes[:, 1]
    transforms[:, 2, 1] = transforms[:, 3, 3] = 1.0
    transforms[:, :3, 3] = panels.middles
    colors = np.random.default_rng(7).uniform(0.1, 1.0, (count, 3))
    materials = [builder.add_material(base_color=(*color, 1.0), roughness=1.0) for color in colors.tolist()]
    builder.add_objects(builder.add_nodes(transforms), mesh, materials)
    builder.lights.add_directional((0.0, 0.0, -1.0), (1.0, 1.0, 1.0), 2.0)
    projection = Perspective(_FIELD_OF_VIEW, SIZE[0] / SIZE[1])
    return builder.build(), Camera.look_at(_EYE, _EYE - np.array((0.0, 0.0, 1.0)), projection=projection)


def scale() -> float:
    """The horizontal scale of the projection."""
    return float(SIZE[1] / SIZE[0] / np.tan(0.5 * _FIELD_OF_VIEW))


def cast(
    panels: Panels, rig: StereoRig, side: float, columns: Floats, rows: Floats
) -> tuple[Indices, Floats]:
    """The panel that an eye sees at positions in pixels, -1 for none, and its distance. `side` is -1 for the
    left eye and 1 for the right one."""
    half = 0.5 * side * rig.eye_distance
    x = (2.0 * columns / SIZE[0] - 1.0) / scale() - half / rig.convergence
    y = (1.0 - 2.0 * rows / SIZE[1]) * np.tan(0.5 * _FIELD_OF_VIEW)
    seen, nearest = np.full(np.broadcast(x, y).shape, -1), np.full(np.broadcast(x, y).shape, np.inf)
    for number, (middle, size) in enumerate(zip(panels.middles - _EYE, panels.sizes, strict=True)):
        distance = -middle[2]
        is_hit = (np.abs(x * distance + half - middle[0]) <= 0.5 * size[0]) & (
            np.abs(y * distance - middle[1]) <= 0.5 * size[1]
        )
        is_hit &= distance < nearest
        seen, nearest = np.where(is_hit, number, seen), np.where(is_hit, distance, nearest)
    return seen, nearest


def _cast_right(
    panels: Panels, rig: StereoRig, distance: float, shift: int, columns: Floats, rows: Floats
) -> Indices:
    """The panels that the right eye is shown, -1 for none: near ones as it sees them, far ones as the left eye
    sees them `shift` pixels farther left, if that is in its image."""
    far = -(panels.middles - _EYE)[:, 2] >= distance
    numbers = np.append(np.arange(len(far)), -1)
    near_seen, near = cast(Panels(panels.middles[~far], panels.sizes[~far]), rig, 1.0, columns, rows)
    distant = Panels(panels.middles[far], panels.sizes[far])
    own, left = (cast(distant, rig, side, columns - moved, rows) for side, moved in ((1.0, 0), (-1.0, shift)))
    seen, farther = (
        np.where(columns < shift, first, second) for first, second in zip(own, left, strict=True)
    )
    of_near, of_far = np.append(numbers[:-1][~far], -1), np.append(numbers[:-1][far], -1)
    return np.where(near < farther, of_near[near_seen], of_far[seen])


def measure_far_objects(device: Device) -> CaseResult:
    """Draw panels for two eyes, what is far once, and count pixels that show another panel than rays do. Where
    a far panel ends behind a near one, by less than the error of parallax, the background may show: those pixels
    are counted apart."""
    panels = make_panels()
    scene, camera = make_panel_scene(panels)
    numbers, holds, images = dict[str, object](), dict[str, bool](), dict[str, CaseImage]()
    wrong = 0
    for technique in ("forward", "deferred"):
        for error in (1.0, 0.5):
            title = f"{technique}, {error} pixels"
            rig, distance, shift = compute_far_rig(RIG, scale(), SIZE[0], error)
            with Renderer(
                device, scene, technique=TECHNIQUES[technique](), size=SIZE, visibility="frustum"
            ) as renderer:
                renderer.stereo = Stereo(RIG, "color", far_error=error)
                result = renderer.render(camera)
                frames = [eye.read() for eye in result.eye_images]
            for description, is_true in shows_something(frames).items():
                holds[f"{title}: {description}"] = is_true
            pair = [frame[..., :3].astype(int) for frame in frames]
            counts = _count_wrong(panels, pair, rig, distance, shift, error)
            numbers |= {f"{title}: {name}": count for name, count in counts.items()}
            wrong += counts["left"] + counts["right"]
            parallax = (
                0.5 * SIZE[0] * rig.compute_parallax(camera.projection, np.geomspace(distance, 1e6, 99))
            )
            holds[f"{title}: parallax is within the error"] = bool(
                (np.abs(parallax - shift) <= error * (1.0 + 1e-9)).all()
            )
            holds[f"{title}: some are drawn once"] = _counts_fewer(result, scene)
            images |= {
                f"{title}, left": pair[0].astype(np.uint8),
                f"{title}, right": pair[1].astype(np.uint8),
            }
    return CaseResult(wrong, numbers, holds, lambda: images)


def _counts_fewer(result: FrameResult, scene: Scene) -> bool:
    return result.statistics.draws < 1.6 * len(result.visible)


def _count_wrong(
    panels: Panels, pair: list[NDArray[np.int64]], rig: StereoRig, distance: float, shift: int, error: float
) -> dict[str, int]:
    x, y = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    offsets = [(a * _UNSURE, b * _UNSURE) for a in (-1, 0, 1) for b in (-1, 0, 1)]
    left = np.array([cast(panels, rig, -1.0, x + a, y + b)[0] for a, b in offsets])
    right = np.array([_cast_right(panels, rig, distance, shift, x + a, y + b) for a, b in offsets])
    # The colour of a panel is the one that most of its pixels have in the left image.
    colors = {}
    for number in np.unique(left):
        seen_colors, counts = np.unique(pair[0][(left == number).all(0)], axis=0, return_counts=True)
        colors[int(number)] = seen_colors[counts.argmax()] if len(seen_colors) else None
    wrong = {"left": 0, "right": 0, "background beside edges": 0}
    for name, expected, image in (("left", left, pair[0]), ("right", right, pair[1])):
        for number, color in colors.items():
            if color is not None:
                is_sure = (expected == number).all(0)
                wrong[name] += int((np.abs(image - color).max(-1)[is_sure] > _COLOR_RANGE).sum())
    seen = np.array([cast(panels, rig, 1.0, x + error * a, y)[0] for a in np.linspace(-1.0, 1.0, 65)])
    can_be_empty = (seen == -1).any(0)
    is_empty = (pair[1] == colors[-1]).all(-1)
    wrong["background beside edges"] = int((is_empty & ~can_be_empty).sum())
    return wrong


MEASURES: Final[Measures] = {108: measure_far_objects}
