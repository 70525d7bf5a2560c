"""All pages of the built site in headless Chromium: they fit a phone, a tablet and a desk, their links lead somewhere,
their images have texts, and the gallery's filters work without a mouse and without a script.

`RHI_LIVE_SCREENSHOTS=FOLDER` keeps screenshots.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import pytest
from chromium_kit import Page, open_page, serve
from live_kit import save_screenshot
from site_kit import built_site, list_addresses

pytestmark = pytest.mark.nightly

WIDTHS: Final = (360, 768, 1440)
"""CSS pixels of a phone, a tablet and a desk."""
CODE_COLUMNS: Final = 88
"""The columns of a line of code that a desk shows whole."""


@pytest.fixture(scope="module")
def site() -> Iterator[str]:
    """The address of the site, in a folder below the server's first page, as where versions are."""
    with serve(built_site().parent) as address:
        yield f"{address}site/"


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Page]:
    """A browser without a GPU that reads pages."""
    with open_page(tmp_path_factory.mktemp("profile"), "--disable-gpu") as page:
        yield page


@pytest.fixture(scope="module")
def good_paths() -> set[str]:
    """Paths of the site that were loaded."""
    return set()


def set_width(reader: Page, width: int) -> None:
    reader.call(
        "Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False
    )


_CUT_OFF: Final = """[...document.querySelectorAll("article *")].filter((element) => {
    const { right, width } = element.getBoundingClientRect();
    if (width === 0 || right <= innerWidth + 1) return false;
    for (let parent = element; parent !== document.body; parent = parent.parentElement)
        if (["auto", "scroll"].includes(getComputedStyle(parent).overflowX)) return false;
    return true;
}).map((element) => `${element.tagName} ${element.textContent.slice(0, 40)}`)"""
"""JavaScript: the elements of a page that its right edge cuts off, and that don't lie in a box that scrolls."""

_SIDEWAYS: Final = "document.documentElement.scrollWidth - innerWidth"
_NARROW_CODE: Final = f"""[...document.querySelectorAll("article .highlight pre > code")].filter((code) =>
    code.textContent.split("\\n").every((line) => line.length <= {CODE_COLUMNS}) &&
    code.scrollWidth > code.clientWidth + 1
).map((code) => code.textContent.slice(0, 60))"""
"""JavaScript: the blocks of code that scroll, though no line of theirs is longer than the limit."""

_IMAGES: Final = """Promise.all([...document.querySelectorAll("article img")].map(async (image) => {
    image.loading = "eager"; await image.decode().catch(() => {});
    return {source: image.src, text: image.alt.trim(), width: image.naturalWidth};
}))"""
_PATHS: Final = """[...new Set([...document.querySelectorAll(
    "a[href], link[rel=stylesheet], link[rel=icon], script[src]")]
    .map((element) => new URL(element.href || element.src))
    .filter((address) => address.origin === location.origin).map((address) => address.pathname))]"""


@pytest.mark.parametrize("name", list_addresses())
def test_a_page_fits_three_widths_and_its_images_and_links_resolve(
    name: str, site: str, reader: Page, good_paths: set[str]
) -> None:
    set_width(reader, WIDTHS[-1])
    reader.open(f"{site}{name}")
    for width in WIDTHS:
        set_width(reader, width)
        save_screenshot(reader, f"page-{name.strip('/').replace('/', '-') or 'index'}-{width}")
        assert reader.evaluate(_SIDEWAYS) <= 0, width
        assert reader.evaluate(_CUT_OFF) == [], width
    assert reader.evaluate(_NARROW_CODE) == []
    images: list[dict[str, Any]] = reader.evaluate(_IMAGES)
    assert [image["source"] for image in images if not image["text"] or not image["width"]] == []
    assert reader.evaluate("document.querySelectorAll('article h1').length") == 1
    paths = set(reader.evaluate(_PATHS)) - good_paths
    good = reader.evaluate(
        f"""Promise.all({sorted(paths)}.map(async (path) =>
            (await fetch(path, {{method: "HEAD"}})).ok ? path : null))"""
    )
    good_paths.update(path for path in good if path is not None)
    assert paths <= good_paths, paths - good_paths
    assert reader.list_errors() == []


def test_an_element_that_is_cut_off_is_listed(site: str, reader: Page) -> None:
    set_width(reader, WIDTHS[0])
    reader.open(f"{site}installation/")
    reader.evaluate(
        'document.querySelector("article").insertAdjacentHTML("beforeend", '
        '\'<p style="width: 500px">wide</p><div style="overflow: auto"><p style="width: 500px">box</p></div>\')'
    )
    assert reader.evaluate(_CUT_OFF) == ["P wide"]


# -- the gallery's filters ---------------------------------------------------------------------------------

_VISIBLE: Final = """[...document.querySelectorAll(".rhi-cards li")].filter((card) => card.offsetParent !== null)
    .map((card) => card.querySelector(".rhi-card-title").textContent)"""


def press(reader: Page, key: str) -> None:
    codes = {"Tab": 9, "ArrowRight": 39}
    for kind in ("rawKeyDown", "keyUp"):
        reader.call("Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=codes[key])


@pytest.mark.parametrize("name", ["", "gallery/"])
def test_the_keyboard_filters_the_cards_and_the_page_says_how_many_are_left(
    name: str, site: str, reader: Page
) -> None:
    set_width(reader, WIDTHS[-1])
    reader.open(f"{site}{name}")
    everything = reader.evaluate(_VISIBLE)
    reader.evaluate("document.querySelector('.rhi-filter input').focus()")
    press(reader, "ArrowRight")  # to the first topic
    first = reader.evaluate("document.querySelector('.rhi-filter input:checked').value")
    topic = reader.evaluate(_VISIBLE)
    press(reader, "Tab")  # to the backends
    press(reader, "ArrowRight")
    save_screenshot(reader, f"filtered-{name.strip('/') or 'index'}")
    filtered = reader.evaluate(_VISIBLE)
    count = reader.evaluate("document.querySelector('.rhi-card-count').textContent")
    outline = reader.evaluate(
        "getComputedStyle(document.querySelector('.rhi-filter input:focus-visible + span')).outlineStyle"
    )
    assert first.startswith("topic-")
    assert "Triangle" in topic
    assert set(filtered) < set(topic) < set(everything) or set(filtered) == set(topic) < set(everything)
    assert count == f"{len(filtered)} of {len(everything)} programs"
    assert outline == "solid"


def test_the_filters_work_without_a_script(site: str, reader: Page) -> None:
    reader.call("Emulation.setScriptExecutionDisabled", value=True)
    try:
        reader.open(f"{site}gallery/")
        everything = reader.evaluate(_VISIBLE)
        reader.evaluate("document.querySelector('input[value=topic-compute]').checked = true")
        compute = reader.evaluate(_VISIBLE)
        message = reader.evaluate("document.querySelector('.rhi-card-count').textContent")
    finally:
        reader.call("Emulation.setScriptExecutionDisabled", value=False)
    assert "Compute particles" in compute
    assert "Triangle" in everything
    assert "Triangle" not in compute
    assert message == ""


def test_filters_and_cards_have_names_for_screen_readers(site: str, reader: Page) -> None:
    reader.open(f"{site}gallery/")
    nodes = reader.call("Accessibility.getFullAXTree")["nodes"]
    named = [
        (node["role"]["value"], node.get("name", {}).get("value", ""))
        for node in nodes
        if not node["ignored"]
    ]
    assert ("radio", "Compute") in named
    assert ("radio", "OpenGL") in named
    assert any(role == "link" and "Textured cube" in name and "mip levels" in name for role, name in named)
    assert [name for role, name in named if role in ("radio", "link") and not name.strip()] == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_cards_and_filters_have_contrast_in_both_schemes(scheme: str, site: str, reader: Page) -> None:
    """4.5 to 1 at least, between a text and what is behind it."""
    reader.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
    reader.open(f"{site}gallery/")
    reader.evaluate("localStorage.clear()")  # the scheme of an earlier visit
    reader.open(f"{site}gallery/")
    expected_scheme = {"light": "default", "dark": "slate"}[scheme]
    reader.wait_for(f"document.body.dataset.mdColorScheme === {expected_scheme!r}")
    save_screenshot(reader, f"gallery-{scheme}")
    ratios = reader.evaluate(
        """(() => {
            const canvas = document.createElement("canvas").getContext("2d", {willReadFrequently: true});
            const paint = (...colours) => {
                for (const colour of colours) { canvas.fillStyle = colour; canvas.fillRect(0, 0, 1, 1); }
                return [...canvas.getImageData(0, 0, 1, 1).data].slice(0, 3).map((value) => value / 255);
            };
            const luminance = (colour) => colour.map((value) =>
                value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4)
                .reduce((sum, value, index) => sum + value * [0.2126, 0.7152, 0.0722][index], 0);
            const page = getComputedStyle(document.body).backgroundColor;
            return [".rhi-filter span", ".rhi-filter input:checked + span", ".rhi-card-title", ".rhi-card-live"]
                .map((name) => {
                    const style = getComputedStyle(document.querySelector(name));
                    const back = paint(page, style.backgroundColor);
                    const [low, high] = [luminance(back), luminance(paint(page, style.backgroundColor, style.color))]
                        .sort((first, second) => first - second);
                    return (high + 0.05) / (low + 0.05);
                });
        })()"""
    )
    reader.call("Emulation.setEmulatedMedia", features=[])
    assert min(ratios) >= 4.5, ratios
