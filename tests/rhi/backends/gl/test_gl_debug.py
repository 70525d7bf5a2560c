"""Validation mode: what the driver reports becomes an exception of the call that caused it."""

from __future__ import annotations

import pytest
from gl_kit import GlKit, describe_program

from rhi.backends.gl.debug import DebugGlBackend
from rhi.contract.descriptors import BufferDescriptor
from rhi.errors import DeviceError, ShaderError

NO_SLOT = 10_000


def test_an_error_names_the_call_and_the_drivers_words(checked_kit: GlKit) -> None:
    buffer = checked_kit.buffer(bytes(64))
    with pytest.raises(DeviceError, match="glBindBufferRange") as caught:
        checked_kit.backend.bind_uniform(NO_SLOT, buffer, 0, 64)
    assert caught.value.rule.id == "device-debug"
    assert caught.value.call.startswith("bind_uniform(10000, 1,")
    assert caught.value.site is not None
    assert caught.value.site.file == __file__


def test_an_error_is_raised_once(checked_kit: GlKit) -> None:
    buffer = checked_kit.buffer(bytes(64))
    with pytest.raises(DeviceError):
        checked_kit.backend.bind_uniform(NO_SLOT, buffer, 0, 64)
    checked_kit.backend.bind_uniform(0, buffer, 0, 64)


def test_a_prepared_call_is_checked_too(checked_kit: GlKit) -> None:
    buffer = checked_kit.buffer(bytes(64))
    bind = checked_kit.backend.prepare_uniform(buffer)
    bind(0, 0, 64)
    with pytest.raises(DeviceError, match="glBindBufferRange"):
        bind(NO_SLOT, 0, 64)


def test_without_validation_the_driver_is_not_asked(gl_kit: GlKit) -> None:
    gl_kit.backend.bind_uniform(NO_SLOT, gl_kit.buffer(bytes(64)), 0, 64)
    gl_kit.buffer(bytes(64))  # nor is the error put down to the next creation


def test_a_failed_creation_keeps_its_own_rule(checked_kit: GlKit) -> None:
    with pytest.raises(DeviceError, match=r"^\[device-out-of-memory\]"):
        checked_kit.backend.create_buffer(1, BufferDescriptor(1 << 43))
    with pytest.raises(ShaderError):
        checked_kit.program(describe_program(fragment="#version 430\nnonsense"))
    checked_kit.buffer(bytes(64))


def test_a_silent_driver_is_asked_after_each_call(checked_kit: GlKit) -> None:
    backend = checked_kit.backend
    assert isinstance(backend, DebugGlBackend)
    assert not backend._debug.is_silent  # Mesa's isn't
    backend.gl.Disable(0x92E0)  # GL_DEBUG_OUTPUT
    backend._debug.is_silent = True
    buffer = checked_kit.buffer(bytes(64))
    with pytest.raises(DeviceError, match="GL_INVALID_VALUE"):
        backend.bind_uniform(NO_SLOT, buffer, 0, 64)
    backend.bind_uniform(0, buffer, 0, 64)
