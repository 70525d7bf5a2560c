"""The output merger in isolation: a kernel that merges given fragments.

The kernel is the general one, which reads formats and states as data; `special=True` takes that of the key
alone.

Images consist of whole blocks. Fragments are (samples, height, width) arrays: outputs as 32-bit words, depth,
coverage.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from rhi.backends.cl.cl_context import QUICK, open_context
from rhi.backends.cl.memory.planes import allocate, buffer_address
from rhi.backends.cl.raster.kernel_text import read_kernels
from rhi.backends.cl.raster.merger import MergerKey, general_defines, make_key, make_state
from rhi.contract.descriptors import FragmentOutput, ProgramDescriptor, Stage, StageText
from rhi.contract.formats import ChannelKind, Format
from rhi.contract.states import (
    DEFAULTS,
    MAX_TARGETS,
    PER_TARGET,
    State,
)

_KERNEL = """
kernel void merge(global const uint *state, global const uint16 *fragments, int front, int columns,
                  global const Merger *merger, global const ulong *surfaces) {
    Targets opened, *targets = &opened;
    open_targets(merger, surfaces, (global const ulong *)(merger + 1), targets);
    int block = get_global_id(0), x = block % columns * 4, y = block / columns * 4;
    for (int sample = 0; sample < SAMPLES; ++sample) {
        global const uint16 *fragment = fragments + (block * SAMPLES + sample) * (OUTPUT_WORDS + 2);
        uint16 outputs[OUTPUT_WORDS];
        for (int word = 0; word < OUTPUT_WORDS; ++word) outputs[word] = fragment[word];
        int16 mask = as_int16(fragment[OUTPUT_WORDS]);
        mask = cover_by_alpha(targets, test_alpha(targets, state, mask, outputs), outputs, sample);
        float16 z = as_float16(fragment[OUTPUT_WORDS + 1]);
        if (TEST_ORDER == TEST_SPLIT) mask = test_depth_stencil(targets, state, x, y, sample, front, mask, z);
        mask = merge_depth_stencil(targets, state, x, y, sample, front, mask, z);
        merge_colors(targets, state, x, y, sample, mask, outputs);
    }
}
"""
_context = cache(open_context)


@cache
def _build(defines: str) -> cl.Kernel:
    source = (
        "#define AT(type, address) ((global type *)(address))\n" + defines + read_kernels("merger") + _KERNEL
    )
    return _context().compile(source, QUICK).find("merge")


@dataclass
class Planes:
    """Contents of targets: (samples, height, width, channels) each; depth and stencil (samples, height,
    width)."""

    colors: list[NDArray[Any]]
    depth: NDArray[np.float32] | None = None
    stencil: NDArray[np.uint8] | None = None

    def copy(self) -> Planes:
        return Planes(
            [color.copy() for color in self.colors],
            None if self.depth is None else self.depth.copy(),
            None if self.stencil is None else self.stencil.copy(),
        )


def state_values(*states: State) -> dict[type, Any]:
    """Return all states: the defaults, replaced by these."""
    values: dict[type, Any] = {t: (v,) * MAX_TARGETS if t in PER_TARGET else v for t, v in DEFAULTS.items()}
    for state in states:
        target = getattr(state, "target", None)
        if type(state) in PER_TARGET:
            target_states = list(values[type(state)])
            target_states[slice(None) if target is None else slice(target, target + 1)] = [state] * (
                MAX_TARGETS if target is None else 1
            )
            values[type(state)] = tuple(target_states)
        else:
            values[type(state)] = state
    return values


def describe(formats: Sequence[Format], components: int = 4, **more: Any) -> ProgramDescriptor:
    """Return a program with an output for each format."""
    kinds = {ChannelKind.UINT: "uint", ChannelKind.INT: "int"}
    outputs = tuple(
        FragmentOutput(f"o{i}", i, kinds.get(f.kind, "float"), components) for i, f in enumerate(formats)
    )
    return ProgramDescriptor(
        "Merged",
        frozenset({Stage.VERTEX, Stage.FRAGMENT}),
        (),
        (),
        outputs,
        (1, 1, 1),
        lambda language, stage: StageText(""),
        **more,
    )


def merge(
    key: MergerKey,
    state: NDArray[np.uint32],
    planes: Planes,
    outputs: NDArray[Any],
    z: NDArray[np.float32],
    covered: NDArray[np.bool_],
    front: bool = True,
    special: bool = False,
) -> Planes:
    """Merge fragments into the planes by the kernel; `outputs`: (samples, height, width, words) of 4
    bytes."""
    kernel = _build(key.defines() if special else general_defines(key.output_words))
    queue = _context().queue
    samples, height, width = covered.shape
    words = np.concatenate(
        [
            np.ascontiguousarray(outputs).view(np.uint32)[..., : key.output_words],
            (-covered.astype(np.int32))[..., None].view(np.uint32),
            np.ascontiguousarray(z, np.float32)[..., None].view(np.uint32),
        ],
        axis=-1,
    )
    blocks = words.reshape(samples, height // 4, 4, width // 4, 4, -1).transpose(1, 3, 0, 5, 2, 4)
    target_planes = [planes.colors[color.location] for color in key.colors]
    if key.has_depth:
        assert planes.depth is not None
        target_planes.append(planes.depth[..., None])
    if key.has_stencil:
        assert planes.stencil is not None
        target_planes.append(planes.stencil[..., None])
    buffers, layouts = [], []
    for number, plane in enumerate(target_planes):  # each begins elsewhere, has longer rows and room around
        texel = plane.shape[-1] * plane.itemsize
        start, pitch = 128 * (number + 1), (width + 4 * number) * texel
        layer = pitch * height
        memory = np.full(start + samples * layer + 128, 0xA5, np.uint8)
        rows = memory[start:][: samples * layer].reshape(samples, height, pitch)
        rows[:, :, : width * texel] = np.ascontiguousarray(plane).view(np.uint8).reshape(samples, height, -1)
        buffers.append((upload(memory), memory, rows, plane))
        layouts.append((start, pitch, layer))
    table = np.frombuffer(key.words + np.array(layouts, "u8").tobytes(), np.uint8)
    surfaces = np.array([buffer_address(buffer) for buffer, *_ in buffers] or [0], "u8")
    arguments = upload(state), upload(np.ascontiguousarray(blocks)), upload(table), upload(surfaces)
    kernel.set_args(
        *arguments[:2], np.int32(front), np.int32(width // 4), *arguments[2:]
    )  # which doesn't keep them alive
    cl.enqueue_nd_range_kernel(queue, kernel, (width * height // 16,), (1,))
    queue.finish()
    after = planes.copy()
    results = []
    for buffer, memory, rows, plane in buffers:
        before = memory.copy()
        inside = np.zeros(len(memory), bool)
        width_bytes = width * plane.shape[-1] * plane.itemsize
        offset = rows.ctypes.data - memory.ctypes.data
        inside[offset:][: rows.size].reshape(rows.shape)[:, :, :width_bytes] = True
        cl.enqueue_copy(queue, memory, buffer)
        assert (memory == before)[~inside].all(), "written outside of a target"
        results.append(np.ascontiguousarray(rows[:, :, :width_bytes]).view(plane.dtype).reshape(plane.shape))
    for color, result in zip(key.colors, results, strict=False):
        after.colors[color.location] = result
    if key.has_depth:
        after.depth = results[len(key.colors)][..., 0].view(np.float32)
    if key.has_stencil:
        after.stencil = results[-1][..., 0]
    return after


def upload(data: NDArray[Any]) -> cl.Buffer:
    return allocate(_context().context, data.nbytes, np.ascontiguousarray(data).reshape(-1))


def run(
    formats: Sequence[Format],
    depth: Format | None,
    states: Sequence[State],
    planes: Planes,
    outputs: NDArray[Any],
    z: NDArray[np.float32],
    covered: NDArray[np.bool_],
    front: bool = True,
    special: bool = False,
    **program: Any,
) -> Planes:
    """`merge` by states and formats."""
    values = state_values(*states)
    key = make_key(describe(formats, **program), values, formats, depth, len(covered))
    return merge(key, make_state(values, formats), planes, outputs, z, covered, front, special)
