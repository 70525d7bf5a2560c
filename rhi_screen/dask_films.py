"""Sends the function of a film to the workers of a Dask cluster, once for each.

A plugin does it: the scheduler gives it to workers that join later, too, and to those that were started
again.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from time import sleep
from typing import Any, Final

from distributed import WorkerPlugin

from rhi_screen.films import close_on_threads, forget, receive

_ATTEMPTS: Final = 5
_PAUSE: Final = 0.5  # seconds between two attempts


class FilmPlugin(WorkerPlugin):
    """Holds the pickled function of a film for a worker."""

    def __init__(self, token: str, content: bytes) -> None:
        self.name = f"film-{token}"
        self._token, self._content = token, content

    def setup(self, worker: Any) -> None:
        """Store the function, when the worker begins or the plugin is sent."""
        receive(self._token, self._content)

    def teardown(self, worker: Any) -> None:
        """Forget the function, and close what it has opened."""
        forget(self._token)
        pool: Any = getattr(worker, "executor", None)
        if hasattr(pool, "_threads"):
            close_on_threads(pool, self._token, 1.0)


@contextmanager
def send(client: Any, token: str, content: bytes) -> Iterator[None]:
    """Send the function of a film to all workers of a client's cluster; they forget it at the end."""
    plugin = FilmPlugin(token, content)
    for attempt in range(_ATTEMPTS):
        try:
            client.register_plugin(plugin)
            break
        except OSError:  # a worker died meanwhile; others may not have it
            if attempt == _ATTEMPTS - 1:
                raise
            sleep(_PAUSE)
    try:
        yield
    finally:
        with suppress(OSError, TimeoutError):  # likewise, or the scheduler has ended
            client.unregister_worker_plugin(plugin.name)
