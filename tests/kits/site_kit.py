"""The documentation's site, built once for all nightly tests of a process: `built_site`, `list_addresses`."""

from __future__ import annotations

import atexit
import functools
import shutil
import sys
import tempfile
from pathlib import Path

import pytest
from web_kit import ROOT

sys.path.append(str(ROOT / "scripts"))


@functools.cache
def _build() -> tuple[Path, tuple[str, ...]]:
    from build_site import build

    folder = Path(tempfile.mkdtemp(prefix="rhi-site-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder / "site", tuple(build(folder))


def built_site() -> Path:
    """The folder of the built site, whose live programs load Pyodide from its own address."""
    for package in ("zensical", "mkdocstrings", "rendercanvas"):
        pytest.importorskip(package)
    site, warnings = _build()
    assert warnings == ()
    return site


def list_addresses() -> list[str]:
    """The address of each page below that of the site: "" for the first one, "how-to/warm-up/"."""
    from build_site import EXTRA_PAGES, MODULES

    pages = [path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")]
    names = [*pages, *EXTRA_PAGES.values(), *(f"reference/{module}.md" for module in MODULES)]
    return sorted("" if name == "index.md" else f"{name.removesuffix('.md')}/" for name in names)
