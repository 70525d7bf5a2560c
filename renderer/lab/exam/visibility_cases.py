"""Visibility: images with culling equal those without."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Final

import numpy as np

from renderer.lab.exam.case import CaseImage, CaseResult, Measures, check_early
from renderer.lab.exam.late_queries import late_query_results
from renderer.lab.exam.scenes import (
    CULLING_SCENARIOS,
    SIZE,
    CullingScenario,
    UnculledFrames,
    along,
    draw_with,
    make_city,
    teleport,
)
from renderer.renderer import Renderer
from renderer.visibility import ALGORITHMS, ChcPlusPlus, VisibilitySettings, list_algorithms, make_visibility
from renderer.visibility.queries.chc_plus_plus import STAY_HIDDEN_PROBABILITIES, choose_group_size
from rhi import Device, FixedQueue, ValidationError

NAMES: Final = tuple(name for name in ALGORITHMS if name != "none")
QUERYING: Final = ("stop_and_wait", "chc", "chc_plus_plus", "conditional")
"""The algorithms that use occlusion queries."""
LATENCIES: Final = (0, 1, 20, 10**9)
"""How often a query is checked before it is finished; the last stands for never within the frame."""
_FAR_SMALLER: Final = 0.1  # fraction of the image that a threshold of 10 samples may lose


def measure_culled_images(number: int, device: Device) -> CaseResult:
    """Render a case with each algorithm that the device runs, and count the pixels that differ."""
    numbers, holds = dict[str, int](), dict[str, bool]()
    worst = ("", "", -1)
    for title, scenario in CULLING_SCENARIOS.items():
        if scenario.number != number:
            continue
        wrong, seen = _compare(device, scenario)
        holds |= {f"{title}: {description}": is_true for description, is_true in seen.items()}
        numbers |= {f"{title}, {name}": sum(count) for name, count in wrong.items()}
        name = max(wrong, key=lambda name: max(wrong[name]))
        worst = max(worst, (title, name, max(wrong[name])), key=lambda candidate: candidate[2])
    return CaseResult(
        sum(numbers.values()), numbers, holds, partial(_worst_images, device, worst[0], worst[1])
    )


def _compare(device: Device, scenario: CullingScenario) -> tuple[dict[str, list[int]], dict[str, bool]]:
    scene = scenario.scene()
    with UnculledFrames(device, scene, scenario.shots(scene), scenario.size) as uncut:
        wrong = {}
        for name in list_algorithms(device):
            if name in NAMES:
                wrong[name] = uncut.try_algorithm(name)
                check_early({f"{name} draws the same": not any(wrong[name])})
    return wrong, uncut.holds


def _worst_images(device: Device, title: str, name: str) -> Mapping[str, CaseImage]:
    """The worst frame without culling, with an algorithm, and where the two differ."""
    scenario = CULLING_SCENARIOS[title]
    scene = scenario.scene()
    with UnculledFrames(device, scene, scenario.shots(scene), scenario.size) as uncut:
        algorithm = make_visibility(name, scene, device)
        frames = uncut.draw(algorithm)
        differs = [(image != expected).any(2) for image, expected in zip(frames, uncut.frames, strict=True)]
        worst = int(np.argmax([image.sum() for image in differs]))
        algorithm.destroy()
    return {
        f"{title}: without culling": uncut.frames[worst],
        name: frames[worst],
        "differs": differs[worst].astype(np.float64),
    }


def measure_batch_sizes(_: Device) -> CaseResult:
    """Compare the sizes of multiqueries with the best of all: k nodes, each of which stays hidden with
    probability p, take 1 + k (1 - p^k) queries."""
    queued, numbers, error = np.arange(1.0, 41.0), dict[str, object](), 0
    for frames in range(1, 16):
        stays = 0.99 - 0.7 * np.exp(-float(frames))
        best = int(np.argmax(queued / (1.0 + queued * (1.0 - stays**queued)))) + 1
        group_size = choose_group_size([STAY_HIDDEN_PROBABILITIES[frames]] * 40)
        numbers[f"after {frames} frames"] = f"{group_size} of {best}"
        error += abs(group_size - best) + abs(choose_group_size([STAY_HIDDEN_PROBABILITIES[frames]]) - 1)
    return CaseResult(error, numbers)


def measure_late_queries(device: Device) -> CaseResult:
    """Delay query results, and count the pixels that differ in a walk with a jump."""
    city = make_city()
    with UnculledFrames(device, city, [*along("ground", 600, 604, 608)(city), *teleport(city)[3:6]]) as uncut:
        wrong: dict[str, int] = {}
        for latency in LATENCIES:
            for name in list_algorithms(device):
                if name not in QUERYING:
                    continue
                title = f"{name}, after {latency} looks"
                with late_query_results(latency):
                    wrong[title] = sum(uncut.try_algorithm(name))
                check_early({f"{title}: draws the same": not wrong[title]})
    return CaseResult(sum(wrong.values()), wrong, uncut.holds)


def measure_one_batch(device: Device) -> CaseResult:
    """Measure CHC++ with all queries in one batch."""
    city = make_city()
    with UnculledFrames(device, city, along("ground", *range(800, 812, 2))(city)) as uncut:
        wrong = uncut.try_algorithm("chc_plus_plus", batch=100_000)
    return CaseResult(sum(wrong), {"wrong pixels by frame": wrong}, uncut.holds)


def measure_visibility_threshold(device: Device) -> CaseResult:
    """Compare a threshold of 0 samples, which loses nothing, with one of 10, which loses little."""
    city = make_city()
    with UnculledFrames(device, city, along("ground", *range(600, 624, 4))(city)) as uncut:
        numbers: dict[str, object] = {}
        total, holds = 0, dict(uncut.holds)
        for name in ("stop_and_wait", "chc", "chc_plus_plus"):
            wrong = {}
            for threshold in (0, 10):
                with late_query_results(0):
                    wrong[threshold] = uncut.try_algorithm(name, threshold=threshold)
                numbers[f"{name}, {threshold} samples"] = wrong[threshold]
            total += sum(wrong[0])
            holds[f"{name} loses little with 10"] = 0 < max(wrong[10]) < _FAR_SMALLER * SIZE[0] * SIZE[1]
    return CaseResult(total, numbers, holds)


def measure_query_persistence(device: Device) -> CaseResult:
    """Measure CHC++ with visible leaves queried in each frame, and in every twentieth."""
    city = make_city()
    shots = along("ground", *range(800, 848, 2))(city)
    with UnculledFrames(device, city, shots) as uncut:
        total, most = 0, []
        for persistence in (1, 20):
            with late_query_results(0):
                algorithm = ChcPlusPlus(city, device, VisibilitySettings(persistence=persistence))
                total += sum(uncut.count_wrong_pixels(algorithm))
                with Renderer(device, city, size=SIZE) as renderer:
                    queries = [
                        draw_with(renderer, algorithm, camera).statistics.queries for camera, _ in shots
                    ]
                algorithm.destroy()
            most.append(max(queries[4:]))
    numbers = {"wrong pixels": total, "most queries of a frame, n = 1": most[0], "n = 20": most[1]}
    return CaseResult(total, numbers, {"n = 20 flattens the spikes": most[1] < most[0], **uncut.holds})


def measure_rings(_: Device) -> CaseResult:
    """Fill and empty rings of 1, 3 and 8, round and round, and count wrong results."""
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
    return CaseResult(sum(wrong.values()), dict(wrong))


MEASURES: Final[Measures] = {
    1: measure_batch_sizes,
    5: measure_late_queries,
    6: measure_one_batch,
    8: measure_visibility_threshold,
    9: measure_query_persistence,
    12: measure_rings,
    **{image.number: partial(measure_culled_images, image.number) for image in CULLING_SCENARIOS.values()},
}
