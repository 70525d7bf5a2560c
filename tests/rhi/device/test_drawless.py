"""A backend without draws: refusals of the front end, and the choice of a backend."""

from __future__ import annotations

from dataclasses import replace

import pytest
from null_kit import hand_made_program

import rhi
from rhi.backends.null import NullBackend
from rhi.contract.descriptors import ProgramDescriptor, Stage, StageText
from rhi.device import registry
from rhi.device.device import Device

EVERYTHING = NullBackend().capabilities


def make_device(**capabilities: bool) -> Device:
    return Device(NullBackend(replace(EVERYTHING, **capabilities)))


def compute_program() -> ProgramDescriptor:
    return ProgramDescriptor(
        "compute", frozenset({Stage.COMPUTE}), (), (), (), (1, 1, 1), lambda *_: StageText("")
    )


def test_a_program_that_draws_is_refused_without_draws() -> None:
    with (
        make_device(draws=False) as device,
        pytest.raises(rhi.ValidationError, match=r"capabilities\.draws") as caught,
    ):
        device.program(hand_made_program())
    assert caught.value.rule.id == "device-capability"
    with make_device() as device:
        device.program(hand_made_program())


def test_a_compute_program_needs_no_draws() -> None:
    with make_device(draws=False) as device:
        device.dispatch(device.program(compute_program()), 1)
        assert device.statistics.dispatches == 1


def test_a_pass_clears_without_draws() -> None:
    with make_device(draws=False) as device:
        image = device.texture((2, 2), rhi.Format.R8)
        with device.render_pass(image, clear=(1, 0, 0, 0)):
            pass
        assert (image.read() == 255).all()


@pytest.mark.parametrize(("draws", "shading"), [(True, True), (True, False), (False, True), (False, False)])
def test_to_render_is_to_draw_with_shaders(draws: bool, shading: bool) -> None:
    assert replace(EVERYTHING, draws=draws, shading=shading).renders == (draws and shading)


def test_a_backend_that_does_not_render_is_not_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RHI_BACKEND", raising=False)
    monkeypatch.setattr(registry, "backend_names", lambda: ["null"])
    with pytest.raises(rhi.DeviceError, match="null: it doesn't render") as caught:
        rhi.create_device()
    assert caught.value.rule.id == "device-driver"
    with rhi.create_device("null") as device:
        assert device.backend_name == "null"
