"""The packed geometry buffer: what a pixel's surface is, before its material is evaluated (Deferred+, 1.3.2).

| word of `packed` | bits | what it holds |
|---|---|---|
| 0 | 32 | the normal, octahedral in 2 × 16 bits |
| 1 | 16 + 16 | the row of the material; the rest of the change of texture coordinates in y |
| 2 | 32 | the fractional parts of the texture coordinates |
| 3 | 24 + 8 | the change of texture coordinates in x; the beginning of that in y |

Its format is RGBA32UI, 16 bytes a pixel; a scene without images has the first two words only, RG32UI. The position
follows from the depth and the ray of the pixel. No texel is read when geometry is drawn: a texture is filtered
later, with the derivatives that are stored, so what is hidden costs no texel.

The encodings are those of `renderer.shaders.encodings`.
"""

from __future__ import annotations

from typing import Any, Final

from renderer import rules
from renderer.frame import DEPTH_FORMAT, Effect, Frame, Needs, Pass, Target, TechniquePass
from renderer.shaders.encodings import (
    decode_change,
    decode_normal,
    decode_uv,
    encode_change,
    encode_normal,
    encode_uv,
)
from renderer.shaders.lighting import safe_normalize
from renderer.shaders.structs import Material, SurfacePoint, SurfaceVarying
from renderer.techniques.scene_shader import SceneShader
from rhi import Format, refuse
from rhi.shading import (
    Shader,
    Storage,
    Struct,
    Texture2D,
    Texture2DArray,
    UintTexture2D,
    ddx,
    ddy,
    uint,
    uvec2,
    uvec4,
    vec3,
)

__rhi_internal__ = True

MOST_MATERIALS: Final = 1 << 16
"""The number of materials that the buffer can tell apart."""


class PlainWords(Struct):
    """What `PackedShader` writes."""

    packed: uvec2


class TexturedWords(Struct):
    """What `PackedTextures` writes."""

    packed: uvec4


class PackedShader(SceneShader):
    """Writes the packed geometry buffer of a scene without images."""

    def fragment(self, v: SurfaceVarying) -> PlainWords:
        return PlainWords(packed=uvec2(encode_normal(safe_normalize(v.normal)), uint(v.material)))


class PackedTextures(SceneShader):
    """Writes the packed geometry buffer of a scene with images."""

    def fragment(self, v: SurfaceVarying) -> TexturedWords:
        x = encode_change(ddx(v.uv))
        y = encode_change(ddy(v.uv))
        words = uvec4(
            encode_normal(safe_normalize(v.normal)),
            uint(v.material) | y >> 8 << 16,
            encode_uv(v.uv),
            x | y << 24,
        )
        return TexturedWords(packed=words)


class PackedReader(Shader):
    """The base of shaders that evaluate the materials of the packed geometry buffer."""

    packed: UintTexture2D
    depth: Texture2D
    materials: Storage[Material]

    def find_surface(self, words: uvec4, material: Material, position: vec3) -> SurfacePoint:
        """Return the surface at `position` whose words were loaded."""
        return SurfacePoint(
            position=position,
            normal=decode_normal(words.x),
            to_eye=safe_normalize(-position),
            base_color=material.base_color.rgb * self.texel(material.texture, words),
            specular_color=material.specular_color,
            shininess=material.shininess,
        )

    def texel(self, image: int, words: uvec4) -> vec3:
        return vec3(1.0)


class PackedImages(PackedReader):
    """Adds images, filtered as they would have been when the geometry was drawn."""

    images: Texture2DArray

    def texel(self, image: int, words: uvec4) -> vec3:
        if image < 0:
            return vec3(1.0)
        x = decode_change(words.w & 0xFFFFFF)
        y = decode_change(words.w >> 24 | words.y >> 16 << 8)
        return self.images.sample_grad(vec3(decode_uv(words.z), float(image)), x, y).rgb


def packed_pass(needs: Needs) -> Pass[Frame]:
    """Return the pass that draws the packed geometry buffer: `packed` and `depth`."""
    has_images = Effect.IMAGES in needs.effects
    return Pass(
        "geometry",
        draw_packed,
        "stores the nearest surface of each pixel, without its material",
        writes=(
            Target("packed", Format.RGBA32UI if has_images else Format.RG32UI),
            Target("depth", DEPTH_FORMAT),
        ),
    )


def draw_packed(frame: Frame) -> None:
    """Draw the visible objects to the packed geometry buffer."""
    resources = frame.resources
    count = len(resources.scene.materials)
    if count > MOST_MATERIALS:
        refuse(rules.MANY_MATERIALS, "render", f"{count:,} materials", f"at most {MOST_MATERIALS:,}")
    shader = PackedTextures if Effect.IMAGES in frame.needs.effects else PackedShader
    frame.draw_visible(
        TechniquePass(
            frame.device,
            resources,
            frame.view,
            frame.device.program(shader),
            {
                "view": frame.view.buffer,
                "objects": resources.objects.buffer,
                "places": resources.places.buffer,
            },
            color=frame.targets["packed"],
            depth=frame.targets["depth"],
        )
    )


def bind_packed(frame: Frame) -> dict[str, Any]:
    """Return the bindings of a `PackedReader`, or of `PackedImages` if the frame needs images."""
    resources, targets = frame.resources, frame.targets
    images = {"images": resources.images} if Effect.IMAGES in frame.needs.effects else {}
    return images | {
        "packed": targets["packed"],
        "depth": targets["depth"],
        "materials": resources.materials.buffer,
    }
