"""Rules of compute programs and dispatches."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from rhi import Access, Device, Format, Mesh, Texture
from rhi.conformance.compare import assert_same
from rhi.conformance.shaders import Colored, Count
from rhi.conformance.validation.refusal import loose, refuses
from rhi.errors import rules
from rhi.shading import uint

SIZE = (4, 4)


def test_a_dispatch_needs_a_compute_stage(recording: Device) -> None:
    program = recording.program(Colored)
    with refuses(rules.PROGRAM_STAGE, recording):
        recording.dispatch(program, 1)
    with recording.storage(uint, 1) as total:
        recording.dispatch(recording.program(Count), 1, total=total)


def test_a_draw_needs_a_vertex_stage(recording: Device, image: Texture, mesh: Mesh) -> None:
    program = recording.program(Count)
    with recording.storage(uint, 1) as total:
        with recording.render_pass(image), refuses(rules.PROGRAM_STAGE, recording):
            recording.draw(program, mesh, total=total)


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


@pytest.mark.parametrize("groups", [-1, (1, -1), (1, 1, 1, 1), (), (0, 0, -1)], ids=str)
def test_groups_are_one_to_three_numbers(recording: Device, groups: Any) -> None:
    with recording.storage(uint, 1) as total:
        with refuses(rules.DISPATCH_SIZE, recording):
            recording.dispatch(recording.program(Count), groups, total=total)
        recording.dispatch(recording.program(Count), (1, 1, 1), total=total)


@pytest.mark.parametrize("offset", [-4, 2, 8])
def test_indirect_groups_lie_in_their_buffer(recording: Device, offset: int) -> None:
    with recording.storage(uint, 1) as total, recording.buffer(np.ones(4, "u4")) as arguments:
        with refuses(rules.INDIRECT_RANGE, recording):
            recording.dispatch_indirect(recording.program(Count), arguments, offset, total=total)
        recording.dispatch_indirect(recording.program(Count), arguments, 4, total=total)


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
