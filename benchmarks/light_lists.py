"""The cost of listing the lights that reach each object, compared with a test of every pair.

The scenes are the city at night with 64 to 4,096 lights, equally dense, and the hall with 4,096. "pairs" tests
every object with every light, a million pairs at a time. Both give the same lists, and alternate in one process. Times
are medians of processor time, memory is the peak of what NumPy allocates.

    python benchmarks/light_lists.py [--json] [--rounds 5]
"""

from __future__ import annotations

import argparse
import sys
import time
import tracemalloc
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))

from renderer.content import load_scene
from renderer.lights.lists import list_lights
from renderer.measure import format_records

Floats = NDArray[np.float64]
Lists = tuple[NDArray[np.int64], NDArray[np.int64]]
SPECS: Final = ("night:lights=64", "night:lights=512", "night:lights=4096", "hall:lights=4096")
PAIRS: Final = 1 << 20


def list_by_pairs(lower: Floats, upper: Floats, positions: Floats, ranges: Floats) -> Lists:
    """Return the lists of `list_lights`, by testing every pair."""
    step = max(PAIRS // len(positions), 1)
    counts, lists = [np.zeros(1, np.int64)], [np.zeros(0, np.int64)]
    for start in range(0, len(lower), step):
        low, high = lower[start : start + step, None], upper[start : start + step, None]
        away = positions - np.clip(positions, low, high)
        reached = (away * away).sum(-1) < ranges * ranges
        counts.append(reached.sum(1))
        lists.append(np.nonzero(reached)[1])
    return np.cumsum(np.concatenate(counts)), np.concatenate(lists)


def measure(spec: str, rounds: int) -> dict[str, Any]:
    """Measure both ways on a scene.

    Raises:
        AssertionError: if they give other lists.
    """
    started = time.process_time()
    scene = load_scene(spec)
    build = time.process_time() - started
    lights = scene.lights
    positions = np.concatenate([lights.point["position"], lights.spot["position"]])
    ranges = np.concatenate([lights.point["range"], lights.spot["range"]]).astype(np.float64)
    given = (scene.objects.lower, scene.objects.upper, positions, ranges)
    ways = {"pairs": list_by_pairs, "groups": list_lights}
    times: dict[str, list[float]] = {name: [] for name in ways}
    peaks: dict[str, int] = {}
    found: dict[str, Lists] = {}
    for _ in range(rounds):
        for name, way in ways.items():
            started = time.process_time()
            found[name] = way(*given)
            times[name].append(time.process_time() - started)
    if not all(map(np.array_equal, *found.values())):
        raise AssertionError(f"{spec}: the lists differ")
    for name, way in ways.items():
        tracemalloc.start()
        way(*given)
        peaks[name] = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    lengths = np.diff(found["groups"][0])
    return {
        "scene": spec,
        "objects": len(scene.objects),
        "listed": int(lengths.sum()),
        "longest": int(lengths.max()),
        "build_ms": round(1e3 * build, 1),
        **{f"{name}_ms": round(1e3 * float(np.median(spent)), 1) for name, spent in times.items()},
        **{f"{name}_mb": round(peak / 1e6, 1) for name, peak in peaks.items()},
    }


def main() -> None:
    """Measure and print a table, or JSON."""
    parser = argparse.ArgumentParser(description="Time the lists of lights that reach each object.")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("--rounds", type=int, default=5, help="runs of each way (default: %(default)s)")
    given = parser.parse_args()
    load_scene("night:blocks=2,lights=64")  # imports and caches
    rows = [measure(spec, given.rounds) for spec in SPECS]
    print(format_records(rows, as_json=given.json))


if __name__ == "__main__":
    main()
