"""Indices that are proved to be inside: each proof beside a control that is one too far, or misses a
condition."""

import pytest

from rhi.contract.descriptors import Stage
from rhi.shading import compile_shader, from_source
from rhi.shading.compile import stage_trees
from rhi.shading.ir import nodes, tree

HEADER = """from rhi.shading import *

class Test(Shader):
    work_group = (8, 4)
    a: Storage[int]
    b: Storage[int]
    k: Uniform[int]
    out: StorageRW[int]
    mine = shared(int, 32)

    def pick(self, n: int) -> int:
        return TABLE[n]

    def compute(self) -> None:
        i = global_id().x
        k = self.k
        TABLE_OF_8 = array(int, 8)
        v = ivec4(1, 2, 3, 4)
        keep = self.pick(0) + self.mine[0] + self.a[0] + self.b[0] + v.x + TABLE_OF_8[0]
{body}
        atomic_add(self.out[0], keep)
"""
IN_BOUNDS = [
    ("keep += TABLE_OF_8[7]", "keep += TABLE_OF_8[k]"),
    ("keep += TABLE_OF_8[k % 8]", "keep += TABLE_OF_8[k % 9]"),
    ("keep += TABLE_OF_8[k & 7]", "keep += TABLE_OF_8[k & 8]"),
    ("keep += TABLE_OF_8[clamp(k, 0, 7)]", "keep += TABLE_OF_8[clamp(k, -1, 7)]"),
    ("keep += TABLE_OF_8[min(max(k, 2), 7)]", "keep += TABLE_OF_8[min(k, 7)]"),
    ("for j in range(8):\n    keep += TABLE_OF_8[j]", "for j in range(9):\n    keep += TABLE_OF_8[j]"),
    (
        "for j in range(1, 8):\n    keep += TABLE_OF_8[j - 1]",
        "for j in range(8):\n    keep += TABLE_OF_8[j - 1]",
    ),
    (
        "for j in range(7, -1, -1):\n    keep += TABLE_OF_8[j]",
        "for j in range(7, -2, -1):\n    keep += TABLE_OF_8[j]",
    ),
    ("if 0 <= k < 8:\n    keep += TABLE_OF_8[k]", "if 0 <= k or k < 8:\n    keep += TABLE_OF_8[k]"),
    (
        "if k < 0 or k > 7:\n    return\nkeep += TABLE_OF_8[k]",
        "if k < 0 or k > 8:\n    return\nkeep += TABLE_OF_8[k]",
    ),
    ("keep += TABLE_OF_8[k] if 0 <= k < 8 else 1", "keep += 1 if 0 <= k < 8 else TABLE_OF_8[k]"),
    (
        "if 0 <= k < 8 and TABLE_OF_8[k] > 0:\n    keep += 1",
        "if TABLE_OF_8[k] > 0 and 0 <= k < 8:\n    keep += 1",
    ),
    (
        "if not (k < 0 or k >= 8):\n    keep += TABLE_OF_8[k]",
        "if not (k < 0 and k >= 8):\n    keep += TABLE_OF_8[k]",
    ),
    ("j = k & 3\nkeep += TABLE_OF_8[j + 4]", "j = k & 3\nj += 1\nkeep += TABLE_OF_8[j]"),
    ("keep += self.mine[local_index()]", "keep += self.mine[local_index() + 1]"),
    ("keep += TABLE_OF_8[local_id().x]", "keep += self.mine[global_id().x]"),
    ("keep += TABLE_OF_8[local_id().y + 4]", "keep += TABLE_OF_8[local_id().x + 1]"),
    ("if i < len(self.a):\n    keep += self.a[i]", "if i < len(self.b):\n    keep += self.a[i]"),
    (
        "if i >= len(self.a):\n    return\nkeep += self.a[i]",
        "if i > len(self.a):\n    return\nkeep += self.a[i]",
    ),
    (
        "n = len(self.a)\nif i < n:\n    keep += self.a[i]",
        "n = len(self.a)\nif i <= n:\n    keep += self.a[i]",
    ),
    ("if k >= 0 and k < len(self.a):\n    keep += self.a[k]", "if k < len(self.a):\n    keep += self.a[k]"),
    ("keep += self.a[min(i, len(self.a) - 1)]", "keep += self.a[min(i, len(self.a))]"),
    (
        "for j in range(len(self.a)):\n    keep += self.a[j]",
        "for j in range(len(self.a)):\n    keep += self.b[j]",
    ),
    ("keep += self.a[unchecked(k)]", "keep += self.a[uniform(k)]"),
    ("keep += v[k & 3]", "keep += v[k]"),
    ("keep += TABLE_OF_8[uint(k) >> 29]", "keep += TABLE_OF_8[k >> 29]"),
    ("keep += self.pick(k & 3)", "keep += self.pick(k & 3) + self.pick(k)"),
    ("if k < 8 and k > -1:\n    TABLE_OF_8[k] += 2", "TABLE_OF_8[k] += 2"),
    ("keep += TABLE_OF_8[bit_count(k) // 5]", "keep += TABLE_OF_8[bit_count(k) // 4]"),
    ("keep += TABLE_OF_8[k % 3 * 3]", "keep += TABLE_OF_8[k % 3 * 4]"),
    (
        "keep += TABLE_OF_8[(k & 1000000) * 0]",
        "keep += TABLE_OF_8[(k & 65535) * (k & 65535) * 2 // 2147483647]",
    ),
]


def count_bounded_indices(body: str) -> int:
    """Return the number of a body's indices that aren't proved to be inside."""
    lines = "\n".join("        " + line for line in body.split("\n"))
    text = "TABLE = (1, 2, 3, 4)\n" + HEADER.format(body=lines)
    stage = stage_trees(from_source(text))[Stage.COMPUTE]
    indices = set()
    for function in stage.functions:
        for statement in nodes.walk(function.body):
            stack = list(tree.parts_of(statement))
            while stack:
                node = stack.pop()
                stack += tree.parts_of(node)
                indices |= {node} if isinstance(node, tree.Index) and not node.inside else set()
    return len(indices)


@pytest.mark.parametrize(("inside", "beyond"), IN_BOUNDS)
def test_an_index_is_proved_inside_only_if_it_is_inside(inside, beyond):
    assert count_bounded_indices(inside) == 0
    assert count_bounded_indices(beyond) == 1


def test_a_loop_over_a_constant_range_has_no_bounds_checks_in_its_text():
    shader = from_source("TABLE = (1, 2, 3, 4)\n" + HEADER.format(body="        keep += TABLE_OF_8[i % 8]"))
    text = compile_shader(shader).emit("glsl", Stage.COMPUTE).text
    assert "clamp(" not in text
    assert "if (uint(" not in text
