"""The values of `range`, up to the ends of an int, in every language: what Python's `range` gives."""

import numpy as np
import pytest

from rhi.shading import from_source

INT_MIN, INT_MAX = -(2**31), 2**31 - 1

RANGES = [
    (0, INT_MAX, 2_000_000_000),
    (0, -INT_MAX, -2_000_000_000),
    (0, INT_MIN, -2_000_000_000),
    (INT_MIN, INT_MAX, INT_MAX),
    (INT_MAX, INT_MIN, INT_MIN),
    (INT_MAX, INT_MIN, -INT_MAX),
    (INT_MAX - 5, INT_MAX, 1),
    (INT_MIN + 5, INT_MIN, -1),
    (INT_MAX - 5, INT_MAX, 3),
    (INT_MAX - 6, INT_MAX, 3),
    (INT_MIN + 6, INT_MIN, -3),
    (INT_MIN + 5, INT_MIN, -3),
    (INT_MAX - 1, INT_MAX, INT_MAX),
    (0, 10, 3),
    (0, 9, 3),
    (10, 0, -3),
    (5, 5, 7),
    (5, 4, 7),
    (5, 6, -7),
    (INT_MAX, INT_MIN, 5),
    (INT_MIN, INT_MAX, -5),
]

HEAD = """
from rhi.shading import *

class Ranges(Shader):
    bounds: Storage[int]
    out: StorageRW[int]

    def compute(self) -> None:
        self.out[0] = self.bounds[0]
"""
LOOP = """
        count = 0
        last = 0
        total = 0
        for i in range({bounds}):
            if count == 9:
                break
            count += 1
            if i == 4:
                continue
            last = i
            total += i
        self.out[{at}] = count
        self.out[{at} + 1] = last
        self.out[{at} + 2] = total
"""
KINDS = {
    "constants": "{0}, {1}, {2}",
    "variables": "self.bounds[{at}], self.bounds[{at} + 1], self.bounds[{at} + 2]",
    "a variable stop": "{0}, self.bounds[{at} + 1], {2}",
    "a variable step": "{0}, {1}, self.bounds[{at} + 2]",
}


def loop(kind, which, bounds):
    return LOOP.format(bounds=KINDS[kind].format(*bounds, at=3 * which), at=3 * which)


def expected_values(start, stop, step):
    values = list(range(start, stop, step)[:9]) if step else []  # a step of 0 gives no values
    remaining = [value for value in values if value != 4]
    return [len(values), remaining[-1] if remaining else 0, int(np.array(sum(remaining), "i8").astype("i4"))]


@pytest.mark.parametrize("kind", KINDS)
def test_a_range_gives_the_values_of_python(run_everywhere, kind):
    ranges = RANGES if kind != "variables" else [*RANGES, (0, 5, 0), (5, 0, 0)]
    shader = from_source(HEAD + "".join(loop(kind, *pair) for pair in enumerate(ranges)))
    result = run_everywhere(shader, bounds=np.array(ranges, "i4").ravel(), out=3 * len(ranges))["out"]
    assert dict(zip(ranges, result.reshape(-1, 3).tolist(), strict=True)) == {
        r: expected_values(*r) for r in ranges
    }


VARYING = from_source("""
from rhi.shading import *

class Strided(Shader):
    work_group = (64,)
    stop: Storage[int]
    out: StorageRW[int]

    def compute(self) -> None:
        i = local_index()
        count = 0
        for k in range(2147483000 + i * 10, self.stop[0], 320):
            count += 1
        for k in range(i, 100, 64):
            count += 100
        for k in range(i, self.stop[1], 64):
            count += 10000
        self.out[i] = count
""")


def test_ranges_that_differ_between_lanes_end_where_each_lane_ends(run_everywhere):
    result = run_everywhere(VARYING, stop=np.array([INT_MAX, 200], "i4"), out=64)["out"].tolist()
    assert result == [
        len(range(2147483000 + i * 10, INT_MAX, 320))
        + 100 * len(range(i, 100, 64))
        + 10000 * len(range(i, 200, 64))
        for i in range(64)
    ]
