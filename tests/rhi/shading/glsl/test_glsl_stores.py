"""Stores as GLSL writes them."""

from rhi.contract.descriptors import Stage
from rhi.contract.formats import Format
from rhi.shading import (
    Image2D,
    Shader,
    Storage,
    StorageRW,
    Texture2D,
    atomic_add,
    compile_shader,
    global_id,
    image,
    ivec2,
    mat4,
)


class StoreAnywhere(Shader):
    columns: Storage[int]
    matrices: StorageRW[mat4]

    def compute(self) -> None:
        i = global_id().x
        self.matrices[i][2][self.columns[i]] = 1.0


class StoreKnown(Shader):
    matrices: StorageRW[mat4]

    def compute(self) -> None:
        self.matrices[global_id().x][2][1] = 1.0


class StoreInOrder(Shader):
    matrices: StorageRW[mat4]
    count: StorageRW[int]

    def compute(self) -> None:
        self.matrices[0][2][atomic_add(self.count[0], 1)] = float(atomic_add(self.count[0], 1))


class CopyTexels(Shader):
    source: Texture2D
    target: Image2D = image(Format.RGBA32F)

    def compute(self) -> None:
        at = ivec2(global_id().xy)
        self.target.store(at, self.source.load(at))


class DoubleTexels(Shader):
    target: Image2D = image(Format.RGBA32F)

    def compute(self) -> None:
        at = ivec2(global_id().xy)
        self.target.store(at, self.target.load(at) * 2.0)


def source(shader: type[Shader]) -> str:
    return compile_shader(shader).emit("glsl", Stage.COMPUTE).text


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
