"""Visibility: whatever is culled, images look as they do without culling."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Final

import numpy as np

from renderer.lab.exam.case import Case, Found, Picture
from renderer.lab.exam.late import late_answers
from renderer.lab.exam.scenes import IMAGES, SIZE, CullingImage, Uncut, along, draw_with, make_city, teleport
from renderer.renderer import Renderer
from renderer.visibility import ALGORITHMS, ChcPlusPlus, VisibilitySettings, list_algorithms, make_visibility
from renderer.visibility.queries.chc_plus_plus import STAYS_HIDDEN, choose_size
from rhi import Device, FixedQueue, ValidationError

NAMES: Final = tuple(name for name in ALGORITHMS if name != "none")
ASKING: Final = ("stop_and_wait", "chc", "chc_plus_plus", "conditional")
"""The algorithms that ask the device by queries."""
LATENCIES: Final = (0, 1, 20, 10**9)
"""The number of times that an answer is looked at before it is there; the last stands for never within the frame."""
_FAR_SMALLER: Final = 0.1  # of the image: what a threshold of 10 samples may lose


def look_alike(number: int, device: Device) -> Found:
    """Draw the images of a case with each algorithm that the device runs, and count the pixels that differ."""
    numbers: dict[str, object] = {}
    worst = ("", "", -1)
    total, holds = 0, dict[str, bool]()
    for title, image in IMAGES.items():
        if image.number != number:
            continue
        wrong, seen = _compare(device, image)
        holds |= {f"{title}: {statement}": is_true for statement, is_true in seen.items()}
        numbers |= {f"{title}, {name}": sum(count) for name, count in wrong.items()}
        total += sum(map(sum, wrong.values()))
        name = max(wrong, key=lambda name: max(wrong[name]))
        worst = max(worst, (title, name, max(wrong[name])), key=lambda one: one[2])
    return Found(total, numbers, holds, partial(_picture, device, worst[0], worst[1]))


def _compare(device: Device, image: CullingImage) -> tuple[dict[str, list[int]], dict[str, bool]]:
    scene = image.scene()
    with Uncut(device, scene, image.shots(scene), image.size) as uncut:
        wrong = {name: uncut.try_algorithm(name) for name in list_algorithms(device) if name in NAMES}
    return wrong, uncut.holds


def _picture(device: Device, title: str, name: str) -> Mapping[str, Picture]:
    """Return the worst frame of an image as it is without culling, with an algorithm, and where the two differ."""
    image = IMAGES[title]
    scene = image.scene()
    with Uncut(device, scene, image.shots(scene), image.size) as uncut:
        algorithm = make_visibility(name, scene, device)
        frames = uncut.draw(algorithm)
        differs = [(one != other).any(2) for one, other in zip(frames, uncut.frames, strict=True)]
        worst = int(np.argmax([one.sum() for one in differs]))
        algorithm.destroy()
    return {
        f"{title}: without culling": uncut.frames[worst],
        name: frames[worst],
        "differs": differs[worst].astype(np.float64),
    }


def choose_sizes(_: Device) -> Found:
    """Compare the sizes of multiqueries with those that have the most nodes for a query, of all that there may be:
    k nodes, each of which stays hidden with a probability of p, take 1 + k (1 - p^k) queries."""
    queued, numbers, error = np.arange(1.0, 41.0), dict[str, object](), 0
    for frames in range(1, 16):
        stays = 0.99 - 0.7 * np.exp(-float(frames))
        best = int(np.argmax(queued / (1.0 + queued * (1.0 - stays**queued)))) + 1
        chosen = choose_size([STAYS_HIDDEN[frames]] * 40)
        numbers[f"after {frames} frames"] = f"{chosen} of {best}"
        error += abs(chosen - best) + abs(choose_size([STAYS_HIDDEN[frames]]) - 1)
    return Found(error, numbers)


def answer_late(device: Device) -> Found:
    """Let answers come after so many looks, and count the pixels that differ in a walk with a jump."""
    city = make_city()
    with Uncut(device, city, [*along("ground", 600, 604, 608)(city), *teleport(city)[3:6]]) as uncut:
        wrong: dict[str, object] = {}
        total = 0
        for latency in LATENCIES:
            for name in list_algorithms(device):
                if name not in ASKING:
                    continue
                with late_answers(latency):
                    count = sum(uncut.try_algorithm(name))
                wrong[f"{name}, after {latency} looks"] = count
                total += count
    return Found(total, wrong, uncut.holds)


def ask_in_one_batch(device: Device) -> Found:
    """Let CHC++ ask for all at once."""
    city = make_city()
    with Uncut(device, city, along("ground", *range(800, 812, 2))(city)) as uncut:
        wrong = uncut.try_algorithm("chc_plus_plus", batch=100_000)
    return Found(sum(wrong), {"wrong pixels by frame": wrong}, uncut.holds)


def ask_with_a_threshold(device: Device) -> Found:
    """Compare a threshold of 0 samples, which loses nothing, and one of 10, which loses little."""
    city = make_city()
    with Uncut(device, city, along("ground", *range(600, 624, 4))(city)) as uncut:
        numbers: dict[str, object] = {}
        total, holds = 0, dict(uncut.holds)
        for name in ("stop_and_wait", "chc", "chc_plus_plus"):
            wrong = {}
            for threshold in (0, 10):
                with late_answers(0):
                    wrong[threshold] = uncut.try_algorithm(name, threshold=threshold)
                numbers[f"{name}, {threshold} samples"] = wrong[threshold]
            total += sum(wrong[0])
            holds[f"{name} loses little with 10"] = 0 < max(wrong[10]) < _FAR_SMALLER * SIZE[0] * SIZE[1]
    return Found(total, numbers, holds)


def ask_seldom(device: Device) -> Found:
    """Let CHC++ ask visible leaves in each frame, and every twentieth."""
    city = make_city()
    shots = along("ground", *range(800, 848, 2))(city)
    with Uncut(device, city, shots) as uncut:
        total, most = 0, []
        for persistence in (1, 20):
            with late_answers(0):
                algorithm = ChcPlusPlus(city, device, VisibilitySettings(persistence=persistence))
                total += sum(uncut.count_wrong_pixels(algorithm))
                with Renderer(device, city, size=SIZE) as renderer:
                    queries = [draw_with(renderer, algorithm, camera).statistics.queries for camera, _ in shots]
                algorithm.destroy()
            most.append(max(queries[4:]))
    numbers = {"wrong pixels": total, "most queries of a frame, n = 1": most[0], "n = 20": most[1]}
    return Found(total, numbers, {"n = 20 flattens the spikes": most[1] < most[0], **uncut.holds})


def fill_rings(_: Device) -> Found:
    """Fill and empty rings of 1, 3 and 8, round and round, and count what isn't as it should be."""
    wrong = {}
    for size in (1, 3, 8):
        ring: FixedQueue[int] = FixedQueue(size)
        count = 0
        for turn in range(4):
            for value in range(size):
                ring.push(value + turn)
            count += not ring
            try:
                ring.push(size)
                count += 1
            except ValidationError:
                pass
            count += [ring.pop() for _ in range(size)] != list(range(turn, turn + size))
            count += bool(ring)
        wrong[f"ring of {size}"] = count
    return Found(sum(wrong.values()), dict(wrong))


_PIXELS: Final = "wrong pixels"
_UNCUT: Final = "the same frames without culling"
_WHY_EXACT: Final = "what is drawn is drawn by the same shaders, so it is the same to the bit"
_DRAWS: Final = ("renders",)
_QUERIES: Final = ("renders", "occlusion_queries")


def _image(number: int, about: str) -> Case:
    return Case(number, about, _UNCUT, 0.0, _PIXELS, _WHY_EXACT, partial(look_alike, number), _DRAWS)


def _asked(number: int, about: str, measure: Callable[[Device], Found]) -> Case:
    return Case(number, about, _UNCUT, 0.0, _PIXELS, _WHY_EXACT, measure, _QUERIES)


CASES: Final = (
    Case(
        1,
        "how many nodes share a query of CHC++",
        "the best of all sizes, by the formula of the thesis in float64",
        0.0,
        "nodes",
        "sizes are whole numbers",
        choose_sizes,
    ),
    _image(2, "a camera 1.5 near planes from a box's corner, which that plane cuts"),
    _image(3, "a camera inside a box"),
    _image(4, "a camera that jumps through a city"),
    _asked(5, "answers of queries after 0, 1 and 20 looks, and never within a frame", answer_late),
    _asked(6, "a batch of queries larger than the tree", ask_in_one_batch),
    _image(7, "everything visible; everything hidden but a wall"),
    _asked(8, "thresholds of 0 and 10 samples", ask_with_a_threshold),
    _asked(9, "visible leaves asked in each frame, and in every twentieth", ask_seldom),
    _image(10, "boxes without thickness"),
    _image(11, "a scene of one object: queries of one node"),
    Case(12, "a ring of N holds N", "a list", 0.0, "faults", "a ring neither loses nor invents anything", fill_rings),
    _image(13, "corners of boxes with w at 0 and below"),
    _image(14, "spheres that touch the near plane, within an ulp"),
    _image(15, "1023 by 767 pixels: a depth pyramid of odd sizes"),
    _image(16, "what shows through a slit of a pixel"),
    _image(17, "sky through a hole in a wall, in a texel of a depth pyramid"),
    _image(18, "a box smaller than a pixel"),
    _image(19, "what was seen in the last frame is behind the camera"),
    _image(20, "1 by 1, 17 by 9 and 130 by 67 pixels: no multiple of 4"),
    _image(21, "two faces at exactly the same depth"),
    _image(52, "boxes a million metres from the origin"),
    _image(53, "a parallel lens whose near plane cuts boxes"),
    _image(77, "a flag that is behind a wall for 6 s, and for 6 s behind the eye"),
)
