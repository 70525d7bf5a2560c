"""Shared parts of the renderer's shaders, in the shading language: structs and the lighting model."""

from renderer.shaders.lighting import ambient_light as ambient_light
from renderer.shaders.lighting import attenuation as attenuation
from renderer.shaders.lighting import directional_incidence as directional_incidence
from renderer.shaders.lighting import hemisphere as hemisphere
from renderer.shaders.lighting import point_incidence as point_incidence
from renderer.shaders.lighting import reflected_light as reflected_light
from renderer.shaders.lighting import safe_normalize as safe_normalize
from renderer.shaders.lighting import spot_incidence as spot_incidence
from renderer.shaders.lighting import tone_map as tone_map
from renderer.shaders.materials import MaterialShader as MaterialShader
from renderer.shaders.structs import DRAW_LISTS as DRAW_LISTS
from renderer.shaders.structs import Ambient as Ambient
from renderer.shaders.structs import DirectionalLight as DirectionalLight
from renderer.shaders.structs import Haze as Haze
from renderer.shaders.structs import Material as Material
from renderer.shaders.structs import MeshPart as MeshPart
from renderer.shaders.structs import Object as Object
from renderer.shaders.structs import ObjectPosition as ObjectPosition
from renderer.shaders.structs import PointLight as PointLight
from renderer.shaders.structs import SpotLight as SpotLight
from renderer.shaders.structs import SurfaceInput as SurfaceInput
from renderer.shaders.structs import SurfaceParameters as SurfaceParameters
from renderer.shaders.structs import SurfacePoint as SurfacePoint
from renderer.shaders.structs import SurfaceVarying as SurfaceVarying
from renderer.shaders.structs import TextureUse as TextureUse
from renderer.shaders.structs import Vertex as Vertex
from renderer.shaders.structs import ViewConstants as ViewConstants
from renderer.shaders.structs import relative_position as relative_position
from rhi.errors.exports import list_public as _list_public

__all__ = _list_public(globals())
