"""The kinds of canvases by name, and what to install for each.

A canvas is a `BaseRenderCanvas` of rendercanvas: https://rendercanvas.readthedocs.io has its methods and
events.
"""

from __future__ import annotations

import importlib
import sys
from dataclasses import dataclass
from typing import Any, Final, TypeAlias

from rhi.errors import DeviceError, refuse
from rhi_screen.rules import INSTALL, SCREEN_CANVAS, SCREEN_MISSING

DEFAULT_SIZE: Final = (960, 540)

Canvas: TypeAlias = Any
"""A `rendercanvas.BaseRenderCanvas`; rendercanvas has no types that a type checker reads."""


@dataclass(frozen=True, slots=True)
class CanvasKind:
    """A class of canvases.

    Attributes:
        module, name: where the class is.
        required_module: a further module without which it doesn't run.
        install: what makes them importable.
    """

    module: str
    name: str = "RenderCanvas"
    required_module: str = "rendercanvas"
    install: str = INSTALL

    def load(self) -> Any:
        """Import and return the class.

        Raises:
            DeviceError: `screen-missing` with what to install.
        """
        try:
            importlib.import_module(self.required_module)
            return getattr(importlib.import_module(self.module), self.name)
        except ImportError as error:
            missing = f"{error.name} is missing" if error.name else str(error).splitlines()[0]
            raise DeviceError(SCREEN_MISSING, "rhi_screen.open_canvas", missing, "", self.install) from error


CANVASES: Final = {
    "window": CanvasKind("rhi_screen.window", "Window"),
    "qt": CanvasKind(
        "rendercanvas.pyside6", required_module="PySide6", install=f"pip install pyside6; {INSTALL}"
    ),
    "page": CanvasKind("rhi_screen.page", "Page", required_module="websockets"),
    "jupyter": CanvasKind(
        "rendercanvas.jupyter", required_module="jupyter_rfb", install=f"pip install jupyter_rfb; {INSTALL}"
    ),
    "html": CanvasKind(
        "rhi_screen.html_canvas",
        "HtmlCanvas",
        required_module="rhi_screen.html_canvas",
        install="it needs Python in a page (Pyodide), and rendercanvas there",
    ),
    "offscreen": CanvasKind("rendercanvas.offscreen"),
}
"""All kinds by name."""


def open_canvas(
    kind: str | None = None, *, title: str = "rhi", size: tuple[float, float] | None = None, **options: Any
) -> Canvas:
    """Open a canvas.

    Args:
        kind: a name of `CANVASES`; None: "html" in a page, "jupyter" in a notebook, else "window".
        title: may contain `$fps` and `$ms`.
        size: in logical pixels, (width, height). None: 960 × 540; in a page, the size of the element.
        options: rendercanvas's: `update_mode` ("ondemand", "continuous", "fastest"), `max_fps`, `vsync`.

    Raises:
        ValidationError: `screen-canvas` if no canvas has this name.
        DeviceError: `screen-missing`, `screen-display` or `screen-driver`, with what to install.
    """
    kind = kind or choose_default_canvas()
    if kind not in CANVASES:
        refuse(SCREEN_CANVAS, f"rhi_screen.open_canvas({kind!r})", kind, ", ".join(CANVASES))
    if size is None and kind != "html":
        size = DEFAULT_SIZE
    return CANVASES[kind].load()(title=title, size=size, **options)


def get_loop(canvas: Canvas) -> Any:
    """Return the loop that runs a canvas, or None if nothing does, as offscreen."""
    widget: Any = getattr(canvas, "_subwidget", canvas)  # a window around a widget has no group of its own
    return widget._rc_canvas_group.get_loop()


def choose_default_canvas() -> str:
    """Return the kind of canvas that is opened if none is named."""
    if sys.platform == "emscripten":
        return "html"
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return "window" if getattr(shell, "kernel", None) is None else "jupyter"
