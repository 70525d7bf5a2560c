"""Assets by content: an image or a mesh that several files hold is one array, however often it is loaded.

An asset's id is a hash of its content: of an image's encoded bytes, so that it is decoded once, or of a
mesh's vertices and indices. An asset lives as long as a scene or a builder uses it. `SceneBuilder` adds the
same array once.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from math import inf
from typing import Any, Final, TypeVar
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from renderer.content import ktx2
from renderer.content.progress import report
from renderer.content.radiance import SIGNATURES, decode_radiance
from renderer.content.thread_maps import map_in_threads
from renderer.scene.images import ImageBlocks, ImagePixels, check_image
from renderer.scene.meshes import MeshGeometry
from rhi import ValidationError, decode_colors, open_image
from rhi.errors.shared_caches import SHARED

_Asset = TypeVar("_Asset")

_images: Final[WeakValueDictionary[bytes, Any]] = WeakValueDictionary()
_meshes: Final[WeakValueDictionary[bytes, MeshGeometry]] = WeakValueDictionary()


def decode_images(encoded: Iterable[NDArray[np.uint8]]) -> list[ImagePixels | ImageBlocks | str]:
    """Return the pixels of images (of `rhi.open_image`) or their blocks, or the reason why one can't be read.

    Each content is decoded once, in threads where Python has them.
    """
    contents = list(encoded)
    ids = [hash_content(content) for content in contents]
    decoded: dict[bytes, ImagePixels | ImageBlocks | str] = {
        key: pixels for key in ids if (pixels := _images.get(key)) is not None
    }
    missing = {key: content for key, content in zip(ids, contents, strict=True) if key not in decoded}
    with map_in_threads(_decode, missing.values()) as results:
        for number, (key, pixels) in enumerate(zip(missing, results, strict=True)):
            report("images", number, len(missing))
            decoded[key] = pixels if isinstance(pixels, str) else _share(_images, key, pixels)
    return [decoded[key] for key in ids]


def share_image(pixels: ImagePixels) -> ImagePixels:
    """Return the image with the same pixels that is in use already, or this one."""
    key = hash_content(repr(pixels.shape).encode(), pixels.reshape(-1))
    return _share(_images, key, pixels)


def share_geometry(geometry: MeshGeometry) -> MeshGeometry:
    """Return the mesh with the same content that is in use already, or this one."""
    vertices = geometry.vertices
    key = hash_content(
        repr(vertices.dtype).encode(), vertices.view(np.uint8), geometry.indices.view(np.uint8)
    )
    return _share(_meshes, key, geometry)


def _share(assets: WeakValueDictionary[bytes, _Asset], key: bytes, asset: _Asset) -> _Asset:
    """Return the asset of this id that is in use already, on any thread, or this one."""
    with SHARED:
        return assets.setdefault(key, asset)


def hash_content(*parts: bytes | NDArray[np.uint8]) -> bytes:
    """Return the id of a content: a hash of 16 bytes."""
    digest = hashlib.blake2b(digest_size=16)
    for part in parts:
        digest.update(len(part).to_bytes(8, "little"))
        digest.update(part if isinstance(part, bytes) else np.ascontiguousarray(part).data)
    return digest.digest()


def _decode(content: NDArray[np.uint8]) -> ImagePixels | ImageBlocks | str:
    try:
        if content[: len(ktx2.SIGNATURE)].tobytes() == ktx2.SIGNATURE:
            return ktx2.decode_ktx2(content.tobytes())
        if content[: len(SIGNATURES[0])].tobytes().startswith(SIGNATURES):
            return check_image(decode_radiance(content.tobytes()))
        with open_image(content.data, max_pixels=inf) as image:  # `Budget` has counted its pixels
            return decode_colors(image)
    except ValidationError as error:
        return error.given.partition(": ")[2] or error.given  # without the number of bytes
    except (ValueError, IndexError) as error:
        return str(error)
