"""The scene as arrays: objects, transforms, meshes, materials, lights and cameras.

scene = load_scene("city:blocks=12,seed=3")
camera = parse_camera("ground", scene, frame=600).with_aspect(16 / 9)
moved = scene.update(seconds=10.0)
"""

from renderer.light_kinds.directional import DIRECTIONAL as DIRECTIONAL
from renderer.light_kinds.directional import PACKED_DIRECTIONAL as PACKED_DIRECTIONAL
from renderer.light_kinds.point import POINT as POINT
from renderer.light_kinds.point import RELATIVE_POINT as RELATIVE_POINT
from renderer.light_kinds.spot import RELATIVE_SPOT as RELATIVE_SPOT
from renderer.light_kinds.spot import SPOT as SPOT
from renderer.scene.ambient_occlusion import AmbientOcclusion as AmbientOcclusion
from renderer.scene.behaviors import Behaviors as Behaviors
from renderer.scene.behaviors import Entity as Entity
from renderer.scene.behaviors import Message as Message
from renderer.scene.catch_up import CatchUp as CatchUp
from renderer.scene.catch_up import Leap as Leap
from renderer.scene.catch_up import LeapSimulation as LeapSimulation
from renderer.scene.catch_up import Recompute as Recompute
from renderer.scene.catch_up import StepSimulation as StepSimulation
from renderer.scene.catch_up import Stepwise as Stepwise
from renderer.scene.catch_up import TimedSimulation as TimedSimulation
from renderer.scene.clips import Clip as Clip
from renderer.scene.depth_of_field import DepthOfField as DepthOfField
from renderer.scene.environment import Environment as Environment
from renderer.scene.fog_and_bloom import Bloom as Bloom
from renderer.scene.fog_and_bloom import Fog as Fog
from renderer.scene.height_fields import HeightField as HeightField
from renderer.scene.height_fields import make_height_field as make_height_field
from renderer.scene.images import Compression as Compression
from renderer.scene.images import ImageBlocks as ImageBlocks
from renderer.scene.images import ImagePixels as ImagePixels
from renderer.scene.lights import Lights as Lights
from renderer.scene.materials import MATERIAL as MATERIAL
from renderer.scene.materials import TEXTURE as TEXTURE
from renderer.scene.materials import AlphaMode as AlphaMode
from renderer.scene.materials import ShadingModel as ShadingModel
from renderer.scene.materials import TextureMap as TextureMap
from renderer.scene.materials import make_material as make_material
from renderer.scene.meshes import RANGE as RANGE
from renderer.scene.meshes import VERTEX as VERTEX
from renderer.scene.meshes import Meshes as Meshes
from renderer.scene.meshes import MeshGeometry as MeshGeometry
from renderer.scene.meshes import MeshLevel as MeshLevel
from renderer.scene.meshes import list_attributes as list_attributes
from renderer.scene.meshes import make_geometry as make_geometry
from renderer.scene.meshes import vertex_format as vertex_format
from renderer.scene.nodes import Nodes as Nodes
from renderer.scene.objects import ObjectBoxes as ObjectBoxes
from renderer.scene.objects import Objects as Objects
from renderer.scene.omissions import Omission as Omission
from renderer.scene.omissions import Omissions as Omissions
from renderer.scene.paths import FRAME_COUNT as FRAME_COUNT
from renderer.scene.paths import FRAMES_PER_SECOND as FRAMES_PER_SECOND
from renderer.scene.paths import CameraPath as CameraPath
from renderer.scene.paths import PathFrame as PathFrame
from renderer.scene.paths import make_path as make_path
from renderer.scene.rigs import COMFORTABLE_PARALLAX as COMFORTABLE_PARALLAX
from renderer.scene.rigs import HUMAN_EYE_DISTANCE as HUMAN_EYE_DISTANCE
from renderer.scene.rigs import SkewedProjection as SkewedProjection
from renderer.scene.rigs import StereoRig as StereoRig
from renderer.scene.rigs import measure_parallax as measure_parallax
from renderer.scene.scene import ObjectHandle as ObjectHandle
from renderer.scene.scene import Scene as Scene
from renderer.scene.scene_builder import SceneBuilder as SceneBuilder
from renderer.scene.simplification import simplify as simplify
from renderer.scene.simulation import AdvanceResult as AdvanceResult
from renderer.scene.simulation import DeformedObjects as DeformedObjects
from renderer.scene.simulation import DeviceVertexSimulation as DeviceVertexSimulation
from renderer.scene.simulation import FacingSimulation as FacingSimulation
from renderer.scene.simulation import FunctionOfTime as FunctionOfTime
from renderer.scene.simulation import NodeSimulation as NodeSimulation
from renderer.scene.simulation import ObjectSimulation as ObjectSimulation
from renderer.scene.simulation import SceneSimulation as SceneSimulation
from renderer.scene.simulation import Simulator as Simulator
from renderer.scene.simulation import VersionedSimulation as VersionedSimulation
from renderer.scene.simulation import VertexSimulation as VertexSimulation
from renderer.scene.tessellated_meshes import TessellatedMesh as TessellatedMesh
from renderer.scene.tessellated_meshes import tessellate as tessellate
from renderer.scene.tessellated_surfaces import TessellatedSurface as TessellatedSurface
from rhi.errors.exports import list_public as _list_public
from rhi.math import Camera as Camera
from rhi.math import Depth as Depth
from rhi.math import Frustum as Frustum
from rhi.math import FrustumPlane as FrustumPlane
from rhi.math import Orthographic as Orthographic
from rhi.math import Perspective as Perspective
from rhi.math import Projection as Projection
from rhi.math import normal_matrices as normal_matrices
from rhi.math import relative_to as relative_to
from rhi.math import rotation as rotation
from rhi.math import scaling as scaling
from rhi.math import translation as translation

__all__ = _list_public(globals())
