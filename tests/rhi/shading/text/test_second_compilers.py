"""Compilers that no backend uses here accept the texts of shaders, too: Tint, glslang and Clang."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from shader_compilers import (
    WITHOUT_CAPABILITY,
    check_spirv,
    check_with_clang,
    check_with_glslang,
    check_with_tint,
    list_texts,
    missing_capability,
)

import rhi.shading as sl
from rhi import Format
from rhi.contract.descriptors import Stage

ROOT = Path(__file__).parents[4]
KIT = ROOT / "tests" / "kits" / "shader_compilers.py"
BROKEN = {"test_shading_spirv.BrokenText", "test_wgpu_backend.Broken"}
"""Shaders of tests whose native code no compiler takes."""


class Corner(sl.Struct):
    position: sl.vec2
    number: int


class Surface(sl.Struct):
    clip: sl.vec4
    uv: sl.vec2
    number: int


class Cell(sl.Struct):
    turn: sl.mat3
    weights: sl.Array[float] = sl.array(float, 5)


@sl.function
def picked(source: sl.Texture2D, at: sl.vec2) -> sl.vec4:
    return source.sample(at) if at.x > 0.25 else sl.vec4(0.5)


class Drawn(sl.Shader):
    """Samples and differences under conditions that vary, and all kinds of bindings."""

    cell: sl.Uniform[Cell]
    source: sl.Texture2D
    layers: sl.Texture2DArray
    shadow: sl.DepthTexture2D
    counts: sl.Storage[int]
    target: sl.Image2D = sl.image(Format.RGBA8)

    def vertex(self, v: Corner) -> Surface:
        at = self.cell.turn @ sl.vec3(v.position, 1.0)
        return Surface(clip=sl.vec4(at, 1.0), uv=v.position, number=v.number + sl.instance_index())

    def fragment(self, s: Surface) -> sl.vec4:
        color = picked(self.source, s.uv)
        for i in range(self.counts[s.number]):
            if s.uv.x < self.cell.weights[i]:
                color += self.layers.sample(sl.vec3(s.uv, 1.0)) * sl.fwidth(s.uv.x)
            elif s.uv.y > 0.5:
                color *= self.shadow.sample_compare(s.uv, 0.5)
        if color.a < sl.atan2(s.uv.y, s.uv.x):
            self.target.store(sl.ivec2(s.uv * 8.0), color)
        return color


class Summed(sl.Shader):
    """A sum in shared memory, with an atomic."""

    values: sl.Storage[float]
    sums: sl.StorageRW[float]
    count: sl.StorageRW[sl.uint]
    partial = sl.shared(float, 64)
    work_group = (64,)

    def compute(self) -> None:
        i = sl.local_index()
        self.partial[i] = self.values[int(sl.global_id().x)] ** 3 % 7.0
        step = 32
        while step > 0:
            sl.barrier()
            if i < step:
                self.partial[i] += self.partial[i + step]
            step = step // 2
        if i == 0:
            self.sums[int(sl.group_id().x)] = self.partial[0]
            sl.atomic_add(self.count[0], sl.uint(1))


def texts_of(language: str, *shaders: type[sl.Shader]) -> dict[str, str]:
    programs = [(shader.__name__, sl.compile_shader(shader)) for shader in shaders]
    return {
        name: text
        for program in programs
        for text_language, name, text in list_texts(*program)
        if text_language == language
    }


def with_stages(texts: dict[str, str]) -> dict[str, tuple[Stage, str]]:
    return {name: (Stage(name.rsplit(" ", 1)[1]), text) for name, text in texts.items()}


# -- two shaders that use much of the language


def test_tint_accepts_texts_of_the_language_and_refuses_a_broken_text() -> None:
    texts = texts_of("wgsl", Drawn, Summed)
    assert len(texts) == 3
    broken = {name: text.replace("f32", "missing", 1) for name, text in texts.items()}
    refused = check_with_tint({**texts, **{f"broken {name}": text for name, text in broken.items()}})
    assert {name: message for name, message in refused.items() if not name.startswith("broken")} == {}
    assert len(refused) == 3
    assert "missing" in refused["broken Summed compute"]


def test_glslang_accepts_texts_of_the_language_and_refuses_a_broken_text() -> None:
    texts = texts_of("glsl", Drawn, Summed)
    broken = {f"broken {name}": text.replace("float", "missing", 1) for name, text in texts.items()}
    assert check_with_glslang(with_stages(texts)) == {}
    assert len(check_with_glslang(with_stages({**texts, **broken}))) == 3


def test_vulkans_glsl_becomes_valid_spirv_and_a_broken_text_does_not() -> None:
    texts = texts_of("vulkan", Drawn, Summed)
    assert check_spirv(with_stages(texts)) == {}
    broken = {name: text.replace("float", "missing", 1) for name, text in texts.items()}
    assert len(check_spirv(with_stages(broken))) == 3


def test_clang_accepts_kernels_without_a_warning_and_refuses_broken_ones() -> None:
    texts = texts_of("opencl", Drawn, Summed)
    assert list(texts) == ["Drawn vertex", "Drawn raster", "Summed opencl1", "Summed opencl16"]
    assert check_with_clang(texts) == {}
    text = texts["Summed opencl1"]
    assert "missing" in check_with_clang({"broken": text.replace("float", "missing", 1)})["broken"]
    doubtful = f"{text}\nkernel void doubtful(global int *a) {{ if (a[0] = 1) a[1] = 2; }}\n"
    assert "[-Wparentheses]" in check_with_clang({"doubtful": doubtful})["doubtful"]


def test_capabilities_that_webgpu_lacks_are_seen_in_a_text() -> None:
    assert missing_capability("enable draw_index;\n@vertex fn main() {}") == "draw_index"
    assert missing_capability("@early_depth_test(force) @fragment fn main() {}") == "early_depth"
    written = "@group(1) @binding(0) var<storage, read_write> a: array<f32>;\n"
    assert missing_capability(f"{written}@vertex fn main() {{}}") == "vertex_writes"
    assert missing_capability(f"{written}@fragment fn main() {{}}") is None
    assert all(missing_capability(text) is None for text in texts_of("wgsl", Drawn, Summed).values())


# -- nightly: all shaders of the tree


@pytest.fixture(scope="module")
def all_texts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, str]]:
    """The texts of all shaders by language and name; those of tests that are meant to be broken are left out."""
    path = tmp_path_factory.mktemp("texts") / "texts.json"
    subprocess.run([sys.executable, KIT, path], check=True)
    texts: dict[str, dict[str, str]] = {"wgsl": {}, "glsl": {}, "vulkan": {}, "opencl": {}}
    for language, name, text in json.loads(path.read_text(encoding="utf-8")):
        if name.rpartition(" ")[0] not in BROKEN:
            texts[language][name] = text
    return texts


@pytest.mark.nightly
@pytest.mark.parametrize("capability", [None, *WITHOUT_CAPABILITY])
def test_tint_accepts_every_stage_within_webgpus_capabilities(
    capability: str | None, all_texts: dict[str, dict[str, str]]
) -> None:
    texts = {name: text for name, text in all_texts["wgsl"].items() if missing_capability(text) == capability}
    refused = check_with_tint(texts, install=True)
    if capability is not None:
        assert refused.keys() == texts.keys(), "WebGPU has it by now"
        pytest.skip(f"{len(texts)} stages need {capability}, which WebGPU lacks")
    assert refused == {}
    assert len(texts) > 850


@pytest.mark.nightly
def test_glslang_accepts_every_stage(all_texts: dict[str, dict[str, str]]) -> None:
    assert check_with_glslang(with_stages(all_texts["glsl"])) == {}
    assert len(all_texts["glsl"]) > 900


@pytest.mark.nightly
def test_every_stage_is_valid_spirv(all_texts: dict[str, dict[str, str]]) -> None:
    assert check_spirv(with_stages(all_texts["vulkan"])) == {}
    assert len(all_texts["vulkan"]) > 900


@pytest.mark.nightly
def test_clang_accepts_every_kernel_without_a_warning(all_texts: dict[str, dict[str, str]]) -> None:
    assert check_with_clang(all_texts["opencl"]) == {}
    assert len(all_texts["opencl"]) > 1200
