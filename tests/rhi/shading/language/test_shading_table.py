"""The table of built-ins: a new built-in needs only a new row. `uniform` declares what the compiler can't infer."""

import numpy as np
import pytest
from opencl_runner import run_opencl

import rhi.shading
from rhi.errors import ShaderError
from rhi.shading import Shader, Storage, StorageRW, global_id, opencl_kernel, uniform, vec3
from rhi.shading.language.builtins import BUILTINS, ErrorBound, _row
from rhi.shading.language.types import LANGUAGE_NAMES

hermite = _row("hermite", "F(F)", "({0} * {0} * (3.0 - 2.0 * {0}))", lanes="(t := a * a) * (3.0 - 2.0 * a)")
hypotenuse = _row(
    "hypotenuse",
    "F(F,F)",
    "sqrt({0} * {0} + {1} * {1})",
    opencl="hypot({0}, {1})",
    numpy="np.hypot({0}, {1})",
)


class UsesNewRows(Shader):
    work_group = (32,)
    a: Storage[float]
    out: StorageRW[vec3]

    def compute(self) -> None:
        i = global_id().x
        v = vec3(self.a[i], self.a[31 - i], 0.5)
        self.out[i] = hermite(v) + hypotenuse(v, v.yzx)


def test_a_row_is_all_that_a_builtin_takes(run_everywhere, monkeypatch):
    monkeypatch.setitem(BUILTINS, "hypotenuse", hypotenuse)
    a = np.linspace(0, 1, 32).astype("f4")
    out = run_everywhere(UsesNewRows, a=a, out=32)["out"][:, :3]
    v = np.stack([a, a[::-1], np.full(32, 0.5)], axis=1)
    np.testing.assert_allclose(out, v * v * (3 - 2 * v) + np.hypot(v, np.roll(v, -1, axis=1)), rtol=1e-6)


nowhere = _row("nowhere", "F(F)", "sin")


class UsesNothing(Shader):
    out: StorageRW[float]

    def compute(self) -> None:
        self.out[0] = nowhere(1.0)


def test_a_row_without_lane_code_is_refused_where_lanes_are_wanted():
    with pytest.raises(ShaderError, match="nowhere"):
        opencl_kernel(UsesNothing, 16)


def test_every_row_says_what_it_is_in_lane_code():
    for row in BUILTINS.values():
        ways = [bool(row.opencl and row.numpy), bool(row.lanes)]
        assert sum(ways) <= 1, row.name
        assert bool(row.opencl) == bool(row.numpy), row.name
        assert not row.fast or row.opencl, row.name
        assert isinstance(row.error, ErrorBound)


class OfTiles(Shader):
    """16 consecutive invocations are in the same tile, which the compiler can't infer."""

    work_group = (32,)
    tiles: Storage[int]
    lists: Storage[float]
    out: StorageRW[float]

    def compute(self) -> None:
        i = global_id().x
        tile = uniform(self.tiles[i])
        total = 0.0
        for k in range(tile):
            total += self.lists[tile + k]
        self.out[i] = total
        if i % 3 == 1:
            self.out[i] = float(uniform(tile * 2)) + (1.0 if uniform(tile > 4) else 0.0)


def test_what_is_uniform_is_read_once_for_all_lanes(run_everywhere):
    tiles = np.repeat([3, 7], 16).astype("i4")
    lists = np.arange(20, dtype="f4")
    out = run_everywhere(OfTiles, tiles=tiles, lists=lists, out=32)["out"]
    expected = np.array([lists[t : 2 * t].sum() if i % 3 != 1 else 2 * t + (t > 4) for i, t in enumerate(tiles)])
    np.testing.assert_array_equal(out, expected)
    assert "rhi_gather(lists_" not in opencl_kernel(OfTiles, 16).text


class OfSomeLanes(Shader):
    work_group = (16,)
    given: Storage[int]
    out: StorageRW[int]

    def compute(self) -> None:
        i = global_id().x
        x = self.given[i]
        if x > 0:
            self.out[i] = uniform(x) * 10


def test_only_lanes_that_take_part_need_to_agree():
    given = np.array([-5, -6, *[4] * 10, -7, -8, -9, 4], "i4")
    for width in (1, 4, 16):
        out = run_opencl(OfSomeLanes, width, given=given, out=16)["out"]
        np.testing.assert_array_equal(out, np.where(given > 0, 40, 0))


def test_every_name_that_shaders_import_can_be_suggested():
    for_the_host = {"HostTexture", "ImageBinding", "NumpyKernel", "StorageRange", "TextureBinding", "UniformRange"}
    for_the_host |= {"compile_shader", "evaluate", "opencl_kernel", "run_compute", "run_fragment", "run_vertex"}
    for_the_host |= {"ShaderCode", "find_element", "from_source", "register_language", "stage_trees", "value_type_of"}
    assert set(rhi.shading.__all__) - for_the_host == LANGUAGE_NAMES
