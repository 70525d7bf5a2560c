"""The text of stages by language that a program's descriptor emits, and the origins of its lines."""

from __future__ import annotations

import inspect

import pytest

from rhi.contract.descriptors import Stage
from rhi.errors import ShaderError
from rhi.shading import Shader, StorageRW, compile_shader, global_id, vec4


class Ramp(Shader):
    work_group = (32,)
    signed: StorageRW[float]  # a word of C, not of GLSL

    def compute(self) -> None:
        i = global_id().x
        self.signed[i] = float(i)


STORE = inspect.getsourcelines(Ramp)[1] + 6


class Corner(Shader):
    def vertex(self) -> vec4:
        return vec4(0.0, 0.0, 0.0, 1.0)


@pytest.mark.parametrize(("lanes", "items"), [(1, 32), (4, 8), (8, 4), (16, 2)])
def test_a_compute_stage_is_emitted_as_a_kernel_for_so_many_lanes(lanes: int, items: int) -> None:
    text = compile_shader(Ramp).emit(f"opencl{lanes}", Stage.COMPUTE).text
    assert text.count("kernel void") == 1
    assert f"reqd_work_group_size({items}, 1, 1)" in text
    assert "void main()" in compile_shader(Ramp).emit("glsl", Stage.COMPUTE).text


@pytest.mark.parametrize("language", ["opencl16", "glsl", "opencl1"])
def test_a_text_has_the_origins_of_its_own_lines(language: str) -> None:
    descriptor = compile_shader(Ramp)
    emitted = descriptor.emit(language, Stage.COMPUTE)
    for other in ("opencl4", "numpy", "glsl"):
        descriptor.emit(other, Stage.COMPUTE)
    lines, origins = emitted.text.split("\n"), emitted.origins
    assert abs(len(lines) - len(origins)) <= 1  # a last line may be empty
    stores = [number for number, origin in enumerate(origins) if origin == (__file__, STORE)]
    assert any("signed" in lines[number] for number in stores)


@pytest.mark.parametrize("language", ["opencl", "opencl2", "hlsl", ""])
def test_an_unknown_language_is_refused_with_the_list_of_languages(language: str) -> None:
    with pytest.raises(ShaderError, match=r"glsl, opencl1, opencl4, opencl8, opencl16") as caught:
        compile_shader(Ramp).emit(language, Stage.COMPUTE)
    assert caught.value.rule.id == "shading-native"


def test_a_stage_that_draws_is_a_function_for_16_lanes() -> None:
    text = compile_shader(Corner).emit("opencl16", Stage.VERTEX).text
    assert "void rhi_vertex(" in text
    assert "kernel" not in text


@pytest.mark.parametrize("language", ["opencl1", "opencl8", "numpy"])
def test_a_stage_that_draws_is_for_16_lanes_only(language: str) -> None:
    with pytest.raises(ShaderError, match=r"allowed: glsl, opencl16, vulkan, spirv, wgsl\n") as caught:
        compile_shader(Corner).emit(language, Stage.VERTEX)
    assert caught.value.rule.id == "shading-native"
