"""The gallery as a grid of cards, which a reader filters by topic and backend.

The site's build puts the grid on the first page and at the top of the gallery. A card has the image, title and first
sentence of a section of `docs/gallery.md`, and leads to it, where the program runs live if it can.

The filters are radio buttons. The style sheet hides the other cards, without a script; with one, the page says how
many cards are left.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from live_site import NOT_LIVE

SOURCES: Final = Path(__file__).resolve().parent / "site"
"""The style sheet and the script of the cards."""

TOPICS: Final = {
    "start": "First programs",
    "objects": "Many objects",
    "light": "Light and shadow",
    "compute": "Compute",
    "passes": "Images and passes",
    "flat": "2D, text, interfaces",
    "fragment": "Drawn by a shader alone",
    "engine": "Engines and tests",
    "processes": "Processes, other code",
}
"""The topics of the filter, with their titles."""

PROGRAM_TOPICS: Final = {
    "batch": "processes",
    "beside_moderngl": "processes",
    "bloom": "passes light",
    "boids": "compute flat objects",
    "curves": "start flat",
    "deferred": "light passes",
    "draw_lists": "flat",
    "engine_test": "engine",
    "film": "processes",
    "instanced_crates": "objects start",
    "julia": "fragment",
    "life": "compute passes",
    "mini_engine": "engine light passes",
    "occlusion": "objects",
    "particles": "compute objects",
    "picking": "passes",
    "raymarching": "fragment",
    "shadow_map": "light passes",
    "sprites": "flat objects",
    "terrain": "fragment",
    "text": "flat",
    "textured_cube": "start",
    "tiled_lights": "light compute engine",
    "triangle": "start",
}
"""The topics of each program, by the name of its file."""

BACKENDS: Final = {
    "live": "Live in this site",
    "gl": "OpenGL",
    "cl": "OpenCL",
    "wgpu": "WebGPU (wgpu)",
    "null": "Null device",
}
"""The backends of the filter, with their titles."""

NOT_ON_WGPU: Final = frozenset({"occlusion", "tiled_lights"})
"""Programs that draw on conditions, which WebGPU lacks."""
LONGER: Final = frozenset({"mini_engine", "tiled_lights"})
"""Programs of the gallery that are too long for its page, so they don't run there."""

_SECTION: Final = re.compile(
    r"^## (?P<title>[^\n]+)\n\n(?P<text>(?:(?!^## ).)*?)!\[[^\]]*\]\(images/(?P<image>[^)\s]+)\)$",
    re.MULTILINE | re.DOTALL,
)
_LINK: Final = re.compile(r"\[([^\]]+)\]\([^)]*\)")


@dataclass(frozen=True)
class Card:
    """A program of the gallery.

    Attributes:
        name: of its file, without the suffix.
        title: of its section.
        sentence: the section's first one, as plain text.
        image: its path in `docs/images`.
        topics: keys of `TOPICS`.
        backends: keys of `BACKENDS`.
    """

    name: str
    title: str
    sentence: str
    image: str
    topics: tuple[str, ...]
    backends: tuple[str, ...]

    @property
    def anchor(self) -> str:
        """The section's anchor in the gallery's page."""
        return re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", self.title.lower())).strip("-")


def list_cards(gallery: str, absent: Mapping[str, str] = NOT_LIVE) -> list[Card]:
    """Return the cards of the gallery's sections that have an image.

    Args:
        gallery: the page's Markdown.
        absent: the programs that don't run in the site.

    Raises:
        KeyError: a program has no topics in `PROGRAM_TOPICS`.
    """
    cards = []
    for section in _SECTION.finditer(gallery):
        name = Path(section["image"]).stem
        text = " ".join(_LINK.sub(r"\1", section["text"]).replace("`", "").split())
        sentence = re.split(r"(?<=[.;])\s", re.sub(r"^\w+\.py(:| is longer:)\s*", "", text))[0].rstrip(".;:")
        backends = [
            backend
            for backend in BACKENDS
            if not (backend == "live" and (name in absent or name in LONGER))
            and not (backend == "wgpu" and name in NOT_ON_WGPU)
        ]
        topics = tuple(PROGRAM_TOPICS[name].split())
        sentence = sentence[:1].upper() + sentence[1:]
        cards.append(Card(name, section["title"], sentence, section["image"], topics, tuple(backends)))
    return cards


def _write_filter(name: str, title: str, choices: Mapping[str, str]) -> Iterator[str]:
    yield f'<fieldset class="rhi-filter"><legend>{title}</legend>'
    for value, label in {"": "All", **choices}.items():
        checked = "" if value else " checked"
        radio = f'<input type="radio" name="rhi-{name}" value="{value and f"{name}-{value}"}"{checked}>'
        yield f"<label>{radio}<span>{label}</span></label>"
    yield "</fieldset>"


def _write_card(card: Card, gallery: str) -> Iterator[str]:
    tags = " ".join(
        [f"topic-{topic}" for topic in card.topics] + [f"backend-{name}" for name in card.backends]
    )
    live = '<span class="rhi-card-live">live</span>' if "live" in card.backends else ""
    sentence = html.escape(card.sentence)
    yield f'<li data-tags="{tags}"><a href="{gallery}#{card.anchor}">'
    yield f'<img src="images/{card.image}" alt="{sentence}" width="320" height="240" loading="lazy">'
    yield f'<span class="rhi-card-title">{html.escape(card.title)}</span>{live}</a></li>'


def write_grid(cards: list[Card], gallery: str) -> str:
    """Return the HTML of the grid, with its filters.

    The generator corrects addresses of images, which are relative to the page's file.

    Args:
        cards: in the order of the page.
        gallery: the gallery's page, as seen from the page's address; "" or ending in "/".
    """
    lines = ['<div class="rhi-cards" role="group" aria-label="Programs of the gallery">']
    lines += _write_filter("topic", "Topic", TOPICS)
    lines += _write_filter("backend", "Runs on", BACKENDS)
    lines += ['<p class="rhi-card-count" role="status"></p>', "<ul>"]
    for card in cards:
        lines += _write_card(card, gallery)
    return "\n".join([*lines, "</ul>", "</div>"])


def add_to_first_page(page: str, cards: list[Card]) -> str:
    """Return the first page with a section of the gallery before its section of backends, or at its end."""
    grid = f"## Gallery\n\n{write_grid(cards, 'gallery/')}\n\n"
    before, heading, after = page.partition("## Backends\n")
    return f"{before}{grid}{heading}{after}" if heading else f"{page.rstrip()}\n\n{grid}"


def add_to_gallery(page: str, cards: list[Card]) -> str:
    """Return the gallery's page with the grid above its first section."""
    before, heading, after = page.partition("\n## ")
    return f"{before}\n{write_grid(cards, '')}\n{heading}{after}"


def write_style() -> str:
    """Return the style sheet: its file, and a rule for each choice of a filter."""
    rules = [
        f'.rhi-cards:has(input[value="{name}-{value}"]:checked) li:not([data-tags~="{name}-{value}"])'
        for name, choices in (("topic", TOPICS), ("backend", BACKENDS))
        for value in choices
    ]
    return (SOURCES / "cards.css").read_text(encoding="utf-8") + ",\n".join(rules) + " { display: none; }\n"


def write_assets(folder: Path) -> None:
    """Write the style sheet and the script to a folder of the site's pages."""
    folder.mkdir(parents=True)
    (folder / "cards.css").write_text(write_style(), encoding="utf-8")
    (folder / "cards.js").write_text((SOURCES / "cards.js").read_text(encoding="utf-8"), encoding="utf-8")
