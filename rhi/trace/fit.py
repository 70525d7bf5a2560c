"""Whether a device can do what a trace does: looked at before anything is issued, since backends check nothing."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Final

from rhi.commands.ops import WIDTHS, Op
from rhi.commands.stream import CommandStream
from rhi.contract.backend import Capabilities
from rhi.contract.descriptors import QueryKind, Stage
from rhi.contract.states import AlphaTest, AlphaToCoverage, StencilTest
from rhi.errors import refuse
from rhi.trace.rules import TRACE_CAPABILITY

__rhi_internal__ = True

_QUERIES: Final = {
    QueryKind.OCCLUSION: "occlusion_queries",
    QueryKind.COUNTER: "sample_counter",
    QueryKind.TIMESTAMP: "timestamps",
}
_STATES: Final = {
    AlphaTest.ON: "alpha_test",
    StencilTest.ON: "stencil",
    AlphaToCoverage.ON: "alpha_to_coverage",
}


def check_fit(stream: CommandStream, limits: Capabilities) -> None:
    """Refuse a trace that the device can't replay, naming the first command that it can't do.

    Raises:
        ValidationError: `trace-capability`.
    """
    looked_at: dict[Op, Callable[[Capabilities, Any], Iterator[str]]] = {
        Op.CREATE_TEXTURE: _texture,
        Op.CREATE_SAMPLER: _sampler,
        Op.CREATE_QUERY: _query,
        Op.CREATE_PROGRAM: _program,
        Op.BEGIN_PASS: _pass,
        Op.SET_STATES: _states,
        Op.BIND_UNIFORM: _uniform,
        Op.BIND_STORAGE: _storage,
        Op.BIND_TEXTURE: _sampled,
        Op.BIND_IMAGE: _image,
        Op.DRAW_INDIRECT: _indirect,
        Op.DISPATCH: _dispatch,
        Op.BEGIN_CONDITIONAL: _conditional,
    }
    checked: set[tuple[Any, ...]] = set()
    place, index, data = 0, 0, stream.data
    while place < len(data):
        op = data[place]
        end = place + WIDTHS[op] - 2
        if op in looked_at:
            entry = tuple(data[place:end])
            if entry not in checked:
                checked.add(entry)
                for reason in looked_at[op](limits, entry[1:]):
                    given = f"command {index}: {stream[index]}"
                    refuse(TRACE_CAPABILITY, f"rhi.trace.replay on {limits.backend}", given, reason)
        place, index = end + 2, index + 1


def _texture(limits: Capabilities, values: Any) -> Iterator[str]:
    descriptor = values[1]
    if max(descriptor.size) > limits.max_texture_size:
        yield f"textures up to {limits.max_texture_size}"
    if descriptor.layers > limits.max_texture_layers:
        yield f"up to {limits.max_texture_layers} layers"
    if descriptor.samples > limits.max_samples:
        yield f"up to {limits.max_samples} samples"
    if descriptor.format in limits.unsupported_formats:
        yield f"formats other than {descriptor.format.name}"


def _sampler(limits: Capabilities, values: Any) -> Iterator[str]:
    if values[1].max_anisotropy > limits.max_anisotropy:
        yield f"anisotropy up to {limits.max_anisotropy:g}"


def _query(limits: Capabilities, values: Any) -> Iterator[str]:
    if not getattr(limits, _QUERIES[values[1]]):
        yield f"needs capabilities.{_QUERIES[values[1]]}"


def _program(limits: Capabilities, values: Any) -> Iterator[str]:
    descriptor = values[1]
    if Stage.COMPUTE in descriptor.stages:
        x, y, z = descriptor.work_group
        fits = all(0 < n <= most for n, most in zip((x, y, z), limits.max_work_group, strict=True))
        if not limits.compute or not fits or x * y * z > limits.max_work_group_invocations:
            yield f"work-groups up to {limits.max_work_group}, {limits.max_work_group_invocations} in all"
        if descriptor.shared_bytes > limits.max_shared_bytes:
            yield f"up to {limits.max_shared_bytes} bytes of shared memory"
    if len(descriptor.attributes) > limits.max_vertex_attributes:
        yield f"up to {limits.max_vertex_attributes} attributes"


def _pass(limits: Capabilities, values: Any) -> Iterator[str]:
    if len(values[0].colors) > limits.max_color_targets:
        yield f"up to {limits.max_color_targets} color targets"


def _states(limits: Capabilities, values: Any) -> Iterator[str]:
    for change in values[0]:
        if isinstance(change.value, AlphaTest | StencilTest | AlphaToCoverage) and change.value in _STATES:
            name = _STATES[change.value]
            if not getattr(limits, name):
                yield f"needs capabilities.{name}"


def _uniform(limits: Capabilities, values: Any) -> Iterator[str]:
    slots, most, step = limits.max_uniform_slots, limits.max_uniform_bytes, limits.uniform_alignment
    return _range(values, slots, most, step)


def _storage(limits: Capabilities, values: Any) -> Iterator[str]:
    slots, most, step = limits.max_storage_slots, limits.max_storage_bytes, limits.storage_alignment
    return _range(values, slots, most, step)


def _range(values: Any, slots: int, most: int, step: int) -> Iterator[str]:
    slot, _, offset, size = values
    if slot >= slots or size > most or offset % step:
        yield f"{slots} slots of up to {most} bytes at multiples of {step}"


def _sampled(limits: Capabilities, values: Any) -> Iterator[str]:
    if values[0] >= limits.max_texture_slots:
        yield f"{limits.max_texture_slots} slots"


def _image(limits: Capabilities, values: Any) -> Iterator[str]:
    if values[0] >= limits.max_image_slots:
        yield f"{limits.max_image_slots} slots"


def _indirect(limits: Capabilities, values: Any) -> Iterator[str]:
    if values[6] and not limits.indirect_count:
        yield "needs capabilities.indirect_count"


def _dispatch(limits: Capabilities, values: Any) -> Iterator[str]:
    if not limits.compute or any(n > most for n, most in zip(values, limits.max_dispatch, strict=True)):
        yield f"up to {limits.max_dispatch} work-groups"


def _conditional(limits: Capabilities, values: Any) -> Iterator[str]:
    if not limits.conditional_rendering:
        yield "needs capabilities.conditional_rendering"
