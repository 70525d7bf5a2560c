"""Fixtures of the interface's own tests."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from null_kit import Camera, Kit, Object, hand_made_program

import rhi


@pytest.fixture
def kit() -> Iterator[Kit]:
    with rhi.create_device("null") as device:
        positions = np.array([[-1, -1], [1, -1], [0, 1]], np.float32)
        yield Kit(
            device,
            device.program(hand_made_program()),
            device.mesh({"position": positions}),
            device.texture((8, 8), rhi.Format.RGBA8),
            device.uniform(Camera(tint=(1, 1, 1, 1))),
            device.uniform_array(Object, 4),
        )
