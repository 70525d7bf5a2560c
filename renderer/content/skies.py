"""Images for environments: a sky that is painted, and files of Radiance (`.hdr`) and OpenEXR (`.exr`)."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.content.radiance import decode_radiance
from renderer.scene.environment import Environment, texel_directions
from renderer.scene.files import read_file
from renderer.scene.scene_builder import SceneBuilder
from rhi.errors import refuse

_MAX_BYTES: Final = 1 << 30
_HEIGHT: Final = 256
_ZENITH, _HORIZON, _GROUND = (0.13, 0.27, 0.60), (0.72, 0.80, 0.90), (0.20, 0.18, 0.15)
_HALO: Final = (1.0, 0.86, 0.66)


def paint_sky(to_sun: tuple[float, float, float] = (0.55, 0.62, 0.50), height: int = _HEIGHT) -> NDArray[Any]:
    """Paint a clear sky, bright at the horizon and around the sun, and the ground below it.

    Args:
        to_sun: the direction to the sun, whose own disc isn't painted: a directional light has its light.
        height: the rows of the image, which has twice as many columns.
    """
    directions = texel_directions(height, 2 * height)
    rise = directions[..., 1:2]
    toward = np.asarray(to_sun, np.float64) / np.linalg.norm(to_sun)
    near = np.clip(directions @ toward, 0.0, 1.0)[..., None]
    share = np.clip(rise, 0.0, 1.0) ** 0.45
    sky = np.array(_HORIZON) * (1.0 - share) + np.array(_ZENITH) * share
    sky = sky + np.array(_HALO) * (0.35 * near**8 + 1.5 * near**200)
    ground = np.array(_GROUND) * (1.0 + 0.6 * np.exp(8.0 * np.minimum(rise, 0.0)))
    return np.where(rise > 0.0, sky, ground).astype(np.float32)


def add_sky(builder: SceneBuilder, strength: float) -> None:
    """Put a painted sky of this strength around a scene unless it is 0; its name then says so."""
    if strength:
        builder.environment = Environment(paint_sky(), intensity=strength)
        builder.name += f",environment={strength:g}"


def read_environment(path: str | Path) -> NDArray[Any]:
    """Read the image of an environment: linear light (height, width, 3), float32.

    Args:
        path: a file of Radiance (`.hdr`), or one of OpenEXR (`.exr`), which needs the package `OpenEXR` (the
            extra `environments`).

    Raises:
        ValidationError: `scene-environment-file` if the file can't be read, or isn't such an image, or its
            package is missing.
    """
    call = f"read_environment({str(path)!r})"
    suffix = Path(path).suffix.lower()
    if suffix not in (".hdr", ".exr"):
        refuse(rules.BAD_ENVIRONMENT_FILE, call, suffix or "a name without an ending", ".hdr or .exr")
    try:
        content = read_file(path, _MAX_BYTES)
        return decode_radiance(content) if suffix == ".hdr" else _read_exr(path, call)
    except (OSError, ValueError, IndexError) as error:
        refuse(rules.BAD_ENVIRONMENT_FILE, call, str(error), "a whole file of this format")


def _read_exr(path: str | Path, call: str) -> NDArray[Any]:
    try:
        import OpenEXR  # optional
    except ImportError:
        tip = 'pip install "rhi[environments]", or convert the image to .hdr'
        refuse(rules.BAD_ENVIRONMENT_FILE, call, "an .exr without the package OpenEXR", "OpenEXR", tip=tip)
    with OpenEXR.File(str(path)) as file:
        channels = file.channels()
        pixels = next((channels[name].pixels for name in ("RGB", "RGBA") if name in channels), None)
        if pixels is None:
            raise ValueError(f"it has the channels {', '.join(channels)}, not R, G and B")
        return np.array(pixels[..., :3], np.float32)
