"""Scenes that a thread loads while a viewer's frames go on.

`SceneLoading` has one load at most (`renderer.content.BackgroundLoad`): another one cancels it. The viewer asks it
between frames, in its own thread, whether the scene is there. What is loaded then goes to the device over several
frames, what is large on the screen first (`renderer.frame.UploadSettings`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from renderer.content import BackgroundLoad
from renderer.content.shapes import box
from renderer.scene import Camera, Scene, SceneBuilder

_NAME_LENGTH: Final = 40
"""The most characters of a scene's text in a line of progress; of a longer text its end."""


class SceneLoading:
    """The scene that is being loaded for a viewer, if any."""

    def __init__(self) -> None:
        self._load: BackgroundLoad | None = None
        self._show: Callable[[Scene], str] = lambda scene: scene.name
        self._fail: Callable[[Exception], object] | None = None

    @property
    def is_loading(self) -> bool:
        """True until the scene is there, or can't be loaded."""
        return self._load is not None

    def follow(
        self,
        load: BackgroundLoad,
        show: Callable[[Scene], str],
        fail: Callable[[Exception], object] | None = None,
    ) -> None:
        """Follow a load from now on, and cancel the one before. `update` passes the scene to `show`, and the errors
        of both to `fail`, if there is one."""
        self.cancel()
        self._load, self._show, self._fail = load, show, fail

    def wait(self, seconds: float | None = None) -> str:
        """Wait for the scene, so many seconds at most, and show it as `update` does; return what is being loaded if
        it isn't there yet."""
        if self._load is not None:
            self._load.join(seconds)
        return self.update() or self.describe()

    def update(self) -> str:
        """Show the scene if it has been loaded since the last call, and return what `show` returns; otherwise an
        empty text. Call it between two frames.

        Raises:
            RhiError: what `load_scene` or `show` refuses. Nothing is being loaded any more then.
        """
        load = self._load
        if load is None or not load.is_done:
            return ""
        self._load = None
        try:
            scene = load.poll()
            assert scene is not None
            return self._show(scene)
        except Exception as error:
            if self._fail is None:
                raise
            self._fail(error)
            return ""

    def describe(self) -> str:
        """Return the scene that is being loaded, the step and the percentage; an empty text if there is none."""
        if self._load is None:
            return ""
        progress = self._load.progress
        name = self._load.name
        if len(name) > _NAME_LENGTH:
            name = f"…{name[1 - _NAME_LENGTH :]}"
        step = f"{progress.step} " if progress.step else ""
        return f"loading {name}: {step}{progress.fraction:.0%}"

    def cancel(self) -> None:
        """Load nothing any more."""
        if self._load is not None:
            self._load.cancel()
            self._load = None


def make_placeholder(text: str) -> Scene:
    """Return a scene without anything to see, for the frames before the scene that `text` names is loaded."""
    builder = SceneBuilder(text)
    node = builder.add_node()
    builder.add_objects([node], builder.add_mesh(box()), builder.add_material())
    builder.hide(node)
    builder.views["loading"] = Camera.look_at((0.0, 0.0, 4.0), (0.0, 0.0, 0.0))
    return builder.build()
