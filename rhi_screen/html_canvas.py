"""A canvas element of a page, for Python in the browser (Pyodide).

It is rendercanvas's canvas for Pyodide, which has the events, sizes and device pixels. Three things differ:

- A device on `web` draws to the element's WebGPU context, and nothing is copied through the CPU.
- Frames are drawn in `requestAnimationFrame`, entered so that Python can wait inside of them, where the engine
  has JSPI.
- `screen.run` returns when the canvas is closed, as it does on the desk, where Python can wait.
"""

from __future__ import annotations

from typing import Any, ClassVar

from pyodide.code import run_js
from pyodide.ffi import can_run_sync, create_proxy, run_sync
from rendercanvas.contexts import BaseContext
from rendercanvas.pyodide import PyodideRenderCanvas

__all__ = ["ElementContext", "HtmlCanvas"]

_FUNCTIONS = """({
request_frame: (paint) => requestAnimationFrame(() => paint.callPromising()),
sleep: (seconds) => new Promise((resolve) => setTimeout(resolve, 1000 * seconds)),
})"""
_POLL_SECONDS = 0.05


class ElementContext(BaseContext):  # type: ignore[misc]  # rendercanvas has no types
    """The context of an element to which a device draws.

    Attributes:
        element: the `HTMLCanvasElement`.
    """

    present_methods: ClassVar = ["screen"]

    def __init__(self, present_info: dict[str, Any]) -> None:
        super().__init__(present_info)
        self.element = present_info["window"]

    def _rc_present(self, *, force_sync: bool = False) -> dict[str, str]:
        return {"method": "screen"}


class HtmlCanvas(PyodideRenderCanvas):  # type: ignore[misc]
    """A canvas element; by default the one whose id is "canvas"."""

    def __init__(self, canvas_element: Any = "canvas", **options: Any) -> None:
        """Take an element.

        Args:
            canvas_element: the element or its id; or a `div` of the class `renderview-wrapper`, in which an
                element is created.
            options: those of `rendercanvas.BaseRenderCanvas`.
        """
        self._functions = run_js(_FUNCTIONS)
        self._paint_proxy = create_proxy(self._time_to_paint)
        super().__init__(canvas_element, **options)

    def get_element_context(self) -> ElementContext:
        """Return the context for a device that draws to the element."""
        context: ElementContext = self.get_context(ElementContext)
        return context

    def wait_until_closed(self, errors: list[Exception]) -> None:
        """Wait until the canvas is closed, or a draw has added an error. Without JSPI, return at once."""
        while can_run_sync() and not self.get_closed() and not errors:
            run_sync(self._functions.sleep(_POLL_SECONDS))

    def _rc_set_title(self, title: str) -> None:
        """Do nothing: the page has a title of its own."""

    def _rc_request_paint(self) -> None:
        self._functions.request_frame(self._paint_proxy)
