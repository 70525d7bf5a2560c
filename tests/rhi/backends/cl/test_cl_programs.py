"""Compute kernels, their arguments and work-groups; errors of the driver's compiler."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyopencl as cl
import pytest
from cl_kit import FILL, ClKit, describe_program

import rhi
from rhi.backends.cl import cl_programs
from rhi.conformance.operation import test_compute
from rhi.contract.descriptors import Binding, BindingKind, BufferUsage
from rhi.errors import DeviceError, ShaderError
from rhi.errors.call_sites import CallSite

SCALE = """
kernel void scale(constant float *factor, global const float *from, int from_count, global float *to, int to_count) {
    int i = get_global_id(0);
    if (i < min(from_count, to_count)) to[i] = from[i] * factor[0];
}
"""
SCALED = (
    Binding("factor", BindingKind.UNIFORM, 0, False, None, 4),
    Binding("source", BindingKind.STORAGE, 0, False, None, 4),
    Binding("target", BindingKind.STORAGE, 1, True, None, 4),
)
LANES = """
__attribute__((reqd_work_group_size(4, 1, 1)))
kernel void lanes(global uint *words, int count) {
    vstore4((uint4)(get_local_size(0), get_num_groups(1), get_group_id(0), 1), get_global_id(0), words);
}
"""
SUM = """
kernel void sum(global uint *words, int count) {
    local uint partial[64];
    int i = get_local_id(0);
    partial[i] = words[get_global_id(0)];
    for (int step = 32; step > 0; step /= 2) {
        barrier(CLK_LOCAL_MEM_FENCE);
        if (i < step) partial[i] += partial[i + step];
    }
    if (i == 0) words[get_global_id(0)] = partial[0];
}
"""
COUNT = "kernel void tally(global uint *words, int count) { atomic_inc(words); }"


def test_bindings_are_arguments_in_their_order(cl_kit: ClKit) -> None:
    program = cl_kit.program(describe_program(SCALE, SCALED, (8, 1, 1)))
    source, target = cl_kit.buffer(np.arange(16, dtype="f4")), cl_kit.buffer(np.full(16, -1, "f4"))
    factor = cl_kit.buffer(np.float32([2.5]))
    cl_kit.backend.bind_uniform(0, factor, 0, 4)
    cl_kit.backend.bind_storage(0, source, 0, 4 * 16)
    cl_kit.backend.bind_storage(1, target, 0, 4 * 10)  # so many elements, though the buffer is larger
    cl_kit.dispatch(program, 2)
    result = np.frombuffer(cl_kit.backend.read_buffer(target, 0, 64), np.float32)
    np.testing.assert_array_equal(result, np.where(np.arange(16) < 10, np.arange(16) * 2.5, -1))


@pytest.mark.parametrize("usage", BufferUsage)
def test_a_uniform_is_read_where_it_was_bound(cl_kit: ClKit, usage: BufferUsage) -> None:
    grain = cl_kit.backend.capabilities.uniform_alignment
    program = cl_kit.program(describe_program(SCALE, SCALED, (1, 1, 1)))
    factors = np.zeros((3, grain // 4), "f4")
    factors[:, 0] = 1, 10, 100
    constants, target = cl_kit.buffer(factors, usage), cl_kit.buffer(bytes(4))
    cl_kit.backend.bind_storage(0, cl_kit.buffer(np.float32([7])), 0, 4)
    cl_kit.backend.bind_storage(1, target, 0, 4)
    for index, expected in ((2, 700), (0, 7), (1, 70)):
        cl_kit.backend.bind_uniform(0, constants, index * grain, 4)
        cl_kit.dispatch(program)
        assert np.frombuffer(cl_kit.backend.read_buffer(target, 0, 4), "f4") == expected


def test_a_new_buffer_that_replaces_a_destroyed_one_is_bound(cl_kit: ClKit) -> None:
    program = cl_kit.program(describe_program(FILL))
    for _ in range(3):
        buffer = cl_kit.buffer(bytes(8))
        cl_kit.backend.bind_storage(0, buffer, 0, 8)
        cl_kit.dispatch(program, 2)
        assert cl_kit.words(buffer, 2) == [2, 3]
        cl_kit.backend.destroy(buffer)


def test_only_numbers_that_change_are_set_again(cl_kit: ClKit, monkeypatch: pytest.MonkeyPatch) -> None:
    """Setting one takes pyopencl 80 times as long as comparing it."""
    program = cl_kit.program(describe_program(FILL))
    arguments: list[object] = []
    set_arg: Callable[..., None] = cl.Kernel.set_arg
    monkeypatch.setattr(
        cl.Kernel, "set_arg", lambda kernel, *values: (arguments.append(values[1]), set_arg(kernel, *values))
    )
    for count, numbers in ((4, [4]), (4, []), (2, [2]), (2, []), (3, [3])):
        arguments.clear()
        buffer = cl_kit.buffer(bytes(16))
        cl_kit.backend.bind_storage(0, buffer, 0, 4 * count)
        cl_kit.dispatch(program, 4)
        assert [values for values in arguments if not isinstance(values, cl.Buffer)] == numbers
        assert cl_kit.words(buffer, 4) == [*range(count, count + 4)]


def test_the_kernel_says_how_many_work_items_do_a_work_group(cl_kit: ClKit) -> None:
    """16 invocations as 4 work-items: what the shading language writes for 4 lanes."""
    program = cl_kit.program(describe_program(LANES, work_group=(16, 1, 1)))
    words = cl_kit.buffer(bytes(4 * 4 * 4 * 3 * 2))
    cl_kit.backend.bind_storage(0, words, 0, 4 * 4 * 4 * 3 * 2)
    cl_kit.backend.bind_program(program)
    cl_kit.backend.dispatch(3, 2, 1)
    rows = np.array(cl_kit.words(words, 4 * 4 * 3)).reshape(3, 4, 4)
    assert (rows[..., 0] == 4).all()
    assert (rows[..., 1] == 2).all()
    assert (rows[..., 2] == np.arange(3)[:, None]).all()


def test_without_that_each_work_item_is_an_invocation(cl_kit: ClKit) -> None:
    program = cl_kit.program(describe_program(SUM, work_group=(64, 1, 1)))
    words = cl_kit.buffer(np.arange(256, dtype="u4"))
    cl_kit.backend.bind_storage(0, words, 0, 1024)
    cl_kit.dispatch(program, 4)
    sums = np.arange(256).reshape(4, 64).sum(axis=1)
    assert cl_kit.words(words, 256)[::64] == sums.tolist()


@pytest.mark.parametrize(
    ("groups", "count"),
    [
        ((3, 2, 2), 12),
        ((0, 1, 1), 0),
        ((1, 0, 1), 0),
        ((1, 1, 1), 1),
        ((65535, 1, 1), 65535),
        ((65536, 1, 1), 0),  # more than a device has: as in WebGPU, nothing
        ((1, 0xFFFFFFFF, 1), 0),
        ((65535, 65535, 65535), 0),  # where PoCL's number of groups would overflow and end the process
    ],
)
def test_an_indirect_dispatch_reads_its_groups_from_earlier_writes(
    cl_kit: ClKit, groups: tuple[int, int, int], count: int
) -> None:
    text = "kernel void write(global uint *words, int count) { vstore3(vload3(0, words + 5), 0, words + 1); }"
    writer, counter = cl_kit.program(describe_program(text)), cl_kit.program(describe_program(COUNT))
    arguments, words = cl_kit.buffer(np.array([9] * 5 + [*groups], "u4")), cl_kit.buffer(bytes(4))
    cl_kit.backend.bind_storage(0, arguments, 0, 32)
    cl_kit.dispatch(writer)
    cl_kit.backend.bind_program(counter)
    cl_kit.backend.bind_storage(0, words, 0, 4)
    cl_kit.backend.dispatch_indirect(arguments, 4)
    assert cl_kit.words(words, 1) == [count]


def test_a_text_that_the_driver_refuses_names_its_line_and_the_python_line(cl_kit: ClKit) -> None:
    text = "kernel void wrong(global uint *words, int count) {\n    words[0] = 1;\n    words[1] = missing;\n}"
    origins = (("shader.py", 10), ("shader.py", 11), ("shader.py", 12), ("shader.py", 13))
    with pytest.raises(ShaderError, match=r"^\[shader-driver\]") as caught:
        cl_kit.program(describe_program(text, origins=origins))
    error = caught.value
    assert "missing" in error.given
    assert "OpenCL C line 3: words[1] = missing;" in error.given
    assert error.site == CallSite("shader.py", 12)


def test_a_program_that_was_refused_leaves_its_id_free(cl_kit: ClKit) -> None:
    with pytest.raises(ShaderError):
        cl_kit.backend.create_program(1, describe_program("kernel void wrong() { missing; }"))
    cl_kit.backend.create_program(1, describe_program(FILL))
    cl_kit.backend.destroy(1)


@pytest.mark.parametrize("text", ["", FILL + COUNT], ids=["none", "two"])
def test_a_text_has_one_kernel(cl_kit: ClKit, text: str) -> None:
    with pytest.raises(ShaderError, match="one kernel"):
        cl_kit.program(describe_program(text))
    cl_kit.program(describe_program(FILL))


def test_a_dispatch_that_fails_names_the_labels_it_lies_in(cl_kit: ClKit) -> None:
    text = FILL.replace("__kernel", "__attribute__((reqd_work_group_size(8192, 1, 1))) kernel")
    words = cl_kit.buffer(bytes(4))
    cl_kit.backend.bind_storage(0, words, 0, 4)
    cl_kit.backend.push_label("frame")
    cl_kit.backend.push_label("lights")
    with pytest.raises(DeviceError, match=r"device.dispatch in frame / lights"):
        cl_kit.dispatch(cl_kit.program(describe_program(text)))
    cl_kit.backend.pop_label()
    cl_kit.backend.pop_label()
    cl_kit.dispatch(cl_kit.program(describe_program(FILL)))
    assert cl_kit.words(words, 1) == [1]


@pytest.mark.parametrize(("floats", "lanes"), [(32, 16), (16, 16), (8, 8), (4, 4), (2, 1), (1, 1), (0, 1)])
def test_a_work_item_does_as_many_invocations_as_a_register_has_floats(floats: int, lanes: int) -> None:
    device: Any = SimpleNamespace(native_vector_width_float=floats)
    assert cl_programs.count_lanes(device) == lanes


@pytest.mark.parametrize("lanes", [1, 4, 8, 16])
def test_shared_memory_barriers_and_atomics_work_with_any_number_of_lanes(
    monkeypatch: pytest.MonkeyPatch, lanes: int
) -> None:
    asked: list[int] = []

    def count_lanes(_: object) -> int:
        asked.append(lanes)
        return lanes

    monkeypatch.setattr(cl_programs, "count_lanes", count_lanes)
    with rhi.create_device("cl") as device:
        test_compute.test_a_work_group_sees_its_shared_memory_after_a_barrier(device)
        test_compute.test_atomics_work_in_shared_memory(device)
    assert asked == [lanes, lanes]
