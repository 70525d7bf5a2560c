"""A renderer written once against `rhi`: scenes, visibility, techniques and their measurements.

renderer.view("city")       # in a window, or in a notebook as a widget
renderer.film("city", "ground", range(600), "city.mp4", executor="processes:4")
"""

from typing import Any


def view(scene: Any, backend: str | None = None, **options: Any) -> Any:
    """Show a scene, or the one that a text names: in a notebook return a widget, else open a window and
    return when it is closed. See `renderer.viewer.viewer_screen.view`."""
    from renderer.viewer.viewer_screen import view  # it needs everything

    return view(scene, backend, **options)


def film(scene: Any, *arguments: Any, **options: Any) -> Any:
    """Draw frames of a scene on the workers of an executor, to a video or to images. See
    `renderer.viewer.scene_films.film`."""
    from renderer.viewer.scene_films import film  # it needs everything

    return film(scene, *arguments, **options)
