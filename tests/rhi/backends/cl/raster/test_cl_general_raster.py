"""Kernels that programs share: quick programs call their stages, and stages the functions that sample, by address."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import rhi
from rhi import Device, Format, Precision, Program
from rhi.backends.cl.builds import Builds
from rhi.backends.cl.cl_context import KERNELS_ENVIRONMENT
from rhi.backends.cl.pocl.kernel_cache import Request
from rhi.backends.cl.raster import general_raster
from rhi.contract.descriptors import TextureKind
from rhi.shading import FullScreen, Texture2D, fragment_coordinate, ivec2, vec2, vec4
from rhi.shading.opencl.opencl_textures import (
    TextureFunction,
    call_textures,
    texture_function,
    texture_function_text,
    textures_text,
)
from tests.kits.nightly_reasons import FEWER_CASES

SIZE = (24, 20)


class Red(FullScreen):
    def fragment(self) -> vec4:
        return vec4(fragment_coordinate().x / 24.0, 0.0, 0.0, 1.0)


class Green(FullScreen):
    def fragment(self) -> vec4:
        return vec4(0.0, fragment_coordinate().y / 20.0, 0.0, 1.0)


class Plain(FullScreen):
    texture: Texture2D

    def fragment(self) -> vec4:
        at = fragment_coordinate().xy / vec2(9.0, 11.0)
        return self.texture.sample(at) + self.texture.sample_lod(at, at.x) * 0.5


class Sampled(FullScreen):
    texture: Texture2D

    def fragment(self) -> vec4:
        at = fragment_coordinate().xy / vec2(9.0, 11.0)
        texel = self.texture.load(ivec2(int(at.x * 3.0), int(at.y * 3.0)), 0)
        return self.texture.sample(at) + self.texture.sample_lod(at, at.x) * 0.5 + texel * 0.25


@pytest.fixture
def texels() -> NDArray[np.uint8]:
    texels: NDArray[np.uint8] = np.random.default_rng(1).integers(0, 256, (8, 8, 4), np.uint8)
    return texels


def draw(device: Device, program: Program[...], **bindings: Any) -> NDArray[Any]:
    """Return the image that a program draws, as floats."""
    with device.texture(SIZE, Format.RGBA32F) as image, device.mesh(3) as mesh:
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw(program, mesh, **bindings)
        return image.read()


def draw_sampled(
    device: Device, texels: NDArray[np.uint8], shader: type[FullScreen] = Sampled
) -> NDArray[Any]:
    texture = device.texture(texels, Format.RGBA8_SRGB, levels=None)
    texture.generate_mipmaps()
    return draw(device, device.program(shader), texture=texture)


@pytest.fixture
def sources(monkeypatch: pytest.MonkeyPatch) -> list[Request]:
    """The requests of all kernels that are compiled."""
    monkeypatch.setenv(KERNELS_ENVIRONMENT, "quick")
    requests: list[Request] = []
    compile_kernels = Builds.compile

    def note(self: Builds, request: Request, quick: bool = False) -> Any:
        requests.append(request)
        return compile_kernels(self, request, quick)

    monkeypatch.setattr(Builds, "compile", note)
    monkeypatch.setattr(Builds, "is_cached", lambda *_: False)
    return requests


def list_kernels(requests: Sequence[Request]) -> list[str]:
    return [name for request in requests for name in request.kernels]


def test_two_programs_share_a_raster_kernel_and_build_a_stage_each(sources: list[Request]) -> None:
    with rhi.create_device("cl") as device:
        red, green = (draw(device, device.program(shader)) for shader in (Red, Green))
    assert list_kernels(sources).count("raster") == 1
    assert list_kernels(sources).count("stage") == 2
    np.testing.assert_allclose(
        red[..., 0], np.broadcast_to((np.arange(24) + 0.5) / 24, red.shape[:2]), atol=1e-6
    )
    np.testing.assert_allclose(
        green[..., 1].T, np.broadcast_to((np.arange(20) + 0.5) / 20, (24, 20)), atol=1e-6
    )


@pytest.mark.parametrize("precision", Precision)
def test_stages_that_call_functions_draw_the_bits_of_those_that_contain_them(
    sources: list[Request], monkeypatch: pytest.MonkeyPatch, texels: NDArray[np.uint8], precision: Precision
) -> None:
    with rhi.create_device("cl", precision=precision) as device:
        called = draw_sampled(device, texels)
    assert list_kernels(sources).count("textures") == 1
    monkeypatch.setattr(platform, "machine", lambda: "riscv64")
    del sources[:]
    with rhi.create_device("cl", precision=precision) as device:
        contained = draw_sampled(device, texels)
    assert not {"stage", "textures"}.intersection(list_kernels(sources)), (
        "the control: nothing is called there"
    )
    np.testing.assert_array_equal(called, contained)
    assert np.ptp(called[..., 0]) > 0.1


def test_a_stage_without_an_address_is_built_into_a_kernel_of_its_own(
    sources: list[Request], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(general_raster.GeneralRaster, "load_function", lambda self, request: 0)
    with rhi.create_device("cl") as device:
        draw(device, device.program(Red))
    assert "rhi_fragment" in next(request for request in sources if "raster" in request.kernels).source


def test_the_text_that_calls_keeps_the_numbers_of_its_lines() -> None:
    text = textures_text(16, [TextureKind.D2], Precision.FAST) + "\nint last;"
    called = call_textures(text, texture_function(text))
    assert called.count("\n") == text.count("\n")
    assert called.endswith("\nint last;")
    assert "rhi_bilinear8" in text
    assert "rhi_bilinear8" not in called
    assert texture_function(text) == TextureFunction(Precision.FAST, is_plain=True)
    assert texture_function("int last;") is None


@pytest.mark.parametrize(
    ("kind", "call", "is_plain"),
    [
        (TextureKind.D2, "rhi_sample(", True),
        (TextureKind.D2_ARRAY, "rhi_sample_grad(", True),
        (TextureKind.D2, "rhi_sample_compare(", False),
        (TextureKind.D2, "rhi_sample_compare_grad(", False),
        (TextureKind.D2, "rhi_gather(", False),
        (TextureKind.D2, "rhi_load(", False),
        (TextureKind.D2, "rhi_load_each(", False),
        (TextureKind.D2, "rhi_size_each(", False),
        (TextureKind.D2, "rhi_store(", False),
        (TextureKind.D3, "rhi_sample(", False),
        (TextureKind.CUBE, "rhi_sample(", False),
    ],
)
def test_stages_that_only_sample_2d_textures_need_the_plain_function(
    kind: TextureKind, call: str, is_plain: bool
) -> None:
    text = textures_text(16, [kind], Precision.EXACT) + f"\n{call}t, w);"
    assert texture_function(text) == TextureFunction(Precision.EXACT, is_plain)
    assert f"RHI_PLAIN_SAMPLES {int(is_plain)}" in call_textures(text, texture_function(text))


def test_the_plain_function_has_less_than_the_whole_one() -> None:
    plain, whole = (
        texture_function_text("run", TextureFunction(Precision.EXACT, is_plain)) for is_plain in (True, False)
    )
    assert "RHI_CUBES = 0" in plain
    assert "RHI_CUBES = 1" in whole
    assert "#define RHI_COMPARES 0" in plain
    assert "#define RHI_COMPARES 1" in whole


@pytest.mark.nightly_cases("Precision.FAST", reason=FEWER_CASES)
@pytest.mark.parametrize("precision", Precision)
def test_plain_samples_have_the_bits_of_the_whole_function(
    sources: list[Request], monkeypatch: pytest.MonkeyPatch, texels: NDArray[np.uint8], precision: Precision
) -> None:
    monkeypatch.setattr(Builds, "is_stored", lambda *_: False)
    with rhi.create_device("cl", precision=precision) as device:
        plain = draw_sampled(device, texels, Plain)
    monkeypatch.setattr(Builds, "is_stored", lambda *_: True)
    with rhi.create_device("cl", precision=precision) as device:
        whole = draw_sampled(device, texels, Plain)
    plain_text, whole_text = (request.source for request in sources if "textures" in request.kernels)
    assert "#define RHI_COMPARES 0" in plain_text
    assert "#define RHI_COMPARES 1" in whole_text
    np.testing.assert_array_equal(plain, whole)
    assert np.ptp(plain[..., 0]) > 0.1


def test_a_plain_stage_takes_the_whole_function_once_that_is_loaded(
    sources: list[Request], monkeypatch: pytest.MonkeyPatch, texels: NDArray[np.uint8]
) -> None:
    monkeypatch.setattr(Builds, "is_stored", lambda *_: False)
    with rhi.create_device("cl") as device:
        draw_sampled(device, texels, Sampled)
        draw_sampled(device, texels, Plain)
    assert list_kernels(sources).count("textures") == 1
    assert list_kernels(sources).count("stage") == 2, "the control: both have a stage of their own"
