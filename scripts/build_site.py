"""Build the documentation, with the extra `docs`, into `out/documentation` or another folder.

    python scripts/build_site.py [FOLDER] [--pyodide FOLDER | --no-live] [--home URL] [--release FOLDER]

Programs of the gallery run in its page (`live_site.py`), on Pyodide. Readers load it from Pyodide's own
distribution, or with `--pyodide` from the site, which then has a copy of that folder's files. The site is built
without a network in any case.

With `--home`, the address of the project's repository, pages have a link to edit them; without it, none.
With `--release`, the site is also copied to a folder of all versions, and its pages lead to the others.

The pages are those of `docs/`, the README as the first one, the changelog, and the API reference, which
mkdocstrings makes from docstrings (`zensical_pages.py`). The generator is Zensical, the successor of MkDocs
Material (which is kept until May 2027 only); it reads the same `mkdocs.yml`. What either warns of is an error
here. What docstrings say of parameters and rules is checked by tests/test_reference.py, links and the search by
tests/test_site.py.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Final

sys.path.insert(0, str(Path(__file__).resolve().parent))

from gallery_cards import PROGRAM_TOPICS, add_to_first_page, add_to_gallery, list_cards, write_assets
from live_site import add_live_programs, list_absent, write_live
from search_phrases import correct_index

ROOT: Final = Path(__file__).resolve().parents[1]

MODULES: Final = (
    "rhi",
    "rhi.math",
    "rhi.shading",
    "rhi.testing",
    "rhi.testing.portability",
    "rhi.trace",
    "rhi.contract",
    "rhi.backends.null",
    "rhi.conformance",
)
"""The modules that users and ports import."""

EXTRA_PAGES: Final = {
    "README.md": "index.md",
    "CHANGELOG.md": "changelog.md",
    "CONTRIBUTING.md": "contributing.md",
    "examples/numpy_backend/README.md": "numpy-backend.md",
}
"""The pages outside of `docs/`, with their names in the site."""

REDIRECTS: Final = {
    "accuracy": "measurements/accuracy",
    "coverage": "decisions/coverage",
    "effect-costs": "measurements/effect-costs",
    "lighting-measured": "measurements/lighting-measured",
    "performance": "measurements/performance",
    "tutorial": "tutorials/first-triangle",
    "visibility-costs": "measurements/visibility-costs",
    "visibility-device": "visibility-algorithms",
    "visibility-tables": "measurements/visibility-tables",
}
"""Former addresses of pages in the site, each with the address of the page that has its text now."""
_REDIRECT: Final = """\
<!doctype html>
<meta charset="utf-8">
<title>Moved</title>
<link rel="canonical" href="{address}">
<meta http-equiv="refresh" content="1; url={address}">
<script>location.replace("{address}" + location.hash)</script>
<p>This page has moved: <a href="{address}">{name}</a>.</p>
"""
"""The page at a former address; the script leads to the same heading, where there is one."""

PAGES: Final = Path(__file__).resolve().parent / "zensical_pages.py"
"""The generator, which inspects the modules of the reference only."""
EDIT_FOLDER: Final = "edit/main/docs/"
"""Where a repository's home edits the files of `docs/`."""
LINK: Final = re.compile(r"\]\((?![a-z]+:|#)([^)#\s]+)")
_HARMLESS: Final = ("Build started", "No issues found", "Build finished")


def collect_pages(folder: Path, *, live: bool = False, pyodide: Path | None = None) -> None:
    """Write the pages of the site to a folder, with the files that they link.

    Args:
        folder: where to; it doesn't exist yet.
        live: whether programs run in their pages.
        pyodide: a folder with Pyodide's distribution for them; None: they load it from its own address.
    """
    absent = list_absent(pyodide) if live else dict.fromkeys(PROGRAM_TOPICS, "")
    cards = list_cards((ROOT / "docs" / "gallery.md").read_text(encoding="utf-8"), absent)
    shutil.copytree(ROOT / "docs", folder)
    write_assets(folder / "site")
    for page in (*(ROOT / "docs").rglob("*.md"), *(ROOT / name for name in EXTRA_PAGES)):
        name = (
            EXTRA_PAGES.get(page.relative_to(ROOT).as_posix()) or page.relative_to(ROOT / "docs").as_posix()
        )

        def lead(link: re.Match[str], home: Path = page.parent, name: str = name) -> str:
            target = _site_link((home / link[1]).resolve(), folder)
            return f"]({os.path.relpath(target, os.path.dirname(name) or '.')}"

        text = page.read_text(encoding="utf-8")
        text = LINK.sub(lead, add_live_programs(text, absent) if live else text)
        if name == "index.md":
            text = add_to_first_page(text, cards)
        elif name == "gallery.md":
            text = add_to_gallery(text, cards)
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "reference").mkdir()
    for module in MODULES:
        (folder / "reference" / f"{module}.md").write_text(f"# {module}\n\n::: {module}\n", encoding="utf-8")


def _site_link(target: Path, folder: Path) -> str:
    """Return the link of the site's pages to a file of the project, which is copied there if it is no
    page."""
    if target.is_relative_to(ROOT / "docs"):
        return target.relative_to(ROOT / "docs").as_posix()
    name = (target / "README.md" if target.is_dir() else target).relative_to(ROOT).as_posix()
    if name in EXTRA_PAGES:
        return EXTRA_PAGES[name]
    copied = folder / "files" / f"{name}.txt"  # which browsers show
    copied.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(ROOT / name, copied)
    return copied.relative_to(folder).as_posix()


def write_redirects(site: Path) -> None:
    """Write a page to each former address of the site that leads to the page's present address."""
    for former, present in REDIRECTS.items():
        file = site / former / "index.html"
        file.parent.mkdir(parents=True, exist_ok=True)
        page = _REDIRECT.format(address=f"../{present}/", name=present)
        file.write_text(page, encoding="utf-8")


def write_configuration(path: Path, *, home: str | None, versions: bool) -> None:
    """Write the generator's configuration: the project's, with edit links and a list of versions if asked for."""
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    if home is not None:
        text = text.replace("features: [", "features: [content.action.edit, ", 1)
        text += f"repo_url: {home.rstrip('/')}\nedit_uri: {EDIT_FOLDER}\n"
    if versions:
        text += "extra: {version: {provider: mike}}\n"
    path.write_text(text, encoding="utf-8")


def correct_edit_links(site: Path, home: str) -> None:
    """Correct the edit links of pages from outside of `docs/`, and remove those of the reference."""
    address = f"{home.rstrip('/')}/{EDIT_FOLDER}"
    for page in site.rglob("index.html"):
        text = page.read_text(encoding="utf-8")
        for source, name in EXTRA_PAGES.items():
            text = text.replace(f'"{address}{name}"', f'"{address.removesuffix("docs/")}{source}"')
        text = re.sub(rf'<a href="{re.escape(address)}reference/[^>]*>.*?</a>', "", text, flags=re.DOTALL)
        page.write_text(text, encoding="utf-8")


def add_version(releases: Path, version: str, site: Path) -> None:
    """Copy a site into a folder of all versions.

    The folder's first page leads to the newest version. `versions.json` lists all of them, the newest first;
    the theme shows them in each page's header.

    Args:
        releases: the folder; it is created if it doesn't exist.
        version: of numbers and dots. A site of that version is replaced.
        site: the folder of the site.
    """
    shutil.rmtree(releases / version, ignore_errors=True)
    shutil.copytree(site, releases / version)
    versions = sorted(
        (path.parent.name for path in releases.glob("*/search.json")),
        key=lambda name: [int(number) for number in re.findall(r"\d+", name)],
        reverse=True,
    )
    rows = [
        {"version": name, "title": name, "aliases": ["latest"] * (name == versions[0])} for name in versions
    ]
    (releases / "versions.json").write_text(json.dumps(rows, indent=1), encoding="utf-8")
    first = _REDIRECT.format(address=f"{versions[0]}/", name=versions[0])
    (releases / "index.html").write_text(first, encoding="utf-8")


def build(
    folder: Path,
    *,
    live: bool = True,
    pyodide: Path | None = None,
    home: str | None = None,
    versions: bool = False,
) -> list[str]:
    """Build the site in `folder/site` and return the generator's warnings.

    Args:
        folder: is emptied first.
        live: whether programs run in their pages.
        pyodide: a folder with Pyodide's distribution for them, whose files are copied.
        home: the address of the project's repository, to which edit links lead; None: pages have no such link.
        versions: whether pages show the versions of `versions.json` above the site.
    """
    shutil.rmtree(folder, ignore_errors=True)
    collect_pages(folder / "docs", live=live, pyodide=pyodide)
    if live:
        write_live(folder / "docs" / "live", pyodide)
    write_configuration(folder / "mkdocs.yml", home=home, versions=versions)
    path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "PYTHONPATH": path, "NO_COLOR": "1"}
    done = subprocess.run(
        [sys.executable, str(PAGES), "build", "--strict", "--config-file", str(folder / "mkdocs.yml")],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )
    write_redirects(folder / "site")
    if done.returncode == 0:
        correct_index(folder / "site" / "search.json", REDIRECTS)
    if home is not None:
        correct_edit_links(folder / "site", home)
    lines = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
    return [line for line in lines if not line.strip().startswith(_HARMLESS)] + ["failed"] * (
        done.returncode != 0
    )


def main() -> int:
    """Build the site; print its warnings, its first page, and the processor time."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("folder", nargs="?", type=Path, default=Path("out/documentation"))
    parser.add_argument("--pyodide", type=Path, help="a folder with Pyodide, to be copied to the site")
    parser.add_argument("--no-live", action="store_true", help="pages without programs that run in them")
    parser.add_argument("--home", help="the address of the repository, for edit links")
    parser.add_argument("--release", type=Path, help="a folder of all versions, to which this one is added")
    options = parser.parse_args()
    folder = options.folder.resolve()
    warnings = build(
        folder,
        live=not options.no_live,
        pyodide=options.pyodide,
        home=options.home,
        versions=options.release is not None,
    )
    if options.release is not None:
        initial = (ROOT / "rhi" / "__init__.py").read_text(encoding="utf-8")
        version = re.search(r'^__version__ = "([\d.]+)', initial, re.MULTILINE)
        assert version is not None
        add_version(options.release.resolve(), version[1], folder / "site")
    used = os.times()
    seconds = used.user + used.system + used.children_user + used.children_system
    print("\n".join([*warnings, str(folder / "site" / "index.html"), f"{seconds:.0f} s of processor time"]))
    return bool(warnings)


if __name__ == "__main__":
    sys.exit(main())
