"""Refusals of work-groups: a barrier that only part of one reaches, a store by all of it to one address."""

from __future__ import annotations

import pytest

from rhi.contract.descriptors import Stage
from rhi.errors import ShaderError
from rhi.shading import Shader, StorageRW, barrier, compile_shader, local_index
from rhi.shading.language.rules import BARRIER, RACE


class Meets(Shader):
    target: StorageRW[int]
    work_group = (4, 1, 1)

    def compute(self) -> None:
        if len(self.target) > 3:  # the same for all
            barrier()
        self.target[local_index()] = local_index()


class PartlyMeets(Shader):
    target: StorageRW[int]
    work_group = (4, 1, 1)

    def compute(self) -> None:
        if local_index() > 1:
            barrier()
        self.target[local_index()] = 1


class OneStores(Shader):
    target: StorageRW[int]
    work_group = (4, 1, 1)

    def compute(self) -> None:
        if local_index() == 0:
            self.target[0] = local_index()


class AllStore(Shader):
    target: StorageRW[int]
    work_group = (4, 1, 1)

    def compute(self) -> None:
        self.target[0] = local_index()


@pytest.mark.parametrize("shader", [Meets, OneStores])
def test_barriers_and_stores_in_uniform_control_flow_are_allowed(shader: type[Shader]) -> None:
    assert compile_shader(shader).emit("opencl4", Stage.COMPUTE).text


@pytest.mark.parametrize(("shader", "rule"), [(PartlyMeets, BARRIER), (AllStore, RACE)])
def test_divergent_barriers_and_racing_stores_are_refused(shader: type[Shader], rule: object) -> None:
    with pytest.raises(ShaderError, match=rf"^\[{rule.id}\]") as caught:
        compile_shader(shader).emit("opencl4", Stage.COMPUTE)
    assert "test_shading_work_groups.py" in str(caught.value)
