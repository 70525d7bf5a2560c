"""Measures the work in a command, for the cost model.

Work is measured right after the command was executed, from its arguments and the state at that point. Covered
pixels are the counted samples (`NullBackend.count_samples`); without a count, the model's estimate for the
draw's viewport.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from rhi.backends.null.execution import DrawOutcome, ExecutionState
from rhi.backends.null.null_draws import ExecutedIndirectDraws
from rhi.backends.null.null_textures import Textures
from rhi.backends.null.simulation.cost import CommandWork, CostModel, count_primitives
from rhi.commands.ops import Op
from rhi.contract import descriptors
from rhi.contract.descriptors import Id
from rhi.contract.states import Scissor, StateChange, Viewport


class WorkMeter:
    """Measures the commands of one device. Its methods are the commands with work of their own, named as in
    `Backend`, but for those that only move bytes (`meters`).

    Attributes:
        samples: the samples that the command just executed passed, None if unknown.
        indirect_draws, indirect_dispatches: the executed indirect commands with their arguments, the latest
            last.
    """

    def __init__(self, cost: CostModel, textures: Textures, state: ExecutionState) -> None:
        self._cost = cost
        self._textures = textures
        self._state = state
        self._begun: descriptors.PassDescriptor | None = None
        self._cached_area: tuple[tuple[object, object, object], int] = ((None, None, None), 0)
        self.samples: int | None = None
        self.indirect_draws: Sequence[ExecutedIndirectDraws] = ()
        self.indirect_dispatches: Sequence[tuple[int, int, int]] = ()

    def set_states(self, changes: Sequence[StateChange]) -> CommandWork:
        return CommandWork(Op.SET_STATES, state_changes=len(changes))

    def bind_program(self, program: Id) -> CommandWork:
        return CommandWork(Op.BIND_PROGRAM, state_changes=1)

    def begin_pass(self, descriptor: descriptors.PassDescriptor) -> CommandWork:
        """Measure the clears."""
        self._begun = descriptor
        width, height = descriptor.size
        targets: list[descriptors.Attachment | descriptors.DepthAttachment] = [*descriptor.colors]
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
        self,
        vertex_array: Id,
        primitive: descriptors.Primitive,
        first: int,
        count: int,
        instances: int,
        base_vertex: int,
        base_instance: int,
    ) -> CommandWork:
        if self._state.outcome is DrawOutcome.DROPPED:
            return CommandWork(Op.DRAW)
        pixels = self._pixels(count_primitives(primitive, count) * instances)
        return CommandWork(Op.DRAW, count * instances, pixels)

    def draw_indirect(self, vertex_array: Id, primitive: descriptors.Primitive, *others: int) -> CommandWork:
        draws = self.indirect_draws[-1].draws
        vertices = int((draws["count"].astype(np.int64) * draws["instances"]).sum())
        pixels = self._pixels(count_primitives(primitive, vertices))
        return CommandWork(Op.DRAW_INDIRECT, vertices, pixels, draws.nbytes)

    def dispatch(self, x: int, y: int, z: int) -> CommandWork:
        return CommandWork(Op.DISPATCH, invocations=x * y * z * self._work_group())

    def dispatch_indirect(self, buffer: Id, offset: int) -> CommandWork:
        x, y, z = self.indirect_dispatches[-1]
        return CommandWork(Op.DISPATCH_INDIRECT, bytes=12, invocations=x * y * z * self._work_group())

    def meters(self) -> tuple[Callable[..., CommandWork] | None, ...]:
        """Return the function that measures each op, None where the command has no work of its own."""
        transfers: dict[Op, Callable[..., int]] = {
            Op.WRITE_BUFFER: lambda buffer, offset, data: memoryview(data).nbytes,
            Op.COPY_BUFFER: lambda source, source_offset, target, target_offset, size: 2 * size,
            Op.CLEAR_BUFFER: lambda buffer, offset, size, value: size,
            Op.WRITE_TEXTURE: lambda texture, level, region, data: memoryview(data).nbytes,
            Op.COPY_TEXTURE: lambda source, level, region, *target: 2 * self._region_bytes(source, region),
            Op.COPY_TEXTURE_TO_BUFFER: lambda source, level, region, *target: (
                2 * self._region_bytes(source, region)
            ),
            Op.COPY_BUFFER_TO_TEXTURE: lambda source, offset, row_bytes, target, level, region: (
                2 * self._region_bytes(target, region)
            ),
            Op.RESOLVE_TEXTURE: self._resolved_bytes,
            Op.GENERATE_MIPMAPS: self._filtered_bytes,
        }

        def get_meter(op: Op) -> Callable[..., CommandWork] | None:
            count = transfers.get(op)
            if count is None:
                return getattr(self, op.method, None)
            return lambda *arguments: CommandWork(op, bytes=count(*arguments))

        return tuple(map(get_meter, Op))

    # -- helpers -----------------------------------------------------------------------------------------

    def _resolved_bytes(self, source: Id, target: Id) -> int:
        return self._level_bytes(target) * (self._textures.textures[source].descriptor.samples + 1)

    def _filtered_bytes(self, texture: Id) -> int:
        levels = len(self._textures.textures[texture].levels)
        return 5 * sum(
            self._level_bytes(texture, level) for level in range(1, levels)
        )  # a texel needs four others

    def _level_bytes(self, texture: Id, level: int = 0) -> int:
        descriptor = self._textures.textures[texture].descriptor
        width, height = descriptor.level_size(level)
        return width * height * descriptor.level_layers(level) * descriptor.format.texel_bytes

    def _region_bytes(self, texture: Id, region: descriptors.Region) -> int:
        texel = self._textures.textures[texture].descriptor.format.texel_bytes
        return region.width * region.height * region.layers * texel

    def _work_group(self) -> int:
        program = self._state.resources.get(self._state.program)
        x, y, z = program.work_group if isinstance(program, descriptors.ProgramDescriptor) else (1, 1, 1)
        return x * y * z

    def _pixels(self, primitives: int) -> float:
        if self.samples is not None:
            return self.samples
        return self._cost.covered_pixels(primitives, self._area())

    def _area(self) -> int:
        """Return the number of pixels that a draw can reach: the intersection of target, viewport and
        scissor."""
        state = self._state
        parts = (state.render_pass, state.states[Viewport], state.states[Scissor])
        cached, area = self._cached_area
        if parts[0] is not cached[0] or parts[1] is not cached[1] or parts[2] is not cached[2]:
            area = _measure_area(*parts)
            self._cached_area = parts, area
        return area


def _measure_area(render_pass: descriptors.PassDescriptor | None, viewport: Any, scissor: Any) -> int:
    if render_pass is None:
        return 0
    width, height = render_pass.size
    left = 0.0
    top = 0.0
    right = float(width)
    bottom = float(height)
    for box, unset in ((viewport, Viewport.TARGET), (scissor, Scissor.OFF)):
        if box != unset:
            left, top = max(left, box.x), max(top, box.y)
            right, bottom = min(right, box.x + box.width), min(bottom, box.y + box.height)
    return int(max(0.0, right - left) * max(0.0, bottom - top))
