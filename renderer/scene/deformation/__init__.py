"""Skins and morph targets: meshes whose vertices follow joints and weights, computed where they are drawn.

- `deformable_mesh`: such a mesh as data, and its vertices by NumPy in float64: the reference, and the way of
  devices without compute shaders.
- `deformation_kernels`, `deformation_buffers`: the same in float32, as one dispatch for all members that are
  due. The vertices lie where they are drawn from, so all passes and views of a frame share them.

Who animates weights and joints is nobody's business here: glTF files do (`renderer.content.gltf`).
"""

from renderer.scene.deformation.deformable_mesh import DeformableMesh
from renderer.scene.deformation.deformation_buffers import DeformationBuffers, Pose

__all__ = ["DeformableMesh", "DeformationBuffers", "Pose"]
