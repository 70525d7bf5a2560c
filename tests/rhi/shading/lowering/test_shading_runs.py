"""The number of lowerings of a stage: another only where a run was told of a value what its end shows to be
otherwise."""

from __future__ import annotations

import pytest

from rhi.contract.descriptors import Stage
from rhi.shading import Shader, Storage, StorageRW, global_id
from rhi.shading.compile import stage_trees
from rhi.shading.lowering import functions
from rhi.shading.lowering.functions import lower_compute


class Straight(Shader):
    values: Storage[float]
    sums: StorageRW[float]
    work_group = (64,)

    def compute(self) -> None:
        i = int(global_id().x)
        value = self.values[i]
        if value < 0.0:
            value = -value
        total = value
        for _ in range(4):
            total += value
        self.sums[i] = total


class Raised(Straight):
    """`step` is read at the loop's beginning as the same for all, and varies from its second turn on."""

    def compute(self) -> None:
        i = int(global_id().x)
        step = 1.0
        total = self.values[i]
        for _ in range(4):
            total += step
            step = self.values[i]
        self.sums[i] = total


class RaisedTwice(Straight):
    """`first` varies once `second` does, which stands behind it in the loop."""

    def compute(self) -> None:
        i = int(global_id().x)
        first = 1.0
        second = 1.0
        total = self.values[i]
        for _ in range(4):
            total += first
            first = second
            second = self.values[i]
        self.sums[i] = total


@pytest.mark.parametrize(("shader", "runs"), [(Straight, 1), (Raised, 2), (RaisedTwice, 3)])
def test_a_stage_is_lowered_again_only_where_a_value_rose_after_it_was_used(
    shader: type[Shader], runs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = stage_trees(shader)[Stage.COMPUTE]
    lowered, entry = [], functions.lower_entry
    monkeypatch.setattr(functions, "lower_entry", lambda *values: lowered.append(values) or entry(*values))
    lower_compute(stage, "shader", (64, 1, 1), 16)
    assert len(lowered) == runs
