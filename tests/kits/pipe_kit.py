"""Streams of the process as pipes, whose readers go away."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def stream_to_pipe(
    monkeypatch: pytest.MonkeyPatch, name: str, *, is_read: bool
) -> Iterator[Callable[[], str]]:
    """Make a stream of the process a pipe, whose reader goes away at once or stays; yield what reads it."""
    source, sink = os.pipe()
    if not is_read:
        os.close(source)
    with open(sink, "w", encoding="utf-8") as stream:
        monkeypatch.setattr(sys, name, stream)
        yield lambda: os.read(source, 1 << 16).decode()
    if is_read:
        os.close(source)
