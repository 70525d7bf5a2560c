"""Targets of a screen whose creation fails or is interrupted: all are made, or none."""

from __future__ import annotations

from typing import Any

import pytest

from rhi import Device, Format, Texture, create_device
from rhi_screen.targets import ScreenTargets


class Stopping:
    """A device whose `stop`-th texture isn't made."""

    def __init__(self, device: Device, error: type[BaseException]) -> None:
        self._device = device
        self._error = error
        self.stop = -1

    def texture(self, *arguments: Any, **named: Any) -> Texture:
        """Make a texture, or raise."""
        self.stop -= 1
        if self.stop == 0:
            raise self._error
        return self._device.texture(*arguments, **named)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)


class Resized:
    """A screen of any size."""

    def __init__(self, device: Any) -> None:
        self.device = device
        self.size = (32, 16)


@pytest.mark.parametrize("error", [MemoryError, KeyboardInterrupt])
@pytest.mark.parametrize("samples", [1, 4])
@pytest.mark.parametrize("depth", [None, Format.D24S8], ids=str)
@pytest.mark.parametrize("colors", [(Format.RGBA8,), (Format.RGBA16F, Format.R32UI, Format.RG8)], ids=len)
@pytest.mark.parametrize("resized", [False, True], ids=["at first", "resized"])
def test_after_a_creation_that_was_stopped_all_targets_are_made(
    error: type[BaseException], samples: int, depth: Format | None, colors: tuple[Format, ...], resized: bool
) -> None:
    count = len(colors) * (1 if samples == 1 else 2) + (depth is not None)
    with create_device("null") as device:
        for stop in range(1, count + 1):
            stopping = Stopping(device, error)
            screen = Resized(stopping)
            targets = ScreenTargets(screen, colors, depth, samples)
            before = targets.images if resized else ()
            screen.size = (8, 4)
            living = set(device._core.timeline.living)
            stopping.stop = stop
            with pytest.raises(error):
                _ = targets.image
            assert set(device._core.timeline.living) == living, "what was made is taken back"
            images, depth_target = targets.images, targets.depth
            assert [image.format for image in images] == [*colors]
            assert all(
                image.samples == 1 and image.size == (8, 4) and not image.destroyed for image in images
            )
            assert (None if depth_target is None else depth_target.format) is depth
            assert depth_target is None or depth_target.samples == samples
            assert all(image.destroyed for image in before)
            if Format.R32UI not in colors or samples == 1:
                with targets.render_pass((0, 0, 0, 1)):
                    pass
            targets.destroy()
            assert targets.image.size == (8, 4)
            targets.destroy()
