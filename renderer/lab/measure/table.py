"""Tables as text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence


def format_table(header: Sequence[str], rows: Sequence[Sequence[object]], *, markdown: bool = False) -> str:
    """Format a table with aligned columns, or as Markdown.

    Text is aligned to the left, numbers to the right; whole numbers have their digits in groups of three.
    """
    if markdown:
        lines = [header, ["---"] * len(header), *([_format_cell(value) for value in row] for row in rows)]
        return "\n".join("| " + " | ".join(line) + " |" for line in lines)
    cells = [[_format_cell(value) for value in row] for row in rows]
    widths = [max(len(line[column]) for line in [list(header), *cells]) for column in range(len(header))]
    numeric = [all(not isinstance(row[column], str) for row in rows) for column in range(len(header))]

    def line(texts: Sequence[str]) -> str:
        parts = zip(texts, widths, numeric, strict=True)
        return "  ".join(t.rjust(w) if right else t.ljust(w) for t, w, right in parts).rstrip()

    return "\n".join([line(header), "  ".join("-" * width for width in widths), *map(line, cells)])


def format_rows(rows: Sequence[Mapping[str, object]], *, markdown: bool = False) -> str:
    """Format mappings with the same keys as a table with a column for each key.

    True is "on", False is "off", and None is a dash.
    """
    cells = [[format_value(value) for value in row.values()] for row in rows]
    return format_table([title_of(name) for name in rows[0]], cells, markdown=markdown)


def title_of(name: str) -> str:
    """The title of a field's column: `hardware_state_changes` is "hardware states"."""
    return name.replace("_", " ").replace("milliseconds", "ms").replace(" changes", "s")


def format_value(value: object) -> object:
    """A value as its cell shows it."""
    if isinstance(value, bool):
        return "on" if value else "off"
    return "-" if value is None else value


def _format_cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:,.2f}"
    return f"{value:,}" if isinstance(value, int) else str(value)
