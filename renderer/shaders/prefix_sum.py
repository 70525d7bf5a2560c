"""Prefix sums, from which a device knows where each of its lists begins."""

from __future__ import annotations

from typing import Final

from rhi.shading import Shader, StorageRW, barrier, local_index, shared, uint

_LANES: Final = 256


class PrefixSum(Shader):
    """Replaces counts by their exclusive prefix sums, in one work-group: each lane adds up a run of
    counts."""

    work_group = (_LANES,)
    counts: StorageRW[uint]
    sums = shared(uint, _LANES)

    def compute(self) -> None:
        lane = local_index()
        share = (len(self.counts) + _LANES - 1) // _LANES
        begin = min(lane * share, len(self.counts))
        end = min(begin + share, len(self.counts))
        total = uint(0)
        for index in range(begin, end):
            total += self.counts[index]
        self.sums[lane] = total
        step = 1
        while step < _LANES:
            barrier()
            before = self.sums[lane - step] if lane >= step else uint(0)
            barrier()
            self.sums[lane] += before
            step *= 2
        running_sum = self.sums[lane] - total
        for index in range(begin, end):
            count = self.counts[index]
            self.counts[index] = running_sum
            running_sum += count
