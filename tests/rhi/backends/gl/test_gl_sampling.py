"""What llvmpipe does otherwise when it samples: known faults, of which a test fails when they have gone."""

from __future__ import annotations

import numpy as np

import rhi
from rhi import Format, SamplerDescriptor
from rhi.shading import Shader, Texture2D, vec2, vec4, vertex_index


class SampledByGradients(Shader):
    """Samples the middle of a texture, all of which a pixel covers by its gradients."""

    source: Texture2D

    def vertex(self) -> vec4:
        corner = vertex_index()
        return vec4(float(corner % 2) * 4.0 - 1.0, float(corner // 2) * 4.0 - 1.0, 0.5, 1.0)

    def fragment(self) -> vec4:
        return self.source.sample_grad(vec2(0.5, 0.5), vec2(1.0, 0.0), vec2(0.0, 1.0))


def test_llvmpipe_ignores_gradients_where_filtering_is_anisotropic() -> None:
    read = []
    with rhi.create_device("gl") as gl:
        is_faulty = "llvmpipe" in gl.capabilities.device
        source, image = gl.texture((8, 8), Format.R32F, levels=None), gl.texture((4, 4), Format.RGBA32F)
        for level in range(4):
            source.write(np.full((8 >> level, 8 >> level), float(level), "f4"), level=level)
        triangle = gl.mesh(3)
        for anisotropy in (1.0, gl.capabilities.max_anisotropy):
            sampled = source.sampled(SamplerDescriptor(max_anisotropy=anisotropy))
            with gl.render_pass(image), gl.states(rhi.CullMode.NONE):
                gl.draw(gl.program(SampledByGradients), triangle, source=sampled)
            read.append(float(image.read()[1, 1, 0]))
    assert read[0] == 3.0  # one texel for the whole texture
    assert read[1] == (0.0 if is_faulty else 3.0)  # coordinates don't change from pixel to pixel
