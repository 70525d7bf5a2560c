"""docs/shading.md is correct: its code runs, and its shaders compile; docs/shading-builtins.md names all
built-ins."""

import importlib.util
import re
import sys
from pathlib import Path

from rhi.shading import Shader
from rhi.shading.language.builtins import BUILTINS
from rhi.shading.tools.reference import merge_forms, update

PAGE = Path(__file__).parents[4] / "docs" / "shading.md"
REFERENCE = PAGE.with_name("shading-builtins.md")


def test_the_code_of_the_page_runs_and_its_shaders_compile_on_the_driver(tmp_path, link):
    path = tmp_path / "page.py"
    path.write_text(
        "\n".join(re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.S)),
        encoding="utf-8",
    )
    spec = importlib.util.spec_from_file_location("page", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules["page"] = module
    try:
        spec.loader.exec_module(module)
    finally:
        del sys.modules["page"]
    shaders = [
        v for v in vars(module).values() if isinstance(v, type) and issubclass(v, Shader) and v is not Shader
    ]
    assert len(shaders) == 5
    for shader in shaders:
        link(shader)


def test_the_page_names_every_builtin():
    words = set(re.findall(r"\w+", REFERENCE.read_text(encoding="utf-8")))
    assert set(BUILTINS) <= words


def test_the_page_of_built_ins_is_generated_from_their_table():
    page = REFERENCE.read_text(encoding="utf-8")
    assert update(page) == page, "run python -m rhi.shading.tools.reference docs/shading-builtins.md"
    assert update(page.replace("| sine (", "| sin (")) == page


MERGED = {
    "T": "BIUF",
    "N": "IUF",
    "W": "IU",
    "TV": ("V", "IV", "UV", "BV"),
    "NV": ("V", "IV", "UV"),
    "n": ("int", "uint", "float"),
    "w": ("int", "uint"),
}


def expand(form: str) -> set[str]:
    """All signatures that letters for several kinds of numbers stand for."""
    letters = sorted({word for word in re.findall(r"\w+", form) if word in MERGED})
    if not letters:
        return {form}
    variants = zip(*(MERGED[letter] for letter in letters), strict=True)
    words = [dict(zip(letters, kinds, strict=True)) for kinds in variants]
    return {"".join(kinds.get(word, word) for word in re.split(r"\b", form)) for kinds in words}


def test_merged_signatures_stand_for_those_of_the_table():
    merged_rows = 0
    for name, builtin in BUILTINS.items():
        forms = [f"{name} {form.strip()}" for form in builtin.form.split(";")]
        merged = merge_forms(forms)
        assert set().union(*map(expand, merged)) == set(forms)
        assert sum(len(expand(form)) for form in merged) == len(forms)
        merged_rows += len(merged) < len(forms)
    assert merged_rows > 15


def test_signatures_that_lack_a_kind_stay_apart():
    assert merge_forms(["f(I) -> I", "f(F) -> F"]) == ["f(I) -> I", "f(F) -> F"]
    assert merge_forms(["f(I) -> I", "f(U) -> I"]) == ["f(I) -> I", "f(U) -> I"]
    assert merge_forms(["f(U) -> U", "f(I) -> I", "f(F) -> F"]) == ["f(N) -> N"]
    assert merge_forms(["f(V) -> V", "f(IV) -> IV", "f(UV) -> UV"]) == ["f(NV) -> NV"]
