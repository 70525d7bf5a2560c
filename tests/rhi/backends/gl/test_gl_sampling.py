"""Sampling on llvmpipe: known faults, of which a test fails when they have gone.

One of them is avoided: devices have no anisotropy there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import rhi
from rhi import Format, SamplerDescriptor
from rhi.__main__ import main
from rhi.contract.driver_faults import limit_anisotropy
from rhi.shading import Shader, Texture2D, vec2, vec4, vertex_index


class SampledByGradients(Shader):
    """Samples the middle of a texture, all of which a pixel covers by its gradients."""

    source: Texture2D

    def vertex(self) -> vec4:
        corner = vertex_index()
        return vec4(float(corner % 2) * 4.0 - 1.0, float(corner // 2) * 4.0 - 1.0, 0.5, 1.0)

    def fragment(self) -> vec4:
        return self.source.sample_grad(vec2(0.5, 0.5), vec2(1.0, 0.0), vec2(0.0, 1.0))


def test_llvmpipe_ignores_gradients_where_filtering_is_anisotropic(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RHI_SLOW_ANISOTROPY", "1")
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


@pytest.mark.parametrize("backend", ["gl", "wgpu"])
def test_a_device_has_no_anisotropy_where_it_may_never_end_unless_it_is_asked_for(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], backend: str
) -> None:
    pytest.importorskip({"gl": "moderngl"}.get(backend, backend))
    capabilities = []
    for value in ("1", "0"):
        monkeypatch.setenv("RHI_SLOW_ANISOTROPY", value)
        with rhi.create_device(backend) as device:
            capabilities.append(device.capabilities)
    asked, plain = capabilities
    assert (asked.max_anisotropy, asked.disabled_features) == (16.0, ())
    hangs = "llvmpipe" in plain.device and "Mesa 22.3" in plain.driver
    assert replace(plain, max_anisotropy=16.0, disabled_features=()) == asked
    assert (plain.max_anisotropy, len(plain.disabled_features)) == ((1.0, 1) if hangs else (16.0, 0))
    main([])
    assert (
        capsys.readouterr().out.count("disabled: anisotropy: llvmpipe of Mesa 22.3 may take minutes") >= hangs
    )


def test_the_driver_is_identified_by_name_and_version(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RHI_SLOW_ANISOTROPY", raising=False)
    for device, driver, most in (
        ("llvmpipe (LLVM 15.0.6, 256 bits)", "OpenGL 4.5 (Core Profile) Mesa 22.3.6", 1.0),
        ("llvmpipe (LLVM 15.0.6, 256 bits)", "OpenGL 4.5 (Core Profile) Mesa 22.30.1", 16.0),
        ("llvmpipe (LLVM 14.0.6, 256 bits)", "Vulkan Mesa 22.2.9 (LLVM 14.0.6), wgpu 0.32.0", 16.0),
        ("Mesa Intel(R) UHD Graphics", "OpenGL 4.6 (Core Profile) Mesa 22.3.6", 16.0),
    ):
        assert limit_anisotropy(device, driver, 16.0)[0] == most
        assert limit_anisotropy(device, driver, 1.0) == (1.0, ())  # a driver without it has lost nothing
