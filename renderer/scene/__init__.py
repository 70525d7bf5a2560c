"""The scene as arrays: objects, transforms, meshes, materials, lights and cameras.

scene = load_scene("city:blocks=12,seed=3")
camera = parse_camera("ground", scene, frame=600).with_aspect(16 / 9)
moved = scene.update(seconds=10.0)
"""

from renderer.scene.air import Fog, Glow
from renderer.scene.camera import Camera, Depth, Frustum, FrustumPlane, Orthographic, Perspective, Projection
from renderer.scene.catching_up import CatchUp, Leap, Leaping, Recompute, Stepped, Stepwise, Timed
from renderer.scene.height_fields import HeightField, make_height_field
from renderer.scene.lights import (
    DIRECTIONAL,
    POINT,
    RELATIVE_POINT,
    RELATIVE_SPOT,
    SPOT,
    Lights,
    RelativeLights,
)
from renderer.scene.materials import (
    MATERIAL,
    TEXTURE,
    AlphaMode,
    ImagePixels,
    ShadingModel,
    TextureMap,
    make_material,
)
from renderer.scene.meshes import (
    RANGE,
    VERTEX,
    Meshes,
    MeshGeometry,
    list_attributes,
    make_geometry,
    vertex_format,
)
from renderer.scene.nodes import Nodes
from renderer.scene.objects import Boxes, Objects
from renderer.scene.omissions import Omission, Omissions
from renderer.scene.paths import FRAME_COUNT, FRAMES_PER_SECOND, CameraPath, make_path
from renderer.scene.scene import Scene, SceneBuilder
from renderer.scene.simulation import (
    Advanced,
    Deformed,
    Deforming,
    DeformingOnDevice,
    FunctionOfTime,
    Moving,
    ObjectSimulation,
    Simulated,
    Simulator,
)
from renderer.scene.stereo import COMFORTABLE_SHARE, NATURAL_DISTANCE, Skewed, StereoRig, measure_parallax
from renderer.scene.transforms import normal_matrices, relative_to, rotation, scaling, translation

__all__ = [
    "COMFORTABLE_SHARE",
    "DIRECTIONAL",
    "FRAMES_PER_SECOND",
    "FRAME_COUNT",
    "MATERIAL",
    "NATURAL_DISTANCE",
    "POINT",
    "RANGE",
    "RELATIVE_POINT",
    "RELATIVE_SPOT",
    "SPOT",
    "TEXTURE",
    "VERTEX",
    "Advanced",
    "AlphaMode",
    "Boxes",
    "Camera",
    "CameraPath",
    "CatchUp",
    "Deformed",
    "Deforming",
    "DeformingOnDevice",
    "Depth",
    "Fog",
    "Frustum",
    "FrustumPlane",
    "FunctionOfTime",
    "Glow",
    "HeightField",
    "ImagePixels",
    "Leap",
    "Leaping",
    "Lights",
    "MeshGeometry",
    "Meshes",
    "Moving",
    "Nodes",
    "ObjectSimulation",
    "Objects",
    "Omission",
    "Omissions",
    "Orthographic",
    "Perspective",
    "Projection",
    "Recompute",
    "RelativeLights",
    "Scene",
    "SceneBuilder",
    "ShadingModel",
    "Simulated",
    "Simulator",
    "Skewed",
    "Stepped",
    "Stepwise",
    "StereoRig",
    "TextureMap",
    "Timed",
    "list_attributes",
    "make_geometry",
    "make_height_field",
    "make_material",
    "make_path",
    "measure_parallax",
    "normal_matrices",
    "relative_to",
    "rotation",
    "scaling",
    "translation",
    "vertex_format",
]
