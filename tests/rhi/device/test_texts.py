"""The texts that `print` and a debugger show of users' objects."""

from __future__ import annotations

import numpy as np
import pytest

import rhi
import rhi.shading as sl
from rhi import CullMode, DepthTest, Device, Format, SamplerDescriptor


class Tint(sl.Struct):
    color: sl.vec4


class Fill(sl.Shader):
    tint: sl.Uniform[Tint]

    def vertex(self) -> sl.vec4:
        return sl.vec4(0.0)

    def fragment(self) -> sl.vec4:
        return self.tint.color


@pytest.fixture
def device() -> Device:
    return rhi.create_device("null")


def test_reprs_of_users_objects_name_their_class_and_contents(device: Device) -> None:
    tint = Tint(color=(1, 0, 0, 1))
    image, program = device.texture((8, 4), Format.RGBA8, label="image"), device.program(Fill)
    array, queries = device.uniform_array(Tint, 3), device.query_set(5)
    query, states = device.occlusion_query(), device.states(CullMode.NONE, DepthTest.OFF)
    expected = {
        device.uniform(tint): "UniformBuffer('Tint', Tint)",
        array[1]: f"UniformRange(Tint, bytes 256 to 272 of buffer {array[1].buffer})",
        device.storage(sl.vec3, np.zeros((5, 3), np.float32)): "StorageBuffer('vec3[]', 5 × vec3)",
        image.image(): "ImageBinding(Texture('image', 8×4, RGBA8), level=0, layer=None)",
        queries: "QuerySet(5, not begun)",
        query: "OcclusionQuery(1, not begun)",
        states: "StateScope(CullMode.NONE, DepthTest.OFF)",
        program: "Program('Fill')",
    }
    assert {repr(thing): text for thing, text in expected.items() if repr(thing) != text} == {}
    sampled = image.sampled(SamplerDescriptor())
    assert repr(sampled) == f"TextureBinding(Texture('image', 8×4, RGBA8), sampler {sampled.sampler})"
    with device.render_pass(image), states:
        assert repr(states) == "StateScope(CullMode.NONE, DepthTest.OFF, open)"
        with query:
            assert repr(query) == "OcclusionQuery(1, open)"
            device.draw(program, device.mesh(3), tint=device.transient.uniform(tint))
        brief = device.transient.storage(Tint, 2)
    assert repr(brief).startswith("StorageRange(2 × Tint, bytes ")
    assert repr(device.transient) == f"TransientMemory({device.transient.capacity} bytes)"
    assert repr(query) == "OcclusionQuery(1, ended)"
