"""Point sizes and point coordinates in the shading language."""

from __future__ import annotations

import numpy as np
import pytest

import rhi
import rhi.shading as sl
from rhi.contract.descriptors import Interpolation, Stage


class PointVertex(sl.Struct):
    position: sl.vec4
    size: float


class Dot(sl.Struct):
    clip: sl.vec4
    color: sl.vec4
    size: sl.PointSize


class Dots(sl.Shader):
    def vertex(self, v: PointVertex) -> Dot:
        return Dot(clip=v.position, color=sl.vec4(1.0), size=v.size * 2.0)

    def fragment(self, v: Dot) -> sl.vec4:
        return sl.vec4(sl.point_coordinate() * sl.vec2(1.0, 10.0), v.color.xy)


class Depths(sl.Shader):
    """Points without a fragment stage."""

    def vertex(self, v: PointVertex) -> Dot:
        return Dot(clip=v.position, color=sl.vec4(1.0), size=v.size)


class Plain(sl.Shader):
    def vertex(self, v: PointVertex) -> sl.vec4:
        return v.position

    def fragment(self) -> sl.vec4:
        return sl.vec4(1.0)


def test_a_descriptor_tells_whether_a_program_writes_point_size_or_reads_point_coordinate() -> None:
    both, sized, plain = map(sl.compile_shader, (Dots, Depths, Plain))
    assert (both.point_size, both.reads_point_coordinates) == ("size", True)
    assert (sized.point_size, sized.reads_point_coordinates) == ("size", False)
    assert (plain.point_size, plain.reads_point_coordinates) == ("", False)


def test_the_size_is_a_flat_varying_also_without_a_fragment_stage() -> None:
    for shader, before in ((Dots, 4), (Depths, 0)):
        (size,) = (varying for varying in sl.compile_shader(shader).varyings if varying.name == "size")
        assert (size.word, size.words, size.interpolation) == (before, 1, Interpolation.FLAT)


def test_glsl_writes_the_built_in_variables() -> None:
    descriptor = sl.compile_shader(Dots)
    assert "gl_PointSize = max(1.0, " in descriptor.emit("glsl", Stage.VERTEX).text
    assert "gl_PointCoord" in descriptor.emit("glsl", Stage.FRAGMENT).text
    assert "gl_PointSize" not in sl.compile_shader(Plain).emit("glsl", Stage.VERTEX).text


def test_numpy_runs_both() -> None:
    run = sl.run_vertex(Dots, {"position": np.zeros((3, 4), "f4"), "size": np.array([1, 2, 3], "f4")})
    assert run.varyings["size"].tolist() == [2, 4, 6]
    coordinates = np.array([(0.25, 0.5), (0.75, 0.125)], "f4").reshape(1, 2, 2)
    color = sl.run_fragment(Dots, {"color": np.ones(4, "f4")}, point_coordinate=coordinates).outputs["color"]
    assert color[..., :2].tolist() == [[[0.25, 5.0], [0.75, 1.25]]]
    assert sl.run_fragment(Dots, {"color": np.ones(4, "f4")}).outputs["color"][0, 0].tolist() == [
        0.5,
        5.0,
        1.0,
        1.0,
    ]


def test_a_vertex_stage_has_one_point_size() -> None:
    class Two(sl.Struct):
        clip: sl.vec4
        size: sl.PointSize
        second_size: sl.PointSize

    class Twice(sl.Shader):
        def vertex(self) -> Two:
            return Two(clip=sl.vec4(0.0), size=1.0, second_size=2.0)

    with pytest.raises(rhi.ShaderError, match="one PointSize"):
        sl.compile_shader(Twice)


def test_point_coordinates_belong_to_fragments() -> None:
    class Early(sl.Shader):
        def vertex(self) -> sl.vec4:
            return sl.vec4(sl.point_coordinate(), sl.vec2(0.0))

    with pytest.raises(rhi.ShaderError):
        sl.compile_shader(Early)
