"""States that GL couples and the contract doesn't."""

from __future__ import annotations

import numpy as np
from gl_kit import FULL, GlKit, describe_program

from rhi.contract import states
from rhi.contract.descriptors import DepthAttachment
from rhi.contract.formats import Format


def test_clears_ignore_masks_and_scissor_and_leave_them_in_force(gl_kit: GlKit) -> None:
    program = gl_kit.program(describe_program())
    shape, color, depth = gl_kit.shape(program, FULL), gl_kit.texture(), gl_kit.texture(Format.D24S8)
    gl_kit.set(
        states.CullMode.NONE,
        states.ColorWrite(red=False),
        states.DepthWrite.OFF,
        states.StencilWriteMask(0, 0),
        states.Scissor(0, 0, 4, 4),
    )
    target = DepthAttachment(depth, clear=0.25, clear_stencil=9)
    gl_kit.begin(color, (0.2, 1, 0, 1), depth=target)
    assert (gl_kit.read(color) == (51, 255, 0, 255)).all()
    assert np.allclose(gl_kit.read(depth), 0.25, atol=1e-6)
    assert (gl_kit.read(depth, stencil=True) == 9).all()
    gl_kit.backend.bind_program(program)
    gl_kit.draw(shape)
    image = gl_kit.read(color)
    assert (image[:4, :4, 0] == 51).all()  # masked
    assert (image[:4, :4, 1] == 0).all()
    assert (image[4:, :, 1] == 255).all()  # cut off
    assert np.allclose(gl_kit.read(depth), 0.25, atol=1e-6)


def test_depth_is_written_while_its_test_is_off(gl_kit: GlKit) -> None:
    program = gl_kit.program(describe_program())
    shape, color, depth = gl_kit.shape(program, FULL), gl_kit.texture(), gl_kit.texture(Format.D32F)
    gl_kit.set(states.CullMode.NONE, states.DepthWrite.OFF, states.DepthTest.OFF)
    for write, stored in ((states.DepthWrite.ON, 0.5), (states.DepthWrite.OFF, 0.75)):
        gl_kit.set(write)
        gl_kit.begin(color, depth=DepthAttachment(depth, clear=0.75))
        gl_kit.backend.bind_program(program)
        gl_kit.draw(shape)
        assert (gl_kit.read(depth) == stored).all()
        assert (gl_kit.read(color)[..., 0] == 255).all()


def test_states_may_hold_numpy_scalars(checked_kit: GlKit) -> None:
    whole, real = np.int64(1), np.float32(0.5)
    checked_kit.set(
        states.Viewport(real, real, real, real, real, real),  # type: ignore[arg-type]
        states.Scissor(whole, whole, whole, whole),  # type: ignore[arg-type]
        states.BlendColor(real, real, real, real),  # type: ignore[arg-type]
        states.StencilReference(whole, whole),  # type: ignore[arg-type]
        states.StencilWriteMask(whole, whole),  # type: ignore[arg-type]
        states.DepthBias(real),  # type: ignore[arg-type]
        states.AlphaReference(real),  # type: ignore[arg-type]
        states.PolygonOffset(real, real),  # type: ignore[arg-type]
    )
