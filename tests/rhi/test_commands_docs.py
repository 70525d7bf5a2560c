"""The examples of docs/commands.md and docs/null.md run as they stand."""

import re
import runpy
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.parametrize("page", ["commands.md", "null.md"])
def test_the_examples_of_a_page_run_one_after_the_other(page, tmp_path):
    blocks = re.findall(r"```python\n(.*?)```", (DOCS / page).read_text(), re.DOTALL)
    assert len(blocks) >= 2
    program = tmp_path / "example.py"
    program.write_text("\n".join(blocks))
    runpy.run_path(str(program), run_name="example")
