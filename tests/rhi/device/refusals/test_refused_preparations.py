"""Rules of `device.prepare`: bad plans are refused before anything begins."""

from __future__ import annotations

from typing import Any

import pytest

import rhi
from rhi import BlendFunction, Device, DrawPlan, Format
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle
from rhi.conformance.validation.refusal import refuses
from rhi.errors import rules
from rhi.shading import Shader, StorageRW, global_id


class Doubled(Shader):
    values: StorageRW[float]

    def compute(self) -> None:
        self.values[global_id().x] *= 2.0


@pytest.mark.parametrize("value", ["a string", None, 5, Colored, ["a plan"], [Colored]], ids=repr)
def test_only_programs_and_plans_are_prepared(recording: Device, value: Any) -> None:
    with refuses(rules.DEVICE_ARGUMENT, recording):
        recording.prepare(value)


def test_a_plan_has_a_program(recording: Device) -> None:
    with refuses(rules.DEVICE_ARGUMENT, recording):
        recording.prepare([DrawPlan(Colored)])  # type: ignore[arg-type]


def test_one_bad_plan_of_many_refuses_all(recording: Device) -> None:
    program, mesh = recording.program(Colored), recording.mesh(rectangle())
    with refuses(rules.DEVICE_ARGUMENT, recording):
        recording.prepare([DrawPlan(program, mesh), DrawPlan(program, mesh, ("target",))])  # type: ignore[arg-type]
    assert not mesh.vertex_arrays
    assert recording.prepare([DrawPlan(program, mesh)]).done()
    assert mesh.vertex_arrays


@pytest.mark.parametrize(
    ("targets", "fits"),
    [
        ([Format.RGBA8] * 8, True),
        ([Format.RGBA8] * 9, False),
        ([Format.D32F], True),
        ([Format.D32F, Format.D32F], False),
        ([5], False),
    ],
    ids=str,
)
def test_targets_are_formats_or_textures_as_many_as_a_pass_takes(
    recording: Device, targets: Any, fits: bool
) -> None:
    program = recording.program(Colored)
    if fits:
        assert recording.prepare(program, targets=targets).done()
    else:
        with refuses(rules.DEVICE_ARGUMENT, recording):
            recording.prepare(program, targets=targets)


def test_targets_have_the_same_samples(recording: Device) -> None:
    program = recording.program(Colored)
    single, four = (recording.texture((4, 4), Format.RGBA8, samples=samples) for samples in (1, 4))
    with refuses(rules.TEXTURE_SIZE, recording):
        recording.prepare(program, targets=(single, four))
    recording.prepare(program, targets=(four, four))


def test_preparing_with_a_destroyed_resource_is_refused(recording: Device) -> None:
    program, image = recording.program(Colored), recording.texture((4, 4), Format.RGBA8)
    mesh = recording.mesh(rectangle())
    image.destroy()
    with refuses(rules.RESOURCE_DESTROYED, recording):
        recording.prepare(program, targets=(image,))
    mesh.destroy()
    with refuses(rules.RESOURCE_DESTROYED, recording):
        recording.prepare(program, mesh)
    program.destroy()
    with refuses(rules.RESOURCE_DESTROYED, recording):
        recording.prepare(program)


def test_states_are_those_of_a_scope(recording: Device) -> None:
    program = recording.program(Colored)
    with refuses(rules.STATE_DUPLICATE, recording):
        recording.prepare(program, states=(BlendFunction.ALPHA, BlendFunction.ALPHA))
    with refuses(rules.STATE_TYPE, recording):
        recording.prepare(program, states=("blend",))  # type: ignore[arg-type]
    recording.prepare(program, states=(BlendFunction.ALPHA,))


def test_a_compute_program_is_prepared_already(recording: Device) -> None:
    assert recording.prepare(recording.program(Doubled)).done()


def test_preparing_records_only_the_creations_of_a_first_draw(recording: Device) -> None:
    program, mesh = recording.program(Colored), recording.mesh(rectangle())
    before = len(recording.stream)
    preparation = recording.prepare(program, mesh, targets=(Format.RGBA8,))
    assert preparation.progress == (0, 0)
    assert [command.op for command in recording.stream][before:] == [rhi.Op.CREATE_VERTEX_ARRAY]
