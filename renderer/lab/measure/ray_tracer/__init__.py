"""The reference ray tracer: renders a scene in float64 by tracing rays through its arrays.

It shares nothing with the renderer but the scene: no shader, device, projection matrix, shadow map, light
list or order of draws. So a fault of the renderer can't be a fault of the reference as well.

- `triangle_tree`: the triangles that a ray meets, by a tree of boxes.
- `surfaces`: what a ray sees there: normals, texels, materials.
- `shading`: the light that these reflect of the sky and of lights, and how fog dims it.
- `tracer`: rays through pixels, coverage, tone mapping and sRGB.

It has no bloom, and nothing moves by itself (it takes the scene as it stands). Textures are read from their
finest level: more rays a pixel replace mip levels.
"""

from renderer.lab.measure.ray_tracer.tracer import RayTracer

__all__ = ["RayTracer"]
