"""Every public call of a device with validation is refused on another thread, in the null device: the check
is the front end's own, in front of all backends."""

from __future__ import annotations

import contextlib
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import replace

import calls
import pytest
from null_kit import Camera, hand_made_program

import rhi
from rhi.contract.descriptors import Binding, BindingKind

FREE = {
    "Device.backend_as",
    "Device.close",
    "Device.record",
    "Device.states",
    "Texture.at",
    "Texture.image",
    "Texture.sampled",
    "Mesh.draws",
    "Mesh.view",
    "TransientMesh.view",
    "ColorWrite.at",
    "BlendFunction.at",
}
"""Calls that any thread may make: they read what never changes. So may a command buffer be recorded on
any."""


class Unseen(calls.Doubled):
    """A shader that no test has made a program of."""


FRESH = {
    "Device.program": {"shader": Unseen},
    "Device.sampler": {"descriptor": rhi.SamplerDescriptor(mip=None)},
}
"""Arguments of which the device has made nothing yet; what it has made, any thread may ask for."""
QUERY = "is_finished visible_samples wait destroy"
MORE = [
    f"{kind}.{name}"
    for kind, names in {
        "Device": "finish finish_async memory signal completed timers statistics reset_statistics "
        "make_current release_current",
        **dict.fromkeys(
            ("Buffer", "UniformBuffer", "UniformArray", "StorageBuffer", "Mesh", "Program"), "destroy"
        ),
        "Texture": "generate_mipmaps destroy",
        "OcclusionQuery": f"begin end {QUERY}",
        "QuerySet": QUERY,
    }.items()
    for name in names.split()
]
"""Members without parameters."""
SAFE = {
    "Device": "NAME backend_as backend_name capabilities closed conditional event immediate is_building precision "
    "record render_pass states stream timing transient",
    "Buffer": "bind_uniform core count dtype id label size destroyed lock",
    "UniformBuffer": "buffer kind offset owner size type",
    "UniformArray": "buffer count dtype label lock struct type",
    "StorageBuffer": "buffer count dtype element id lock offset owner size type",
    "Texture": "at compressed core descriptor destroyed format id image kind label layers levels lock owner sampled "
    "requested sampler samples size texture",
    "Mesh": "base_instance base_vertex buffers core count data draws element_count first index_count indices instances "
    "instance_count instance_fields is_indexed cache_vertex_array offset_draws create_vertex_array "
    "prepared_draws "
    "primitive vertex_arrays vertex_count vertices view",
    "Program": "core descriptor destroyed id label name recorded_code uniforms",
    "OcclusionQuery": "core destroyed emulated id ids label",
    "QuerySet": "core destroyed emulated id ids label",
    "TransientMemory": "arguments capacity uniforms",
}
"""Members that any thread may use: they read what never changes, or create a block, view or recording that is
checked when it is used."""


def test_every_public_member_has_a_call() -> None:
    for kind in calls.CLASSES:
        name = kind.__name__
        if name in SAFE:
            members = {member for member in dir(kind) if not member.startswith("_") and not member.isupper()}
            called = {
                call.partition(".")[2] for call in [*calls.SAMPLES, *MORE] if call.startswith(f"{name}.")
            }
            assert members <= called | {*SAFE[name].split(), *calls.INTERNAL.get(name, ())}, members


THREADED = [
    name
    for name in calls.SAMPLES
    if "." in name and name not in FREE and not name.startswith("CommandBuffer.")
]


@pytest.mark.parametrize("name", [*THREADED, *MORE])
def test_a_call_on_another_thread_is_refused(name: str) -> None:
    with (
        rhi.create_device("null", validation=True) as device,
        ThreadPoolExecutor(1) as pool,
        ExitStack() as stack,
    ):
        harness = calls.CallHarness(device)

        def call() -> object:
            if name in calls.SAMPLES:
                right = calls.make_arguments(harness, calls.SAMPLES[name]) | FRESH.get(name, {})
                return calls.run(
                    harness, replace(calls.SAMPLES[name], within=lambda harness, stack: None), right
                )
            kind, _, member = name.partition(".")
            attribute = getattr(getattr(harness, calls.OBJECTS[kind]), member)
            return attribute() if callable(attribute) else attribute

        if "draw" in name or name == "OcclusionQuery.end":
            calls.in_pass(harness, stack)
        if name == "OcclusionQuery.end":
            stack.enter_context(harness.query)
        before = len(device.stream)
        with pytest.raises(rhi.ValidationError, match=r"^\[device-thread\]") as caught:
            pool.submit(call).result()
        assert caught.value.site is not None
        assert caught.value.site.file in (__file__, calls.__file__, contextlib.__file__)
        assert len(device.stream) == before
        stack.close()
        calls.check_drawing(harness)


def test_another_thread_is_refused_before_the_faults_of_its_program() -> None:
    bad = hand_made_program("bad", Binding("self", BindingKind.UNIFORM, 0, False, Camera, 16))
    with rhi.create_device("null", validation=True) as device, ThreadPoolExecutor(1) as pool:
        with pytest.raises(rhi.ValidationError, match=r"^\[device-thread\]"):
            pool.submit(device.program, bad).result()
        with pytest.raises(rhi.ValidationError, match=r"^\[binding-name\]"):
            device.program(bad)
