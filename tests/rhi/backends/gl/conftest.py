"""A GL backend per test; one costs 3 ms."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from gl_kit import GlKit

from rhi.backends.gl import create_backend


@pytest.fixture
def gl_kit() -> Iterator[GlKit]:
    backend = create_backend()
    yield GlKit(backend)
    backend.close()


@pytest.fixture
def checked_kit() -> Iterator[GlKit]:
    backend = create_backend(validation=True)
    yield GlKit(backend)
    backend.close()
