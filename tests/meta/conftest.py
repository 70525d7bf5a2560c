"""Tests of the tests: each proves that tests, or the kit, would notice a fault. Most are marked nightly.

They build on the helpers beside the tests that they prove, so those folders are on the path (`pythonpath` in
pyproject.toml).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import moderngl
import pytest
from glsl_runner import context as context
from glsl_runner import run_glsl


@pytest.fixture
def run(context: moderngl.Context) -> Callable[..., dict[str, Any]]:
    """Run a compute shader on OpenGL."""
    return partial(run_glsl, context)
