"""An OpenCL backend per test; one costs 2 ms when PoCL has the probe kernel on disk."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from cl_kit import ClKit

from rhi.backends.cl import create_backend


@pytest.fixture
def cl_kit() -> Iterator[ClKit]:
    kit = ClKit(create_backend())
    yield kit
    kit.close()
