"""WGSL texts: naga accepts them, layouts of memory are kept, and what WGSL lacks is refused by name."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import rhi.shading as sl
from rhi.contract.descriptors import Stage
from rhi.contract.formats import Format
from rhi.errors import ShaderError
from rhi.shading.wgsl.wgsl_names import texel_format
from rhi.shading.wgsl.wgsl_stages import read_declarations

ROOT = Path(__file__).parents[4]
RECORDED_REFUSALS = 22
"""Stages of the tree's shaders that WGSL can't say: native GLSL, point coordinates, integer textures that are
sampled, a comparison at another level than 0, and `memory_barrier`."""


def text_of(shader: type[sl.Shader], stage: Stage = Stage.COMPUTE) -> str:
    return sl.compile_shader(shader).emit("wgsl", stage).text


@pytest.fixture(scope="module")
def naga() -> Any:
    """A device of wgpu, whose compiler checks texts."""
    wgpu = pytest.importorskip("wgpu")
    pytest.importorskip("wgpu.backends.wgpu_native")
    adapters = [a for a in wgpu.gpu.enumerate_adapters_sync() if a.info["backend_type"] != "OpenGL"]
    if not adapters:
        pytest.skip("no adapter")
    return adapters[0].request_device_sync()


class Packed(sl.Struct):
    weights: sl.Array[float] = sl.array(float, 3)
    turn: sl.mat2
    pairs: sl.Array[sl.vec2] = sl.array(sl.vec2, 2)
    end: sl.vec3


class Plain(sl.Struct):
    view: sl.vec4
    scale: float


class Counted(sl.Struct):
    start: float
    count: sl.uint


class ReadsLayouts(sl.Shader):
    packed: sl.Uniform[Packed]
    plain: sl.Uniform[Plain]
    copies: sl.Storage[Packed]
    out: sl.StorageRW[float]

    def compute(self) -> None:
        i = int(sl.global_id().x)
        whole = self.packed
        self.out[0] = (
            self.packed.weights[i] + self.packed.pairs[i].y + self.packed.turn[i].x + self.plain.scale
        )
        self.out[1] = whole.weights[i] + self.copies[i].weights[i]


def test_uniform_memory_has_types_of_its_own_only_where_its_layout_differs(naga: Any) -> None:
    text = text_of(ReadsLayouts)
    assert re.search(r"struct Packed \{\s+weights: array<f32, 3>,\s+turn: mat2x2<f32>,", text)
    assert re.search(
        r"struct Packed_std140 \{\s+@align\(16\) @size\(48\) weights: array<vec4<f32>, 3>,", text
    )
    assert "@align(16) @size(32) turn: mat2x4<f32>," in text
    assert "var<uniform> packed: Packed_std140;" in text
    assert "var<uniform> plain: Plain;" in text
    assert "array<Packed>" in text
    assert "packed.weights[clamp(i, 0, 2)].x" in text
    assert "packed.pairs[clamp(i, 0, 1)].xy" in text
    naga.create_shader_module(code=text)


class CountsTwice(sl.Shader):
    first: sl.StorageRW[Counted]
    second: sl.Storage[Counted]

    def compute(self) -> None:
        sl.atomic_add(self.first[0].count, sl.uint(1))
        whole = self.first[1]
        whole.count += self.second[0].count
        self.first[2] = whole


def test_words_are_atomic_only_in_the_memory_that_atomics_work_on(naga: Any) -> None:
    text = text_of(CountsTwice)
    assert re.search(r"struct Counted_first \{\s+start: f32,\s+count: atomic<u32>,", text)
    assert "var<storage, read_write> first: array<Counted_first>;" in text
    assert "var<storage, read> second: array<Counted>;" in text
    plain_load = "first[clamp(i32(1), 0, i32(arrayLength(&first)) - 1)]"
    assert f"Counted({plain_load}.start, atomicLoad(&{plain_load}.count))" in text
    assert "atomicStore(&first[i32(2)].count, whole_2.count);" in text
    naga.create_shader_module(code=text)
    assert read_declarations(text) == {(1, 0): "read_write", (1, 1): "read"}


class ChoosesEffects(sl.Shader):
    out: sl.StorageRW[int]

    def compute(self) -> None:
        i = int(sl.global_id().x)
        self.out[1] = self.out[2] + (sl.atomic_add(self.out[0], 1) if i > 3 else 7)
        if i > 5 and sl.atomic_compare_exchange(self.out[0], 1, 2) == 1:
            self.out[3] = 1
        elif i < 2 or sl.atomic_compare_exchange(self.out[0], 2, 3) == 2:
            self.out[3] = 2
        while sl.atomic_compare_exchange(self.out[0], 4, 5) == 4:
            self.out[4] += 1


def test_choices_with_effects_are_statements_in_the_order_of_python(naga: Any) -> None:
    text = text_of(ChoosesEffects)
    assert "select(" not in text
    lines = [line.strip() for line in text.splitlines()]
    first_line = lines.index("let first = operand;")
    assert lines[first_line - 1].startswith("var operand: i32 = atomicLoad(&out[clamp(i32(2), ")
    assert lines[first_line + 2] == "if ((i > i32(3))) {"
    assert lines[first_line + 3] == "selected = atomicAdd(&out[i32(0)], i32(1));"
    assert text.count("atomicCompareExchangeWeak") == 3
    # The condition of `while` is evaluated in each turn.
    assert re.search(r"loop \{\s+let argument\w* = i32\(4\);", text)
    naga.create_shader_module(code=text)


class LoadsAndStores(sl.Shader):
    """Loads from a level that the device chooses, from level 1 and from level 0; stores to an image that it
    doesn't read."""

    source: sl.Texture2D
    at: sl.Storage[int]
    target: sl.Image2D = sl.image(Format.RGBA8)

    def compute(self) -> None:
        texel = sl.ivec2(sl.global_id().xy)
        texels = self.source.load(texel, self.at[0]) + self.source.load(texel, 1)
        self.target.store(texel, texels + self.source.load(texel))


def test_a_load_outside_the_texture_or_its_levels_is_zero(naga: Any) -> None:
    """WebGPU may load any texel instead; rhi promises zeros."""
    text = text_of(LoadsAndStores)
    naga.create_shader_module(code=text)
    of_level, of_whole = sorted(re.findall(r"fn rhi_load\w+\(.*", text), key=len, reverse=True)
    assert "u32(index) >= textureNumLevels(image)" in of_level
    assert ">= max(textureDimensions(image) >> vec2<u32>(u32(index)), vec2<u32>(1u))" in of_level
    assert "if (any(vec2<u32>(at) >= textureDimensions(image))) { return vec4<f32>(); }" in of_whole
    assert text.count("textureLoad(") == 2


class CountsLoads(sl.Shader):
    """Loads where an atomic counts, of an array, of a volume and of an image."""

    layers: sl.Texture2DArray
    volume: sl.Texture3D
    count: sl.StorageRW[int]
    image: sl.Image2D = sl.image(Format.R32F)

    def compute(self) -> None:
        x = sl.atomic_add(self.count[0], 1)
        total = self.layers.load(
            sl.ivec3(sl.atomic_add(self.count[0], 1), x, x), sl.atomic_add(self.count[0], 1)
        )
        total += self.volume.load(sl.ivec3(sl.atomic_add(self.count[0], 1), x, x))
        texel = sl.ivec2(sl.atomic_add(self.count[0], 1), x)
        self.image.store(texel, self.image.load(texel) + total.x)


def test_positions_with_effects_are_evaluated_once(naga: Any) -> None:
    text = text_of(CountsLoads)
    naga.create_shader_module(code=text)
    assert text.count("atomicAdd(") == 5
    assert "u32(at.z) >= textureNumLayers(image)" in text
    assert "any(vec3<u32>(at) >= textureDimensions(image))" in text
    assert "image: texture_storage_2d<r32float, read_write>" in text


def test_an_image_that_is_only_stored_to_is_not_read() -> None:
    """All devices of WebGPU can store texels of 8 bits, and few read and store them."""
    assert "texture_storage_2d<rgba8unorm, write>" in text_of(LoadsAndStores)
    assert [binding.reads for binding in sl.compile_shader(LoadsAndStores).bindings] == [True, True, False]


class SamplesIntegers(sl.Shader):
    source: sl.IntTexture2D
    out: sl.StorageRW[int]

    def compute(self) -> None:
        self.out[0] = self.source.sample_lod(sl.vec2(0.5), 0.0).x


class FencesMemory(sl.Shader):
    out: sl.StorageRW[int]

    def compute(self) -> None:
        self.out[0] = 1
        sl.memory_barrier()


@pytest.mark.parametrize(
    ("shader", "construct"),
    [(SamplesIntegers, "an integer texture that is sampled"), (FencesMemory, "memory_barrier()")],
)
def test_a_construct_that_wgsl_lacks_is_refused_at_its_python_line(
    shader: type[sl.Shader], construct: str
) -> None:
    with pytest.raises(ShaderError, match=r"^\[shading-native\]") as caught:
        text_of(shader)
    assert caught.value.given == f"{construct}, which WGSL lacks"
    assert caught.value.site is not None
    line = Path(__file__).read_text(encoding="utf-8").splitlines()[caught.value.site.line - 1]
    assert construct.split()[-1].split("(")[0][:6] in line


@sl.function
def doubled(value: float) -> float:
    return value * 2.0


class Simple(sl.Shader):
    out: sl.StorageRW[float]

    def compute(self) -> None:
        self.out[0] = doubled(1.5)


def test_each_line_knows_the_python_line_that_it_comes_from() -> None:
    written = sl.compile_shader(Simple).emit("wgsl", Stage.COMPUTE)
    lines = written.text.splitlines()
    number = next(i for i, line in enumerate(lines) if "return (value * 2.0f);" in line)
    file, line = written.origins[number]
    assert "return value * 2.0" in Path(file).read_text(encoding="utf-8").splitlines()[line - 1]
    assert len(written.origins) == len(lines)


def test_formats_have_their_names_in_webgpu() -> None:
    names = {format: texel_format(format) for format in Format}
    assert len(set(names.values())) == len(Format)
    formats = (
        "R8",
        "RGBA8_SRGB",
        "RG8_SNORM",
        "RGBA16",
        "RG16F",
        "R32I",
        "RGB10A2",
        "RGB10A2UI",
        "R11G11B10F",
    )
    assert [names[Format[name]] for name in formats] == [
        "r8unorm",
        "rgba8unorm-srgb",
        "rg8snorm",
        "rgba16unorm",
        "rg16float",
        "r32sint",
        "rgb10a2unorm",
        "rgb10a2uint",
        "rg11b10ufloat",
    ]


@pytest.mark.nightly
def test_naga_accepts_every_stage_of_the_tree_that_wgsl_can_say(naga: Any) -> None:
    del naga
    done = subprocess.run(
        [sys.executable, ROOT / "scripts" / "dump_shaders.py", "--naga"],
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )
    accepted, refused, wrong = map(int, re.findall(r"(\d+) (?:accepted|refused|wrong)", done.stderr))
    assert wrong == 1, done.stdout  # a test's WGSL that doesn't compile
    assert refused == RECORDED_REFUSALS
    assert accepted > 790
