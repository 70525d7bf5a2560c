"""The target's layer in the shading language."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import rhi
import rhi.shading as sl
import rhi.trace
from rhi.contract.descriptors import ALL_LAYERS, Interpolation, Stage


class LayerVertex(sl.Struct):
    position: sl.vec4
    layer: int


class Slice(sl.Struct):
    clip: sl.vec4
    color: sl.vec4
    layer: sl.TargetLayer


class Slices(sl.Shader):
    def vertex(self, v: LayerVertex) -> Slice:
        return Slice(clip=v.position, color=sl.vec4(1.0), layer=v.layer + 1)

    def fragment(self, v: Slice) -> sl.vec4:
        return v.color


class Depths(sl.Shader):
    """Layers without a fragment stage."""

    def vertex(self, v: LayerVertex) -> Slice:
        return Slice(clip=v.position, color=sl.vec4(1.0), layer=v.layer)


class Plain(sl.Shader):
    def vertex(self, v: LayerVertex) -> sl.vec4:
        return v.position


def test_the_layer_is_a_flat_varying_also_without_a_fragment_stage() -> None:
    for shader, word in ((Slices, 4), (Depths, 0)):
        descriptor = sl.compile_shader(shader)
        assert descriptor.target_layer == "layer"
        (layer,) = (varying for varying in descriptor.varyings if varying.name == "layer")
        assert (layer.word, layer.words, layer.interpolation) == (word, 1, Interpolation.FLAT)
    assert sl.compile_shader(Plain).target_layer == ""


@pytest.mark.parametrize("language", ["glsl", "vulkan"])
def test_glsl_asks_for_the_extension_where_a_layer_is_chosen(language: str) -> None:
    text = sl.compile_shader(Slices).emit(language, Stage.VERTEX).text
    assert "gl_Layer = " in text
    assert "#extension GL_ARB_shader_viewport_layer_array : require" in text
    for shader, stage in ((Slices, Stage.FRAGMENT), (Plain, Stage.VERTEX)):
        assert "ayer_array" not in sl.compile_shader(shader).emit(language, stage).text


def test_numpy_returns_the_layer_of_each_vertex() -> None:
    attributes = {"position": np.zeros((3, 4), "f4"), "layer": np.array([0, 4, -3], "i4")}
    assert sl.run_vertex(Slices, attributes).varyings["layer"].tolist() == [1, 5, -2]


def test_a_vertex_stage_chooses_one_layer() -> None:
    class Two(sl.Struct):
        clip: sl.vec4
        layer: sl.TargetLayer
        second_layer: sl.TargetLayer

    class Twice(sl.Shader):
        def vertex(self) -> Two:
            return Two(clip=sl.vec4(0.0), layer=1, second_layer=2)

    with pytest.raises(rhi.ShaderError, match="one TargetLayer"):
        sl.compile_shader(Twice)


def test_a_trace_holds_a_pass_on_all_layers(tmp_path: Path) -> None:
    with rhi.create_device("null", record=True) as device:
        cube = device.texture((4, 4), rhi.Format.RGBA8, kind=rhi.TextureKind.CUBE)
        corners = {"position": np.zeros((3, 4), "f4"), "layer": np.zeros(3, "i4")}
        with device.render_pass(cube.at(layer=None), clear=(1, 1, 1, 1)):
            device.draw(device.program(Slices), device.mesh(corners))
        rhi.trace.save(device, tmp_path / "layers.zip")
    trace = rhi.trace.load(tmp_path / "layers.zip")
    (render_pass,) = (command for command in trace.stream if command.op is rhi.Op.BEGIN_PASS)
    assert render_pass["descriptor"].colors[0].layer == ALL_LAYERS
    with rhi.create_device("null") as device:
        assert rhi.trace.replay(trace, on=device).commands == len(trace.stream)
