"""Graphics stages, textures and images, on the driver."""

import pytest

import rhi.shading as sl
from rhi import Format
from rhi.contract.descriptors import Attribute, BindingKind, FragmentOutput, Stage
from rhi.contract.layout import FLOAT, INT, UINT, VectorType
from rhi.errors import ShaderError
from rhi.shading.language.types import TextureType


class ClipPosition(sl.Struct):
    clip: sl.vec4


class Plane(sl.Struct):
    position: sl.vec2
    id: sl.uint


class Offset(sl.Struct):
    offset: sl.ivec2


class Surface(ClipPosition):
    uv: sl.vec2
    screen: sl.NoPerspective[sl.vec2]
    tint: sl.Flat[sl.vec3]
    id: sl.uint
    turn: sl.mat4


class Targets(sl.Struct):
    color: sl.vec4
    ids: sl.uvec2
    offset: int
    depth: sl.FragmentDepth


class Everything(sl.Shader):
    early_depth = False
    camera: sl.Uniform[sl.mat4]
    albedo: sl.Texture2D
    layers: sl.Texture2DArray
    volume: sl.Texture3D
    sky: sl.TextureCube
    shadow: sl.DepthTexture2D
    cascades: sl.DepthTexture2DArray
    point: sl.DepthTextureCube
    ids: sl.UintTexture2D
    counts: sl.IntTexture2D
    lights: sl.Storage[sl.vec4]
    hits: sl.StorageRW[sl.uint]

    def vertex(self, v: Plane, instance: Offset) -> Surface:
        n = sl.vertex_index() + sl.instance_index() + sl.draw_index()
        position = v.position + sl.vec2(instance.offset)
        return Surface(
            clip=self.camera @ sl.vec4(position, 0, 1),
            uv=v.position,
            screen=v.position * float(n),
            tint=sl.vec3(1),
            id=v.id,
            turn=self.camera,
        )

    def shaded(self, shadow: sl.DepthTexture2D, uv: sl.vec2) -> float:
        return shadow.sample_compare(uv, 0.5) + shadow.sample_compare_lod(uv, reference=0.5, lod=0)

    def fragment(self, s: Surface) -> Targets:
        if s.uv.x < 0.0 or not sl.front_facing():
            sl.discard()
        uv = s.uv
        uvw = sl.vec3(uv, 0.5)
        color = self.albedo.sample(uv) + self.albedo.sample_bias(uv, 1.0) + self.albedo.sample_lod(uv, lod=2)
        color += self.albedo.sample_grad(uv, sl.ddx(uv), sl.ddy(uv)) + self.albedo.load(
            sl.ivec2(1, 2), level=1
        )
        color += (
            self.layers.sample(uvw) + self.layers.load(sl.ivec3(1, 2, 3)) + self.volume.sample_lod(uvw, 0)
        )
        color += self.volume.sample_grad(uvw, sl.ddx(uvw), sl.ddy(uvw)) + self.volume.load(sl.ivec3(0, 0, 0))
        color += self.sky.sample(uvw) + self.sky.sample_lod(uvw, 1.5) + self.sky.gather(uvw)
        color += self.albedo.gather(uv) + self.albedo.gather(uv, component=2)
        color.x += self.shaded(self.shadow, uv) + self.cascades.sample_compare(uvw, 0.5)
        color += self.shadow.gather_compare(uv, 0.5) + self.cascades.gather_compare(uvw, 0.25)
        color.y += self.point.sample_compare(uvw, 0.5)
        color.z += float(self.albedo.levels()) + float(self.albedo.size().x + self.sky.size(1).y)
        color.w += float(self.volume.size().z + self.layers.size().z + self.shadow.size().y)
        ids = self.ids.load(sl.ivec2(sl.fragment_coordinate().xy)).xy
        counts = self.counts.load(sl.ivec2(0)) + self.counts.sample(uv) + self.counts.gather(uv, 1)
        sl.atomic_add(self.hits[s.id], sl.uint(sl.primitive_index()))
        for i in range(len(self.lights)):
            color += self.lights[i] * sl.fwidth(uv.x)
        return Targets(color=s.turn @ color, ids=ids, offset=counts.x, depth=s.screen.x + s.tint.y)


def test_every_graphics_feature_compiles_on_the_driver(link):
    program = link(Everything)
    assert program.stages == {Stage.VERTEX, Stage.FRAGMENT}
    assert program.attributes == (
        Attribute("position", 0, VectorType(FLOAT, 2)),
        Attribute("id", 1, UINT),
        Attribute("offset", 2, VectorType(INT, 2)),
    )
    assert program.outputs == (
        FragmentOutput("color", 0, "float", 4),
        FragmentOutput("ids", 1, "uint", 2),
        FragmentOutput("offset", 2, "int", 1),
    )
    assert program.discards
    assert program.writes_depth
    assert program.writes_memory
    assert not program.early_depth


def test_slots_count_within_each_kind_in_the_order_of_the_class():
    bindings = {binding.name: binding for binding in sl.compile_shader(Everything).bindings}
    assert list(bindings) == list(Everything.__annotations__)
    assert (bindings["camera"].kind, bindings["camera"].slot, bindings["camera"].size) == (
        BindingKind.UNIFORM,
        0,
        64,
    )
    assert (bindings["lights"].slot, bindings["lights"].size, bindings["lights"].writes) == (0, 16, False)
    assert (bindings["hits"].slot, bindings["hits"].size, bindings["hits"].writes) == (1, 4, True)
    assert [bindings[name].slot for name in ("albedo", "layers", "counts")] == [0, 1, 8]
    assert bindings["shadow"].type == TextureType(bindings["shadow"].type.kind, FLOAT, True)


class EarlyOnly(sl.Shader):
    early_depth = True
    hits: sl.StorageRW[sl.uint]

    def vertex(self) -> sl.vec4:
        return sl.vec4(0, 0, 0.5, 1)

    def fragment(self) -> None:
        sl.atomic_add(self.hits[0], 1)


def test_a_fragment_stage_may_only_write_memory(link):
    program = link(EarlyOnly)
    assert "early_fragment_tests" in program.emit("glsl", Stage.FRAGMENT).text
    assert (program.early_depth, program.outputs, program.writes_memory) == (True, (), True)


def test_a_fragment_depth_with_early_depth_is_refused():
    class Early(Everything):
        early_depth = True

    class Late(Everything):
        early_depth = False

    sl.compile_shader(Late)
    with pytest.raises(ShaderError, match="early_depth"):
        sl.compile_shader(Early)


class DepthOnly(sl.Shader):
    def vertex(self, v: Plane) -> ClipPosition:
        return ClipPosition(clip=sl.vec4(v.position, 0, 1))


def test_a_shader_may_have_a_vertex_stage_alone(link):
    program = link(DepthOnly)
    assert program.stages == {Stage.VERTEX}
    assert [attribute.name for attribute in program.attributes] == ["position", "id"]


class Colored(sl.Shader):
    scale: sl.Uniform[sl.vec4]

    def vertex(self) -> sl.vec4:
        i = sl.vertex_index()
        return sl.vec4(float(i % 2) * 4 - 1, float(i // 2) * 4 - 1, 0, 1)

    def base(self) -> sl.vec4:
        return sl.vec4(sl.fragment_coordinate().xy, 0, 1)

    def fragment(self) -> sl.vec4:
        return self.base() * self.scale


class Reversed(Colored):
    extra: sl.Uniform[sl.vec4]

    def base(self) -> sl.vec4:
        return super().base().yxzw + self.extra


def test_a_subclass_adds_the_bindings_of_its_overriding_methods():
    assert [binding.name for binding in sl.compile_shader(Reversed).bindings] == ["scale", "extra"]


class Loading(sl.Shader):
    source: sl.Image2D = sl.image(Format.RGBA8)
    texture: sl.Texture2D
    ids: sl.UintImage2D = sl.image(Format.R32UI)
    out: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        at = sl.global_id().xy
        self.out[0] = self.source.load(at) + self.texture.load(at)
        self.ids.store(at, self.ids.load(at))


def test_an_image_that_is_only_loaded_is_not_written():
    program = sl.compile_shader(Loading)
    writes = {binding.name: binding.writes for binding in program.bindings}
    assert writes == {"source": False, "texture": False, "ids": True, "out": True}
    assert "layout(rgba8, binding = 0) readonly uniform image2D" in program.emit("glsl", Stage.COMPUTE).text


@sl.function
@sl.native("glsl", "return float(bitfieldReverse(n)) + EXTRA;", declarations="const float EXTRA = 0.5;")
def reversed_bits(n: sl.uint) -> float: ...


class Native(sl.Shader):
    out: sl.StorageRW[float]

    def compute(self) -> None:
        self.out[0] = reversed_bits(sl.uint(0x80000000))
        self.store(2.0)

    @sl.native("glsl", "out_[1] = value * 4.0;\nout_[2] = float(out_.length());")
    def store(self, value: float) -> None:
        self.out[1] = value * 4.0


def test_a_native_body_replaces_the_python_one_and_keeps_typed_bindings(run):
    assert run(Native, out=4)["out"].tolist() == [1.5, 8, 4, 0]


class Broken(sl.Shader):
    out: sl.StorageRW[float]

    @sl.native("other", "nothing")
    def store(self) -> None: ...

    def compute(self) -> None:
        self.store()


def test_a_function_that_is_native_in_another_language_only_is_refused():
    with pytest.raises(ShaderError, match=r"^\[shading-native\]"):
        sl.compile_shader(Broken).emit("glsl", Stage.COMPUTE)
    sl.compile_shader(Native).emit("glsl", Stage.COMPUTE)
    with pytest.raises(ShaderError, match=r"^\[shading-native\]"):
        sl.compile_shader(Native).emit("other", Stage.COMPUTE)


def test_emission_is_deterministic_and_descriptors_are_memoised():
    first = sl.compile_shader(Everything)
    assert sl.compile_shader(Everything) is first
    from rhi.shading.compile import _compile

    for stage in first.stages:
        assert _compile(Everything)[0].emit("glsl", stage).text == first.emit("glsl", stage).text


def test_only_bindings_that_a_stage_uses_are_declared_in_it():
    program = sl.compile_shader(Colored)
    assert "scale" not in program.emit("glsl", Stage.VERTEX).text
    assert "scale" in program.emit("glsl", Stage.FRAGMENT).text
    assert [d.name for d in sl.stage_trees(Colored)[Stage.FRAGMENT].bindings] == ["scale"]
