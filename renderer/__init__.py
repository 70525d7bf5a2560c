"""A renderer written once against `rhi`: scenes, visibility, techniques and their measurements.

renderer.view("city")       # in a window, or in a notebook as a widget
"""

from typing import Any


def view(scene: Any, backend: str | None = None, **options: Any) -> Any:
    """Show a scene, or the one that a text names: in a notebook return a widget, else open a window and
    return when it is closed. See `renderer.viewer.viewer_screen.view`."""
    from renderer.viewer.viewer_screen import view  # it needs everything

    return view(scene, backend, **options)
