"""glTF 2.0: reading files into a scene under construction, and writing scenes.

add_gltf(builder, "model.glb")
"""

from renderer.content.gltf.reader import add_gltf

__rhi_internal__ = True

__all__ = ["add_gltf"]
