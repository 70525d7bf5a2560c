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
    """The textures that the passes of a frame draw to, by the names of the plan's resources.

    A frame with another plan keeps the textures that it can use, and destroys the others. The texture of the
    image is created at once, so that a size that the device can't have is refused when it is set.

    Attributes:
        output_image: the image at the size that is shown, if passes draw to a smaller or a larger one.
    """

    def __init__(self, device: Device, size: tuple[int, int], scale: float = 1.0) -> None:
        self._device = device
        self.output_image: Texture | None = None
        self._textures: dict[_Kind, list[Texture]] = {}
        self._plan: Sequence[SharedTexture] | None = None
        self._by_name: dict[str, Texture] = {}
        self._last: dict[str, Texture] = {}  # of the last frame
        self._others: dict[str, Texture] = {}  # second textures of what is kept
        self._size = (0, 0)
        self.resize(size, scale)

    @property
    def size(self) -> tuple[int, int]:
        """The size (width, height) in pixels that passes draw at."""
        return self._size

    def resize(self, output_size: tuple[int, int], scale: float = 1.0) -> None:
        """Create new textures, if needed, for output images of `output_size` that are drawn at `scale`."""
        size = fit_size(output_size, scale)
        if size == self._size and output_size == (
            size if self.output_image is None else self.output_image.size
        ):
            return
        with ExitStack() as stack:
            image = stack.enter_context(self._device.texture(size, IMAGE_FORMAT, label="image"))
            output_image = (
                None
                if size == output_size
                else self._device.texture(output_size, IMAGE_FORMAT, label="output image")
            )
            stack.pop_all()
        self.destroy()
        self._size, self.output_image = size, output_image
        self._textures[IMAGE_FORMAT, size, 1] = [image]

    @property
    def image(self) -> Texture:
        """The image at the output's size."""
        return self.output_image or self._by_name["image"]

    @property
    def depth(self) -> Texture:
        """The depth of the image."""
        return self._by_name["depth"]

    def __getitem__(self, name: str) -> Texture:
        """The texture of the resource `name`."""
        return self._by_name[name]

    def get(self, name: str) -> Texture | None:
        """The texture of the resource `name`; None if the plan has no such resource."""
        return self._by_name.get(name)

    def name(self, texture: Texture) -> str:
        """The name of a resource that a texture of the frame holds."""
        return next(name for name, other in self._by_name.items() if other is texture)

    def previous(self, name: str) -> Texture | None:
        """The texture of the resource `name` in the last frame; None if that had another plan, without a history of
        this resource."""
        return self._last.get(name)

    def provide(self, textures: Sequence[SharedTexture]) -> None:
        """Provide the textures of a frame's plan, before each frame. If one can't be created, all stay as
        they were."""
        if textures is not self._plan:
            if textures != self._plan:
                self._replace(textures)
                return
            self._plan = textures
        for name, other in self._others.items():
            self._last[name], self._by_name[name], self._others[name] = (
                self._by_name[name],
                other,
                self._by_name[name],
            )

    def _replace(self, textures: Sequence[SharedTexture]) -> None:
        free = {kind: list(textures_of_kind) for kind, textures_of_kind in self._textures.items()}
        used: dict[_Kind, list[Texture]] = {}
        by_name: dict[str, Texture] = {}
        others: dict[str, Texture] = {}
        last: dict[str, Texture] = {}
        histories = self._list_histories(textures)
        for name, pair in histories.items():
            for kind, textures_of_kind in free.items():
                if pair[0] in textures_of_kind:
                    free[kind] = [texture for texture in textures_of_kind if texture not in pair]
                    used.setdefault(kind, []).extend(pair)
            last[name], by_name[name] = others[name], _ = pair
        with ExitStack() as stack:

            def take(shared: SharedTexture) -> Texture:
                kind = (shared.format, fit_size(self._size, shared.scale), shared.samples)
                if free.get(kind):
                    texture = free[kind].pop(0)
                else:
                    format, size, samples = kind
                    texture = stack.enter_context(
                        self._device.texture(size, format, samples=samples, label=shared.names[0])
                    )
                used.setdefault(kind, []).append(texture)
                return texture

            for shared in textures:
                if shared.names[0] in histories:
                    continue
                by_name.update(dict.fromkeys(shared.names, take(shared)))
                if shared.has_history:
                    others.update(dict.fromkeys(shared.names, take(shared)))
            stack.pop_all()
        for textures_of_kind in free.values():
            for texture in textures_of_kind:
                texture.destroy()
        self._plan = textures
        self._textures = used
        self._by_name = by_name
        self._others = others
        self._last = last

    def _list_histories(self, textures: Sequence[SharedTexture]) -> dict[str, tuple[Texture, Texture]]:
        """The two textures of each resource whose history another plan goes on with: the last frame's, and that of the
        frame before."""
        before = {shared.names: shared for shared in self._plan or () if shared.has_history}
        return {
            shared.names[0]: (self._by_name[shared.names[0]], self._others[shared.names[0]])
            for shared in textures
            if len(shared.names) == 1 and before.get(shared.names) == shared
        }

    def destroy(self) -> None:
        """Destroy all textures."""
        for textures in self._textures.values():
            for texture in textures:
                texture.destroy()
        self._plan = None
        self._textures = {}
        self._by_name = {}
        self._others = {}
        self._last = {}
        if self.output_image is not None:
            self.output_image.destroy()
            self.output_image = None
