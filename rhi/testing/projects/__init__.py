"""`python -m rhi new KIND NAME`: writes a small project to start from, with its tests.

Each kind is a folder of texts beside this module: a program and its tests, which run on the null device, so
without a GPU, a driver or a display. Both pass ruff and `mypy --strict` as they are.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Final

from rhi.errors import refuse
from rhi.errors.rules import DEVICE_ARGUMENT
from rhi.testing.projects.names import describe_fault

KINDS: Final = {
    "game": ("a window, a camera that flies, fixed time steps, and a score", "rhi[viewer]"),
    "tool": ("a window, a camera that orbits, and a panel of widgets", "rhi[viewer]"),
    "tests": ("images without a window, and tests of their commands and pixels", "rhi[images]"),
}
"""By name: what is written, and what it needs."""

_PROJECT: Final = """\
[project]
name = "{name}"
version = "0.1.0"
requires-python = ">=3.11"
dependencies = ["{needs}"]

[project.optional-dependencies]
test = ["pytest>=9", "mypy>=1.10", "ruff>=0.6"]

[build-system]
requires = ["setuptools>=77"]
build-backend = "setuptools.build_meta"

[tool.setuptools]
py-modules = ["{name}"]

[tool.mypy]
strict = true

[[tool.mypy.overrides]]
module = ["imgui_bundle.*"]
ignore_missing_imports = true

[tool.ruff]
line-length = 120

[tool.ruff.lint]
select = ["E", "F", "W", "I", "UP", "B"]
"""

_README: Final = """\
# {name}

{words}.

```
pip install --editable ".[test]"
python {name}.py
python -m pytest
python -m mypy {name}.py test_{name}.py
python -m ruff check .
```
"""


def write_project(kind: str, name: str, folder: Path) -> Path:
    """Write a project of a kind of `KINDS` to a new folder of its name in `folder`, and return that.

    Raises:
        ValidationError: `device-argument` for another kind, or a name that is no module's or that a module
            has.
        FileExistsError: if there is such a folder.
    """
    call = f"rhi new {kind} {name}"
    if kind not in KINDS:
        refuse(DEVICE_ARGUMENT, call, kind, ", ".join(KINDS))
    fault = describe_fault(name)
    if fault:
        refuse(DEVICE_ARGUMENT, call, f"{name!r}: {fault}", "a name that no module, package or tool has")
    words, needs = KINDS[kind]
    root = folder / name
    root.mkdir(parents=True)
    (root / "pyproject.toml").write_text(_PROJECT.format(name=name, needs=needs), encoding="utf-8")
    (root / "README.md").write_text(_README.format(name=name, words=words.capitalize()), encoding="utf-8")
    texts = files(__name__) / kind
    for source, target in (("program.txt", f"{name}.py"), ("tests.txt", f"test_{name}.py")):
        text = (texts / source).read_text(encoding="utf-8").replace("NAME", name)
        (root / target).write_text(text, encoding="utf-8")
    return root
