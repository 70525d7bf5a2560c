"""Driver faults, known by name and version, and the features that they disable."""

from __future__ import annotations

import os
import re
from typing import Final

_WALKS: Final = re.compile(r"Mesa 22\.3\b")
_OPT_IN: Final = "RHI_SLOW_ANISOTROPY"
_ZEROS: Final = (
    "compressed textures: SwiftShader reads zeros from them; the CPU decodes them "
    "(python -m rhi docs backends-wgpu)"
)
_REASON: Final = (
    "anisotropy: llvmpipe of Mesa 22.3 may take minutes for a pixel; "
    f"{_OPT_IN}=1 allows it (python -m rhi docs backends-gl)"
)


def limit_anisotropy(device: str, driver: str, max_anisotropy: float) -> tuple[float, tuple[str, ...]]:
    """Return the anisotropy that is safe to request of a driver, and the reason if it is below
    `max_anisotropy`.

    llvmpipe walks over all texels below a pixel, of the last level if the pixel covers the texture more than
    once: its time has no bound, and nothing in a sampler's state sets one.
    """
    walks = max_anisotropy > 1.0 and "llvmpipe" in device and _WALKS.search(driver) is not None
    return (1.0, (_REASON,)) if walks and not allows_slow_anisotropy() else (max_anisotropy, ())


def allows_slow_anisotropy() -> bool:
    """Return whether the environment allows anisotropy that may take minutes."""
    return os.environ.get(_OPT_IN, "0") not in ("", "0")


def is_fourth_uniform_faulty(device: str) -> bool:
    """True if a driver's fault breaks the fourth uniform buffer of a stage.

    Mesa 22.3's lavapipe keeps the uniforms that conditions depend on in a table of 4 for each of 32 buffers,
    but steps through it by 32. Those of a stage's fourth buffer, the fifth row, are written over the counts
    that follow the table, and the next draw reads a buffer that isn't there. Later buffers meet nothing that
    is used.
    """
    return "llvmpipe" in device


def is_indirect_unbounded(device: str) -> bool:
    """True if a driver may end the process if an indirect draw names elements that its buffers don't have.

    Mesa 22.3's llvmpipe looks up indices some 5 million behind the end of their buffer before it compares.
    With vertices alone it counts to the end of 32 bits, for minutes.
    """
    return "llvmpipe" in device


def list_block_faults(device: str) -> tuple[str, ...]:
    """Yield the reasons why a device's compressed textures can't be used."""
    return (_ZEROS,) if "SwiftShader" in device else ()
