"""Existing GLSL, with its own `main`, as a stage of a shader whose interface is declared in Python."""

from pathlib import Path

import numpy as np
import pytest

import rhi
import rhi.shading as sl
from rhi.contract.descriptors import Stage
from rhi.errors import ShaderError


class Corner(sl.Struct):
    in_position: sl.vec2
    in_uv: sl.vec2


class Surface(sl.Struct):
    clip: sl.vec4
    v_uv: sl.vec2


class Output(sl.Struct):
    frag_color: sl.vec4


class Settings(sl.Struct):
    turn: sl.mat3
    scale: float


class Existing(sl.Shader):
    settings: sl.Uniform[Settings]
    albedo: sl.Texture2D

    @sl.native(
        "glsl",
        """
        #version 330 core
        layout(location = 0) in vec2 in_position;
        in vec2 in_uv;
        out vec2 v_uv;  // to the fragment stage
        vec2 twice(vec2 v) { return v * 2.0; }
        void main() {
            v_uv = (settings.turn * vec3(twice(in_uv), 0.0)).xy;
            gl_Position = vec4(in_position, 0.5, 1.0);
        }
        """,
    )
    def vertex(self, v: Corner) -> Surface: ...

    @sl.native(
        "glsl",
        """
        #version 330 core
        in vec2 v_uv;
        uniform sampler2D albedo;
        out vec4 frag_color;
        void main() {
            frag_color = texture(albedo, v_uv) * settings.scale + vec4(v_uv, 0.0, 0.0);
        }
        """,
    )
    def fragment(self, s: Surface) -> Output: ...


class HalfPython(Existing):
    """A native vertex stage with a fragment stage in Python."""

    def fragment(self, s: Surface) -> Output:
        return Output(frag_color=self.albedo.sample(s.v_uv) * self.settings.scale + sl.vec4(s.v_uv, 0, 0))


@pytest.fixture(scope="module")
def device(context):  # which is skipped where there is no OpenGL
    with rhi.create_device("gl") as device:
        yield device


@pytest.mark.parametrize("shader", [Existing, HalfPython])
def test_existing_stages_draw_with_the_bindings_of_the_class(device, shader):
    corners = np.zeros(3, Corner.dtype)
    corners["in_position"], corners["in_uv"] = [(-1, -1), (3, -1), (-1, 3)], (0.125, 0.375)
    image = device.texture((4, 4), rhi.Format.RGBA32F)
    white = device.texture((1, 1), rhi.Format.RGBA32F)
    white.write(np.full((1, 1, 4), 0.5, "f4"))
    settings = device.uniform(Settings(turn=[(0, 1, 0), (2, 0, 0), (0, 0, 1)], scale=3.0))
    with device.render_pass(image, clear=(0, 0, 0, 0)):
        device.draw(device.program(shader), device.mesh(corners), settings=settings, albedo=white)
    assert np.asarray(image.read()).reshape(-1, 4).tolist() == [[0.75 + 1.5, 0.5 + 1.5, 1.5, 1.5]] * 16


def test_lines_of_the_text_keep_their_origins():
    text = sl.compile_shader(Existing).emit("glsl", Stage.VERTEX)
    lines = text.text.splitlines()
    at = next(i for i, line in enumerate(lines) if "twice(in_uv)" in line)
    file, number = text.origins[at]
    assert file == __file__
    assert "twice(in_uv)" in Path(__file__).read_text(encoding="utf-8").splitlines()[number - 1]
    assert lines[0] == "#version 430 core"
    assert sum("#version" in line for line in lines) == 1


def test_a_backend_without_the_language_refuses_the_stage_by_name():
    for language, stage in (("opencl16", Stage.FRAGMENT), ("opencl16", Stage.VERTEX)):
        with pytest.raises(ShaderError, match=r"^\[shading-native\]") as error:
            sl.compile_shader(Existing).emit(language, stage)
        assert stage.value in error.value.given
        assert error.value.site.line > 0


TEXT = '''
from rhi.shading import *
class Corner(Struct):
    at: vec2
class Surface(Struct):
    clip: vec4
    uv: vec2
class Test(Shader):
    tint: Uniform[vec4]
    @native("glsl", """
        #version 330
        in vec2 at;
        uniform vec4 tint;
        out vec2 uv;
        void main() { uv = at; gl_Position = tint + vec4(at, 0.0, 1.0); }
        """)
    def vertex(self, v: Corner) -> Surface: ...
    def fragment(self, s: Surface) -> vec4:
        return self.tint
'''
WRONG = [
    ("in vec2 at;", "in vec3 at;", "in vec3 at", "in vec2 at"),
    ("in vec2 at;", "in vec2 att;", "in vec2 att", "did you mean 'at'"),
    ("uniform vec4 tint;", "uniform vec3 tint;", "uniform vec3 tint", "uniform vec4 tint"),
    ("uniform vec4 tint;", "uniform vec4 tint[4];", "uniform vec4[4] tint", "uniform vec4 tint"),
    ("uniform vec4 tint;", "uniform float other;", "uniform float other", "uniform vec4 tint"),
    ("out vec2 uv;", "flat out ivec2 uv;", "out ivec2 uv", "out vec2 uv"),
    ("uniform vec4 tint;", "uniform Block { vec4 tint; };", "uniform Block", "remove it"),
    ("uniform vec4 tint;", "layout(std140) buffer Block { vec4 tint; };", "buffer Block", "remove it"),
    ("in vec2 at;", "struct Corner { vec2 at; };", "struct Corner", "remove it"),
]


@pytest.mark.parametrize(("right", "wrong", "declaration", "says"), WRONG, ids=[row[1] for row in WRONG])
def test_a_declaration_that_differs_from_the_class_is_refused(right, wrong, declaration, says):
    assert "void main()" in sl.compile_shader(sl.from_source(TEXT)).emit("glsl", Stage.VERTEX).text
    with pytest.raises(ShaderError, match=r"^\[shading-native\]") as error:
        sl.compile_shader(sl.from_source(TEXT.replace(right, wrong, 1))).emit("glsl", Stage.VERTEX)
    assert error.value.given == declaration
    assert says in str(error.value)
    assert wrong in str(error.value)  # the line


class Doubled(sl.Shader):
    work_group = (4,)
    values: sl.StorageRW[float]

    @sl.native(
        "glsl",
        """
        #version 430
        layout(local_size_x = 4) in;
        void main() { values[gl_GlobalInvocationID.x] *= 2.0; }
        """,
    )
    def compute(self) -> None: ...


class WrongGroup(Doubled):
    work_group = (8,)


def test_a_compute_stage_may_be_existing_text(device):
    values = device.storage(float, np.arange(4, dtype="f4"))
    device.dispatch(device.program(Doubled), 1, values=values)
    assert values.read().tolist() == [0, 2, 4, 6]
    with pytest.raises(ShaderError, match=r"work-group of \(4, 1, 1\)"):
        sl.compile_shader(WrongGroup).emit("glsl", Stage.COMPUTE)
