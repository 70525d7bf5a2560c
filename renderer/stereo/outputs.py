"""The outputs that show both eyes, and the colours of an anaglyph, in float64.

An anaglyph is seen through a red and a cyan glass: red is for the left eye, green and blue are for the right
one. Each way to make one is two matrices, for the left and for the right image, and the image is the sum of
both products, in linear light. In each row both matrices together sum to 1, so what is grey in both images
stays the same grey.

`grey` has no colours and thus no rivalry of the eyes, `color` has all, and `half_color` has grey for the left
eye only. `dubois` is the least-squares match to what an eye sees through each glass (Dubois, 2001); what is
below 0 or above 1 is cut off there.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules

_LUMA: Final = (0.2126, 0.7152, 0.0722)  # Rec. 709
_NONE: Final = (0.0, 0.0, 0.0)
_RED, _GREEN, _BLUE = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_DUBOIS: Final = (
    (
        (0.4561, 0.500484, 0.176381),
        (-0.0400822, -0.0378246, -0.0157589),
        (-0.0152161, -0.0205971, -0.00546856),
    ),
    (
        (-0.0434706, -0.0879388, -0.00155529),
        (0.378476, 0.73364, -0.0184503),
        (-0.0721527, -0.112961, 1.2264),
    ),
)

ANAGLYPHS: Final = {
    name: np.array(matrices, np.float64)
    for name, matrices in {
        "grey": ((_LUMA, _NONE, _NONE), (_NONE, _LUMA, _LUMA)),
        "color": ((_RED, _NONE, _NONE), (_NONE, _GREEN, _BLUE)),
        "half_color": ((_LUMA, _NONE, _NONE), (_NONE, _GREEN, _BLUE)),
        "dubois": _DUBOIS,
    }.items()
}
"""The matrices (2, 3, 3) of each anaglyph, for the left and the right image."""

SHUTTER: Final = "shutter"
"""The output of shutter glasses, which let each frame through to one eye."""

GLASSES: Final = {"red": np.array(_RED), "cyan": np.array((0.0, 1.0, 1.0))}
"""The part (3,) of each channel that a glass lets through: the left eye's, and the right eye's."""

OUTPUTS: Final = (*ANAGLYPHS, "interlaced", "side_by_side", "over_under", SHUTTER)
"""All ways to show two images. `interlaced` has the left image in even rows, from the top, and the right one
in odd rows. `side_by_side` and `over_under` show both at half their width or height, the left one first.
`shutter` draws the eyes in turn, one each frame."""


def check_output(name: str, call: str) -> None:
    """Refuse a name that isn't one of `OUTPUTS`: `stereo-unknown-output`."""
    if name not in OUTPUTS:
        rules.refuse_name(rules.UNKNOWN_STEREO, call, name, OUTPUTS)


def eye_image_size(output: str, size: tuple[int, int]) -> tuple[int, int]:
    """Return the (width, height) of each image in an image of `size` pixels. If it is odd where it is halved,
    the right image lacks its last column or row."""
    width, height = size
    if output == "side_by_side":
        return -(-width // 2), height
    return (width, -(-height // 2)) if output == "over_under" else size


def view_through_glasses(
    anaglyph: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The light (..., 3) that the red and the cyan glass let through (Russell 2011, appendices E and F)."""
    red = anaglyph * _RED
    return red, anaglyph - red


def compute_brightness(light: NDArray[np.float64], glass: NDArray[np.float64]) -> NDArray[np.float64]:
    """The brightness (...) of light (..., 3) behind a glass, 1 for white. Eyes forget the color of their glass, so
    what differs between both of them is what they compete about.

    Args:
        glass: (3,), the part of each channel that the glass lets through.
    """
    weights = glass * _LUMA
    return np.asarray(light @ (weights / weights.sum()))


def compute_rivalry(anaglyph: NDArray[np.float64]) -> float:
    """The mean difference, 0 to 1, of the brightness that both eyes see of an anaglyph (..., 3) through their
    glasses."""
    left, right = (
        compute_brightness(light, glass)
        for light, glass in zip(view_through_glasses(anaglyph), GLASSES.values(), strict=True)
    )
    return float(np.abs(left - right).mean())


def mix_anaglyph(name: str, left: NDArray[np.float64], right: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the anaglyph (..., 3) of two images (..., 3) of linear light from 0 to 1."""
    of_left, of_right = ANAGLYPHS[name]
    return np.asarray(np.clip(left @ of_left.T + right @ of_right.T, 0.0, 1.0))
