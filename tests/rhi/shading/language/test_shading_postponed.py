"""Shaders whose annotations are text (`from __future__ import annotations`), at module level and inside
functions, and names that come from other places than the module."""

from __future__ import annotations

import enum
import gc
import math
import weakref

import numpy as np

import rhi.shading as sl
from rhi.contract.descriptors import Stage
from rhi.shading import Shader, Storage, StorageRW, Struct, compile_shader, function, uint, vec2


class Pair(Struct):
    left: float
    right: vec2


class Modular(Shader):
    pairs: Storage[Pair]
    out: StorageRW[float]

    def total(self, pair: Pair) -> float:
        result: float = 1
        result += sl.dot(pair.right, sl.vec2(1, 2)) + pair.left
        return result

    def compute(self) -> None:
        self.out[0] = self.total(self.pairs[0])


def test_postponed_annotations_and_names_through_modules_work(run):
    pairs = np.array([(1, (2, 3))], Pair.dtype)
    assert run(Modular, pairs=pairs, out=1)["out"].tolist() == [1 + 2 + 6 + 1]


class Kind(enum.IntEnum):
    POINT = 3


def test_shaders_structs_and_functions_may_be_local(run):
    class Local(Struct):
        value: float

    scale = 3
    np_scale = np.float32(0.5)

    @function
    def doubled(item: Local) -> Local:
        return Local(value=item.value * 2 * scale * np_scale)

    class Inside(Shader):
        items: StorageRW[Local]
        kinds: StorageRW[uint]

        def copy(self, item: Local) -> Local:
            return doubled(item)

        def compute(self) -> None:
            self.items[1] = self.copy(self.items[0])
            self.kinds[0] = uint(Kind.POINT)
            self.items[2].value = math.inf if self.items[0].value > 0 else -math.inf

    out = run(Inside, items=np.array([(2,), (0,), (0,)], Local.dtype), kinds=1)
    assert out["items"]["value"].tolist() == [2, 6, math.inf]
    assert out["kinds"].tolist() == [3]


def test_side_effects_of_a_target_come_after_those_of_the_value(run):
    class Ordered(Shader):
        counter: StorageRW[int]
        out: StorageRW[int]

        def compute(self) -> None:
            self.out[sl.atomic_add(self.counter[0], 1)] = sl.atomic_add(self.counter[0], 1) + 10

    assert run(Ordered, counter=1, out=2)["out"].tolist() == [0, 10]


def test_a_shader_class_can_be_collected_after_it_was_compiled():
    class Short(Shader):
        out: StorageRW[float]

        def compute(self) -> None:
            self.out[0] = 1

    compile_shader(Short).emit("glsl", Stage.COMPUTE)
    alive = weakref.ref(Short)
    del Short
    gc.collect()
    assert alive() is None
