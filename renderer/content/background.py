"""Scenes that a thread loads while frames go on."""

from __future__ import annotations

import atexit
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final
from weakref import WeakSet

from renderer import rules
from renderer.content.library import load_scene
from renderer.content.progress import watch_progress
from renderer.scene.scene import Scene
from rhi.errors import refuse

STEPS: Final[Mapping[str, tuple[float, float]]] = MappingProxyType(
    {"files": (0.0, 0.2), "images": (0.2, 0.7), "meshes": (0.7, 0.9), "scene": (0.9, 1.0)}
)
"""The steps of loading, with the fractions of the whole at which they begin and end."""

_PATIENCE: Final = 10.0
"""The seconds in which a cancelled thread should have ended, when the interpreter exits."""


@dataclass(frozen=True, slots=True)
class LoadProgress:
    """The progress of loading: the `fraction`, 0 to 1, which never falls, and the current `step` of `STEPS`, or an
    empty text before the first and after the last one."""

    fraction: float
    step: str


class _Cancellation(BaseException):
    """Stops the thread of a load; libraries that catch every error let it pass."""


class BackgroundLoad:
    """A scene that is being loaded by a thread of its own, from its text as in `load_scene`, or by a function.

    All methods may be called from any thread. When the interpreter exits, loads are cancelled.

    Attributes:
        name: the scene's text, or the name of the function.
    """

    def __init__(self, scene: str | Callable[[], Scene]) -> None:
        self._load = scene if callable(scene) else lambda: load_scene(scene)
        self.name = scene if isinstance(scene, str) else getattr(scene, "__name__", "scene")
        self._progress = LoadProgress(0.0, "")
        self._is_cancelled = threading.Event()
        self._ended = threading.Event()
        self._scene: Scene | None = None
        self._error: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name=f"load {self.name}", daemon=True)
        _LOADS.add(self)
        self._thread.start()

    @property
    def progress(self) -> LoadProgress:
        """The fraction that is loaded, and the current step."""
        return self._progress

    @property
    def is_done(self) -> bool:
        """True once the scene is there, loading has failed, or it was cancelled and has stopped."""
        return self._ended.is_set()

    def cancel(self) -> None:
        """Stop loading at the next part of a step. A scene that is there already stays."""
        self._is_cancelled.set()

    def poll(self) -> Scene | None:
        """Return the scene, or None while it is being loaded. It belongs to the thread that takes it.

        Raises:
            RhiError: what `load_scene` refuses, with its rule; `scene-load-cancelled` after `cancel`.
        """
        if not self.is_done:
            return None
        if self._error is not None:
            raise self._error
        if self._scene is None:
            refuse(rules.LOAD_CANCELLED, f"BackgroundLoad({self.name!r})", "a load that was cancelled")
        return self._scene

    def wait(self, timeout: float | None = None) -> Scene | None:
        """Wait until loading has ended, or for so many seconds; return and raise as `poll` does."""
        self._ended.wait(timeout)
        return self.poll()

    def join(self, timeout: float | None = None) -> bool:
        """Wait until the thread has ended, or for so many seconds; return whether it has."""
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            with watch_progress(self._note):
                scene = self._load()
            self._note("scene", 1.0)
            self._progress, self._scene = LoadProgress(1.0, ""), scene
        except _Cancellation:
            pass
        except Exception as error:
            if not self._stops:  # else a pool that refuses work at exit
                self._error = error
        finally:
            self._ended.set()

    @property
    def _stops(self) -> bool:
        return self._is_cancelled.is_set() or not threading.main_thread().is_alive()

    def _note(self, step: str, fraction: float) -> None:
        if self._stops:
            raise _Cancellation
        begin, end = STEPS[step]
        whole = max(begin + fraction * (end - begin), self._progress.fraction)
        self._progress = LoadProgress(whole, step)


_LOADS: Final[WeakSet[BackgroundLoad]] = WeakSet()


@atexit.register
def _cancel_all() -> None:
    """Cancel the loads that are running, and wait for their threads."""
    loads = list(_LOADS)
    for load in loads:
        load.cancel()
    for load in loads:
        load.join(_PATIENCE)
