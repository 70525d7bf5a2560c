"""The packed geometry buffer: what a pixel's surface is, before its material is evaluated (Deferred+, 1.3.2).

| word of `packed` | bits | what it holds |
|---|---|---|
| 0 | 32 | the normal, octahedral in 2 × 16 bits; if the scene has normal maps the normal and the tangent |
| 1 | 16 + 16 | the row of the material; the rest of the change of texture coordinates in y |
| 2 | 32 | the fractional parts of the texture coordinates |
| 3 | 24 + 8 | the change of texture coordinates in x; the beginning of that in y |

Its format is RGBA32UI, 16 bytes a pixel; a scene without images has the first two words only, RG32UI. The position
follows from the depth and the ray of the pixel. Texture coordinates are stored as the material's textures are read, a
transform applied. Texels are read when geometry is drawn only where masks cut it: a
texture is filtered later, with the derivatives that are stored, so what is hidden costs no texel.

Materials are evaluated by the parts that draw geometry in other techniques (`surfaces`), given a surface of the buffer
instead of varyings. Only where texture coordinates and their derivatives come from is another matter.

The encodings are those of `renderer.shaders.encodings`.
"""

from __future__ import annotations

from typing import Any, Final

from renderer import rules
from renderer.frame import DEPTH_FORMAT, Effect, Frame, Needs, Pass, Target, TechniquePass
from renderer.shaders.encodings import (
    TangentFrame,
    away_from_zero,
    decode_change,
    decode_frame,
    decode_normal,
    decode_uv,
    encode_change,
    encode_frame,
    encode_normal,
    encode_uv,
)
from renderer.shaders.lighting import safe_normalize
from renderer.shaders.pixels import FullScreen
from renderer.shaders.structs import Material, SurfaceVarying, TextureUse
from renderer.techniques.scene_shader import SceneShader
from renderer.techniques.surfaces import (
    SURFACE_PARTS,
    Aspect,
    MaterialShader,
    TextureShader,
    WithTextureTable,
    bind_surfaces,
    surface_variant,
)
from rhi import Format, refuse
from rhi.shading import (
    Shader,
    Storage,
    Struct,
    Texture2D,
    UintTexture2D,
    ddx,
    ddy,
    dot,
    fragment_coordinate,
    ivec2,
    ivec3,
    max,
    uint,
    uvec2,
    uvec4,
    vec2,
    vec3,
    vec4,
)

__rhi_internal__ = True

MOST_MATERIALS: Final = 1 << 16
"""The number of materials that the buffer can tell apart."""

_UNPACKED: Final = (Effect.VERTEX_COLORS, Effect.SECOND_UVS, Effect.MIXED_COORDINATES)
_EVALUATED: Final = (Aspect.COLOR, Aspect.NORMAL, Aspect.METAL, Aspect.AMBIENT)


class PlainWords(Struct):
    """What `PackedPlain` writes."""

    packed: uvec2


class TexturedWords(Struct):
    """What `PackedTextures` writes."""

    packed: uvec4


class PackedShader(SceneShader):
    """The base of shaders that write the packed geometry buffer."""

    def encode_directions(self, v: SurfaceVarying) -> uint:
        return encode_normal(self.find_normal(v))


class PackedPlain(PackedShader):
    """Writes the packed geometry buffer of a scene without images."""

    def fragment(self, v: SurfaceVarying) -> PlainWords:
        _ = self.find_texel(v)  # which leaves out what isn't drawn
        return PlainWords(packed=uvec2(self.encode_directions(v), uint(v.material)))


class PackedTextures(PackedShader):
    """Writes the packed geometry buffer of a scene with images."""

    def fragment(self, v: SurfaceVarying) -> TexturedWords:
        x = encode_change(self.place(v, vec3(ddx(v.uv), 0.0)))
        y = encode_change(self.place(v, vec3(ddy(v.uv), 0.0)))
        _ = self.find_texel(v)  # which leaves out what isn't drawn
        words = uvec4(
            self.encode_directions(v),
            uint(v.material) | y >> 8 << 16,
            encode_uv(self.place(v, vec3(v.uv, 1.0))),
            x | y << 24,
        )
        return TexturedWords(packed=words)

    def place(self, v: SurfaceVarying, uv: vec3) -> vec2:
        """Return texture coordinates (u, v, 1), or changes of them (u, v, 0), as the material's textures are read."""
        return uv.xy


class PackedFrames(PackedTextures):
    """Writes the packed geometry buffer of a scene with normal maps."""

    def encode_directions(self, v: SurfaceVarying) -> uint:
        # Of a back the bent normal is turned, and so are all vectors that it is made of.
        normal = self.find_normal(v)
        turned = away_from_zero(dot(normal, v.normal))
        tangent = safe_normalize(v.tangent.xyz) * turned
        return encode_frame(TangentFrame(normal=normal, tangent=tangent, side=away_from_zero(v.tangent.w) * turned))


class PlacedTextures(PackedTextures):
    """Writes texture coordinates as textures are read: all of a material have the same transform."""

    materials: Storage[Material]
    textures: Storage[TextureUse]

    def place(self, v: SurfaceVarying, uv: vec3) -> vec2:
        material = self.materials[v.material]
        maps = max(max(material.texture, material.normal_texture), material.metallic_roughness_texture)
        row = max(maps, max(material.occlusion_texture, material.emissive_texture))
        if row < 0:
            return uv.xy
        use = self.textures[row]
        return vec2(dot(use.u, uv), dot(use.v, uv))


class PlacedFrames(PlacedTextures, PackedFrames):
    """Writes both of these."""


# Where `PackedReader` is a base, mypy finds two vertex stages of different types: that of `FullScreen`, which it has,
# and that of `SceneShader`, from which the parts of materials are derived.
class PackedReader(FullScreen, MaterialShader):  # type: ignore[misc]
    """The base of shaders that evaluate the materials of the packed geometry buffer, pixel by pixel."""

    packed: UintTexture2D
    depth: Texture2D

    def read_words(self) -> uvec4:
        """Return what is stored of the pixel."""
        return self.packed.load(ivec2(fragment_coordinate().xy))

    def read_varying(self, position: vec3) -> SurfaceVarying:
        """Return the varyings of the pixel's surface, which is at `position`."""
        words = self.read_words()
        frame = self.decode_directions(words.x)
        return SurfaceVarying(
            clip=vec4(0.0),
            position=position,
            normal=frame.normal,
            uv=decode_uv(words.z),
            uv2=vec2(0.0),
            tangent=vec4(frame.tangent, frame.side),
            color=vec4(1.0),
            material=int(words.y & 65535),
            lights=ivec3(0),
        )

    def decode_directions(self, bits: uint) -> TangentFrame:
        return TangentFrame(normal=decode_normal(bits), tangent=vec3(1.0, 0.0, 0.0), side=1.0)

    def find_change(self) -> vec4:
        """Return the changes of texture coordinates to the next pixel on the right, and to that below."""
        words = self.read_words()
        x = decode_change(words.w & 0xFFFFFF)
        y = decode_change(words.w >> 24 | words.y >> 16 << 8)
        return vec4(x, y)


class StoredFrames(PackedReader):
    """Pixels have tangents."""

    def decode_directions(self, bits: uint) -> TangentFrame:
        return decode_frame(bits)


class StoredTextures(TextureShader, PackedReader):  # type: ignore[misc]  # as `PackedReader`
    """Textures are filtered as they would have been when the geometry was drawn."""

    def read_texture(self, texture: int, v: SurfaceVarying) -> vec4:
        change = self.find_change()
        return self.images.sample_grad(vec3(v.uv, float(texture)), change.xy, change.zw)


class StoredTable(WithTextureTable, PackedReader):  # type: ignore[misc]  # as `PackedReader`
    """Likewise, where textures are found by a table."""

    def read_texture(self, texture: int, v: SurfaceVarying) -> vec4:
        use = self.textures[texture]
        change = self.find_change()
        return self.read_array(use.array, vec3(v.uv, use.layer), change.xy, change.zw)


def can_pack(needs: Needs) -> bool:
    """Return whether all that the scene's materials read is in the buffer: repeated textures, all of a material at the
    same place, and no colours of vertices."""
    return needs.effects.isdisjoint(_UNPACKED)


def _has_textures(needs: Needs) -> bool:
    maps = Effect.IMAGES, Effect.NORMAL_MAPS, Effect.ROUGHNESS_MAPS, Effect.OCCLUSION_MAPS, Effect.EMISSIVE_MAPS
    return not needs.effects.isdisjoint(maps)


def packed_pass(needs: Needs) -> Pass[Frame]:
    """Return the pass that draws the packed geometry buffer: `packed` and `depth`."""
    return Pass(
        "geometry",
        draw_packed,
        "stores the nearest surface of each pixel, without its material",
        writes=(
            Target("packed", Format.RGBA32UI if _has_textures(needs) else Format.RG32UI),
            Target("depth", DEPTH_FORMAT),
        ),
    )


def draw_packed(frame: Frame) -> None:
    """Draw the visible objects to the packed geometry buffer."""
    resources, effects = frame.resources, frame.needs.effects
    count = len(resources.scene.materials)
    if count > MOST_MATERIALS:
        refuse(rules.MANY_MATERIALS, "render", f"{count:,} materials", f"at most {MOST_MATERIALS:,}")
    has_tangents = Effect.NORMAL_MAPS in effects
    aspects = Aspect.COVERAGE, Aspect.SIDE
    parts, bindings = bind_surfaces(frame, aspects, has_materials=False, has_tangents=has_tangents)
    base: type[PackedShader] = PackedPlain
    if Effect.TEXTURE_TRANSFORMS in effects:
        base = PlacedFrames if has_tangents else PlacedTextures
        assert resources.images is not None, "textures are read"
        bindings |= {"textures": resources.images.table, "materials": resources.materials.buffer}
    elif _has_textures(frame.needs):
        base = PackedFrames if has_tangents else PackedTextures
    frame.draw_visible(
        TechniquePass(
            frame.device,
            resources,
            frame.view,
            frame.program(surface_variant(base, parts)),
            bindings,
            color=frame.targets["packed"],
            depth=frame.targets["depth"],
        )
    )


def bind_packed(frame: Frame) -> tuple[tuple[type[Shader], ...], dict[str, Any]]:
    """Return the parts by which a `PackedReader` evaluates the scene's materials, and its bindings."""
    names, bindings = bind_surfaces(frame, _EVALUATED)
    # Which side is seen, and the attributes of vertices, were found when the geometry was drawn.
    maps = [name for name in names if name != "two_sides" and "vertex" not in vars(SURFACE_PARTS[name])]
    parts = [SURFACE_PARTS[name] for name in maps]
    if Effect.NORMAL_MAPS in frame.needs.effects:
        parts.append(StoredFrames)
    if "textures" in maps:
        parts.insert(parts.index(WithTextureTable), StoredTable)
    elif any(issubclass(part, TextureShader) for part in parts):
        parts.append(StoredTextures)
    return tuple(parts), bindings | {"packed": frame.targets["packed"], "depth": frame.targets["depth"]}
