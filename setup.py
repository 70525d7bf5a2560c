"""The metadata that depends on where the project lives: addresses, and the README with links that lead there.

A package index shows the README without the files that it links. So a release says the project's home, from
which the links and images of the README are made absolute, those of this version:

    RHI_HOME=https://HOST/OWNER/NAME python -m build

Without `RHI_HOME` the README is taken as it is, and no addresses are written. All other metadata is in
pyproject.toml. The pages of the documentation become a part of the package.
"""

from __future__ import annotations

import os
import re
import tomllib
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

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
        "Documentation": f"{home}/blob/v{version}/docs/contents.md",
        "Changelog": f"{home}/blob/v{version}/CHANGELOG.md",
        "Issues": f"{home}/issues",
    }


class BuildWithPages(build_py):
    """Puts the pages of the documentation into the package, where `python -m rhi docs` looks for them."""

    def run(self) -> None:
        super().run()
        if not self.editable_mode:  # a checkout has them
            self.copy_pages()

    def copy_pages(self) -> None:
        """Copy the pages to where the package is built."""
        folder = Path(self.build_lib) / "rhi" / "documentation"
        for page in sorted((ROOT / "docs").rglob("*.md")):
            copied = folder / page.relative_to(ROOT / "docs")
            self.mkpath(str(copied.parent))
            self.copy_file(str(page), str(copied))


if __name__ == "__main__":
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    home = os.environ.get("RHI_HOME", "").rstrip("/")
    number = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
    setup(
        cmdclass={"build_py": BuildWithPages},
        long_description=link_absolutely(readme, home, number) if home else readme,
        long_description_content_type="text/markdown",
        project_urls=list_urls(home, number) if home else {},
    )
