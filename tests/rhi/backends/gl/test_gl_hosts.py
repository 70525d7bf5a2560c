"""Devices beside contexts of other code: states stay apart, textures are shared, images show in its
framebuffer."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import moderngl
import numpy as np
import pytest
from screens_kit import Display

import rhi
import rhi.backends.gl.gl_backend
from rhi import BlendFunction, CullMode, Device, DeviceError, Format, Scissor, ValidationError
from rhi.backends.gl import enums
from rhi.backends.gl.entry_points import EntryPoints
from rhi.backends.gl.gl_host import Egl, _describe_version
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle
from rhi.contract.texels import halve
from rhi.shading import Shader, Texture2D, fragment_coordinate, vec2, vec4, vertex_index

EGL: dict[str, Any] = {"backend": "egl", "libgl": "libEGL.so.1", "libegl": "libEGL.so.1"}
SIZE = (8, 6)
READ = {
    "program": 0x8B8D,
    "vertex array": 0x85B5,
    "draw framebuffer": 0x8CA6,
    "read framebuffer": 0x8CAA,
    "depth function": 0x0B74,
    "depth mask": 0x0B72,
    "blend source": 0x80C9,
    "cull face": 0x0B45,
    "front face": 0x0B46,
    "active texture": 0x84E0,
    "array buffer": 0x8894,
    "pack alignment": 0x0D05,
    "unpack alignment": 0x0CF5,
    "provoking vertex": 0x8E4F,
    "clip origin": 0x935C,
    "clip depth": 0x935D,
}
"""States that a program in the same context would change."""
SWITCHES = {
    "blend": 0x0BE2,
    "depth test": 0x0B71,
    "scissor test": 0x0C11,
    "cull": 0x0B44,
    "dither": 0x0BD0,
    "sRGB": 0x8DB9,
    "point size": 0x8642,
    "restart": 0x8D69,
}


class Host:
    """Other code, with a context and a framebuffer of its own."""

    def __init__(self) -> None:
        self.context = moderngl.create_context(330, standalone=True, **EGL)
        self.gl = EntryPoints(self.context.mglo._context.load)
        self.get_current = ctypes.PYFUNCTYPE(ctypes.c_void_p)(
            self.context.mglo._context.load("eglGetCurrentContext")
        )
        self.address = self.get_current()
        self.framebuffer = self.context.simple_framebuffer(SIZE)
        self.framebuffer.use()
        self.framebuffer.clear(0, 0, 1, 1)

    @property
    def is_current(self) -> bool:
        return bool(self.get_current() == self.address)

    def states(self) -> dict[str, int]:
        numbers = {name: self.gl.get_integer(number) for name, number in READ.items()}
        return numbers | {name: self.gl.IsEnabled(number) for name, number in SWITCHES.items()}

    def read_image(self) -> np.ndarray:
        """The framebuffer as a person sees it, the top row first."""
        texels = np.frombuffer(self.framebuffer.read(components=4), np.uint8)
        return texels.reshape(SIZE[1], SIZE[0], 4)[::-1]


@pytest.fixture
def host() -> Iterator[Host]:
    created = Host()
    yield created
    created.context.release()


@pytest.fixture(params=["direct", "recorded", "validated"])
def device(request: pytest.FixtureRequest, host: Host) -> Iterator[Device]:
    recorded, validated = request.param == "recorded", request.param == "validated"
    with rhi.create_device("gl", context="current", record=recorded, validation=validated) as device:
        yield device


def ramp(size: tuple[int, int] = SIZE) -> np.ndarray:
    return np.random.default_rng(1).integers(0, 256, (size[1], size[0], 4), np.uint8)


def draw_all(device: Device, image: rhi.Texture) -> None:
    with (
        device.render_pass(image, clear=(0, 0, 0, 0)),
        device.states(CullMode.NONE, BlendFunction.ADDITIVE, Scissor(1, 1, 5, 3)),
    ):
        device.draw(device.program(Colored), device.mesh(rectangle()))


def test_an_image_appears_in_the_hosts_framebuffer_its_top_row_uppermost(host: Host, device: Device) -> None:
    image = device.texture(ramp(), Format.RGBA8)
    device.present(image)
    np.testing.assert_array_equal(host.read_image(), ramp())


def test_an_image_is_copied_bit_for_bit_into_the_viewport_alone(host: Host, device: Device) -> None:
    image = device.texture(ramp((4, 3)), Format.RGBA8_SRGB)
    device.present()
    host.framebuffer.viewport = 2, 1, 4, 3
    host.context.enable_direct(enums.FRAMEBUFFER_SRGB)
    device.present(image)
    expected = np.full((6, 8, 4), (0, 0, 255, 255), np.uint8)
    expected[2:5, 2:6] = ramp((4, 3))
    np.testing.assert_array_equal(host.read_image(), expected)


def test_the_hosts_states_are_as_they_were(host: Host, device: Device) -> None:
    device.present()
    host.framebuffer.use()
    host.framebuffer.scissor = 2, 2, 3, 3  # doesn't cut the image
    host.context.enable_direct(enums.FRAMEBUFFER_SRGB)
    host.context.enable(moderngl.BLEND | moderngl.CULL_FACE)
    before = host.states()
    assert before["scissor test"]
    assert before["sRGB"]
    image = device.texture(SIZE, Format.RGBA8)
    draw_all(device, image)
    device.present(image)
    assert host.states() == before
    assert host.context.error == "GL_NO_ERROR"
    seen = image.read()
    device.present()
    np.testing.assert_array_equal(host.read_image(), seen)
    assert np.ptp(seen[..., 0]) > 0


def test_the_devices_states_are_not_the_hosts(host: Host, device: Device) -> None:
    image = device.texture(SIZE, Format.RGBA8)
    draw_all(device, image)
    expected = image.read()
    for _ in range(2):
        device.present(image)
        host.context.enable(moderngl.BLEND | moderngl.CULL_FACE | moderngl.DEPTH_TEST)
        host.framebuffer.viewport = 0, 0, 1, 1
        host.framebuffer.color_mask = False, False, False, False
        draw_all(device, image)
        np.testing.assert_array_equal(image.read(), expected)


def test_the_hosts_context_is_current_after_a_frame_and_when_the_device_lets_go(host: Host) -> None:
    device = rhi.create_device("gl", context=host.context)
    for _ in range(2):
        assert host.is_current
        device.buffer(4)
        assert not host.is_current
        device.present()
    assert host.is_current
    device.buffer(4)
    assert not host.is_current
    device.release_current()
    assert host.is_current
    device.make_current()
    assert not host.is_current
    device.close()
    assert host.is_current


@pytest.mark.parametrize("works", [True, False], ids=["created", "refused"])
@pytest.mark.parametrize("current", ["the host's", "a neighbour's", "none"])
def test_creating_a_device_restores_the_context_that_was_current(
    host: Host, monkeypatch: pytest.MonkeyPatch, current: str, works: bool
) -> None:
    neighbour = Host() if current == "a neighbour's" else host
    if current == "none":
        host.context.mglo.__exit__()
    before = Egl().get_current()
    assert (before is None) == (current == "none")
    if not works:
        monkeypatch.setattr(Egl, "create_shared", lambda self, binding: None)
        with pytest.raises(DeviceError, match="device-driver"):
            rhi.create_device("gl", context=host.context)
        assert Egl().get_current() == before
        return
    with rhi.create_device("gl", context=host.context) as device:
        assert Egl().get_current() == before
        device.present(device.texture(ramp(), Format.RGBA8))
        assert host.is_current
        np.testing.assert_array_equal(host.read_image(), ramp())
    if neighbour is not host:
        neighbour.context.release()


def test_a_texture_of_the_host_is_read_and_drawn_to(host: Host, device: Device) -> None:
    device.present()
    source = host.context.texture(SIZE, 4, ramp().tobytes())
    target = host.context.texture(SIZE, 4)
    host.context.finish()
    read, drawn = device.adopt_texture(source, label="source"), device.adopt_texture(target.glo)
    assert (read.size, read.format, read.levels, read.label) == (SIZE, Format.RGBA8, 1, "source")
    np.testing.assert_array_equal(read.read(), ramp())
    read.copy_to(drawn)
    device.present()
    np.testing.assert_array_equal(np.frombuffer(target.read(), np.uint8), ramp().ravel())
    with device.render_pass(drawn, clear=(1, 0, 0, 1)):
        pass
    device.present()
    assert set(np.frombuffer(target.read(), np.uint8)[::4]) == {255}


class Copied(Shader):
    source: Texture2D

    def vertex(self) -> vec4:
        return vec4(float(vertex_index() & 1) * 4.0 - 1.0, float(vertex_index() >> 1) * 4.0 - 1.0, 0.5, 1.0)

    def fragment(self) -> vec4:
        return self.source.sample(fragment_coordinate().xy / vec2(self.source.size()))


def test_a_texture_of_the_host_is_sampled_like_any_other(host: Host, device: Device) -> None:
    """It has one level, and its owner lets shaders read a thousand: OpenGL would sample black."""
    device.present()
    source = host.context.texture(SIZE, 4, ramp().tobytes())
    adopted, image = device.adopt_texture(source), device.texture(SIZE, Format.RGBA8)
    with device.render_pass(image):
        device.draw(device.program(Copied), device.mesh(3), source=adopted)
    np.testing.assert_array_equal(image.read(), ramp())
    adopted.destroy()
    device.finish()
    device.present()
    last = ctypes.c_int()
    host.gl.GetTextureParameteriv(source.glo, enums.TEXTURE_MAX_LEVEL, ctypes.byref(last))
    assert last.value == 1000


def test_a_texture_of_the_host_outlives_the_devices(host: Host) -> None:
    source = host.context.texture(SIZE, 4, ramp().tobytes())
    with rhi.create_device("gl", context="current") as device:
        device.adopt_texture(source).destroy()
        device.adopt_texture(source)
        device.finish()
    np.testing.assert_array_equal(np.frombuffer(source.read(), np.uint8), ramp().ravel())


def test_a_texture_of_the_host_has_its_levels_and_layers(host: Host, device: Device) -> None:
    device.present()
    flat = host.context.texture((8, 4), 1, dtype="f4")
    flat.build_mipmaps()
    layered = host.context.texture_array((4, 4, 3), 2, dtype="f2")
    cube = host.context.texture_cube((4, 4), 4)
    host.context.finish()
    adopted = [device.adopt_texture(texture) for texture in (flat, layered, cube)]
    assert [(texture.format, texture.levels, texture.layers) for texture in adopted] == [
        (Format.R32F, 4, 1),
        (Format.RG16F, 1, 3),
        (Format.RGBA8, 1, 6),
    ]


def test_levels_of_the_hosts_textures_are_generated(host: Host, device: Device) -> None:
    """Their storage isn't immutable, so they have no views."""
    device.present()
    random = np.random.default_rng(2)
    flat = host.context.texture((7, 5), 4, random.integers(0, 256, (5, 7, 4), np.uint8).tobytes())
    layered = host.context.texture_array(
        (3, 5, 2), 1, random.random((2, 5, 3), np.float32).tobytes(), dtype="f4"
    )
    cube = host.context.texture_cube((7, 7), 2, random.integers(0, 256, (6, 7, 7, 2), np.uint8).tobytes())
    for host_texture in (flat, layered, cube):
        host_texture.build_mipmaps()
    host.context.finish()
    for texture in (device.adopt_texture(host_texture) for host_texture in (flat, layered, cube)):
        assert texture.levels > 1
        texture.generate_mipmaps()
        level = texture.read_layers(0)
        for number in range(1, texture.levels):
            level = np.concatenate([halve(texture.format, layer[None], 1) for layer in level])
            np.testing.assert_allclose(texture.read_layers(number), level, rtol=1e-6, atol=1.0)


def test_the_host_reads_a_texture_of_the_device(host: Host, device: Device) -> None:
    image = device.texture(ramp(), Format.RGBA8)
    device.present()
    seen = host.context.external_texture(device.native_texture(image), SIZE, 4, 0, "f1")
    np.testing.assert_array_equal(np.frombuffer(seen.read(), np.uint8), ramp().ravel())


def test_closing_deletes_the_device_s_own_objects_only(host: Host) -> None:
    is_texture = ctypes.PYFUNCTYPE(ctypes.c_ubyte, ctypes.c_uint)(
        host.context.mglo._context.load("glIsTexture")
    )
    is_buffer = ctypes.PYFUNCTYPE(ctypes.c_ubyte, ctypes.c_uint)(
        host.context.mglo._context.load("glIsBuffer")
    )
    theirs = host.context.texture(SIZE, 4)
    with rhi.create_device("gl", context="current") as device:
        image, buffer = device.texture(SIZE, Format.RGBA8), device.buffer(16)
        draw_all(device, image)
        name = device.native_texture(image)
        bound = device.backend_as(rhi.backends.gl.gl_backend.GlBackend)._buffers.objects[buffer.id].glo
        device.present(image)
        assert is_texture(name)
        assert is_buffer(bound)
    assert not is_texture(name)
    assert not is_buffer(bound)
    assert is_texture(theirs.glo)


REFUSED = {
    "no name": (lambda device: device.adopt_texture("image"), "device-argument"),
    "a name of nothing": (lambda device: device.adopt_texture(4711), "device-argument"),
    "no texture": (lambda device: device.native_texture(3), "device-argument"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_names_that_are_not_textures_of_the_host_are_refused(host: Host, device: Device, what: str) -> None:
    call, rule = REFUSED[what]
    with pytest.raises(ValidationError, match=rf"^\[{rule}\]"):
        call(device)
    draw_all(device, device.texture(SIZE, Format.RGBA8))


def test_textures_of_several_samples_are_refused(host: Host, device: Device) -> None:
    device.present()
    several = host.context.texture(SIZE, 4, samples=4)
    with pytest.raises(ValidationError, match="target 0x9100"):
        device.adopt_texture(several)


def test_a_device_that_shares_nothing_refuses_textures_of_others() -> None:
    with rhi.create_device("null") as device:
        for call in (
            lambda: device.adopt_texture(1),
            lambda: device.native_texture(device.texture(SIZE, Format.R8)),
        ):
            with pytest.raises(ValidationError, match=r"^\[device-capability\]"):
                call()


def test_without_a_current_context_nothing_is_adopted(host: Host) -> None:
    host.context.mglo.__exit__()
    with pytest.raises(DeviceError, match="no OpenGL context is current") as refused:
        rhi.create_device("gl", context="current")
    assert refused.value.rule.id == "device-driver"
    with rhi.create_device("gl", context=host.context) as device:  # it is made current
        assert device.texture(ramp(), Format.RGBA8).read().shape == (6, 8, 4)


@pytest.mark.parametrize(("version", "description"), [(b"3.1 (Old)", "3.1 (Old)"), (None, "unknown version")])
def test_the_version_of_a_context_that_shares_nothing_is_reported(
    version: bytes | None, description: str
) -> None:
    text = ctypes.create_string_buffer(version) if version is not None else None
    get = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_uint)(lambda _: ctypes.addressof(text) if text else None)
    api: Any = SimpleNamespace(get_proc_address=lambda _: ctypes.cast(get, ctypes.c_void_p).value)
    assert _describe_version(api) == description


def test_an_object_that_is_not_a_context_is_refused(host: Host) -> None:
    with pytest.raises(ValidationError, match=r"^\[device-argument\]"):
        rhi.create_device("gl", context=7)
    assert host.is_current


UNPRESENTABLE = {
    "depth": {"format": Format.D32F},
    "integers": {"format": Format.RGBA8UI},
    "samples": {"format": Format.RGBA8, "samples": 4},
    "layers": {"format": Format.RGBA8, "kind": rhi.TextureKind.D2_ARRAY, "layers": 2},
}


@pytest.mark.parametrize("what", UNPRESENTABLE)
def test_textures_that_cannot_be_presented_are_refused(host: Host, device: Device, what: str) -> None:
    image = device.texture(SIZE, **UNPRESENTABLE[what])
    with pytest.raises(ValidationError, match=r"^\[texture-format\]"):
        device.present(image)
    device.present(device.texture(ramp(), Format.RGBA8))
    np.testing.assert_array_equal(host.read_image(), ramp())


def test_two_devices_beside_one_host(host: Host) -> None:
    with (
        rhi.create_device("gl", context=host.context) as first,
        rhi.create_device("gl", context=host.context) as second,
    ):
        images = [device.texture(SIZE, Format.RGBA8) for device in (first, second)]
        for device, image in zip((first, second), images, strict=True):
            draw_all(device, image)
        np.testing.assert_array_equal(*(image.read() for image in images))
        seen = second.adopt_texture(first.native_texture(images[0]))
        first.present()
        np.testing.assert_array_equal(seen.read(), images[1].read())


STANDALONE = """
import moderngl, numpy as np, rhi
from rhi.backends.gl.gl_host import Glx
host = moderngl.create_context(standalone=True)
there = Glx().get_current()
with rhi.create_device("gl", context=host) as device:
    assert Glx().get_current() == there, "and after the device was created"
    texels = np.arange(16, dtype=np.uint8).reshape(2, 2, 4)
    texture = device.texture(texels, rhi.Format.RGBA8)
    name = device.native_texture(texture)
    device.present()
    assert Glx().get_current() == there, "the host's context is current after a frame"
    seen = host.external_texture(name, (2, 2), 4, 0, "f1").read()
assert Glx().get_current() == there, "and when the device lets go"
print(sorted(seen) == list(range(16)))
"""


def test_a_context_of_x11_without_a_window_shares_with_a_device(display: Display) -> None:
    # Its configuration is one that no window can have.
    done = subprocess.run(
        [sys.executable, "-c", STANDALONE],
        env=os.environ | display.environment,
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )
    assert (done.stdout, done.returncode) == ("True\n", 0), done.stderr[-2000:]


@pytest.mark.nightly
def test_the_kit_passes_beside_another_context() -> None:
    folders = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-q",
        "-n",
        "0",
        "-p",
        "no:cacheprovider",
        "--pyargs",
        "rhi.conformance",
    ]
    done = subprocess.run(
        [*command, "--rhi-backend", "hosted_backend:create"],
        env=os.environ | {"PYTHONPATH": folders},
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stdout[-3000:]
    assert "hosted_backend:create" in done.stdout
