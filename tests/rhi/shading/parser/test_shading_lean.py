"""Lean shaders: variants that bind what their stages read, and check what they keep."""

from __future__ import annotations

import numpy as np
import pytest
from tested_devices import open_device

import rhi
import rhi.shading as sl
from rhi.contract.descriptors import Stage
from rhi.errors import ShaderError


class Sums(sl.Shader):
    """Adds up what its switches say."""

    work_group = (4,)
    lean = True
    has_more = False
    has_third = False

    results: sl.StorageRW[float]
    less: sl.Storage[float]
    more: sl.Storage[float]
    third: sl.Storage[float]

    def compute(self) -> None:
        i = int(sl.global_id().x)
        self.results[i] = self.term(i)

    def term(self, i: int) -> float:
        if self.has_third:
            return self.third[i]
        if self.has_more:
            return self.more[i] + self.less[i]
        return self.less[i]


class More(Sums):
    has_more = True


class Third(Sums):
    has_third = True
    has_more = True


class Whole(Sums):
    lean = False


def list_bindings(shader: type[sl.Shader]) -> list[tuple[str, int]]:
    return [(binding.name, binding.slot) for binding in sl.compile_shader(shader).bindings]


def test_a_lean_program_has_the_bindings_that_its_stages_read_in_slots_without_gaps() -> None:
    assert list_bindings(Sums) == [("results", 0), ("less", 1)]
    assert list_bindings(More) == [("results", 0), ("less", 1), ("more", 2)]
    assert list_bindings(Third) == [
        ("results", 0),
        ("third", 1),
    ]  # what follows a return that is taken isn't read
    assert [name for name, _ in list_bindings(Whole)] == ["results", "less", "more", "third"]


class Decided(sl.Shader):
    """Returns by a condition that is constant."""

    work_group = (4,)
    doubles = True
    results: sl.StorageRW[float]

    def compute(self) -> None:
        self.results[int(sl.global_id().x)] = self.term(3.0)

    def term(self, value: float) -> float:
        if self.doubles:
            return value + value
        return value * 7.0


class Undecided(Decided):
    doubles = False


def test_statements_after_a_return_that_is_always_taken_are_removed() -> None:
    texts = [sl.compile_shader(shader).emit("glsl", Stage.COMPUTE).text for shader in (Decided, Undecided)]
    assert ["7.0" in text for text in texts] == [False, True]


class Skips(sl.Shader):
    """Adds up `values` in a loop that a constant condition may leave or go on with before `more` is added."""

    work_group = (4,)
    ends = False
    skips = False

    results: sl.StorageRW[float]
    values: sl.Storage[float]
    more: sl.Storage[float]

    def compute(self) -> None:
        total = 0.0
        for i in range(3):
            total += self.values[i]
            if self.ends:
                break
            if self.skips:
                continue
            total += self.more[i]
        self.results[int(sl.global_id().x)] = total


class Ends(Skips):
    ends = True


class Goes(Skips):
    skips = True


@pytest.mark.parametrize(
    ("shader", "read", "total"),
    [(Skips, {"values", "more"}, 66.0), (Ends, {"values"}, 1.0), (Goes, {"values"}, 6.0)],
)
def test_statements_after_a_break_or_continue_that_is_always_taken_are_removed(
    shader: type[sl.Shader], read: set[str], total: float
) -> None:
    assert {declared.name for declared in sl.stage_trees(shader)[Stage.COMPUTE].bindings} == {
        "results",
        *read,
    }
    values, more = np.float32([1, 2, 3]), np.float32([10, 20, 30])
    assert sl.run_compute(shader, values=values, more=more, results=4)["results"].tolist() == [total] * 4


def test_a_lean_program_computes_as_the_whole_one_does() -> None:
    words = {
        name: np.arange(4, dtype=np.float32) * k for name, k in (("less", 1), ("more", 10), ("third", 100))
    }
    for shader, expected in ((Sums, "less"), (Whole, "less"), (Third, "third")):
        names = [name for name, _ in list_bindings(shader)][1:]
        results = sl.run_compute(
            shader, 1, results=np.zeros(4, np.float32), **{name: words[name] for name in names}
        )
        assert results["results"].tolist() == words[expected].tolist()


class Wrong(Sums):
    """Its untaken branch isn't of the language."""

    has_text = False

    def term(self, i: int) -> float:
        if self.has_text:
            return "text"  # type: ignore[return-value]
        return self.less[i]


def test_branches_that_a_lean_shader_does_not_take_are_checked_in_the_variant_that_takes_them() -> None:
    assert [name for name, _ in list_bindings(Wrong)] == ["results", "less"]
    for variant in ({"has_text": True}, {"lean": False}):
        with pytest.raises(ShaderError):
            sl.compile_shader(type("Variant", (Wrong,), {"__module__": __name__, **variant}))


def test_a_lean_program_is_bound_by_the_names_that_it_has() -> None:
    with rhi.create_device("null") as device:
        program = device.program(Third)
        assert [binding.name for binding in program.descriptor.bindings] == ["results", "third"]


class Corner(sl.Struct):
    position: sl.vec2


class Shades(sl.Struct):
    dark: float
    light: sl.vec4


class Shaded(sl.Struct):
    clip: sl.vec4
    color: sl.vec4


class Painted(sl.Shader):
    """Draws vertices in one of their colours."""

    lean = True
    is_light = True

    def vertex(self, v: Corner, shades: Shades) -> Shaded:
        return Shaded(
            clip=sl.vec4(v.position, 0.0, 1.0), color=shades.light if self.is_light else sl.vec4(shades.dark)
        )

    def fragment(self, v: Shaded) -> sl.vec4:
        return v.color


class Dark(Painted):
    is_light = False


class Unsparing(Painted):
    lean = False


def test_a_lean_program_has_the_attributes_that_its_vertex_stage_reads() -> None:
    results = {
        shader: [(attribute.name, attribute.location) for attribute in sl.compile_shader(shader).attributes]
        for shader in (Painted, Dark, Unsparing)
    }
    assert results[Painted] == [("position", 0), ("light", 1)]
    assert results[Dark] == [("position", 0), ("dark", 1)]
    assert results[Unsparing] == [("position", 0), ("dark", 1), ("light", 2)]
    assert "in_dark" not in sl.compile_shader(Painted).emit("glsl", Stage.VERTEX).text


@pytest.mark.parametrize("name", ["gl", "cl"])
def test_a_mesh_may_lack_the_attributes_that_a_lean_program_does_not_read(name: str) -> None:
    corners = np.array([(-1, -1), (3, -1), (-1, 3)], np.float32)
    for shader, extra, expected in (
        (Painted, {"light": np.tile(np.float32([0.2, 0.4, 0.6, 1.0]), (3, 1))}, [51, 102, 153, 255]),
        (Dark, {"dark": np.full(3, 0.8, np.float32)}, [204, 204, 204, 204]),
    ):
        with open_device(name) as device:
            image = device.texture((2, 2), rhi.Format.RGBA8)
            mesh = device.mesh({"position": corners, **extra})
            with device.render_pass(image, clear=(0.0, 0.0, 0.0, 0.0)):
                device.draw(device.program(shader), mesh)
            assert (image.read() == expected).all()


def test_on_numpy_too_a_lean_shader_takes_the_attributes_that_it_reads() -> None:
    position, light = np.float32([[0.5, -0.5]]), np.float32([[0.2, 0.4, 0.6, 1.0]])
    assert (sl.run_vertex(Painted, {"position": position, "light": light}).varyings["color"] == light).all()
    assert (sl.run_vertex(Dark, {"position": position, "dark": 0.5}).varyings["color"] == 0.5).all()
    more = {"position": position, "dark": 0.5, "light": light}
    assert (sl.run_vertex(Painted, more).varyings["color"] == light).all()
    for shader, values in (
        (Painted, {"position": position, "dark": 0.5}),
        (Painted, {**more, "faint": 1.0}),
        (Unsparing, {"position": position, "light": light}),
    ):
        with pytest.raises(rhi.ValidationError, match=r"^\[shading-arguments\]"):
            sl.run_vertex(shader, values)
