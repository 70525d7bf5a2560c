"""RenderDoc's library, if RenderDoc has loaded it into this process."""

from __future__ import annotations

import ctypes
import os
import sys


def get_renderdoc_library() -> ctypes.CDLL | None:
    """Return RenderDoc's library; None if it isn't loaded, for it is never loaded here."""
    try:
        if sys.platform == "win32":
            handle = ctypes.windll.kernel32.GetModuleHandleW("renderdoc.dll")
            return ctypes.CDLL("renderdoc.dll", handle=handle) if handle else None
        return ctypes.CDLL("librenderdoc.so", mode=os.RTLD_NOW | os.RTLD_NOLOAD)
    except (OSError, AttributeError):  # it isn't loaded, or the platform has no such libraries
        return None
