"""Render targets as large as a screen: they are made again when it is resized.

    targets = screen.targets(depth=Format.D32F, samples=4)
    def draw():
        with targets.render_pass(clear=(0, 0, 0, 1)):
            device.draw(...)
        screen.show(targets.image)

The textures of an old size are destroyed, which the GPU may still read: they go when it has finished. All are
destroyed with the screen.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import Protocol

from rhi import Device, Format, RenderPass, Texture


class ResizableScreen(Protocol):
    """A screen as targets see it: a device, and a size that may change."""

    @property
    def device(self) -> Device:
        """The device."""
        ...

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels, as of now."""
        ...


class ScreenTargets:
    """Textures of a screen's size. Those that are read here have the size that the screen has then.

    Attributes:
        samples: of each texel that is drawn to.
    """

    def __init__(
        self,
        screen: ResizableScreen,
        color: Format | Sequence[Format] = Format.RGBA8,
        depth: Format | None = None,
        samples: int = 1,
    ) -> None:
        """
        Args:
            screen: a screen; or anything with a device and a size.
            color: the format, or one for each color target.
            depth: the format of the depth target; None: there is none.
            samples: above 1, passes draw to multi-sampled textures and resolve them at their end.
        """
        self.samples = samples
        self._screen = screen
        self._formats = (color,) if isinstance(color, Format) else tuple(color)
        self._depth_format = depth
        self._drawn: list[Texture] = []
        self._images: list[Texture] = []
        self._depth: Texture | None = None

    @property
    def images(self) -> tuple[Texture, ...]:
        """The color textures, of one sample: what passes have drawn."""
        self._fit()
        return tuple(self._images)

    @property
    def image(self) -> Texture:
        """The first color texture, of one sample: what is shown."""
        return self.images[0]

    @property
    def depth(self) -> Texture | None:
        """The depth texture, with all its samples."""
        self._fit()
        return self._depth

    def render_pass(
        self,
        clear: Sequence[float] | Sequence[Sequence[float] | None] | None = None,
        clear_depth: float = 0.0,
        *,
        label: str = "",
    ) -> RenderPass:
        """Return a render pass to these targets.

        Args:
            clear: the color, or one for each target; None: what was drawn before stays, depth as well.
            clear_depth: the depth that is cleared with it, and a stencil of 0; 0 is the far end.
            label: the name of the pass in tools.
        """
        self._fit()
        cleared = clear is not None and self._depth is not None
        stencil = cleared and self._depth is not None and self._depth.format.has_stencil
        return self._screen.device.render_pass(
            self._drawn,
            self._depth,
            clear=clear,
            clear_depth=clear_depth if cleared else None,
            clear_stencil=0 if stencil else None,
            resolve=self._images if self.samples > 1 else None,
            label=label,
        )

    def destroy(self) -> None:
        """Destroy the textures. They are made again if they are asked for."""
        textures = {*self._drawn, *self._images, self._depth} - {None}
        self._drawn, self._images, self._depth = [], [], None
        for texture in textures:
            assert texture is not None
            texture.destroy()

    def _fit(self) -> None:
        """Make the textures again if the screen has another size: all of them, or none if one can't be
        made."""
        size = self._screen.size
        if self._images and self._images[0].size == size:
            return
        device = self._screen.device
        with ExitStack() as created:

            def make(format: Format, samples: int, label: str) -> Texture:
                return created.enter_context(device.texture(size, format, samples=samples, label=label))

            drawn = [make(color_format, self.samples, "screen color") for color_format in self._formats]
            images = drawn
            if self.samples > 1:
                images = [make(color_format, 1, "screen image") for color_format in self._formats]
            depth = (
                None if self._depth_format is None else make(self._depth_format, self.samples, "screen depth")
            )
            created.pop_all()
        self.destroy()
        self._drawn, self._depth = drawn, depth
        self._images = images  # the last one, since it tells whether all are made
