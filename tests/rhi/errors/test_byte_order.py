"""Arrays of either byte order hold equal numbers wherever they come in."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rhi.shading as sl
from renderer.scene.meshes import VERTEX, MeshGeometry
from rhi import Format
from rhi.errors.arguments import little_endian, to_little_endian
from rhi.shading.evaluation.compute import run_compute
from rhi.shading.numpy.host_textures import HostTexture

CODES = ["u1", "i1", "u2", "i2", "f2", "u4", "i4", "f4", "u8", "i8", "f8", "c8"]


@st.composite
def dtypes(draw: st.DrawFn, depth: int = 2) -> np.dtype[Any]:
    """Return a random dtype: numbers of either order, subarrays, structs with gaps, in each other."""
    kind = draw(st.sampled_from(["number", "number", "subarray", "struct"] if depth else ["number"]))
    if kind == "number":
        return np.dtype(draw(st.sampled_from("<>")) + draw(st.sampled_from(CODES)))
    if kind == "subarray":
        return np.dtype((draw(dtypes(depth - 1)), (draw(st.integers(1, 3)),)))
    fields = draw(st.lists(dtypes(depth - 1), min_size=1, max_size=4))
    offsets, end = [], 0
    for field in fields:
        offsets.append(end + draw(st.integers(0, 5)))
        end = offsets[-1] + field.itemsize
    names = [f"field{i}" for i in range(len(fields))]
    size = end + draw(st.integers(0, 5))
    return np.dtype({"names": names, "formats": fields, "offsets": offsets, "itemsize": size})


def codes(dtype: np.dtype[Any]) -> list[str]:
    """Return the codes of all numbers in a dtype."""
    if dtype.subdtype is not None:
        return codes(dtype.subdtype[0])
    if dtype.fields is not None:
        return [code for field in dtype.fields.values() for code in codes(field[0])]
    return [dtype.str]


def flatten(value: Any) -> list[Any]:
    if isinstance(value, (tuple, list)):
        return [number for part in value for number in flatten(part)]
    if isinstance(value, np.ndarray):
        return flatten(value.tolist())
    return [value]


@given(dtypes(), st.integers(0, 2**32 - 1))
def test_conversion_keeps_numbers_offsets_and_sizes(dtype: np.dtype[Any], seed: int) -> None:
    base = dtype.base
    random_bytes = np.random.default_rng(seed).integers(
        0, 64, 3 * base.itemsize, np.uint8
    )  # no NaN in any format
    array = np.frombuffer(random_bytes.tobytes(), base)
    base = array.dtype  # of a subarray, its elements
    converted = to_little_endian(array)
    assert not any(code.startswith(">") for code in codes(converted.dtype))
    assert flatten(converted.tolist()) == flatten(array.tolist())
    assert converted.dtype == little_endian(base)
    assert converted.dtype.itemsize == base.itemsize
    if base.fields is not None:
        assert converted.dtype.fields is not None
        for name, field in base.fields.items():
            assert converted.dtype.fields[name][1] == field[1]


@given(dtypes())
def test_an_array_in_order_is_returned_as_it_is(dtype: np.dtype[Any]) -> None:
    array = np.zeros(2, little_endian(dtype))
    assert to_little_endian(array) is array


def test_gaps_between_fields_become_zero() -> None:
    dtype = np.dtype({"names": ["a"], "formats": [">u4"], "offsets": [4], "itemsize": 12})
    array = np.zeros(2, dtype)
    array.view(np.uint8)[:] = 7
    assert to_little_endian(array).tobytes() == (bytes(4) + bytes([7] * 4) + bytes(4)) * 2


class Doubled(sl.Shader):
    words: sl.StorageRW[float]

    def compute(self) -> None:
        self.words[0] = 2.0 * self.words[1]


@pytest.mark.parametrize("order", "<>")
def test_a_shader_that_runs_on_the_cpu_reads_equal_numbers(order: str) -> None:
    results = run_compute(Doubled, 1, words=np.array([0.0, 1.5], f"{order}f4"))
    assert results["words"].tolist() == [3.0, 1.5]


@pytest.mark.parametrize("order", "<>")
def test_a_texture_on_the_cpu_holds_equal_texels(order: str) -> None:
    texels = np.arange(6, dtype=f"{order}u2").reshape(2, 3)
    assert HostTexture(texels, Format.R16).levels[0].ravel().tolist() == list(range(6))


@pytest.mark.parametrize("order", "<>")
def test_a_mesh_of_the_renderer_holds_equal_numbers(order: str) -> None:
    vertices = np.zeros(3, VERTEX.newbyteorder(order))
    vertices["position"] = np.eye(3)
    mesh = MeshGeometry(vertices, np.arange(3, dtype=f"{order}u4"))
    assert mesh.vertices.dtype == VERTEX
    assert mesh.vertices["position"].tolist() == np.eye(3).tolist()
    assert mesh.indices.tolist() == [0, 1, 2]
