"""Lean shaders: variants that bind what their stages read, and check what they keep."""

from __future__ import annotations

import numpy as np
import pytest

import rhi
from rhi.errors import ShaderError
from rhi.shading import Shader, Storage, StorageRW, compile_shader, global_id, run_compute


class Sums(Shader):
    """Adds up what its switches say."""

    work_group = (4,)
    lean = True
    has_more = False
    has_most = False

    found: StorageRW[float]
    less: Storage[float]
    more: Storage[float]
    most: Storage[float]

    def compute(self) -> None:
        i = int(global_id().x)
        self.found[i] = self.find(i)

    def find(self, i: int) -> float:
        if self.has_most:
            return self.most[i]
        if self.has_more:
            return self.more[i] + self.less[i]
        return self.less[i]


class More(Sums):
    has_more = True


class Most(Sums):
    has_most = True
    has_more = True


class Whole(Sums):
    lean = False


def list_bindings(shader: type[Shader]) -> list[tuple[str, int]]:
    return [(binding.name, binding.slot) for binding in compile_shader(shader).bindings]


def test_a_lean_program_has_the_bindings_that_its_stages_read_in_slots_without_gaps() -> None:
    assert list_bindings(Sums) == [("found", 0), ("less", 1)]
    assert list_bindings(More) == [("found", 0), ("less", 1), ("more", 2)]
    assert list_bindings(Most) == [("found", 0), ("most", 1)]  # what follows a return that is taken isn't read
    assert [name for name, _ in list_bindings(Whole)] == ["found", "less", "more", "most"]


def test_a_lean_program_computes_as_the_whole_one_does() -> None:
    words = {name: np.arange(4, dtype=np.float32) * k for name, k in (("less", 1), ("more", 10), ("most", 100))}
    for shader, expected in ((Sums, "less"), (Whole, "less"), (Most, "most")):
        names = [name for name, _ in list_bindings(shader)][1:]
        found = run_compute(shader, 1, found=np.zeros(4, np.float32), **{name: words[name] for name in names})
        assert found["found"].tolist() == words[expected].tolist()


class Wrong(Sums):
    """Its untaken branch isn't of the language."""

    has_text = False

    def find(self, i: int) -> float:
        if self.has_text:
            return "text"  # type: ignore[return-value]
        return self.less[i]


def test_branches_that_a_lean_shader_does_not_take_are_checked_in_the_variant_that_takes_them() -> None:
    assert [name for name, _ in list_bindings(Wrong)] == ["found", "less"]
    for variant in ({"has_text": True}, {"lean": False}):
        with pytest.raises(ShaderError):
            compile_shader(type("Variant", (Wrong,), {"__module__": __name__, **variant}))


def test_a_lean_program_is_bound_by_the_names_that_it_has() -> None:
    with rhi.create_device("null") as device:
        program = device.program(Most)
        assert [binding.name for binding in program.descriptor.bindings] == ["found", "most"]
