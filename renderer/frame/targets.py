"""The textures of a frame, as its plan asks for them, kept from frame to frame."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from typing import Final

from renderer.frame.plan import SharedTexture, fit_size
from rhi import Device, Format, Texture

_Kind = tuple[Format, tuple[int, int], int]

IMAGE_FORMAT: Final = Format.RGBA8_SRGB
"""The format of a frame's image."""
DEPTH_FORMAT: Final = Format.D32F
"""The format of a frame's depth, unless a technique needs a stencil buffer."""


class Targets:
    """The textures that the passes of a frame draw to, by the names of their contents.

    A frame with another plan keeps the textures that it can use, and destroys the others. The texture of the image is
    created at once, so that a size that the device can't have is refused when it is set.

    Attributes:
        picture: the image at the size that is shown, if passes draw to a smaller or a larger one.
    """

    def __init__(self, device: Device, size: tuple[int, int], scale: float = 1.0) -> None:
        self._device = device
        self.picture: Texture | None = None
        self._textures: dict[_Kind, list[Texture]] = {}
        self._plan: Sequence[SharedTexture] | None = None
        self._held: dict[str, Texture] = {}
        self._last: dict[str, Texture] = {}  # of the last frame
        self._others: dict[str, Texture] = {}  # second textures of what is kept
        self._size = (0, 0)
        self.resize(size, scale)

    @property
    def size(self) -> tuple[int, int]:
        """The size (width, height) in pixels that passes draw at."""
        return self._size

    def resize(self, shown: tuple[int, int], scale: float = 1.0) -> None:
        """Create new textures, if need be, for images of the size `shown` that are drawn at `scale` of it."""
        size = fit_size(shown, scale)
        if size == self._size and shown == (size if self.picture is None else self.picture.size):
            return
        with ExitStack() as made:
            image = made.enter_context(self._device.texture(size, IMAGE_FORMAT, label="image"))
            picture = None if size == shown else self._device.texture(shown, IMAGE_FORMAT, label="picture")
            made.pop_all()
        self.destroy()
        self._size, self.picture = size, picture
        self._textures[IMAGE_FORMAT, size, 1] = [image]

    @property
    def image(self) -> Texture:
        """The image at the size that is shown."""
        return self.picture or self._held["image"]

    @property
    def depth(self) -> Texture:
        """The depth of the image."""
        return self._held["depth"]

    def __getitem__(self, name: str) -> Texture:
        """Return the texture with the contents `name`."""
        return self._held[name]

    def find(self, name: str) -> Texture | None:
        """Return the texture with the contents `name`, or None if the plan has no such contents."""
        return self._held.get(name)

    def last(self, name: str) -> Texture | None:
        """Return the texture with the contents `name` of the last frame, or None if its plan was another one."""
        return self._last.get(name)

    def provide(self, textures: Sequence[SharedTexture]) -> None:
        """Provide the textures of a frame's plan, before each frame. If one can't be created, all stay as they were."""
        if textures is not self._plan:
            if textures != self._plan:
                self._replace(textures)
                return
            self._plan = textures
        for name, other in self._others.items():
            self._last[name], self._held[name], self._others[name] = self._held[name], other, self._held[name]

    def _replace(self, textures: Sequence[SharedTexture]) -> None:
        free = {kind: list(some) for kind, some in self._textures.items()}
        used: dict[_Kind, list[Texture]] = {}
        held: dict[str, Texture] = {}
        others: dict[str, Texture] = {}
        with ExitStack() as made:

            def take(shared: SharedTexture) -> Texture:
                kind = (shared.format, fit_size(self._size, shared.scale), shared.samples)
                if free.get(kind):
                    texture = free[kind].pop(0)
                else:
                    format, size, samples = kind
                    texture = made.enter_context(
                        self._device.texture(size, format, samples=samples, label=shared.names[0])
                    )
                used.setdefault(kind, []).append(texture)
                return texture

            for shared in textures:
                held.update(dict.fromkeys(shared.names, take(shared)))
                if shared.kept:
                    others.update(dict.fromkeys(shared.names, take(shared)))
            made.pop_all()
        for some in free.values():
            for texture in some:
                texture.destroy()
        self._plan, self._textures, self._held, self._others, self._last = textures, used, held, others, {}

    def destroy(self) -> None:
        """Destroy all textures."""
        for some in self._textures.values():
            for texture in some:
                texture.destroy()
        self._textures, self._held, self._others, self._last, self._plan = {}, {}, {}, {}, None
        if self.picture is not None:
            self.picture.destroy()
            self.picture = None
