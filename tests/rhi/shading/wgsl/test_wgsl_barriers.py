"""Barriers in WGSL: under each condition that a work-group shares, compilers accept them, and the result is the same.

WGSL proves less than `rhi.shading`: what memory that may be written holds, for instance, might differ.
"""

from __future__ import annotations

from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
from nightly_reasons import FEWER_CASES
from shader_compilers import check_with_tint

import rhi
import rhi.shading as sl
from rhi.contract.descriptors import Stage

CONDITIONS = {
    "constant": "3 > 2",
    "uniform": "self.limits.x > 1",
    "read_only": "self.inputs[int(sl.group_id().x)] > 1",
    "group": "int(sl.group_id().x) > 0",
    "groups": "int(sl.group_count().x) > 1",
    "length": "len(self.inputs) > 4",
    "written": "self.state[int(sl.group_id().x)] > 1",
    "shared": "self.partial[0] > 1",
    "called": "is_large(self.state[1])",
    "called_group": "in_later_group(1)",
    "local": "shared_sum > 1",
    "changed": "changed > 1",
    "both": "self.state[0] > 1 and int(sl.group_id().x) > 0",
}
STRUCTURES = {
    "then": "if {c}:\n    sl.barrier()\n    self.out[i] += 1",
    "otherwise": "if {c}:\n    self.out[i] += 1\nelse:\n    sl.barrier()",
    "elif": "if self.limits.y > 99:\n    pass\nelif {c}:\n    sl.barrier()\n    self.out[i] += 1",
    "stop": "for k in range(2 if {c} else 1):\n    sl.barrier()\n    self.out[i] += k + 1",
    "start": "for k in range(1 if {c} else 0, 3):\n    sl.barrier()\n    self.out[i] += k",
    "step": "for k in range(0, 6, 2 if {c} else 3):\n    sl.barrier()\n    self.out[i] += k",
    "returns": "if {c}:\n    return\nsl.barrier()\nself.out[i] += 1",
    "returns_from_loop": "for k in range(3):\n    sl.barrier()\n    self.out[i] += 1\n    if {c}:\n        return",
    "breaks": "for k in range(3):\n    if {c}:\n        break\n    sl.barrier()\n    self.out[i] += 1",
    "continues": "for k in range(3):\n    if {c}:\n        continue\n    sl.barrier()\n    self.out[i] += 1",
    "while": "n = 0\nwhile ({c}) and n < 2:\n    sl.barrier()\n    n += 1\nself.out[i] += n",
    "method": "if {c}:\n    self.wait(i)",
    "function": "self.wait_under({c}, i)",
    "value": "self.out[i] += self.waited(i) if {c} else 5",
    "nested": "for k in range(2):\n    if {c}:\n        for m in range(2):\n            sl.barrier()\n"
    "            self.out[i] += 1",
    "varying_after": "sl.barrier()\nif {c}:\n    if i % 8 > 3:\n        return\nself.out[i] += 1",
}
TEXT = """
from rhi.shading import *
import rhi.shading as sl

@sl.function
def is_large(value: int) -> bool:
    return value > 1

@sl.function
def in_later_group(number: int) -> bool:
    return int(sl.group_id().x) >= number

class Waits(sl.Shader):
    limits: sl.Uniform[sl.ivec2]
    inputs: sl.Storage[int]
    state: sl.StorageRW[int]
    out: sl.StorageRW[int]
    partial = sl.shared(int, 8)
    work_group = ({size},)

    def wait(self, i: int) -> None:
        sl.barrier()
        self.out[i] += 3

    def waited(self, i: int) -> int:
        sl.barrier()
        return self.out[i] + 2

    def wait_under(self, condition: bool, i: int) -> None:
        if condition:
            sl.barrier()
            self.out[i] += 4

    def compute(self) -> None:
        i = int(sl.global_id().x)
        shared_sum = self.state[0] + self.inputs[1]
        changed = self.limits.x
        if shared_sum > 100:
            changed += self.state[2]
        self.partial[sl.local_index() % 8] = self.limits.x
        self.state[2 + i] = 1
        sl.barrier()
{body}
"""


@cache
def write_shader(structure: str, condition: str, size: int = 8) -> type[sl.Shader]:
    body = STRUCTURES[structure].format(c=CONDITIONS[condition])
    lines = "\n".join(f"        {line}" for line in body.split("\n"))
    return sl.from_source(TEXT.format(body=lines, size=size))


def texts_of(cases: Any) -> dict[str, str]:
    return {
        f"{structure} {condition}": sl.compile_shader(write_shader(structure, condition))
        .emit("wgsl", Stage.COMPUTE)
        .text
        for structure, condition in cases
    }


CASES = list(product(STRUCTURES, CONDITIONS))


def test_tint_accepts_barriers_under_every_condition_that_a_work_group_shares() -> None:
    assert check_with_tint(texts_of(CASES)) == {}


def test_conditions_that_wgsl_sees_to_be_shared_are_left_alone() -> None:
    plain = ("constant", "uniform", "read_only", "group", "groups", "length", "called_group")
    texts = texts_of(product(STRUCTURES, plain))
    assert [name for name, text in texts.items() if "rhi_agree" in text] == []
    others = texts_of(product(STRUCTURES, CONDITIONS.keys() - set(plain)))
    agreed = {name.split()[0] for name, text in others.items() if "rhi_agree" in text}
    assert STRUCTURES.keys() - agreed == {"varying_after"}
    assert sum("rhi_agree" in text for text in others.values()) == len(agreed) * 6


INPUTS = {
    "limits": np.array([2, 0], "i4"),
    "inputs": np.array([0, 2, 1, 0, 3, 1, 1, 1], "i4"),
    "state": np.concatenate([np.array([3, 0], "i4"), np.zeros(16, "i4")]),
    "out": np.zeros(16, "i4"),
}


@pytest.fixture(scope="module")
def wgpu() -> Any:
    pytest.importorskip("wgpu")
    try:
        device = rhi.create_device("wgpu")
    except rhi.DeviceError as error:
        pytest.skip(str(error))
    with device:
        yield device


@pytest.mark.nightly_cases(
    *(f"*-{condition}" for condition in CONDITIONS if condition != "written"), reason=FEWER_CASES
)
@pytest.mark.parametrize(("structure", "condition"), CASES, ids=map("-".join, CASES))
def test_agreed_conditions_compute_the_results_of_python(structure: str, condition: str, wgpu: Any) -> None:
    shader = write_shader(structure, condition)
    expected = sl.run_compute(shader, 2, **INPUTS)["out"]
    buffers = {name: data if name == "limits" else wgpu.storage(int, data) for name, data in INPUTS.items()}
    wgpu.dispatch(wgpu.program(shader), (16, 1, 1), **buffers)
    assert buffers["out"].read().tolist() == expected.tolist()
