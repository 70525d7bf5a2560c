"""Contexts: a missing library is named, and several contexts can coexist."""

from __future__ import annotations

import inspect
import subprocess
import sys

import numpy as np
import pytest
from gl_kit import FULL, GlKit, describe_program

from rhi.backends.gl import create_backend
from rhi.backends.gl.gl_backend import GlBackend
from rhi.conformance.port_steps import METHODS
from rhi.contract.backend import Backend
from rhi.contract.descriptors import BufferDescriptor, Region, TextureDescriptor
from rhi.contract.formats import Format
from rhi.contract.states import CullMode
from rhi.errors import DeviceError


def test_the_package_imports_no_driver_before_a_backend_is_made() -> None:
    code = "import sys, rhi.backends.gl as gl; assert 'moderngl' not in sys.modules; "
    code += "gl.create_backend().close(); "
    code += "assert 'moderngl' in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_missing_library_is_an_error_that_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GLCONTEXT_LINUX_LIBEGL", "libmissing.so")
    with pytest.raises(DeviceError, match="libegl1 libegl-mesa0 libgl1-mesa-dri") as caught:
        create_backend()
    assert caught.value.rule.id == "device-driver"
    assert "libmissing.so" in caught.value.given
    assert "\n" not in caught.value.given + caught.value.tip


def test_a_missing_moderngl_is_an_error_that_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "moderngl", None)
    with pytest.raises(DeviceError, match="pip install moderngl") as caught:
        create_backend()
    assert caught.value.rule.id == "device-driver"


def test_two_backends_draw_alternately(gl_kit: GlKit) -> None:
    other = GlKit(create_backend())
    kits = (gl_kit, other)
    programs = [kit.program(describe_program()) for kit in kits]
    shapes = [kit.shape(program, FULL) for kit, program in zip(kits, programs, strict=True)]
    images = [kit.texture() for kit in kits]
    for kit, image in zip(kits, images, strict=True):
        kit.begin(image)
    for kit, program in zip(kits, programs, strict=True):
        kit.set(CullMode.NONE)
        kit.backend.bind_program(program)
    for kit, shape in zip(kits, shapes, strict=True):
        kit.draw(shape)
    for kit, image in zip(kits, images, strict=True):
        assert (kit.read(image)[..., 0] == 255).all()
    other.backend.close()
    gl_kit.draw(shapes[0])
    assert (gl_kit.read(images[0])[..., 0] == 255).all()


def test_copies_between_buffers_and_textures_go_to_the_backends_own_context(gl_kit: GlKit) -> None:
    backend, other = gl_kit.backend, create_backend()
    texels = np.arange(4 * 4 * 4, dtype=np.uint8)
    whole = Region(0, 0, 4, 4)
    for source in (
        backend,
        other,
    ):  # the ids are those of both, and what one does in the other's context is seen
        source.create_buffer(901, BufferDescriptor(64))
        source.create_texture(902, TextureDescriptor((4, 4), Format.RGBA8))
    backend.write_buffer(901, 0, texels.tobytes())
    other.write_buffer(901, 0, bytes(64))
    backend.copy_buffer_to_texture(901, 0, 16, 902, 0, whole)
    assert (backend.read_texture(902, 0, whole, False).reshape(-1) == texels).all()
    backend.write_buffer(901, 0, bytes(64))
    other.write_buffer(901, 0, bytes(64))
    backend.copy_texture_to_buffer(902, 0, whole, 901, 0, 16)
    assert backend.read_buffer(901, 0, 64) == texels.tobytes()
    other.close()


class TakenBackError(Exception):
    """The thread was taken back."""


@pytest.mark.parametrize("method", sorted(METHODS - {"capabilities", "close"}))
def test_each_method_first_takes_the_thread_back_from_another_backend(
    gl_kit: GlKit, monkeypatch: pytest.MonkeyPatch, method: str
) -> None:
    def take_back(backend: GlBackend) -> None:
        raise TakenBackError

    nothing = {"BytesLike": b"", "Sequence[StateChange]": ()}
    parameters = list(inspect.signature(getattr(Backend, method)).parameters.values())[1:]
    other = create_backend()
    with monkeypatch.context() as patch:
        patch.setattr(GlBackend, "_activate", take_back)
        with pytest.raises(TakenBackError):
            getattr(gl_kit.backend, method)(
                *[nothing.get(str(parameter.annotation)) for parameter in parameters]
            )
    other.close()


def test_the_capabilities_are_the_contexts_own(gl_kit: GlKit) -> None:
    capabilities, gl = gl_kit.backend.capabilities, gl_kit.backend.gl
    assert capabilities.backend == "gl"
    assert capabilities.max_texture_size == gl.get_integer(0x0D33)
    assert capabilities.max_work_group[2] == gl.get_integer(0x91BF, 2)
    assert capabilities.uniform_alignment == gl.get_integer(0x8A34)
    assert np.log2(capabilities.uniform_alignment) % 1 == 0


DROP = """
import gc, warnings
import psutil, rhi

warnings.simplefilter("ignore")
live = rhi.create_device("gl")
image = live.texture((4, 4), rhi.Format.RGBA8)

def clear(device, image, red):
    with device.render_pass(image, clear=(red, 0, 0, 1)):
        pass
    assert image.read()[0, 0].tolist() == [round(255 * red), 0, 0, 255]

def drop(count):
    for number in range(count):
        device = rhi.create_device("gl")
        clear(device, device.texture((64, 64), rhi.Format.RGBA8), 1)
        if number % 2:
            del device
            gc.collect()
        clear(live, image, number / count)
    gc.collect()
    rhi.create_device("gl").close()
    return psutil.Process().memory_info().rss

drop(10)
begun = drop(10)
print((drop(40) - begun) / 40)
live.close()
"""


def test_contexts_of_devices_that_were_dropped_are_released_with_the_next_device() -> None:
    """2.4 MiB each stayed; and a device that lives beside them goes on."""
    done = subprocess.run(
        [sys.executable, "-c", DROP],
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
        encoding="utf-8",
    )
    assert float(done.stdout) < 1 << 20
