"""Rules of compute programs and dispatches."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rhi import Access, Device, Format, ProgramDescriptor
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle
from rhi.conformance.validation.refusal import loose, refuses
from rhi.conformance.validation.shaders import Passing
from rhi.contract.descriptors import Binding, BindingKind
from rhi.errors import rules
from rhi.shading import Shader, StorageRW, atomic_add, compile_shader, shared, uint

SIZE = (4, 4)


class Count(Shader):
    """Counts its invocations."""

    total: StorageRW[uint]

    def compute(self) -> None:
        atomic_add(self.total[0], uint(1))


@pytest.mark.needs("compute")
@pytest.mark.needs("draws")
def test_a_dispatch_needs_a_compute_stage(recording: Device) -> None:
    program = recording.program(Colored)
    with refuses(rules.PROGRAM_STAGE, recording):
        recording.dispatch(program, 1)
    with recording.storage(uint, 1) as total:
        recording.dispatch(recording.program(Count), 1, total=total)


@pytest.mark.needs("compute")
def test_a_draw_needs_a_vertex_stage(recording: Device) -> None:
    program = recording.program(Count)
    with (
        recording.texture(SIZE, Format.R8) as image,
        recording.mesh(rectangle()) as mesh,
        recording.storage(uint, 1) as total,
    ):
        with recording.render_pass(image), refuses(rules.PROGRAM_STAGE, recording):
            recording.draw(program, mesh, total=total)


@pytest.mark.needs("compute")
def test_a_dispatch_lies_outside_of_passes(recording: Device) -> None:
    program = recording.program(Count)
    with recording.texture(SIZE, Format.R8) as image, recording.storage(uint, 1) as total:
        with recording.buffer(np.ones(3, "u4")) as arguments, recording.render_pass(image):
            with refuses(rules.PASS_OPEN, recording):
                recording.dispatch(program, 1, total=total)
            with refuses(rules.PASS_OPEN, recording):
                recording.dispatch_indirect(program, arguments, 0, total=total)
            with refuses(rules.PASS_OPEN, recording):
                recording.present()
        assert_same(total.read(), 0)


@pytest.mark.needs("compute")
@pytest.mark.parametrize("groups", [-1, (1, -1), (1, 1, 1, 1), (), (0, 0, -1)], ids=str)
def test_groups_are_one_to_three_numbers(recording: Device, groups: Any) -> None:
    with recording.storage(uint, 1) as total:
        with refuses(rules.DISPATCH_SIZE, recording):
            recording.dispatch(recording.program(Count), groups, total=total)
        recording.dispatch(recording.program(Count), (1, 1, 1), total=total)


@pytest.mark.needs("compute")
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_groups_are_no_more_than_the_device_says(recording: Device, axis: int) -> None:
    groups = [1, 1, 1]
    groups[axis] = recording.capabilities.max_dispatch[axis] + 1
    with recording.storage(uint, 1) as total, refuses(rules.DISPATCH_SIZE, recording):
        recording.dispatch(recording.program(Count), groups, total=total)


@pytest.mark.needs("compute")
@pytest.mark.parametrize("offset", [-4, 2, 8])
def test_indirect_groups_lie_in_their_buffer(recording: Device, offset: int) -> None:
    with recording.storage(uint, 1) as total, recording.buffer(np.ones(4, "u4")) as arguments:
        with refuses(rules.INDIRECT_RANGE, recording):
            recording.dispatch_indirect(recording.program(Count), arguments, offset, total=total)
        recording.dispatch_indirect(recording.program(Count), arguments, 4, total=total)


@pytest.mark.needs("compute")
def test_a_dispatch_checks_its_bindings(recording: Device, device: Device) -> None:
    program = recording.program(Count)
    with (
        recording.storage(uint, 1) as total,
        recording.storage(float, 1) as wrong,
        device.storage(uint, 1) as theirs,
    ):
        with refuses(rules.BINDING_MISSING, recording):
            loose(recording).dispatch(program, 1)
        with refuses(rules.BINDING_UNKNOWN, recording):
            loose(recording).dispatch(program, 1, totals=total)
        with refuses(rules.BINDING_TYPE, recording):
            loose(recording).dispatch(program, 1, total=wrong)
        with refuses(rules.RESOURCE_FOREIGN, recording):
            recording.dispatch(program, 1, total=theirs)
        foreign = device.program(Count)
        with refuses(rules.RESOURCE_FOREIGN, recording):
            recording.dispatch(foreign, 1, total=total)
        with total.lock(Access.READ), refuses(rules.LOCK_OPEN, recording):
            recording.dispatch(program, 1, total=total)
        recording.dispatch(program, 1, total=total)


@pytest.mark.needs("draws")
@pytest.mark.parametrize(
    ("kind", "limit"),
    [
        (BindingKind.UNIFORM, "max_uniform_slots"),
        (BindingKind.STORAGE, "max_storage_slots"),
        (BindingKind.TEXTURE, "max_texture_slots"),
        (BindingKind.IMAGE, "max_image_slots"),
    ],
    ids=lambda value: value.name.lower() if isinstance(value, BindingKind) else "",
)
def test_bindings_are_no_more_than_the_device_says(recording: Device, kind: BindingKind, limit: str) -> None:
    def program(count: int) -> ProgramDescriptor:
        bindings = tuple(Binding(f"b{i}", kind, i, False, None, 16) for i in range(count))
        return replace(compile_shader(Passing), bindings=bindings)

    most = getattr(recording.capabilities, limit)
    with refuses(rules.DEVICE_CAPABILITY, recording):
        recording.program(program(most + 1))
    recording.program(program(most)).destroy()


@pytest.mark.needs("compute")
def test_a_work_group_shares_no_more_than_the_device_says(recording: Device) -> None:
    most = recording.capabilities.max_shared_bytes // 4

    class Sharing(Shader):
        """Shares a little too much."""

        results: StorageRW[float]
        numbers = shared(float, most + 1)

        def compute(self) -> None:
            self.numbers[0] = 1.0
            self.results[0] = self.numbers[0]

    with refuses(rules.DEVICE_CAPABILITY, recording):
        recording.program(Sharing)
