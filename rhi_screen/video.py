"""Videos of images, by FFmpeg's libraries (PyAV, `pip install "rhi[video]"`).

    with VideoWriter("turn.mp4", 30) as video:
        for angle in angles:
            video.add(draw(angle))

The container follows from the file's name, and the codec from the container: H.264 for .mp4, VP9 for .webm.
"""

from __future__ import annotations

from fractions import Fraction
from os import PathLike
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

import rhi
from rhi.errors import DeviceError, refuse
from rhi.errors.arguments import ArgumentChecker
from rhi_screen.rules import SCREEN_MISSING, VIDEO_FILE, VIDEO_IMAGE, VIDEO_SIZE

_MIN_RATE: Final = 0.001
_MAX_RATE: Final = 1000.0


class VideoWriter:
    """A file that images are added to, one for each frame of the video. Use it in a `with` block, or call
    `close`.

    Attributes:
        path: the file.
        frames: how many images were added.
    """

    def __init__(self, path: str | Path, fps: float = 30.0, *, comment: str = "") -> None:
        """
        Args:
            path: the file; its folder is made.
            fps: frames a second.
            comment: a text that is stored in the file; `read_comment` returns it.

        Raises:
            DeviceError: `screen-missing` without PyAV.
            ValidationError: `device-argument` for a path that is none, or a rate outside of 0.001 to 1,000
                frames a second; `video-file` for a file that can't be written, or a name of another
                container.
        """
        check = ArgumentChecker("VideoWriter")
        if not isinstance(path, (str, PathLike)):
            check.fail("path", path, "the path of a file")
        path = Path(path)
        rate = Fraction(check.number("fps", fps, _MIN_RATE, _MAX_RATE)).limit_denominator(1001)
        try:
            import av
        except ImportError as error:
            raise DeviceError(
                SCREEN_MISSING, "VideoWriter", "PyAV", "", 'pip install "rhi[video]"'
            ) from error
        self.path = path
        self.frames = 0
        self._rate = rate
        self._library = av
        self._file: Any = None
        self._stream: Any = None
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = av.open(str(self.path), "w")
            if self._file.default_video_codec == "none":
                self._file.close()
                self._file = None
                raise ValueError("its container has no video")
            if comment:
                self._file.metadata["comment"] = comment
        except (OSError, ValueError, av.FFmpegError) as error:
            refuse(VIDEO_FILE, "VideoWriter", f"{path}: {error}")

    def add(self, image: rhi.Texture | NDArray[np.uint8]) -> None:
        """Add an image as the next frame.

        Args:
            image: a texture of 8-bit colors, or (height, width, 3 or 4) uint8, top row first. All have the
                size of the first one. A last row or column that makes a size odd is left out: most codecs
                take even ones.

        Raises:
            ValidationError: `video-image` for anything else, and after `close`; `video-size` for an image of
                another size, or below 2×2.
        """
        if self._file is None:
            refuse(
                VIDEO_IMAGE, "VideoWriter.add", "an image after close()", "images before the file is finished"
            )
        texels = read_colors(image, "VideoWriter.add")
        height, width = (length & ~1 for length in texels.shape[:2])
        if self._stream is None and min(width, height) > 0:
            self._stream = self._file.add_stream(self._file.default_video_codec, rate=self._rate)
            self._stream.width, self._stream.height, self._stream.pix_fmt = width, height, "yuv420p"
        expected = (self._stream.width, self._stream.height) if self._stream is not None else "at least 2×2"
        if (width, height) != expected:
            refuse(VIDEO_SIZE, "VideoWriter.add", f"{texels.shape[1]}×{texels.shape[0]}", str(expected))
        colors = np.ascontiguousarray(texels[:height, :width, :3])
        for packet in self._stream.encode(self._library.VideoFrame.from_ndarray(colors, format="rgb24")):
            self._file.mux(packet)
        self.frames += 1

    @classmethod
    def check(cls, path: Path, fps: float) -> None:
        """Refuse what `VideoWriter(path, fps)` would; nothing is left in the file's folder."""
        part = path.with_name(f"{path.stem}.part{path.suffix}")
        cls(part, fps).close()
        part.unlink(missing_ok=True)

    @property
    def is_closed(self) -> bool:
        """True if the file is finished."""
        return self._file is None

    def close(self) -> None:
        """Finish the file. A second call does nothing."""
        if self._file is None:
            return
        if self._stream is not None:
            for packet in self._stream.encode():
                self._file.mux(packet)
        self._file.close()
        self._file = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self.close()


def read_colors(image: rhi.Texture | NDArray[np.uint8], call: str) -> NDArray[np.uint8]:
    """Return the texels of an image, (height, width, 3 or 4) uint8.

    Raises:
        ValidationError: `video-image` for anything else.
    """
    check = ArgumentChecker(call, rule=VIDEO_IMAGE)
    texels = image.read() if isinstance(image, rhi.Texture) else check.array("image", image)
    if texels.ndim != 3 or texels.shape[2] not in (3, 4) or texels.dtype != np.uint8:
        actual = repr(image) if isinstance(image, rhi.Texture) else f"shape {texels.shape} of {texels.dtype}"
        refuse(VIDEO_IMAGE, call, actual, "(height, width, 3 or 4) of uint8")
    return texels


def read_comment(path: Path) -> str:
    """Return the comment of a video; "" if it has none, or there is no such file."""
    try:
        import av

        with av.open(str(path)) as file:
            return str(file.metadata.get("comment", ""))
    except (ImportError, OSError, av.FFmpegError):
        return ""
