"""The table of built-ins: a new built-in needs only a new row, and a row that lacks a language fails at
import.

`uniform` declares what the compiler can't infer.
"""

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from new_builtins import VALUES, UsesNewRows, add_new_rows, expected_results
from opencl_runner import run_opencl

import rhi.shading
from rhi.shading import Shader, Storage, StorageRW, global_id, opencl_kernel, uniform
from rhi.shading.language import builtins
from rhi.shading.language.builtins import BUILTINS, POLYFILL, ErrorBound, Refused, _row
from rhi.shading.language.types import LANGUAGE_NAMES
from rhi.shading.lowering import builtins as lowered_builtins
from rhi.shading.wgsl import wgsl_writer


def test_a_row_is_all_that_a_builtin_takes(run_everywhere, monkeypatch):
    add_new_rows(monkeypatch)
    out = run_everywhere(UsesNewRows, a=VALUES, out=32)["out"][:, :3]
    np.testing.assert_allclose(out, expected_results(), rtol=1e-6)


SOURCE = Path(builtins.__file__)


def import_edited(tmp_path: Path, column: str, row: str) -> ModuleType:
    """Import a copy of the table in which this row lacks this column."""
    text = SOURCE.read_text(encoding="utf-8")
    start = text.index(f'        "{row}",\n')
    end = text.index("\n    ),\n", start)
    edited = re.sub(rf"^        {column}=.*\n", "", text[start:end] + "\n", flags=re.MULTILINE).rstrip("\n")
    assert edited != text[start:end]
    copy = tmp_path / "edited_builtins.py"
    copy.write_text(text[:start] + edited + text[end:], encoding="utf-8")
    spec = importlib.util.spec_from_file_location("edited_builtins", copy)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["edited_builtins"] = module  # dataclasses look their module up
    try:
        spec.loader.exec_module(module)
    finally:
        del sys.modules["edited_builtins"]
    return module


@pytest.mark.parametrize(
    ("column", "language"), [("glsl", "GLSL"), ("wgsl", "WGSL"), ("opencl", "OpenCL"), ("numpy", "NumPy")]
)
def test_a_row_that_lacks_a_language_fails_at_import(tmp_path, column, language):
    with pytest.raises(TypeError, match=f"built-in 'exp2' has no meaning in {language}: give a spelling"):
        import_edited(tmp_path, column, "exp2")


def test_a_row_that_lacks_only_a_fast_spelling_is_imported(tmp_path):
    assert import_edited(tmp_path, "fast", "exp2").BUILTINS["exp2"].fast == ""


@pytest.mark.parametrize(
    ("module", "language"), [(wgsl_writer, "WGSL"), (lowered_builtins, "lane code")], ids=["wgsl", "lanes"]
)
def test_a_polyfill_that_a_package_lacks_fails_at_its_import(monkeypatch, module, language):
    row = _row("nowhere", "F(F)", glsl="sin", wgsl=POLYFILL, lanes=POLYFILL)
    monkeypatch.setitem(BUILTINS, "nowhere", row)
    spec = importlib.util.find_spec(module.__name__)
    with pytest.raises(TypeError, match=f"built-ins in {language}: no polyfill of nowhere"):
        spec.loader.exec_module(importlib.util.module_from_spec(spec))


def test_every_row_has_one_meaning_in_each_language():
    for row in BUILTINS.values():
        assert row.overloads[0].glsl, row.name
        assert row.wgsl, row.name
        assert bool(row.opencl) == bool(row.numpy), row.name
        assert bool(row.opencl) != bool(row.lanes), row.name
        assert not row.fast or row.opencl, row.name
        assert isinstance(row.error, ErrorBound)


def test_the_built_ins_that_wgsl_lacks_are_refused_by_name():
    assert [row.name for row in BUILTINS.values() if isinstance(row.wgsl, Refused)] == [
        "memory_barrier",
        "point_coordinate",
    ]


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


def test_uniform_values_are_read_once_for_all_lanes(run_everywhere):
    tiles = np.repeat([3, 7], 16).astype("i4")
    lists = np.arange(20, dtype="f4")
    out = run_everywhere(OfTiles, tiles=tiles, lists=lists, out=32)["out"]
    expected = np.array(
        [lists[t : 2 * t].sum() if i % 3 != 1 else 2 * t + (t > 4) for i, t in enumerate(tiles)]
    )
    np.testing.assert_array_equal(out, expected)
    assert "rhi_gather(lists_" not in opencl_kernel(OfTiles, 16).text


class UniformOfActiveLanes(Shader):
    work_group = (16,)
    values: Storage[int]
    out: StorageRW[int]

    def compute(self) -> None:
        i = global_id().x
        x = self.values[i]
        if x > 0:
            self.out[i] = uniform(x) * 10


def test_only_lanes_that_take_part_need_to_agree():
    values = np.array([-5, -6, *[4] * 10, -7, -8, -9, 4], "i4")
    for width in (1, 4, 16):
        out = run_opencl(UniformOfActiveLanes, width, values=values, out=16)["out"]
        np.testing.assert_array_equal(out, np.where(values > 0, 40, 0))


def test_every_name_that_shaders_import_can_be_suggested():
    for_the_host = {
        "HostTexture",
        "HostTextureTable",
        "ImageBinding",
        "NumpyKernel",
        "StorageRange",
        "TableBinding",
        "TableTexture",
        "TextureBinding",
        "UniformRange",
    }
    for_the_host |= {
        "compile_shader",
        "evaluate",
        "opencl_kernel",
        "run_compute",
        "run_fragment",
        "run_vertex",
    }
    for_the_host |= {
        "ShaderCode",
        "find_element",
        "from_source",
        "register_language",
        "stage_trees",
        "value_type_of",
    }
    assert set(rhi.shading.__all__) - for_the_host == LANGUAGE_NAMES
