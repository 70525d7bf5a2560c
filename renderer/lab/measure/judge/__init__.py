"""An independent judge: what a scene looks like, found by tracing rays through its arrays in float64.

It shares nothing with what it judges but the scene: no shader, no device, no matrix of a lens, no shadow map, no list
of lights, no order of draws. So a fault of the renderer can't be a fault of the truth as well.

- `rays`: which triangles a ray meets, by a tree of boxes.
- `surfaces`: what a ray sees there: normals, texels, materials.
- `light`: what these reflect of the sky, the sun and the lamps, and what of it the air lets through.
- `picture`: rays through pixels, what covers what, tones and sRGB.

What it leaves out: glow, and what moves by itself (it takes the scene as it stands). Textures are read from their
finest level: more rays a pixel take the place of mip levels.
"""

from renderer.lab.measure.judge.picture import Judge

__all__ = ["Judge"]
