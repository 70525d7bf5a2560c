"""Stores as GLSL writes them, and matrices as it reads them."""

import pytest

import rhi.shading as sl
from rhi.contract.descriptors import Stage
from rhi.contract.formats import Format


class StoreAnywhere(sl.Shader):
    columns: sl.Storage[int]
    matrices: sl.StorageRW[sl.mat4]

    def compute(self) -> None:
        i = sl.global_id().x
        self.matrices[i][2][self.columns[i]] = 1.0


class StoreAtConstant(sl.Shader):
    matrices: sl.StorageRW[sl.mat4]

    def compute(self) -> None:
        self.matrices[sl.global_id().x][2][1] = 1.0


class StoreInOrder(sl.Shader):
    matrices: sl.StorageRW[sl.mat4]
    count: sl.StorageRW[int]

    def compute(self) -> None:
        self.matrices[0][2][sl.atomic_add(self.count[0], 1)] = float(sl.atomic_add(self.count[0], 1))


class CopyTexels(sl.Shader):
    source: sl.Texture2D
    target: sl.Image2D = sl.image(Format.RGBA32F)

    def compute(self) -> None:
        at = sl.ivec2(sl.global_id().xy)
        self.target.store(at, self.source.load(at))


class DoubleTexels(sl.Shader):
    target: sl.Image2D = sl.image(Format.RGBA32F)

    def compute(self) -> None:
        at = sl.ivec2(sl.global_id().xy)
        self.target.store(at, self.target.load(at) * 2.0)


def source(shader: type[sl.Shader]) -> str:
    return sl.compile_shader(shader).emit("glsl", Stage.COMPUTE).text


def test_a_store_to_a_variable_column_of_a_matrix_is_a_switch() -> None:
    text = source(StoreAnywhere)
    assert "if (uint(i) < uint(int(matrices.length())) && uint(at) < 4u) {\n        switch (at) {" in text
    assert [f"case {i}: matrices[i][{i}][2] = 1.0; break;" in text for i in range(4)] == [True] * 4


def test_a_store_to_a_constant_column_of_a_matrix_is_direct() -> None:
    text = source(StoreAtConstant)
    assert "switch" not in text
    assert "[1][2] = 1.0;" in text


def test_the_value_of_a_column_store_is_computed_before_its_column() -> None:
    text = source(StoreInOrder)
    assert text.index("value = float(atomicAdd(") < text.index("at = atomicAdd(") < text.index("switch (at)")


def test_an_image_that_is_only_stored_is_writeonly_though_a_texture_is_loaded() -> None:
    assert "writeonly uniform image2D target;" in source(CopyTexels)


def test_an_image_that_is_loaded_and_stored_is_not_writeonly() -> None:
    text = source(DoubleTexels)
    assert "uniform image2D target;" in text
    assert "writeonly" not in text


class Turned(sl.Struct):
    turn: sl.mat3
    weight: float


class ReadTurns(sl.Shader):
    turns: sl.Storage[Turned]
    results: sl.StorageRW[sl.vec3]

    def compute(self) -> None:
        thing = self.turns[1]
        self.results[0] = thing.turn @ self.turns[2].turn[1]
        self.results[1] = (self.turns[3].turn @ sl.vec3(self.turns[4].weight)) * self.turns[5].turn[2][0]


class CopyTurns(sl.Shader):
    turns: sl.StorageRW[Turned]

    def compute(self) -> None:
        self.turns[0] = self.turns[1]


class ReadNatively(ReadTurns):
    @sl.native("glsl", "return turns[0].turn * v;")
    def turn(self, v: sl.vec3) -> sl.vec3: ...

    def compute(self) -> None:
        self.results[0] = self.turn(self.turns[1].turn[0])


def test_matrices_that_are_only_read_are_read_by_columns() -> None:
    text = source(ReadTurns)
    assert "layout(std430, binding = 0) readonly buffer" in text
    assert "Turned rhi_rows(Turned x) { x.turn = transpose(x.turn); return x; }" in text
    assert "thing = rhi_rows(turns[" in text
    reads = ("].turn[1])", "transpose(turns[", "].weight)", "].turn[2][0])")
    assert [read in text for read in reads] == [True] * len(reads)
    assert text.count("rhi_rows(turns[") == 1, "what isn't read as a whole isn't copied"


@pytest.mark.parametrize("shader", [CopyTurns, ReadNatively])
def test_matrices_that_are_written_or_seen_by_native_code_have_their_rows_in_order(
    shader: type[sl.Shader],
) -> None:
    text = source(shader)
    assert text.count("layout(std430, row_major, binding = 0)") == 1
    assert "rhi_rows" not in text
