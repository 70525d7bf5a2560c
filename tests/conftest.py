"""For all tests: property tests take the same examples each time, and no clock judges them; mypy as tests run it.

`pytest --hypothesis-profile exploring` takes new examples.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile(
    "repeatable",
    derandomize=True,
    deadline=None,
    # A busy machine is slow; devices are shared between examples, which leave them as they found them.
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.register_profile("exploring", settings.get_profile("repeatable"), derandomize=False)
settings.load_profile("repeatable")


@pytest.fixture(scope="session")
def mypy_strict(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., tuple[str, int]]:
    """`mypy --strict` on paths, with further options: its output and exit status.

    Its cache is this process's own, begun as a copy of the project's: it is a database, and of several runs at once
    those that wait for its lock too long fail.
    """
    api = pytest.importorskip("mypy.api")
    cache, known = tmp_path_factory.mktemp("mypy"), Path(__file__).parents[1] / ".mypy_cache"
    if known.is_dir():
        shutil.copytree(known, cache, dirs_exist_ok=True)

    def run(*arguments: object) -> tuple[str, int]:
        options = ["--strict", "--no-error-summary", "--cache-dir", str(cache)]
        out, _, status = api.run([*options, *map(str, arguments)])
        return out, status

    return run
