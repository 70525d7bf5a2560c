"""Frames for RenderDoc: `device.capture()` calls its in-application API, if RenderDoc is loaded.

RenderDoc loads itself into a program that it starts (`renderdoccmd capture python app.py`). This module never
loads it. The functions of its API lie in a table, in the order of `_NAMES` (RenderDoc's renderdoc_app.h, version
1.1.2, which later versions only extend).
"""

from __future__ import annotations

import ctypes
import logging
import os
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from rhi.contract.renderdoc import get_renderdoc_library
from rhi.device.core.core import Core
from rhi.errors.device_objects import DeviceObject

LOGGER: Final = logging.getLogger("rhi.device")
_VERSION: Final = 10102
_NAMES: Final = (
    *("GetAPIVersion", "SetCaptureOptionU32", "SetCaptureOptionF32", "GetCaptureOptionU32"),
    *("GetCaptureOptionF32", "SetFocusToggleKeys", "SetCaptureKeys", "GetOverlayBits", "MaskOverlayBits"),
    *("RemoveHooks", "UnloadCrashHandler", "SetCaptureFilePathTemplate", "GetCaptureFilePathTemplate"),
    *("GetNumCaptures", "GetCapture", "TriggerCapture", "IsTargetControlConnected", "LaunchReplayUI"),
    *("SetActiveWindow", "StartFrameCapture", "IsFrameCapturing", "EndFrameCapture"),
)
_pointer, _u32 = ctypes.c_void_p, ctypes.c_uint32
_TYPES: Final = {
    "SetCaptureFilePathTemplate": ctypes.CFUNCTYPE(None, ctypes.c_char_p),
    "GetNumCaptures": ctypes.CFUNCTYPE(_u32),
    "GetCapture": ctypes.CFUNCTYPE(
        _u32, _u32, _pointer, ctypes.POINTER(_u32), ctypes.POINTER(ctypes.c_uint64)
    ),
    "StartFrameCapture": ctypes.CFUNCTYPE(None, _pointer, _pointer),
    "IsFrameCapturing": ctypes.CFUNCTYPE(_u32),
    "EndFrameCapture": ctypes.CFUNCTYPE(_u32, _pointer, _pointer),
}
_GET_API: Final = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_int, ctypes.POINTER(_pointer))


class RenderDoc:
    """The functions of RenderDoc's API that this module calls."""

    def __init__(self, table: int) -> None:
        """Read the functions from the table at an address."""
        addresses = (ctypes.c_void_p * len(_NAMES)).from_address(table)
        self._functions: dict[str, Any] = {
            name: kind(addresses[_NAMES.index(name)] or 0) for name, kind in _TYPES.items()
        }

    def __getattr__(self, name: str) -> Any:
        return self._functions[name]

    def list_captures(self) -> list[Path]:
        """Return the files of all captures of this process."""
        files = []
        for index in range(self.GetNumCaptures()):
            length = _u32(0)
            if self.GetCapture(index, None, ctypes.byref(length), None):
                name = ctypes.create_string_buffer(length.value + 1)
                self.GetCapture(index, name, ctypes.byref(length), None)
                files.append(Path(os.fsdecode(name.value)))
        return files


def find_renderdoc() -> RenderDoc | None:
    """Return RenderDoc's API, None if RenderDoc isn't loaded into this process."""
    library = _find_library()
    if library is None:
        return None
    table = _pointer()
    if not library(_VERSION, ctypes.byref(table)) or not table.value:
        return None
    return RenderDoc(table.value)


def _find_library() -> Any:
    """Return RenderDoc's function `RENDERDOC_GetAPI`, None if its library isn't loaded."""
    library = get_renderdoc_library()
    return library and _GET_API(("RENDERDOC_GetAPI", library))


class FrameCapture(DeviceObject):
    """A block whose commands RenderDoc captures: `with device.capture() as capture:`.

    Attributes:
        is_active: whether RenderDoc is loaded, and captures.
        file: the file that RenderDoc has written, once the block has ended; None if there is none.
    """

    __slots__ = ("_api", "_core", "_template", "file", "is_active")

    def __init__(self, core: Core, path: Path | None) -> None:
        self._core = core
        self._template = path
        self._api: RenderDoc | None = None
        self.is_active = False
        self.file: Path | None = None

    def __repr__(self) -> str:
        return f"FrameCapture(file={str(self.file) if self.file else None!r})"

    def __enter__(self) -> Self:
        self._finish()
        api = self._api = find_renderdoc()
        if api is None:
            LOGGER.warning(
                "nothing is captured: RenderDoc isn't loaded; start the program with `renderdoccmd capture`, or "
                "save a trace with rhi.trace.save"
            )
        elif api.IsFrameCapturing():
            LOGGER.warning("nothing is captured here: RenderDoc captures a frame already")
        else:
            if self._template is not None:
                api.SetCaptureFilePathTemplate(os.fsencode(self._template))
            api.StartFrameCapture(None, None)
            self.is_active = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        api = self._api
        if api is None or not self.is_active:
            return
        self.is_active = False
        try:
            if kind is None:
                self._finish()
        finally:
            if api.EndFrameCapture(None, None):
                self.file = next(iter(api.list_captures()[-1:]), None)
            else:
                LOGGER.warning("RenderDoc could not capture: it knows OpenGL and Vulkan, and none drew here")

    def _finish(self) -> None:
        """Wait for the work so far, which belongs to one side of the capture's begin or end."""
        core = self._core
        core.check_ready()
        core.timeline.wait(core.signal())
