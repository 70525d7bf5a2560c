"""The structure of the project: what the docs say of it is true, and a name means one thing.

Which package may import which is held by import-linter (pyproject.toml); what is tested here is derived from
tables and folders, so that a new leaf needs no row of its own.
"""

from __future__ import annotations

import ast
import importlib
import logging
import re
import tokenize
import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("rhi", "rhi_pytest", "rhi_screen", "renderer")
FOLDERS = ("rhi", "rhi_pytest", "rhi_screen", "renderer", "examples", "benchmarks", "tests")
PAGES = [
    *sorted(ROOT.glob("*.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "examples").glob("*/README.md")),
]
PROGRAMS = [
    path
    for folder in FOLDERS
    for path in sorted((ROOT / folder).rglob("*.py*"))
    if path.suffix in (".py", ".pyi")
]
MODULES_WITH_LOGGERS = [
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in PROGRAMS
    if path.relative_to(ROOT).parts[0] in ("rhi", "rhi_screen", "renderer")
    and "LOGGER: Final = logging.getLogger(" in path.read_text(encoding="utf-8")
]
TICKED = re.compile(r"`([^`\n]+)`")
DOTTED = re.compile(r"(?:rhi_screen|rhi_pytest|rhi|renderer)(?:\.\w+)+")
FILE = re.compile(
    r"(?:rhi_screen|rhi|renderer|tests|docs|examples|benchmarks|scripts)/[\w./-]*\.(?:py|pyi|cl|md|sh)"
)
MOVED = "docs/decisions/new-names.md"  # lists names that are gone, beside those that took their place


@cache
def read_prose(path: Path) -> tuple[tuple[int, str], ...]:
    """The text of a page, or the strings and comments of a program, with their first lines."""
    if path.suffix == ".md":
        text = re.sub(
            r"```.*?```",
            lambda block: "\n" * block[0].count("\n"),
            path.read_text(encoding="utf-8"),
            flags=re.DOTALL,
        )
        return ((1, text),)
    with path.open("rb") as file:
        tokens = tokenize.tokenize(file.readline)
        kinds = (tokenize.STRING, tokenize.COMMENT)
        return tuple(
            (token.start[0], token.string) for token in tokens if token.type in kinds and "`" in token.string
        )


def list_mentions(path: Path, pattern: re.Pattern[str]) -> Iterator[tuple[int, str]]:
    """The words of a file in back-ticks, each with its line."""
    for start, text in read_prose(path):
        for ticked in TICKED.finditer(text):
            match = pattern.match(ticked[1])
            if match is not None:
                yield start + text.count("\n", 0, ticked.start()), match[0]


def resolves(dotted: str) -> bool:
    """True if a dotted path names a module, something in one, or a logger."""
    if dotted in logging.root.manager.loggerDict:
        return True
    parts = dotted.split(".")
    for count in range(len(parts), 0, -1):
        name = ".".join(parts[:count])
        try:
            resolved: object = importlib.import_module(name)
        except ModuleNotFoundError as error:
            if error.name is not None and (name == error.name or name.startswith(error.name + ".")):
                continue
            raise
        try:
            for part in parts[count:]:
                resolved = getattr(resolved, part)
        except AttributeError:
            # A field of a dataclass without a default, or one that only instances have.
            owner = getattr(resolved, "__annotations__", {}) if isinstance(resolved, type) else {}
            return part in owner or part in getattr(resolved, "__slots__", ())
        return True
    return False


def describe(path: Path, line: int, mention: str) -> str:
    return f"{path.relative_to(ROOT)}:{line}: {mention}"


@pytest.mark.parametrize("folder", ["pages", *FOLDERS])
def test_every_dotted_path_in_back_ticks_resolves(folder: str) -> None:
    paths = PAGES if folder == "pages" else [path for path in PROGRAMS if path.is_relative_to(ROOT / folder)]
    mentions = [
        (path, *mention) for path in paths for mention in list_mentions(path, DOTTED) if not path.match(MOVED)
    ]
    for module in MODULES_WITH_LOGGERS:  # pages name loggers, which exist once their module is imported
        importlib.import_module(module)
    resolved = {dotted: resolves(dotted) for dotted in {mention for _, _, mention in mentions}}
    assert [describe(*mention) for mention in mentions if not resolved[mention[2]]] == []


def test_every_file_in_back_ticks_exists() -> None:
    wrong = [
        describe(path, line, file)
        for path in (*PAGES, *PROGRAMS)
        if not path.match(MOVED)
        for line, file in list_mentions(path, FILE)
        if not (ROOT / file).exists()
    ]
    assert wrong == []


@pytest.mark.parametrize(
    "dotted",
    [
        "rhi.Device",
        "rhi.contract.Backend.draw",
        "rhi.contract.backend",
        "renderer.lab.measure",
        "rhi.Capabilities.draws",
    ],
)
def test_a_path_that_exists_resolves(dotted: str) -> None:
    assert resolves(dotted)


@pytest.mark.parametrize(
    "dotted", ["rhi.validation", "renderer.technique", "rhi.Device.paint", "rhi.contract.backends"]
)
def test_a_path_that_does_not_exist_is_found(dotted: str) -> None:
    assert not resolves(dotted)


# -- one name, one thing -------------------------------------------------------------------------------------

ROLES = {"Buffers", "Draws", "Fence", "Programs", "Queries", "Samplers", "Textures", "VertexArrays"}
"""Classes with the same job in each backend, which therefore have the same name."""
REPRESENTATIONS = {"Break", "Continue", "If", "Return", "Statement"}
"""Statements of both intermediate representations, always written `tree.If` and `lanes.If`."""
TABLE_MODULES = ["rhi/device/resources/texture_tables.py", "rhi/shading/language/texture_tables.py"]
"""The modules of the table that a device makes, and of the type as which shaders declare it."""


def list_classes(source: str) -> Iterator[str]:
    """The names of the classes at the top level of a module."""
    yield from (node.name for node in ast.parse(source).body if isinstance(node, ast.ClassDef))


def list_homonyms(sources: dict[str, str]) -> dict[str, list[str]]:
    """Names of classes that several modules define, with these modules. A leading underscore makes no other
    name."""
    modules: dict[str, list[str]] = {}
    for module, source in sources.items():
        for name in list_classes(source):
            modules.setdefault(name.lstrip("_"), []).append(module)
    return {name: paths for name, paths in modules.items() if len(paths) > 1}


def test_a_class_name_means_one_thing() -> None:
    sources = {
        str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        if not path.is_relative_to(ROOT / "rhi/conformance")
    }
    homonyms = list_homonyms(sources)
    for name in ROLES:
        assert all(module.startswith("rhi/backends/") for module in homonyms.pop(name, []))
    for name in REPRESENTATIONS:
        assert sorted(homonyms.pop(name)) == ["rhi/shading/ir/lanes.py", "rhi/shading/ir/tree.py"]
    assert sorted(homonyms.pop("TextureTable")) == TABLE_MODULES
    assert homonyms == {}


def test_a_homonym_is_found() -> None:
    assert list_homonyms({"a": "class Place: ...", "b": "class _Place: ...", "c": "class Other: ..."}) == {
        "Place": ["a", "b"]
    }


# -- techniques ----------------------------------------------------------------------------------------------

FLOORS = (("technique_settings",), ("auto", "inspection", "resource_capture"), ("table",))
"""The modules that may know techniques, and those on floors below their own."""


def list_wrong_imports(folder: Path, leaves: set[str]) -> list[str]:
    """The imports between the modules of techniques that run up, or from one technique to another."""
    wrong = []
    for path in sorted(folder.rglob("*.py")):
        package = path.relative_to(folder).with_suffix("").parts[0]
        if package == "__init__":
            continue
        allowed = {"parts", "technique"}
        for number, floor in enumerate(FLOORS):
            if package in floor:
                allowed |= leaves.union(*FLOORS[number + 1 :])
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("renderer.techniques."):
                used = (node.module or "").split(".")[2]
                wrong += [f"{path.name}: {used}"] if used not in allowed else []
    return wrong


def list_leaves() -> set[str]:
    from renderer.techniques import TECHNIQUES, Technique

    makers: list[Callable[..., Technique]] = list(TECHNIQUES.values())
    return {maker.__module__.rpartition(".")[2] for maker in makers}


def test_no_technique_imports_another_and_parts_import_none() -> None:
    folder = ROOT / "renderer/techniques"
    leaves = list_leaves()
    assert list_wrong_imports(folder, leaves) == []
    rest = {path.stem for path in folder.glob("*.py")} - leaves - {"__init__", "technique", *sum(FLOORS, ())}
    assert rest == set(), "a part of techniques belongs to parts/, and a technique into the table"


def test_a_technique_that_imports_another_is_found(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    imports = {"deferred": "forward", "parts/depth": "deferred", "forward": "parts.depth", "table": "forward"}
    for name, imported in {**imports, "auto": "technique_settings", "resource_capture": "auto"}.items():
        (tmp_path / f"{name}.py").write_text(
            f"from renderer.techniques.{imported} import Thing\n", encoding="utf-8"
        )
    wrong_imports = list_wrong_imports(tmp_path, {"deferred", "forward"})
    assert wrong_imports == [
        "auto.py: technique_settings",
        "deferred.py: forward",
        "depth.py: deferred",
        "resource_capture.py: auto",
    ]


# -- rooms ---------------------------------------------------------------------------------------------------


def count_entries(folder: str) -> int:
    """The modules and packages at the root of a package, without its own `__init__`."""
    root = ROOT / folder
    entries = [path for path in root.iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()]
    return len(entries) - 1


@pytest.mark.parametrize(
    ("folder", "most"),
    [("renderer", 20), ("renderer/techniques", 17), ("rhi/backends/cl", 12), ("renderer/lab", 12)],
)
def test_a_package_has_few_rooms(folder: str, most: int) -> None:
    assert count_entries(folder) <= most


def test_the_root_of_rhi_has_at_most_a_dozen_packages_and_modules() -> None:
    rooms = [
        path for path in (ROOT / "rhi").iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()
    ]
    assert len(rooms) <= 12


def test_no_two_files_of_tests_have_one_name() -> None:
    """They are imported by their names alone, so pytest would refuse the second one."""
    names = [path.name for path in (ROOT / "tests").rglob("test_*.py")]
    assert sorted(name for name in set(names) if names.count(name) > 1) == []
    assert len(names) > 100


def list_unreachable_imports(root: Path, reachable: set[Path]) -> list[str]:
    """Imports in tests that only work if pytest has collected another folder before.

    A test file reaches modules in its folder, beside a `conftest.py` above it, and in `reachable` folders. The
    `conftest.py` of a folder is for the files below it: what it imports may be beside it.
    """
    files = sorted((root / "tests").rglob("*.py"))
    folders: dict[str, set[Path]] = {}
    for file in files:
        folders.setdefault(file.stem, set()).add(file.parent)
    wrong = []
    for file in files:
        reached = {
            file.parent,
            *(each for each in file.parents if (each / "conftest.py").exists()),
        } | reachable
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                modules = [alias.name for alias in node.names]
            else:
                modules = [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            for module in modules:
                *path, name = module.split(".")
                if path[:1] == ["tests"]:
                    lacks = name == "conftest" and root.joinpath(*path) not in file.parents
                else:
                    lacks = not path and name in folders and not folders[name] & reached
                if lacks:
                    wrong.append(f"{file.relative_to(root).as_posix()}:{node.lineno}: {module}")
    return wrong


def test_each_file_of_tests_can_be_collected_alone() -> None:
    options = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["pytest"]
    reachable = {ROOT / folder for folder in options["ini_options"]["pythonpath"]}
    assert list_unreachable_imports(ROOT, reachable) == []


def test_an_import_that_needs_another_folder_is_detected(tmp_path: Path) -> None:
    files = {
        "tests/kits/kit.py": "",
        "tests/a/conftest.py": "import beside",
        "tests/a/beside.py": "",
        "tests/a/deep/test_right.py": "import beside\nimport kit\nfrom tests.a.conftest import x\nimport ast",
        "tests/b/test_wrong.py": "import kit\nimport beside\nfrom tests.a.conftest import x",
    }
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text, encoding="utf-8")
    wrong = list_unreachable_imports(tmp_path, {tmp_path / "tests/kits"})
    assert wrong == ["tests/b/test_wrong.py:2: beside", "tests/b/test_wrong.py:3: tests.a.conftest"]


def test_the_example_of_a_port_imports_the_contract_and_the_language_only() -> None:
    for path in sorted((ROOT / "examples/numpy_backend/rhi_numpy").glob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            for name in names:
                assert name.split(".")[0] != "rhi" or name in ("rhi.contract", "rhi.shading"), (
                    f"{path.name}: {name}"
                )


def test_each_package_that_an_extra_installs_is_used() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    needed = [*project["dependencies"], *project["optional-dependencies"]["renderer"]]
    imported = "\n".join(
        path.read_text(encoding="utf-8")
        for folder in ("rhi", "renderer")
        for path in (ROOT / folder).rglob("*.py")
    )
    for requirement in needed:
        name = re.split(r"[^\w-]", requirement)[0].replace("-", "_")
        module = {"pillow": "PIL"}.get(name, name)
        assert re.search(rf"^\s*(import|from) {module}\b", imported, re.MULTILINE), name
