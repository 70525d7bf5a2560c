"""Blocks whose statements have no text in NumPy, as a barrier alone, are blocks of Python none the less."""

from __future__ import annotations

import numpy as np
import pytest

import rhi.shading as sl

TEXT = """
from rhi.shading import *
import rhi.shading as sl

@sl.function
def wait() -> None:
    sl.barrier()

@sl.function
def wait_if(condition: bool) -> None:
    if condition:
        sl.barrier()

class Waits(sl.Shader):
    limits: sl.Uniform[sl.ivec2]
    out: sl.StorageRW[int]
    work_group = (4,)

    def rest(self) -> None:
        sl.barrier()

    def compute(self) -> None:
        i = int(sl.global_id().x)
        self.out[i] += 1 + self.limits.y
{body}
        self.out[i] += 2
"""
BLOCKS = {
    "then": "if {c}:\n    {s}",
    "then, otherwise": "if {c}:\n    self.out[i] += 4\nelse:\n    {s}",
    "otherwise": "if {c}:\n    {s}\nelse:\n    self.out[i] += 8",
    "both": "if {c}:\n    {s}\nelse:\n    {s}",
    "elif": "if self.limits.y > 99:\n    {s}\nelif {c}:\n    {s}\nelse:\n    {s}",
    "for": "for k in range(2 if {c} else 1):\n    {s}",
    "nested": "for k in range(2):\n    if {c}:\n        for m in range(2):\n            {s}",
    "while": "n = 0\nwhile n < 2:\n    n += 1\n    if {c}:\n        {s}",
}
ADDED = {("then, otherwise", True): 4, ("otherwise", False): 8}
STATEMENTS = {
    "nothing": "pass",
    "barrier": "sl.barrier()",
    "method": "self.rest()",
    "function": "wait()",
    "condition in a function": "wait_if(self.limits.y < 1)",
    "several": "sl.barrier(); wait(); self.rest()",
}


@pytest.mark.parametrize("holds", [True, False])
@pytest.mark.parametrize("statement", STATEMENTS)
@pytest.mark.parametrize("block", BLOCKS)
def test_a_block_without_text_runs(block: str, statement: str, holds: bool) -> None:
    body = BLOCKS[block].format(c="self.limits.x > 1", s=STATEMENTS[statement])
    lines = "\n".join(f"        {line}" for line in body.split("\n"))
    shader = sl.from_source(TEXT.format(body=lines))
    inputs = {"limits": np.array([2 if holds else 0, 0], "i4"), "out": np.zeros(8, "i4")}
    expected = 3 + ADDED.get((block, holds), 0)
    assert sl.run_compute(shader, 2, **inputs)["out"].tolist() == [expected] * 8
