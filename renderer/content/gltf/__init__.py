"""glTF 2.0: reading files into a scene under construction, and writing scenes.

add_gltf(builder, "model.glb")
write_gltf(scene, "scene.glb")
"""

from renderer.content.gltf.extras import SceneExtras
from renderer.content.gltf.reader import add_gltf
from renderer.content.gltf.writer import check_model_name, write_gltf

__all__ = ["SceneExtras", "add_gltf", "check_model_name", "write_gltf"]
