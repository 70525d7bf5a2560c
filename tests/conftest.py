"""For all tests: hypothesis profiles, mypy as tests run it, a virtual X server, and anisotropy on llvmpipe.

- `repeatable`, the default: property tests take the same examples in each run, and have no deadline.
- `exploring`: new examples. `nightly`: new ones, and 20 times as many; `./test.sh --nightly` uses it.
"""

from __future__ import annotations

import gc
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from fnmatch import fnmatchcase
from itertools import chain
from pathlib import Path

import file_processes
import pytest
from hypothesis import HealthCheck, settings
from screens_kit import Display, open_display

from rhi.backends.cl.pocl.kernel_cache import settle_folder
from rhi.conformance import plugin
from rhi.contract import trust
from rhi.errors import DeviceError

settings.register_profile(
    "repeatable",
    derandomize=True,
    deadline=None,
    # A busy machine is slow; devices are shared between examples, which leave them as they found them.
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.register_profile("exploring", settings.get_profile("repeatable"), derandomize=False)
settings.register_profile("nightly", settings.get_profile("exploring"))
settings.load_profile("repeatable")

settle_folder()  # PoCL asks once for its folder, and some tests begin it without rhi
os.environ.setdefault("RHI_SLOW_ANISOTROPY", "1")  # no pixel of the tests takes long

WITHOUT_DRIVERS = "RHI_TESTS_WITHOUT_DRIVERS"
"""A variable that is set where drivers can't be had: tests that create a device of another backend than null are
skipped there. Elsewhere they fail, so that no run is green because a driver has gone."""
NIGHTLY_FACTOR = 20
COLLECTED_AFTER = (10_000, 10, 50)
"""Thresholds of the garbage collector. With Python's own, tests full of Python spend a quarter of their time
there."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options of test files that run in processes of their own."""
    file_processes.add_options(parser)


def pytest_configure(config: pytest.Config) -> None:
    """Register plugins: the kit's, whose marker `requires` the tests of all packages use, the one that prints what a
    worker wrote to standard error before it crashed, the one that returns freed memory, and the one that runs test
    files in processes of their own.

    The kit's is imported above, so `import_plugin` would warn, where the tree isn't the installed one, that
    pytest can't rewrite it.
    """
    if not config.pluginmanager.has_plugin(plugin.__name__):
        config.pluginmanager.register(plugin, plugin.__name__)
    config.pluginmanager.import_plugin("worker_errors")
    config.pluginmanager.import_plugin("worker_memory")
    file_processes.register_side(config)


def pytest_itemcollected(item: pytest.Item) -> None:
    """Mark the cases that `nightly_cases` selects as nightly. In the profile `nightly`, multiply the number
    of examples of property tests, but for tests that are marked nightly themselves, which state their own
    number."""
    is_own = item.get_closest_marker("nightly") is not None
    parameters = item.nodeid.partition("[")[2].removesuffix("]")
    patterns = [mark.args or ("*",) for mark in item.iter_markers("nightly_cases")]
    if any(fnmatchcase(parameters, pattern) for pattern in chain(*patterns)):
        item.add_marker(pytest.mark.nightly)
    if is_own:
        return
    test = getattr(item, "obj", None)
    if getattr(test, "is_hypothesis_test", False) and settings.get_current_profile_name() == "nightly":
        test = getattr(test, "__func__", test)
        if not hasattr(test, "own_settings"):  # a function is shared by its parametrisations
            test.own_settings = test._hypothesis_internal_use_settings
            more = NIGHTLY_FACTOR * test.own_settings.max_examples
            test._hypothesis_internal_use_settings = settings(
                test.own_settings, max_examples=more, derandomize=False
            )


@contextmanager
def skipping_without_drivers() -> Iterator[None]:
    """Skip a test whose device has no driver, if this system has none by its nature (`WITHOUT_DRIVERS`)."""
    try:
        yield
    except (DeviceError, ImportError) as error:
        is_missing = (
            error.rule.id == "device-driver" if isinstance(error, DeviceError) else "glcontext" in str(error)
        )
        if is_missing and os.environ.get(WITHOUT_DRIVERS):
            pytest.skip(str(error).splitlines()[0])
        raise


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup() -> Generator[None, object, object]:
    """Skip a test whose fixtures create a device without a driver."""
    with skipping_without_drivers():
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call() -> Generator[None, object, object]:
    """Skip a test that creates a device without a driver."""
    with skipping_without_drivers():
        return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect without garbage collections: what is made, 400,000 objects, lives as long as the process.

    They are frozen, so no later collection passes over them.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.collect()
        gc.freeze()
        gc.set_threshold(*COLLECTED_AFTER)
        gc.enable()


@pytest.fixture(scope="session", autouse=True)
def isolated_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Tests use a cache folder of their own instead of the user's."""
    folder = tmp_path_factory.mktemp("cache")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trust, "cache_folder", lambda name: Path(os.environ.get(trust.FOLDER) or folder) / name)
        yield


@pytest.fixture(scope="session")
def mypy_strict(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., tuple[str, int]]:
    """`mypy --strict` on paths, with further options: its output and exit status.

    Its cache is this process's own, begun as a copy of the project's: it is a database, and of several runs
    at once those that wait for its lock too long fail.
    """
    pytest.importorskip("mypy")
    cache, previous_cache = tmp_path_factory.mktemp("mypy"), Path(__file__).parents[1] / ".mypy_cache"
    if previous_cache.is_dir():
        shutil.copytree(previous_cache, cache, dirs_exist_ok=True)

    def run(*arguments: object) -> tuple[str, int]:
        options = ["--strict", "--no-error-summary", "--cache-dir", str(cache)]
        command = [sys.executable, "-m", "mypy", *options, *map(str, arguments)]
        done = subprocess.run(
            command, capture_output=True, text=True, check=False, encoding="utf-8"
        )  # in this process it keeps 190 MB
        return done.stdout, done.returncode

    return run


@pytest.fixture(scope="module")
def display(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Display]:
    """A virtual X server."""
    with open_display(tmp_path_factory.mktemp("screen")) as opened:
        yield opened
