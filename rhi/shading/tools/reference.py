"""Writer of the reference of built-ins in a page: `python -m rhi.shading.tools.reference
docs/shading-builtins.md`.

The text between the two markers is generated from the table of built-ins. A test checks that the page is
current.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Final

from rhi.shading.language.builtins import BUILTINS, OPERATORS, Builtin, ErrorBound, SideEffect

BEGIN: Final = "<!-- built-ins, written by `python -m rhi.shading.tools.reference` -->"
END: Final = "<!-- end of built-ins -->"
_SECTIONS: Final = {
    "radians": "Angles",
    "pow": "Exponentials",
    "abs": "Common",
    "length": "Geometry",
    "transpose": "Matrices",
    "less_than": "Component-wise comparisons",
    "float_bits_to_int": "Bits",
    "pack_half_2x16": "Packing",
    "uniform": "Lanes",
    "ddx": "Fragments",
    "atomic_add": "Memory",
    "vertex_index": "Stage inputs",
}
_MIN_EXACT_ROWS: Final = 4
"""Exact built-ins of a section that make a table of their own, without error bounds."""
_FAMILIES: Final[tuple[tuple[Mapping[str, str], ...], ...]] = (
    ({"B": "T"}, {"I": "T"}, {"U": "T"}, {"F": "T"}),
    ({"I": "N", "int": "n"}, {"U": "N", "uint": "n"}, {"F": "N", "float": "n"}),
    ({"I": "W", "int": "w"}, {"U": "W", "uint": "w"}),
    ({"V": "TV"}, {"IV": "TV"}, {"UV": "TV"}, {"BV": "TV"}),
    ({"V": "NV"}, {"IV": "NV"}, {"UV": "NV"}),
)
"""Kinds of numbers that signatures have in common, and the letters that stand for all kinds of a family."""
_DEFAULT: Final = ErrorBound().domain


def write_reference() -> str:
    """Return the reference: a table per section of built-ins, and one of the operators' errors."""
    return "\n".join(_lines()).strip()


def _lines() -> Iterator[str]:
    names = list(BUILTINS)
    firsts = [*(names.index(name) for name in _SECTIONS), len(names)]
    for first, end in pairwise(firsts):
        rows = [BUILTINS[name] for name in names[first:end]]
        errors = [_errors(row) for row in rows]
        is_exact = [not set(numbers) - {"", "0"} for numbers in errors]
        all_exact = all(is_exact) and any("0" in numbers for numbers in errors)
        if not all_exact and sum(is_exact) < _MIN_EXACT_ROWS:
            is_exact = [False] * len(rows) if any("0" in numbers for numbers in errors) else is_exact
        yield f"\n**{_SECTIONS[names[first]]}**{', all exact' if all_exact else ''}\n"
        if not all(is_exact):
            yield "| | | OpenGL | `EXACT` | `FAST` | NumPy |"
            yield "|---|---|---|---|---|---|"
            for row, numbers, exact in zip(rows, errors, is_exact, strict=True):
                if not exact:
                    yield f"| {' | '.join([*_describe(row), *numbers])} |"
        if any(is_exact):
            yield from () if all(is_exact) else ("\nExact:\n",)
            yield "| | |"
            yield "|---|---|"
            for row, exact in zip(rows, is_exact, strict=True):
                if exact:
                    yield f"| {' | '.join(_describe(row))} |"
    yield "\n**Operators**\n"
    yield "| | | OpenGL | `EXACT` | `FAST` | NumPy |"
    yield "|---|---|---|---|---|---|"
    for name, error in OPERATORS.items():
        if error.exact:
            yield f"| `{name}` | of floats{_domain(error)} | {' | '.join(_numbers(error))} |"


def _describe(builtin: Builtin) -> list[str]:
    return [f"`{_form(builtin)}`", f"{builtin.doc}{_domain(builtin.error)}"]


def _form(builtin: Builtin) -> str:
    """Return the row's signatures in the form `name(F, F) -> F`, separated by line breaks."""
    forms = []
    for signature in builtin.form.split(";"):
        result, _, rest = signature.strip().partition("(")
        parameters = ", ".join(part.strip().rstrip("&") for part in rest.rstrip(")").split(","))
        forms.append(f"{builtin.name}({parameters})" + (f" -> {result}" if result != "None" else ""))
    return "`<br>`".join(merge_forms(forms))


def merge_forms(forms: list[str]) -> list[str]:
    """Replace signatures that differ only in their kind of numbers by a single signature in a letter for all."""
    for family in _FAMILIES:
        for form in tuple(forms):
            merged = _replace_words(form, family[0])
            variants = [
                _replace_words(merged, {letter: kind for kind, letter in kinds.items()}) for kinds in family
            ]
            if merged != form and form == variants[0] and set(variants) <= set(forms):
                forms = [
                    merged if signature == form else signature
                    for signature in forms
                    if signature not in variants[1:]
                ]
    return forms


def _replace_words(text: str, words: Mapping[str, str]) -> str:
    return re.sub(r"\w+", lambda word: words.get(word[0], word[0]), text)


def _errors(builtin: Builtin) -> list[str]:
    no_error = (
        not builtin.overloads[0].parameters
        or builtin.effect is not SideEffect.NONE
        or len(builtin.stages) == 1
    )
    return ["", "", "", ""] if no_error else _numbers(builtin.error)


def _numbers(error: ErrorBound) -> list[str]:
    glsl = f"{error.glsl:g}" + (f", or {error.glsl_absolute:g} absolute" if error.glsl_absolute else "")
    return [glsl, *(f"{units:g}" for units in (error.exact, error.fast, error.numpy))]


def _domain(error: ErrorBound) -> str:
    if error.domain == _DEFAULT or not (error.glsl or error.exact):
        return ""
    ranges = ", ".join(f"{_number(low)}…{_number(high)}" for low, high in error.domain)
    return f" ({ranges})"


def _number(number: float) -> str:
    return "2^-126" if number == 2.0**-126 else f"{number:g}"


def update(page: str) -> str:
    """Return the page with its reference regenerated from the table."""
    text = f"{BEGIN}\n\n{write_reference()}\n\n{END}"
    return re.sub(f"{re.escape(BEGIN)}.*{re.escape(END)}", lambda _: text, page, flags=re.DOTALL)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        path = Path(name)
        path.write_text(update(path.read_text(encoding="utf-8")), encoding="utf-8")
