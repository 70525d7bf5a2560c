"""docs/shading.md is correct: its code runs, and its shaders compile; docs/shading-builtins.md names all
built-ins."""

import importlib.util
import re
import sys
from pathlib import Path

from rhi.shading import Shader
from rhi.shading.language.builtins import BUILTINS
from rhi.shading.tools.reference import update

PAGE = Path(__file__).parents[4] / "docs" / "shading.md"
REFERENCE = PAGE.with_name("shading-builtins.md")


def test_the_code_of_the_page_runs_and_its_shaders_compile_on_the_driver(tmp_path, link):
    path = tmp_path / "page.py"
    path.write_text("\n".join(re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S)))
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
    words = set(re.findall(r"\w+", REFERENCE.read_text()))
    assert set(BUILTINS) <= words


def test_the_page_of_built_ins_is_generated_from_their_table():
    page = REFERENCE.read_text()
    assert update(page) == page, "run python -m rhi.shading.tools.reference docs/shading-builtins.md"
    assert update(page.replace("| sine (", "| sin (")) == page
