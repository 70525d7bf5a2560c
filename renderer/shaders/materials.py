"""Material shaders: they compute the colours and properties of a surface at a point.

`MaterialShader.describe` is the renderer's own: base colour, normals, and what other maps say. A material may
have a shader of its own: a class derived from `MaterialShader` with another `describe`, which may call this
one. A technique combines it with its own shaders, so it is compiled for each technique, and objects are drawn
by it.

Where a technique evaluates materials after geometry (Deferred+), a material's shader runs for pixels, not for
fragments: it has no derivatives but `SurfaceInput.uv_gradients`, and writes nothing.

What a scene may lack is a switch, a constant `has_…`: a stage keeps the branches that are taken, and a
program binds what they read. So a feature that a scene lacks costs nothing.

A texture is read in one of two ways. If all images are in one array, and all are read by texture coordinates
as they are, a texture's row is its layer. Otherwise a table of textures (`TextureUse`) leads to an array, a
layer and the transform of texture coordinates. All fragments of a primitive have one material, and so take
the same branches: there, derivatives of texture coordinates are defined, and a device skips the arrays that
aren't read. llvmpipe doesn't: it samples each array that a texture might be in. So colours are looked for in
the arrays of colours alone (`images`), and data, such as normals, in those of data (`maps`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Final

import rhi.shading as sl
from renderer.scene import AlphaMode
from renderer.shaders.decals import Decal, DecalGrid, step_along_plane
from renderer.shaders.lighting import safe_normalize
from renderer.shaders.lighting_models import check_lighting_model
from renderer.shaders.pixels import ViewRayShader
from renderer.shaders.structs import (
    TABLE_WIDTH,
    Material,
    SurfaceInput,
    SurfaceParameters,
    TextureUse,
    ViewConstants,
)
from rhi.shading.language.function import ShadingFunction

_NO_NORMAL: Final = 5e-5
"""The square of a normal's length, below which it has no direction. No number of 8 bits means 0: a vector of
length 0 is stored as 127 or 128, 1/255 beside it along each axis, and a diagonal would be made of that."""


IN_TABLE: Final = -1
"""The number of arrays where images are in a texture table, since they have more sizes and samplers than a
shader binds arrays."""
_MASK: Final = int(AlphaMode.MASK)
_ROUNDING: Final = 2.0**-16
"""The most that an alpha may be below the cut and still be at it: filtering rounds."""


@sl.function
def color_scale(material: Material) -> float:
    """Return the unit of the colors of surfaces with decals: 1, unless the material's base color is brighter."""
    base = material.base_color.rgb
    return sl.max(sl.max(sl.max(base.r, base.g), base.b), 1.0)


class MaterialShader(ViewRayShader):
    """The base of shaders that describe surfaces, and of materials' own shaders, which override `describe`.

    A shader of a material's own may declare `parameters`, a storage buffer of a struct, in which a material's
    row (`SurfaceInput.material`) has its values. It adds no other binding.

    Attributes:
        parameter_defaults: the parameters that materials needn't give, and their values.
        parameter_textures: the parameters that are textures, and whether these hold colours (`read_color`) or
            data (`read_data`). One that a material lacks is -1.
        has_anisotropy: whether it draws out highlights by `describe_anisotropy`, which needs `reads_tangents`.
        lighting_model: a function that reflects light instead of the renderer's models: of the surface, the light that
            arrives and, if there are `parameters`, those of the material, to the light that the eye receives. It is
            called for each light in reach, on both sides of the surface; a light with a size counts as one at its
            middle. Ambient and emitted light stay the renderer's.
        reads_tangents: whether it reads `SurfaceInput.tangent`, so that meshes need tangents.
    """

    # Highlights end up in 8 bits: a pow as exact as GL's (128 ulp) halves the time of a lit pass on OpenCL.
    precision = sl.Precision.FAST
    lean = True

    parameter_defaults: ClassVar[Mapping[str, object]] = {}
    parameter_textures: ClassVar[Mapping[str, bool]] = {}
    reads_tangents: ClassVar[bool] = False
    has_anisotropy = False
    lighting_model: ClassVar[ShadingFunction[..., Any] | None] = None

    view: sl.Uniform[ViewConstants]
    materials: sl.Storage[Material]
    textures: sl.Storage[TextureUse]
    images: sl.Texture2DArray
    images_1: sl.Texture2DArray
    images_2: sl.Texture2DArray
    images_3: sl.Texture2DArray
    images_4: sl.Texture2DArray
    images_5: sl.Texture2DArray
    images_6: sl.Texture2DArray
    images_7: sl.Texture2DArray
    maps: sl.Texture2DArray
    maps_1: sl.Texture2DArray
    maps_2: sl.Texture2DArray
    maps_3: sl.Texture2DArray
    maps_4: sl.Texture2DArray
    maps_5: sl.Texture2DArray
    maps_6: sl.Texture2DArray
    maps_7: sl.Texture2DArray
    image_table: sl.TextureTable
    map_table: sl.TextureTable
    decals: sl.Storage[Decal]
    decal_cells: sl.UintTexture2D
    decal_grid: sl.Uniform[DecalGrid]
    image_arrays = 1
    map_arrays = 1
    """The number of arrays of data, `IN_TABLE` where they are images of a texture table. 0 if there are none,
    where tangents may be needed all the same."""
    has_table = False
    has_gradients = False
    """Whether textures are sampled with the gradients of texture coordinates of the input
    (`uv_gradients`)."""
    gradient_scale = 1.0
    """The side of what a pixel covers of a texture, in that of what it shows."""
    has_transformed_uvs = False
    """Whether the texture coordinates of the input have been transformed already."""
    has_texture_transforms = False
    """Whether a table may rotate or mirror texture coordinates, and so the tangents of normal maps."""
    is_own = False
    """Whether this is a material's own shader rather than the renderer's."""
    has_color = True
    """Whether the derived shader needs the colour."""
    has_images = False
    has_decals = False
    has_second_uvs = False
    has_vertex_colors = False
    has_masks = False
    has_normal_maps = False
    has_two_channels = False
    """Whether normal maps may have two channels: blue is 0 then, which says that a unit normal has the third."""
    has_roughness_maps = False
    has_occlusion_maps = False
    has_emissive_maps = False
    has_light_maps = False

    @classmethod
    def check(cls) -> None:
        """Refuse a `lighting_model` that isn't one."""
        check_lighting_model(cls)

    def describe(self, at: SurfaceInput) -> SurfaceParameters:
        """Return the surface's properties at a point, by the renderer's own materials."""
        metal = self.sample_metallic_roughness(at)
        return SurfaceParameters(
            color=self.sample_base_color(at),
            normal=self.mapped_normal(at),
            metallic=metal.x,
            roughness=metal.y,
            occlusion=self.sample_occlusion(at),
            emissive=self.sample_emissive(at),
        )

    def describe_anisotropy(self, at: SurfaceInput) -> sl.vec3:
        """Return the direction in which highlights of the metallic-roughness model are drawn out, as long as they are
        anisotropic, from 0 to 1 (glTF's KHR_materials_anisotropy)."""
        return sl.vec3(0.0)

    def evaluate(self, at: SurfaceInput) -> SurfaceParameters:
        """Return the surface's properties at a point. Nothing is drawn where the alpha of a mask is below its
        cut."""
        described = self.describe(at)
        self.discard_below_cutoff(described.color.a, at)
        if self.has_decals and self.has_color:
            return self.apply_decals(at, described)
        return described

    def discard_masked(self, at: SurfaceInput) -> None:
        """Discard the fragment where the alpha of a mask is below its cut."""
        if self.has_masks:
            self.discard_below_cutoff(
                self.describe(at).color.a if self.is_own else self.sample_base_color(at).a, at
            )

    def discard_below_cutoff(self, alpha: float, at: SurfaceInput) -> None:
        """Discard the fragment where this alpha of a material is below its cut."""
        if self.has_masks:
            material = self.materials[at.material]
            if (
                material.alpha_mode == _MASK
                and material.base_color.a * alpha < material.alpha_cutoff - _ROUNDING
            ):
                sl.discard()

    def sample_base_color(self, at: SurfaceInput) -> sl.vec4:
        """Return the factor of the material's base colour, from vertex colours and textures."""
        texel = sl.vec4(1.0)
        if not self.has_color and not self.has_masks:
            return texel
        if self.has_images:
            texture = self.materials[at.material].texture
            if texture >= 0:
                texel = self.read_color(texture, at)
        if self.has_vertex_colors:
            texel = texel * at.color
        return texel

    def mapped_normal(self, at: SurfaceInput) -> sl.vec3:
        """Return the unit normal as maps bend it. Where a texture has no direction, it is as it was."""
        if not self.has_normal_maps or self.map_arrays == 0:
            return at.normal
        material = self.materials[at.material]
        if material.normal_texture < 0:
            return at.normal
        texel = self.read_data(material.normal_texture, at).xyz * 2.0 - 1.0
        if self.has_two_channels and texel.z <= -1.0:
            texel = sl.vec3(texel.xy, sl.sqrt(sl.max(1.0 - sl.dot(texel.xy, texel.xy), 0.0)))
        tangent = safe_normalize(at.tangent.xyz)
        up = sl.cross(at.normal, tangent) * (-1.0 if at.tangent.w < 0.0 else 1.0)
        bent = (tangent * texel.x + up * texel.y) * material.normal_scale + at.normal * texel.z
        if sl.dot(bent, bent) < _NO_NORMAL:
            return at.normal
        return safe_normalize(bent)

    def turn_tangent(self, material: int, normal: sl.vec3, tangent: sl.vec4) -> sl.vec4:
        """Return the tangent along which the coordinates of the material's normal map grow, of any length,
        where those of the mesh grow along `tangent`: a table may have rotated or mirrored them."""
        texture = self.materials[material].normal_texture
        if texture < 0:
            return tangent
        use = self.textures[texture]
        area = use.u.x * use.v.y - use.u.y * use.v.x
        if area == 0.0:
            return tangent
        side = -1.0 if area < 0.0 else 1.0
        # The point moves along u' by the inverse of the transform. The v of images counts down, so the
        # bitangent is where it falls; where u and v are stretched unlike, w is their ratio.
        along = safe_normalize(tangent.xyz)
        up = sl.cross(normal, along) * tangent.w
        return sl.vec4((along * use.v.y + up * use.v.x) * side, tangent.w * side)

    def sample_metallic_roughness(self, at: SurfaceInput) -> sl.vec2:
        """Return the surface's metalness and roughness."""
        material = self.materials[at.material]
        metal = sl.vec2(material.metallic, material.roughness)
        if self.has_roughness_maps and material.metallic_roughness_texture >= 0:
            metal = metal * self.read_data(material.metallic_roughness_texture, at).zy
        return metal

    def sample_occlusion(self, at: SurfaceInput) -> float:
        """Return the share of the ambient light that reaches the surface, from 0 to 1."""
        if not self.has_occlusion_maps:
            return 1.0
        material = self.materials[at.material]
        if material.occlusion_texture < 0:
            return 1.0
        return sl.mix(1.0, self.read_data(material.occlusion_texture, at).x, material.occlusion_strength)

    def sample_emissive(self, at: SurfaceInput) -> sl.vec3:
        """Return the factor of the material's emissive colour, from its texture."""
        if not self.has_emissive_maps:
            return sl.vec3(1.0)
        texture = self.materials[at.material].emissive_texture
        if texture < 0:
            return sl.vec3(1.0)
        return self.read_color(texture, at).rgb

    def sample_light_map(self, at: SurfaceInput) -> sl.vec3:
        """Return the irradiance of the material's light map, negative without one."""
        material = self.materials[at.material]
        if material.light_map_texture < 0:
            return sl.vec3(-1.0)
        return material.light_map_color * self.read_data(material.light_map_texture, at).rgb

    def world_position(self, at: SurfaceInput) -> sl.vec3:
        """Return the position of the point in the world: to 1e-7 of its distance from the world's origin."""
        return at.position + self.view.eye_low + self.view.eye_high

    def apply_decals(self, at: SurfaceInput, described: SurfaceParameters) -> SurfaceParameters:
        """Return a surface whose color is the material's base color with the decals over it, in units of
        `color_scale`."""
        material = self.materials[at.material]
        color = material.base_color.rgb * described.color.rgb
        grid = self.decal_grid
        corner = (grid.high - self.view.eye_high) + (grid.low - self.view.eye_low)
        cell = sl.floor((at.position - corner) * grid.density)
        above = grid.counts - 1.0 - cell
        if sl.min(sl.min(cell.x, cell.y), cell.z) >= 0.0 and sl.min(sl.min(above.x, above.y), above.z) >= 0.0:
            to_eye = self.direction_to_eye(at.position)
            right = step_along_plane(self.rays, at.position, at.normal, to_eye, sl.vec3(1.0, 0.0, 0.0))
            below = step_along_plane(self.rays, at.position, at.normal, to_eye, sl.vec3(0.0, 1.0, 0.0))
            number = int((cell.z * grid.counts.y + cell.y) * grid.counts.x + cell.x)
            for entry in range(self.read_cell(number), self.read_cell(number + 1)):
                color = self.project_decal(self.decals[self.read_cell(entry)], at, color, right, below)
        described.color = sl.vec4(color / color_scale(material), described.color.a)
        return described

    def read_cell(self, entry: int) -> int:
        """Return a number of the table of cells of decals."""
        return int(self.decal_cells.load(sl.ivec2(entry % TABLE_WIDTH, entry // TABLE_WIDTH)).x)

    def project_decal(
        self, decal: Decal, at: SurfaceInput, color: sl.vec3, right: sl.vec3, below: sl.vec3
    ) -> sl.vec3:
        """Return the color of a surface with a decal over it. `right` and `below` lead to the next pixels."""
        center = (decal.high - self.view.eye_high) + (decal.low - self.view.eye_low)
        inside = decal.to_box @ (at.position - center)
        away = sl.abs(inside)
        facing = sl.saturate((sl.dot(at.normal, decal.axis) - decal.outer) * decal.fade)
        if sl.max(sl.max(away.x, away.y), away.z) > 0.5 or facing <= 0.0:
            return color
        step_right = decal.to_box @ right
        step_below = decal.to_box @ below
        texel = self.read_images(
            decal.array,
            sl.vec3(inside.x + 0.5, 0.5 - inside.y, decal.layer),
            sl.vec4(step_right.x, -step_right.y, step_below.x, -step_below.y),
        )
        return sl.mix(color, texel.rgb * decal.color, texel.a * decal.strength * facing)

    def read_color(self, texture: int, at: SurfaceInput) -> sl.vec4:
        """Return the texel of the texture of colours of this row."""
        if self.has_table:
            use = self.textures[texture]
            return self.read_images(
                use.array, self.texture_coordinates(use, at), self.texture_gradients(use, at)
            )
        if self.gradient_scale != 1.0:
            return self.read_images(0, sl.vec3(at.uv, float(texture)), at.uv_gradients)
        if self.has_gradients:
            return self.images.sample_grad(
                sl.vec3(at.uv, float(texture)), at.uv_gradients.xy, at.uv_gradients.zw
            )
        return self.images.sample(sl.vec3(at.uv, float(texture)))

    def read_data(self, texture: int, at: SurfaceInput) -> sl.vec4:
        """Return the texel of the texture of data of this row."""
        if self.has_table:
            use = self.textures[texture]
            return self.read_maps(
                use.array, self.texture_coordinates(use, at), self.texture_gradients(use, at)
            )
        if self.gradient_scale != 1.0:
            return self.read_maps(0, sl.vec3(at.uv, float(texture)), at.uv_gradients)
        if self.has_gradients:
            return self.maps.sample_grad(
                sl.vec3(at.uv, float(texture)), at.uv_gradients.xy, at.uv_gradients.zw
            )
        return self.maps.sample(sl.vec3(at.uv, float(texture)))

    # Texture coordinates by the table are numbers of a buffer, from which a fragment that failed a test may
    # have read zeros (llvmpipe), so its neighbours would derive nonsense. Derivatives are those of the
    # varying, transformed alike.

    def texture_coordinates(self, use: TextureUse, at: SurfaceInput) -> sl.vec3:
        """Return the texture coordinates and the layer at which a texture is read."""
        if self.has_transformed_uvs:
            return sl.vec3(at.uv, use.layer)
        uv = at.uv
        if self.has_second_uvs:
            uv = at.uv if use.uv_set == 0 else at.uv2
        homogeneous = sl.vec3(uv, 1.0)
        return sl.vec3(sl.dot(use.u, homogeneous), sl.dot(use.v, homogeneous), use.layer)

    def texture_gradients(self, use: TextureUse, at: SurfaceInput) -> sl.vec4:
        """Return the changes of a texture's coordinates to the next pixel on the right, and to that below."""
        uv_gradients = at.uv_gradients
        if self.has_transformed_uvs:
            return uv_gradients
        if self.has_second_uvs:
            uv_gradients = at.uv_gradients if use.uv_set == 0 else at.uv2_gradients
        right = sl.vec3(uv_gradients.xy, 0.0)
        below = sl.vec3(uv_gradients.zw, 0.0)
        return sl.vec4(sl.dot(use.u, right), sl.dot(use.v, right), sl.dot(use.u, below), sl.dot(use.v, below))

    def read_images(self, array: int, texture_coordinates: sl.vec3, uv_gradients: sl.vec4) -> sl.vec4:
        """Return a texel of an array of colours, given the changes of texture coordinates."""
        if self.gradient_scale != 1.0:
            uv_gradients = uv_gradients * self.gradient_scale
        if self.image_arrays == IN_TABLE:
            return self.image_table[int(texture_coordinates.z)].sample_grad(
                texture_coordinates.xy, uv_gradients.xy, uv_gradients.zw
            )
        if self.image_arrays > 1 and array == 1:
            return self.images_1.sample_grad(texture_coordinates, uv_gradients.xy, uv_gradients.zw)
        if self.image_arrays > 2 and array == 2:
            return self.images_2.sample_grad(texture_coordinates, uv_gradients.xy, uv_gradients.zw)
        if self.image_arrays > 3 and array == 3:
            return self.images_3.sample_grad(texture_coordinates, uv_gradients.xy, uv_gradients.zw)
        if self.image_arrays > 4 and array == 4:
            return self.images_4.sample_grad(texture_coordinates, uv_gradients.xy, uv_gradients.zw)
        if self.image_arrays > 5 and array == 5:
            return self.images_5.sample_grad(texture_coordinates, uv_gradients.xy, uv_gradients.zw)
        if self.image_arrays > 6 and array == 6:
            return self.images_6.sample_grad(texture_coordinates, uv_gradients.xy, uv_gradients.zw)
        if self.image_arrays > 7 and array == 7:
            return self.images_7.sample_grad(texture_coordinates, uv_gradients.xy, uv_gradients.zw)
        return self.images.sample_grad(texture_coordinates, uv_gradients.xy, uv_gradients.zw)

    def read_maps(self, array: int, texture_coordinates: sl.vec3, uv_gradients: sl.vec4) -> sl.vec4:
        """Return a texel of an array of data, given the changes of texture coordinates."""
        if self.gradient_scale != 1.0:
            uv_gradients = uv_gradients * self.gradient_scale
        if self.map_arrays == IN_TABLE:
            return self.map_table[int(texture_coordinates.z)].sample_grad(
                texture_coordinates.xy, uv_gradients.xy, uv_gradients.zw
            )
        if self.map_arrays > 1 and array == 1:
            return self.maps_1.sample_grad(texture_coordinates, uv_gradients.xy, uv_gradients.zw)
        if self.map_arrays > 2 and array == 2:
            return self.maps_2.sample_grad(texture_coordinates, uv_gradients.xy, uv_gradients.zw)
        if self.map_arrays > 3 and array == 3:
            return self.maps_3.sample_grad(texture_coordinates, uv_gradients.xy, uv_gradients.zw)
        if self.map_arrays > 4 and array == 4:
            return self.maps_4.sample_grad(texture_coordinates, uv_gradients.xy, uv_gradients.zw)
        if self.map_arrays > 5 and array == 5:
            return self.maps_5.sample_grad(texture_coordinates, uv_gradients.xy, uv_gradients.zw)
        if self.map_arrays > 6 and array == 6:
            return self.maps_6.sample_grad(texture_coordinates, uv_gradients.xy, uv_gradients.zw)
        if self.map_arrays > 7 and array == 7:
            return self.maps_7.sample_grad(texture_coordinates, uv_gradients.xy, uv_gradients.zw)
        return self.maps.sample_grad(texture_coordinates, uv_gradients.xy, uv_gradients.zw)
