"""Visibility: whatever is culled, images look as they do without culling."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Final

import numpy as np

from renderer.lab.exam.case import Found, Measures, Picture
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
    numbers, holds = dict[str, int](), dict[str, bool]()
    worst = ("", "", -1)
    for title, image in IMAGES.items():
        if image.number != number:
            continue
        wrong, seen = _compare(device, image)
        holds |= {f"{title}: {statement}": is_true for statement, is_true in seen.items()}
        numbers |= {f"{title}, {name}": sum(count) for name, count in wrong.items()}
        name = max(wrong, key=lambda name: max(wrong[name]))
        worst = max(worst, (title, name, max(wrong[name])), key=lambda one: one[2])
    return Found(sum(numbers.values()), numbers, holds, partial(_picture, device, worst[0], worst[1]))


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
        wrong: dict[str, int] = {}
        for latency in LATENCIES:
            for name in list_algorithms(device):
                if name not in ASKING:
                    continue
                with late_answers(latency):
                    wrong[f"{name}, after {latency} looks"] = sum(uncut.try_algorithm(name))
    return Found(sum(wrong.values()), wrong, uncut.holds)


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


MEASURES: Final[Measures] = {
    1: choose_sizes,
    5: answer_late,
    6: ask_in_one_batch,
    8: ask_with_a_threshold,
    9: ask_seldom,
    12: fill_rings,
    **{image.number: partial(look_alike, image.number) for image in IMAGES.values()},
}
