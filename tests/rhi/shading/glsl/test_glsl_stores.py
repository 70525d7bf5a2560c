"""Stores as GLSL writes them."""

from rhi.contract.descriptors import Stage
from rhi.shading import Shader, Storage, StorageRW, atomic_add, compile_shader, global_id, mat4


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


def source(shader: type[Shader]) -> str:
    return compile_shader(shader).emit("glsl", Stage.COMPUTE).text


def test_an_unknown_column_of_a_stored_matrix_is_chosen_by_a_switch() -> None:
    text = source(StoreAnywhere)
    assert "switch (columns[i])" in text
    assert [f"case {i}: matrices[i][{i}][2] = 1.0; break;" in text for i in range(4)] == [True] * 4


def test_a_known_column_is_stored_at_once() -> None:
    text = source(StoreKnown)
    assert "switch" not in text
    assert "[1][2] = 1.0;" in text


def test_the_value_of_such_a_store_is_computed_before_its_column() -> None:
    text = source(StoreInOrder)
    assert text.index("float(atomicAdd(") < text.index("switch (atomicAdd(")
