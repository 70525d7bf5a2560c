"""Images of materials within a budget of memory: each has the mip levels that the view reads, as far as they fit.

An image is in one of several array textures, which hold images of one size: the image's own, or half of it, or a
quarter, as many as a shader can bind. An image without its finest level is a layer of the array of half the size,
whose levels are those of the image from its second one on. So no shader knows of it: the row of a texture leads to
another array and layer. The coarsest arrays have all images at all times.

In each frame, `advance` chooses the levels that images should have:

1. Each image has what the view reads of it (`TextureNeeds`), and finer levels that it has already.
2. If that is more than the budget, levels that aren't needed are released, those first that haven't been needed for
   longest.
3. If what is needed is more than the budget, images lose one level each, the smallest on the screen first. Only when
   all have lost one does any lose a second.

An array gets another number of layers by being created anew; its images are copied. While there is no room for both, it
is released before, and its images are those of the coarsest arrays until they are uploaded again. Layers are uploaded
within the bytes of a frame, what is large on the screen first, and shaders read them once they are whole.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.frame.texture_needs import OUT_OF_VIEW, TextureNeeds, ViewNeeds
from renderer.scene import Camera
from rhi import CompressedFormat, Device, Format, Region, Texture, TextureKind

_BLOCK: Final = 4
Size = tuple[int, int]


@dataclass(frozen=True, slots=True)
class ArrayKind:
    """The kind of an array of images: its size, format and number of levels, whether it holds colours, and whether all
    of the images that end there are always in it."""

    size: Size
    format: Format | CompressedFormat
    levels: int
    is_color: bool
    is_coarsest: bool

    @property
    def layer_bytes(self) -> int:
        """The bytes of a layer with its levels."""
        return sum(self.level_bytes(level) for level in range(self.levels))

    def level_bytes(self, level: int) -> int:
        """The bytes of a level of a layer."""
        width, height = (max(side >> level, 1) for side in self.size)
        if isinstance(self.format, CompressedFormat):
            return -(-width // _BLOCK) * -(-height // _BLOCK) * self.format.block_bytes
        return width * height * self.format.transfer_bytes


@dataclass(frozen=True, slots=True)
class StreamedImage:
    """An image that is streamed.

    Attributes:
        kinds: the kinds of arrays that may hold it, from all of its levels to the coarsest.
        levels: the texels or blocks of all of its levels.
    """

    kinds: tuple[ArrayKind, ...]
    levels: tuple[NDArray[Any], ...]

    def fill(self, coarsest: Texture, layer: int) -> None:
        """Write the levels that the coarsest array has."""
        for level, rows in enumerate(self.levels[len(self.kinds) - 1 :]):
            coarsest.write(rows, level, layer)


@dataclass(frozen=True, slots=True)
class StreamingReport:
    """The state of streamed images.

    Attributes:
        bytes: the memory of all arrays.
        budget: the memory that they may have. The coarsest arrays exist in any case.
        full_bytes: the memory that they would have with all levels of all images.
        waiting: the number of images that lack a level which will be uploaded.
        reduced: the number of images that lack a level for which there is no memory.
        lost_levels: the most levels that one lacks for that reason.
    """

    bytes: int
    budget: int
    full_bytes: int
    waiting: int
    reduced: int
    lost_levels: int

    def describe(self) -> str:
        """The levels that images lack, as a sentence; an empty text if they lack none."""
        if self.reduced:
            return f"{self.reduced} images lack up to {self.lost_levels} levels: no memory"
        return f"{self.waiting} images get finer" if self.waiting else ""


@dataclass(slots=True)
class _LayerArray:
    texture: Texture
    layers: dict[int, int]  # by image
    whole: set[int]  # the images whose layer is uploaded
    done: dict[int, tuple[int, int]] = field(default_factory=dict)  # by image, the levels and rows that are


class ImageStream:
    """The arrays of streamed images, and what they hold.

    Attributes:
        kinds: the kinds of arrays, in a fixed order.
        level: (e,) the finest level of each image that shaders read.
        version: counts changes of arrays and layers.
    """

    def __init__(
        self,
        device: Device,
        images: Sequence[StreamedImage],
        needs: TextureNeeds,
        budget: int,
        frame_bytes: float,
    ) -> None:
        """Create the coarsest arrays with all images. `frame_bytes` is the most that a frame uploads; infinity for what
        it needs."""
        self._device, self._images, self._needs = device, tuple(images), needs
        self._budget, self._frame_bytes = budget, frame_bytes
        self.kinds = tuple(dict.fromkeys(kind for image in images for kind in image.kinds))
        self._most: NDArray[np.int64] = np.array([len(image.kinds) - 1 for image in images], np.int64)
        self.level = self._most.copy()
        self._target = self._most.copy()
        self._used: NDArray[np.int64] = np.full(len(images), -1)
        self._frame, self.version = 0, 0
        self._seen: tuple[object, ...] = ()
        self._view = ViewNeeds(self._most.copy(), np.zeros(len(images)))
        self._arrays: dict[ArrayKind, _LayerArray] = {}
        self._empty: dict[ArrayKind, Texture] = {}
        self._retired: list[tuple[int, int]] = []  # of destroyed arrays, a fence value and their bytes
        for kind in self.kinds:
            members = [number for number, image in enumerate(images) if image.kinds[-1] == kind]
            if members and kind.is_coarsest:
                array = self._create(kind, members)
                for number, layer in array.layers.items():
                    images[number].fill(array.texture, layer)
                array.whole.update(members)
            else:
                self._empty[kind] = self._make_texture(kind, 1, is_empty=True)

    def get_texture(self, kind: ArrayKind) -> Texture:
        """The array of a kind; a small one that no shader reads if it has no images."""
        array = self._arrays.get(kind)
        return self._empty[kind] if array is None else array.texture

    def get_layer(self, image: int) -> int:
        """The layer in which shaders read an image."""
        return self._arrays[self._images[image].kinds[self.level[image]]].layers[image]

    def get_kind(self, image: int) -> ArrayKind:
        """The kind of array in which shaders read an image."""
        return self._images[image].kinds[int(self.level[image])]

    @property
    def bytes(self) -> int:
        """The memory of the arrays that have images."""
        return sum(len(array.layers) * kind.layer_bytes for kind, array in self._arrays.items())

    @property
    def report(self) -> StreamingReport:
        """The state after the last frame."""
        needed = np.minimum(self._view.levels, self._most)
        lost = np.maximum(self._target - needed, 0)
        full = sum(
            image.kinds[0].layer_bytes + (image.kinds[-1].layer_bytes if len(image.kinds) > 1 else 0)
            for image in self._images
        )
        waiting = int((self.level > self._target).sum())
        return StreamingReport(
            self.bytes, self._budget, full, waiting, int((lost > 0).sum()), int(lost.max(initial=0))
        )

    @property
    def is_done(self) -> bool:
        """True once each image has the levels that the last view reads, as far as there is memory."""
        return not (self.level > self._target).any()

    def needs_work(self, cameras: Sequence[Camera], size: Size) -> bool:
        """Return whether a frame through these cameras reads other levels, or is to upload some. The scene is that of
        the last frame."""
        if self._describe(cameras, size) == self._seen:
            return not self.is_done
        view = self._needs.measure(cameras, size)
        return not self.is_done or bool((np.minimum(view.levels, self._most) < self._target).any())

    def advance(self, cameras: Sequence[Camera], size: Size) -> bool:
        """Choose the levels that images should have, and upload as much as a frame may; return whether an array or a
        layer has changed."""
        self._frame += 1
        self._seen = self._describe(cameras, size)
        self._view = self._needs.measure(cameras, size)
        version = self.version
        needed = np.minimum(self._view.levels, self._most)
        self._used[self._view.levels < OUT_OF_VIEW] = self._frame
        self._target = self._choose_levels(needed)
        self._reshape()
        self._upload()
        return self.version != version

    def destroy(self) -> None:
        """Destroy the arrays."""
        for array in self._arrays.values():
            array.texture.destroy()
        for texture in self._empty.values():
            texture.destroy()
        self._arrays, self._empty = {}, {}

    def _describe(self, cameras: Sequence[Camera], size: Size) -> tuple[object, ...]:
        return size, *(
            (camera.position.tobytes(), camera.rotation.tobytes(), camera.projection) for camera in cameras
        )

    def _choose_levels(self, needed: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the finest levels (e,) that images should have."""
        selected = np.minimum(needed, self._target)
        excess = self._count_bytes(selected) - self._budget
        if excess <= 0:
            return selected
        for image in np.argsort(self._used, kind="stable").tolist():  # what was needed long ago
            while selected[image] < needed[image] and excess > 0:
                excess -= self._count_savings(image, int(selected[image]))
                selected[image] += 1
        smallest = np.argsort(self._view.sizes, kind="stable").tolist()
        for lost in range(int(self._most.max(initial=0))):
            for image in smallest:
                if excess <= 0:
                    return selected
                if selected[image] - needed[image] == lost and selected[image] < self._most[image]:
                    excess -= self._count_savings(image, int(selected[image]))
                    selected[image] += 1
        return selected

    def _count_layer(self, image: int, level: int) -> int:
        """The bytes that an image with this finest level takes beside its layer of the coarsest array."""
        kinds = self._images[image].kinds
        return 0 if level == len(kinds) - 1 else kinds[level].layer_bytes

    def _count_savings(self, image: int, level: int) -> int:
        return self._count_layer(image, level) - self._count_layer(image, level + 1)

    def _count_bytes(self, levels: NDArray[np.int64]) -> int:
        coarsest = sum(image.kinds[-1].layer_bytes for image in self._images)
        return coarsest + sum(self._count_layer(image, int(level)) for image, level in enumerate(levels))

    def _reshape(self) -> None:
        """Give the arrays layers for the images that should be in them."""
        requested: dict[ArrayKind, list[int]] = {kind: [] for kind in self.kinds if not kind.is_coarsest}
        for image, level in enumerate(self._target.tolist()):
            kind = self._images[image].kinds[level]
            if not kind.is_coarsest:
                requested[kind].append(image)
        left = {kind for kind, members in requested.items() if self._differs(kind, members)}
        while left:
            ascending = sorted(left, key=lambda kind: kind.layer_bytes)
            done = {kind for kind in ascending if self._fit(kind, requested[kind])}
            left -= done
            if left and not done:
                # Nothing fits beside what it replaces: release the largest array that isn't as it should be.
                differing = [kind for kind, members in requested.items() if self._differs(kind, members)]
                largest = max(differing, key=self._count_array)
                self._release(largest)
                left.add(largest)

    def _count_array(self, kind: ArrayKind) -> int:
        array = self._arrays.get(kind)
        return 0 if array is None else len(array.layers) * kind.layer_bytes

    def _differs(self, kind: ArrayKind, members: Sequence[int]) -> bool:
        array = self._arrays.get(kind)
        return set(members) != set(() if array is None else array.layers)

    def _fit(self, kind: ArrayKind, members: Sequence[int]) -> bool:
        """Exchange an array for one with these images, if both have room beside the others; return whether."""
        # What leaves the array stays until it is elsewhere, if there is room.
        old = self._arrays.get(kind)
        leaving: list[int] = []
        if old is not None:
            leaving = [image for image in old.whole - set(members) if self.get_kind(image) == kind]
            if set(members) | set(leaving) == set(old.layers) or (leaving and not members):
                return True
        if not members:
            self._release(kind)
            return True
        room = self._budget - self.bytes - self._retired_bytes
        if len(members) * kind.layer_bytes > room and self._retired:
            self._device.wait(self._retired[-1][0])
            room = self._budget - self.bytes - self._retired_bytes
        if len(members) * kind.layer_bytes > room:
            return False
        if (len(members) + len(leaving)) * kind.layer_bytes <= room:
            members = [*members, *leaving]
        array = self._create(kind, members, replaced=old)
        if old is not None:
            self._drop(kind, old, lost=old.whole - array.whole)
        self._arrays[kind] = array
        return True

    def _create(
        self, kind: ArrayKind, members: Sequence[int], replaced: _LayerArray | None = None
    ) -> _LayerArray:
        """Create an array with these images, of which those in the array that it replaces are copied."""
        self.version += 1
        array = _LayerArray(
            self._make_texture(kind, len(members)),
            {image: layer for layer, image in enumerate(members)},
            set(),
        )
        self._arrays[kind] = array
        if replaced is not None and isinstance(kind.format, Format):
            for image in replaced.whole & set(members):
                self._copy(kind, replaced, image, array, range(kind.levels), 0)
                array.whole.add(image)
        return array

    def _make_texture(self, kind: ArrayKind, layers: int, *, is_empty: bool = False) -> Texture:
        return self._device.texture(
            (_BLOCK, _BLOCK) if is_empty else kind.size,
            kind.format,
            kind=TextureKind.D2_ARRAY,
            layers=layers,
            levels=1 if is_empty else kind.levels,
            label="images" if kind.is_color else "maps",
        )

    def _copy(
        self,
        kind: ArrayKind,
        source: _LayerArray,
        image: int,
        target: _LayerArray,
        levels: range,
        source_level: int,
    ) -> None:
        """Copy levels of an image to those of another array, from a level of the source on."""
        for at, level in enumerate(levels):
            width, height = (max(side >> level, 1) for side in kind.size)
            region = Region(0, 0, width, height, source.layers[image])
            source.texture.copy_to(
                target.texture,
                level=source_level + at,
                region=region,
                target_level=level,
                layer=target.layers[image],
            )

    def _release(self, kind: ArrayKind) -> None:
        """Destroy an array; its images are read where they are coarsest."""
        array = self._arrays.pop(kind, None)
        if array is not None:
            self._drop(kind, array, lost=array.whole)

    def _drop(self, kind: ArrayKind, array: _LayerArray, lost: set[int]) -> None:
        """Destroy the texture of an array of which these images are lost."""
        self.version += 1
        for image in lost:
            if self.get_kind(image) == kind:
                self.level[image] = self._most[image]
        array.texture.destroy()
        self._retired.append((self._device.signal(), len(array.layers) * kind.layer_bytes))

    @property
    def _retired_bytes(self) -> int:
        """The memory of destroyed arrays that the device may still use."""
        completed = self._device.completed
        self._retired = [entry for entry in self._retired if entry[0] > completed]
        return sum(size for _, size in self._retired)

    def _upload(self) -> None:
        """Upload layers, what is large on the screen first, and have shaders read those that are whole."""
        left = self._frame_bytes
        waiting = np.flatnonzero(self.level != self._target)
        for image in waiting[np.argsort(-self._view.sizes[waiting], kind="stable")].tolist():
            kind = self._images[image].kinds[int(self._target[image])]
            array = self._arrays.get(kind)
            if array is None or image not in array.layers:
                continue
            if image not in array.whole:
                left -= self._write(kind, array, image, left)
            if image in array.whole:
                self.level[image] = self._target[image]
                self.version += 1
            if left <= 0:
                break
        self._tidy()

    def _tidy(self) -> None:
        """Release the arrays that hold nothing that is read or should be."""
        for kind in [kind for kind in self._arrays if not kind.is_coarsest]:
            if all(
                kind not in (self.get_kind(image), self._images[image].kinds[int(self._target[image])])
                for image in self._arrays[kind].layers
            ):
                self._release(kind)

    def _write(self, kind: ArrayKind, array: _LayerArray, image: int, most: float) -> int:
        """Write rows of a layer of at most so many bytes, from the finest level on; return their bytes."""
        streamed = self._images[image]
        finest = streamed.kinds.index(kind)
        level, row = array.done.get(image, (0, 0))
        written, is_compressed = 0, isinstance(kind.format, CompressedFormat)
        count = kind.levels if is_compressed else len(streamed.kinds) - 1 - finest
        while level < count:
            rows = streamed.levels[finest + level]
            pitch = rows[0].nbytes
            number = len(rows) - row
            if most < inf:
                least = 1 if most == self._frame_bytes and not written else 0  # so that wide rows get there
                number = min(number, max(int((most - written) // pitch), least))
            if number <= 0:
                break
            y = row * (_BLOCK if is_compressed else 1)
            array.texture.write(rows[row : row + number], level, array.layers[image], y=y)
            written, row = written + number * pitch, row + number
            if row == len(rows):
                level, row = level + 1, 0
        array.done[image] = level, row
        if level == count:
            del array.done[image]
            array.whole.add(image)
            coarsest = self._arrays[streamed.kinds[-1]]
            if not is_compressed:
                self._copy(kind, coarsest, image, array, range(count, kind.levels), 0)
        return written


def list_kinds(
    size: Size, format: Format | CompressedFormat, levels: int, is_color: bool, most: int
) -> tuple[ArrayKind, ...]:
    """The kinds of arrays for an image, at most so many: of its size, and of halves that have all of its texels'
    edges."""
    kinds = [ArrayKind(size, format, levels, is_color, False)]
    step = 2 * (_BLOCK if isinstance(format, CompressedFormat) else 1)
    while len(kinds) < most and levels > 1 and not (size[0] % step or size[1] % step):
        size, levels = (size[0] // 2, size[1] // 2), levels - 1
        kinds.append(ArrayKind(size, format, levels, is_color, False))
    last = kinds[-1]
    kinds[-1] = ArrayKind(last.size, last.format, last.levels, is_color, True)
    return tuple(kinds)
