"""Stores as GLSL writes them."""

import rhi.shading as sl
from rhi.contract.descriptors import Stage
from rhi.contract.formats import Format


class StoreAnywhere(sl.Shader):
    columns: sl.Storage[int]
    matrices: sl.StorageRW[sl.mat4]

    def compute(self) -> None:
        i = sl.global_id().x
        self.matrices[i][2][self.columns[i]] = 1.0


class StoreKnown(sl.Shader):
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


def test_an_unknown_column_of_a_stored_matrix_is_chosen_by_a_switch() -> None:
    text = source(StoreAnywhere)
    assert "if (uint(i) < uint(int(matrices.length())) && uint(at) < 4u) {\n        switch (at) {" in text
    assert [f"case {i}: matrices[i][{i}][2] = 1.0; break;" in text for i in range(4)] == [True] * 4


def test_a_known_column_is_stored_at_once() -> None:
    text = source(StoreKnown)
    assert "switch" not in text
    assert "[1][2] = 1.0;" in text


def test_the_value_of_such_a_store_is_computed_before_its_column() -> None:
    text = source(StoreInOrder)
    assert text.index("value = float(atomicAdd(") < text.index("at = atomicAdd(") < text.index("switch (at)")


def test_an_image_that_is_only_stored_is_writeonly_though_a_texture_is_loaded() -> None:
    assert "writeonly uniform image2D target;" in source(CopyTexels)


def test_an_image_that_is_loaded_and_stored_is_not_writeonly() -> None:
    text = source(DoubleTexels)
    assert "uniform image2D target;" in text
    assert "writeonly" not in text
