"""Measures the work in a command, for the cost model.

Work is measured right after the command was executed, from its arguments and the state at that point. Covered pixels
are the counted samples (`NullBackend.count_samples`); without a count, the model's estimate for the draw's viewport.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from typing_extensions import Buffer as BytesLike

from rhi.backends.null.draws import ExecutedIndirectDraws
from rhi.backends.null.execution import DrawOutcome, ExecutionState
from rhi.backends.null.simulation.cost import CommandWork, CostModel, count_primitives
from rhi.backends.null.textures import Textures
from rhi.commands.ops import Op
from rhi.contract.descriptors import (
    Attachment,
    DepthAttachment,
    Id,
    PassDescriptor,
    Primitive,
    ProgramDescriptor,
    Region,
)
from rhi.contract.states import Scissor, StateChange, Viewport

__rhi_internal__ = True


class WorkMeter:
    """Measures the commands of one device. Its methods are the commands with work of their own, named as in
    `Backend`.

    Attributes:
        samples: the samples that the command just executed passed, None if unknown.
        indirect_draws, indirect_dispatches: the executed indirect commands with their arguments, the latest last.
    """

    def __init__(
        self, cost: CostModel, textures: Textures, state: ExecutionState
    ) -> None:
        self._cost = cost
        self._textures = textures
        self._state = state
        self._begun: PassDescriptor | None = None
        self._known_area: tuple[tuple[object, object, object], int] = ((None, None, None), 0)
        self.samples: int | None = None
        self.indirect_draws: Sequence[ExecutedIndirectDraws] = ()
        self.indirect_dispatches: Sequence[tuple[int, int, int]] = ()

    def set_states(self, changes: Sequence[StateChange]) -> CommandWork:
        return CommandWork(Op.SET_STATES, state_changes=len(changes))

    def bind_program(self, program: Id) -> CommandWork:
        return CommandWork(Op.BIND_PROGRAM, state_changes=1)

    def begin_pass(self, descriptor: PassDescriptor) -> CommandWork:
        """Measure the clears."""
        self._begun = descriptor
        width, height = descriptor.size
        targets: list[Attachment | DepthAttachment] = [*descriptor.colors]
        if descriptor.depth is not None:
            targets.append(descriptor.depth)
        cleared = sum(target.clear is not None for target in targets)
        return CommandWork(Op.BEGIN_PASS, pixels=width * height * descriptor.samples * cleared)

    def end_pass(self) -> CommandWork:
        """Measure the resolves, which read all samples."""
        begun = self._begun
        if begun is None:
            return CommandWork(Op.END_PASS)
        resolved = [attachment.resolve for attachment in begun.colors if attachment.resolve]
        bytes = sum(self._level_bytes(texture) * (begun.samples + 1) for texture in resolved)
        return CommandWork(Op.END_PASS, bytes=bytes)

    def draw(
        self, vertex_array: Id, primitive: Primitive, first: int, count: int, instances: int, base_vertex: int,
        base_instance: int,
    ) -> CommandWork:  # fmt: skip
        if self._state.outcome is DrawOutcome.DROPPED:
            return CommandWork(Op.DRAW)
        pixels = self._pixels(count_primitives(primitive, count) * instances)
        return CommandWork(Op.DRAW, count * instances, pixels)

    def draw_indirect(self, vertex_array: Id, primitive: Primitive, *others: int) -> CommandWork:
        draws = self.indirect_draws[-1].draws
        vertices = int((draws["count"].astype(np.int64) * draws["instances"]).sum())
        pixels = self._pixels(count_primitives(primitive, vertices))
        return CommandWork(Op.DRAW_INDIRECT, vertices, pixels, draws.nbytes)

    def dispatch(self, x: int, y: int, z: int) -> CommandWork:
        return CommandWork(Op.DISPATCH, invocations=x * y * z * self._work_group())

    def dispatch_indirect(self, buffer: Id, offset: int) -> CommandWork:
        x, y, z = self.indirect_dispatches[-1]
        return CommandWork(Op.DISPATCH_INDIRECT, bytes=12, invocations=x * y * z * self._work_group())

    def write_buffer(self, buffer: Id, offset: int, data: BytesLike) -> CommandWork:
        return CommandWork(Op.WRITE_BUFFER, bytes=memoryview(data).nbytes)

    def copy_buffer(
        self, source: Id, source_offset: int, target: Id, target_offset: int, size: int
    ) -> CommandWork:
        return CommandWork(Op.COPY_BUFFER, bytes=2 * size)

    def clear_buffer(self, buffer: Id, offset: int, size: int, value: int) -> CommandWork:
        return CommandWork(Op.CLEAR_BUFFER, bytes=size)

    def write_texture(self, texture: Id, level: int, region: Region, data: BytesLike) -> CommandWork:
        return CommandWork(Op.WRITE_TEXTURE, bytes=memoryview(data).nbytes)

    def copy_texture(
        self, source: Id, source_level: int, source_region: Region, target: Id, target_level: int, x: int, y: int,
        layer: int,
    ) -> CommandWork:  # fmt: skip
        return CommandWork(Op.COPY_TEXTURE, bytes=2 * self._region_bytes(source, source_region))

    def copy_texture_to_buffer(
        self, source: Id, level: int, region: Region, target: Id, offset: int, row_bytes: int
    ) -> CommandWork:
        return CommandWork(Op.COPY_TEXTURE_TO_BUFFER, bytes=2 * self._region_bytes(source, region))

    def copy_buffer_to_texture(
        self, source: Id, offset: int, row_bytes: int, target: Id, level: int, region: Region
    ) -> CommandWork:
        return CommandWork(Op.COPY_BUFFER_TO_TEXTURE, bytes=2 * self._region_bytes(target, region))

    def resolve_texture(self, source: Id, target: Id) -> CommandWork:
        samples = self._textures.textures[source].descriptor.samples
        return CommandWork(Op.RESOLVE_TEXTURE, bytes=self._level_bytes(target) * (samples + 1))

    def generate_mipmaps(self, texture: Id) -> CommandWork:
        levels = len(self._textures.textures[texture].levels)
        written = sum(self._level_bytes(texture, level) for level in range(1, levels))
        return CommandWork(
            Op.GENERATE_MIPMAPS, bytes=5 * written
        )  # each texel written needs four texels read

    def meters(self) -> tuple[Callable[..., CommandWork] | None, ...]:
        """Return the function that measures each op, None where the command has no work of its own."""
        return tuple(getattr(self, op.method, None) for op in Op)

    # -- helpers -----------------------------------------------------------------------------------------

    def _level_bytes(self, texture: Id, level: int = 0) -> int:
        descriptor = self._textures.textures[texture].descriptor
        width, height = descriptor.level_size(level)
        return width * height * descriptor.level_layers(level) * descriptor.format.texel_bytes

    def _region_bytes(self, texture: Id, region: Region) -> int:
        texel = self._textures.textures[texture].descriptor.format.texel_bytes
        return region.width * region.height * region.layers * texel

    def _work_group(self) -> int:
        program = self._state.resources.get(self._state.program)
        x, y, z = program.work_group if isinstance(program, ProgramDescriptor) else (1, 1, 1)
        return x * y * z

    def _pixels(self, primitives: int) -> float:
        if self.samples is not None:
            return self.samples
        return self._cost.covered_pixels(primitives, self._area())

    def _area(self) -> int:
        """Return the number of pixels that a draw can reach: the intersection of target, viewport and scissor."""
        state = self._state
        parts = (state.render_pass, state.states[Viewport], state.states[Scissor])
        known, area = self._known_area
        if parts[0] is not known[0] or parts[1] is not known[1] or parts[2] is not known[2]:
            area = _measure_area(*parts)
            self._known_area = parts, area
        return area


def _measure_area(render_pass: PassDescriptor | None, viewport: Any, scissor: Any) -> int:
    if render_pass is None:
        return 0
    width, height = render_pass.size
    left, top, right, bottom = 0.0, 0.0, float(width), float(height)
    for box, unset in ((viewport, Viewport.TARGET), (scissor, Scissor.OFF)):
        if box != unset:
            left, top = max(left, box.x), max(top, box.y)
            right, bottom = min(right, box.x + box.width), min(bottom, box.y + box.height)
    return int(max(0.0, right - left) * max(0.0, bottom - top))
