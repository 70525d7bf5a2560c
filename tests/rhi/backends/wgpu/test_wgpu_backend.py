"""The wgpu backend: what is missing is named, errors of wgpu are errors by name, and passes have few
segments."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nightly_reasons import CHEAPER_TEST

import rhi
from rhi import Device, DeviceError, Format, Primitive, ShaderError
from rhi.backends.null.null_capabilities import PROFILES
from rhi.backends.wgpu import wgpu_backend as wgpu_backend
from rhi.conformance.shaders import Colored, Tint, Tinted
from rhi.conformance.shapes import rectangle
from rhi.conformance.single_draws import draw_once
from rhi.shading import Shader, StorageRW, global_id, native

SIZE = (8, 8)


def inside(device: Device) -> Any:
    """Return the backend of a device."""
    return device.backend_as(wgpu_backend.WgpuBackend)


# -- what is missing ---------------------------------------------------------------------------------------


def test_a_missing_package_is_named_with_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "wgpu.backends.wgpu_native", None)
    with pytest.raises(DeviceError, match=r"^\[device-driver\]") as caught:
        rhi.create_device("wgpu")
    assert caught.value.tip == 'pip install "rhi[wgpu]"'


def test_another_version_of_wgpu_is_refused(usable: None, monkeypatch: pytest.MonkeyPatch) -> None:
    import wgpu

    monkeypatch.setattr(wgpu, "__version__", "0.33.1")
    with pytest.raises(DeviceError) as caught:
        rhi.create_device("wgpu")
    assert (caught.value.given, caught.value.allowed) == ("wgpu 0.33.1", "wgpu 0.32")


def test_an_adapter_that_does_not_exist_is_refused_with_those_that_do(
    usable: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RHI_WGPU_ADAPTER", "no such adapter")
    with pytest.raises(DeviceError, match=r"^\[device-driver\]") as caught:
        rhi.create_device("wgpu")
    assert "'no such adapter'" in caught.value.given
    assert "mesa-vulkan-drivers" in caught.value.tip


# -- devices -----------------------------------------------------------------------------------------------


def test_the_core_profile_equals_the_null_device_s_profile_of_webgpu(
    usable: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RHI_WGPU_PROFILE", "core")
    monkeypatch.setenv("RHI_SLOW_ANISOTROPY", "1")
    expected = PROFILES["webgpu"]
    own_fields = {"backend", "device", "driver", "shading", "rejected_devices", "disabled_features"}
    with rhi.create_device("wgpu") as device:
        names = {field.name for field in fields(expected)} - own_fields
        assert {name: getattr(device.capabilities, name) for name in names} == {
            n: getattr(expected, n) for n in names
        }
        assert (draw_once(device, SIZE, Format.R8, rectangle()) == 255).all()


_PARSES = """
import cffi.cparser
parsed = []
parse = cffi.cparser.Parser.parse_type
cffi.cparser.Parser.parse_type = lambda self, text: parsed.append(text) or parse(self, text)
import rhi
device = rhi.create_device("wgpu")
texture = device.texture((4, 4), rhi.Format.RGBA8)
with device.render_pass(texture, clear=(1, 0, 0, 0)):
    pass
texture.read()
print(len(parsed))
"""


def test_a_first_frame_parses_few_c_types(usable: None) -> None:
    """Each takes as long as reading the names of all: fifty of them took most of the start."""
    done = subprocess.run(
        [sys.executable, "-c", _PARSES], capture_output=True, text=True, check=True, encoding="utf-8"
    )
    assert 0 < int(done.stdout) <= 5


# -- errors ------------------------------------------------------------------------------------------------


class Broken(Shader):
    out: StorageRW[float]

    @native(
        "wgsl",
        """
    let i = 1u;
    out[i] = sqrt(true);
        """,
    )
    def compute(self) -> None:
        self.out[0] = 1.0


def test_an_error_of_naga_names_the_python_line(device: Device) -> None:
    with pytest.raises(ShaderError, match=r"^\[shader-driver\]") as caught:
        device.program(Broken)
    assert "WGSL line 5: out[i] = sqrt(true);" in caught.value.given
    assert caught.value.site is not None
    line = Path(__file__).read_text(encoding="utf-8").splitlines()[caught.value.site.line - 1]
    assert "sqrt(true)" in line


def test_commands_that_wgpu_refuses_are_an_error_and_those_after_them_run(device: Device) -> None:
    backend = inside(device)
    with device.buffer(np.zeros(64, np.float32)) as values:
        same = backend._buffers[values.id].object
        backend._stream.outside().copy_buffer_to_buffer(same, 0, same, 4, 8)
        with pytest.raises(DeviceError, match=r"^\[device-driver\]"):
            values.read()
        values.write(np.arange(64, dtype=np.float32))
        assert values.read().tolist() == list(range(64))


_LOST = """
import numpy as np
import rhi
from rhi.backends.wgpu.wgpu_backend import WgpuBackend
device = rhi.create_device("wgpu")
buffer = device.buffer(64, np.dtype("u1"))
device.backend_as(WgpuBackend).device.destroy()
calls = [buffer.read, lambda: buffer.write(np.zeros(64, "u1")), lambda: device.texture((4, 4), rhi.Format.RGBA8),
         lambda: device.buffer(64, np.dtype("u1")), device.finish]
for call in calls:
    try:
        call()
    except rhi.DeviceError as error:
        print(error.rule.id)
{close}
"""


@pytest.mark.nightly_cases("left open", reason=CHEAPER_TEST)
@pytest.mark.parametrize("close", ["device.close()", ""], ids=["closed", "left open"])
def test_a_lost_device_is_an_error_of_each_call_and_never_ends_the_process(usable: None, close: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _LOST.format(close=close)],
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["device-lost"] * 5


def test_memory_that_cannot_be_had_is_an_error_and_the_device_lives_on(device: Device) -> None:
    with pytest.raises(DeviceError, match=r"^\[device-out-of-memory\]"):
        device.buffer(1 << 39, np.dtype("u1"))
    with device.storage(float, np.ones(64, np.float32)) as values:
        device.dispatch(device.program(Doubles), (64, 1, 1), values=values)
        assert values.read().tolist() == [3.0] * 64


# -- segments, groups and pipelines ------------------------------------------------------------------------


def test_a_pass_is_one_segment_whatever_its_draws_and_a_write_ends_it(device: Device) -> None:
    stream = inside(device)._stream
    program = device.program(Colored)
    with device.texture(SIZE, Format.RGBA8) as image, device.mesh(rectangle()) as mesh:
        other = device.mesh(rectangle())
        before = stream.segments
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            for drawn in (mesh, other, mesh):
                device.draw(program, drawn)
        assert stream.segments - before == 1
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw(program, mesh)
            mesh.vertices.write(rectangle())  # type: ignore[union-attr]
            device.draw(program, mesh)
        assert stream.segments - before == 3
        assert (image.read() == 255).all()
        other.destroy()


def test_draws_with_the_same_states_share_a_pipeline(device: Device) -> None:
    program = device.program(Colored)
    with device.texture(SIZE, Format.RGBA8) as image, device.mesh(rectangle()) as mesh:
        for _ in range(2):
            for cull in rhi.CullMode:
                with device.render_pass(image, clear=(0, 0, 0, 0)), device.states(cull):
                    device.draw(program, mesh)
        assert len(inside(device)._programs[program.id].pipelines) == len(rhi.CullMode)


class Doubles(Shader):
    values: StorageRW[float]
    work_group = (64,)

    def compute(self) -> None:
        i = int(global_id().x)
        self.values[i] = self.values[i] * 2.0 + 1.0


def test_dispatches_in_a_row_share_a_pass_and_see_each_others_writes(device: Device) -> None:
    program = device.program(Doubles)
    with device.storage(float, np.zeros(64, np.float32)) as values:
        for _ in range(5):
            device.dispatch(program, (64, 1, 1), values=values)
        assert values.read().tolist() == [31.0] * 64


@pytest.mark.parametrize("count", [3, 5, 2000])
def test_fans_and_quads_without_indices_share_their_index_buffers(device: Device, count: int) -> None:
    draws = inside(device)._draws
    program = device.program(Colored)
    rows = np.resize(rectangle(), 4 * count)
    with device.texture(SIZE, Format.RGBA8) as image:
        for primitive in (Primitive.TRIANGLE_FAN, Primitive.QUADS):
            with device.mesh(rows, primitive=primitive) as mesh:
                with device.render_pass(image, clear=(0, 0, 0, 0)):
                    device.draw(program, mesh)
                    device.draw(program, mesh)
        assert {
            kind: size >= 6 * count for kind, (size, _) in draws._shared_indices.items()
        } == dict.fromkeys((Primitive.TRIANGLE_FAN, Primitive.QUADS), True)


# -- uniforms ----------------------------------------------------------------------------------------------


def test_frames_that_write_the_same_memory_have_their_own_values(usable: None) -> None:
    """Each begins at the first byte, although the GPU has finished none of them: the queue orders the writes."""
    with rhi.create_device("wgpu", frames_in_flight=8) as device:
        program, mesh = device.program(Tinted), device.mesh(rectangle())
        images = [device.texture(SIZE, Format.RGBA8) for _ in range(6)]
        offsets = []
        for number, image in enumerate(images):
            with device.render_pass(image, clear=(0, 0, 0, 0)):
                for red in (0.0, number / 255):
                    device.draw(program, mesh, tint=Tint(color=(red, 0, 0, 1)))
            offsets.append(dict(inside(device)._bindings.offsets))
            device.present()
        assert [int(image.read()[4, 4, 0]) for image in images] == list(range(6))
    assert offsets == offsets[:1] * 6


def test_a_value_that_a_shader_has_written_over_is_written_again(usable: None) -> None:
    """A buffer that the device writes has no copy on the CPU, so its writes take the other path."""
    with rhi.create_device("wgpu") as device:
        program, mesh = device.program(Tinted), device.mesh(rectangle())
        image = device.texture(SIZE, Format.RGBA8)
        backend = inside(device)
        for red in (1.0, 0.4):
            with device.render_pass(image, clear=(0, 0, 0, 0)):
                device.draw(program, mesh, tint=Tint(color=(red, 0, 0, 1)))
            buffer = backend._bindings.uniforms[min(backend._bindings.uniforms)][0]
            device.present()
            backend.clear_buffer(buffer, 0, 256, 0xFFFFFFFF)
        assert backend._buffers[buffer].shadow is None or backend._buffers[buffer].device_wrote
        with device.render_pass(image, clear=(0, 0, 0, 0)):
            device.draw(program, mesh, tint=Tint(color=(0.2, 0, 0, 1)))
        assert image.read()[4, 4].tolist() == [51, 0, 0, 255]
