"""The metadata that depends on where the project lives: addresses, and the README with links that lead there.

A package index shows the README without the files that it links. So a release says the project's home, from
which the links and images of the README are made absolute, those of this version:

    RHI_HOME=https://HOST/OWNER/NAME python -m build

Without `RHI_HOME` the README is taken as it is, and no addresses are written. All other metadata is in
pyproject.toml.
"""

from __future__ import annotations

import os
import re
import tomllib
from pathlib import Path

from setuptools import setup

ROOT = Path(__file__).parent
IMAGE_SUFFIXES = (".webp", ".png")


def link_absolutely(text: str, home: str, version: str) -> str:
    """Return Markdown whose links to files of the project, and images, lead to the home's files of a
    version."""

    def lead(link: re.Match[str]) -> str:
        kind = "raw" if link[1].endswith(IMAGE_SUFFIXES) else "blob"
        return f"]({home}/{kind}/v{version}/{link[1]}{link[2]})"

    return re.sub(r"\]\((?![a-z]+:|#)([^)#\s]+)(#[^)\s]*|)\)", lead, text)


def list_urls(home: str, version: str) -> dict[str, str]:
    """Return the addresses of the metadata."""
    return {
        "Homepage": home,
        "Documentation": f"{home}/blob/v{version}/docs/index.md",
        "Changelog": f"{home}/blob/v{version}/CHANGELOG.md",
        "Issues": f"{home}/issues",
    }


if __name__ == "__main__":
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    home = os.environ.get("RHI_HOME", "").rstrip("/")
    number = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    setup(
        long_description=link_absolutely(readme, home, number) if home else readme,
        long_description_content_type="text/markdown",
        project_urls=list_urls(home, number) if home else {},
    )
