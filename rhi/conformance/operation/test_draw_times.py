"""The time that draws take: waits last as long, and timers show it."""

from __future__ import annotations

import pytest

from rhi import Device, Format
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle

pytestmark = pytest.mark.requires("draws", "shading")


def test_a_wait_lasts_as_long_as_the_work_before_it(device: Device) -> None:
    """The work grows until its signal was seen unfinished twice: then it is too long to finish before the
    wait."""
    unfinished = 0
    with device.texture((1024, 1024), Format.RGBA8) as image, device.mesh(rectangle()) as mesh:
        program = device.program(Colored)
        for instances in (8**n for n in range(4)):
            with device.render_pass(image, clear=(0, 0, 0, 0)):
                device.draw(program, mesh, instances)
            value = device.signal()
            unfinished += device.completed < value
            assert device.wait(value)
            device.signal()  # so `completed` queries the backend, and doesn't return the value waited for
            assert device.completed >= value
            if unfinished == 2:
                break


@pytest.mark.requires("timestamps")
def test_more_work_takes_more_time(device: Device) -> None:
    """Whole passes are timed: within a pass, a device that works tile by tile has no separate time for each
    draw.

    A busy machine can only add to a time. So the small work is the minimum of several runs, and the large
    work grows until it takes longer in spite of that.
    """
    with device.texture((1024, 1024), Format.RGBA8) as image, device.mesh(rectangle()) as mesh:
        program = device.program(Colored)

        def measure(instances: int) -> float:
            with device.event("pass"), device.render_pass(image):
                device.draw(program, mesh.view(0, 3), instances)
            device.present()
            device.finish()
            (node,) = device.timers
            return node.gpu_milliseconds

        device.present()  # earlier timings belong to the frame that ends here
        little = min(measure(1) for _ in range(5))
        assert little > 0
        assert any(measure(16**n) > 4 * little for n in range(1, 5))
