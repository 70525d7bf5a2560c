"""Shared parts of the renderer's shaders, in the shading language: structs and the lighting model."""

from renderer.light_kinds.directional import DirectionalLight as DirectionalLight
from renderer.light_kinds.directional import directional_incidence as directional_incidence
from renderer.light_kinds.incidence import Incidence as Incidence
from renderer.light_kinds.incidence import attenuation as attenuation
from renderer.light_kinds.incidence import safe_normalize as safe_normalize
from renderer.light_kinds.point import PointLight as PointLight
from renderer.light_kinds.point import point_incidence as point_incidence
from renderer.light_kinds.spot import SpotLight as SpotLight
from renderer.light_kinds.spot import spot_incidence as spot_incidence
from renderer.shaders.lighting import ambient_light as ambient_light
from renderer.shaders.lighting import hemisphere as hemisphere
from renderer.shaders.lighting import reflected_light as reflected_light
from renderer.shaders.lighting_models import surface_roughness as surface_roughness
from renderer.shaders.materials import MaterialShader as MaterialShader
from renderer.shaders.structs import DRAW_LISTS as DRAW_LISTS
from renderer.shaders.structs import Ambient as Ambient
from renderer.shaders.structs import Haze as Haze
from renderer.shaders.structs import ListEntry as ListEntry
from renderer.shaders.structs import Material as Material
from renderer.shaders.structs import Meshlet as Meshlet
from renderer.shaders.structs import MeshPart as MeshPart
from renderer.shaders.structs import Object as Object
from renderer.shaders.structs import ObjectPosition as ObjectPosition
from renderer.shaders.structs import SurfaceInput as SurfaceInput
from renderer.shaders.structs import SurfaceParameters as SurfaceParameters
from renderer.shaders.structs import SurfacePoint as SurfacePoint
from renderer.shaders.structs import SurfaceVarying as SurfaceVarying
from renderer.shaders.structs import TextureUse as TextureUse
from renderer.shaders.structs import Vertex as Vertex
from renderer.shaders.structs import ViewConstants as ViewConstants
from renderer.shaders.structs import relative_position as relative_position
from renderer.shaders.tone_mapping import tone_map as tone_map
from rhi.errors.exports import list_public as _list_public

__all__ = _list_public(globals())
