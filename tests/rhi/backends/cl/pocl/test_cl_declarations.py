"""Programs that declare the functions that they use themselves: exactly as the driver's header does, or not
at all."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cl_kit import ClKit, describe_program

import rhi
from rhi.backends.cl import cl_context
from rhi.backends.cl.cl_context import open_context
from rhi.backends.cl.pocl.declarations import GUARD, declare, declare_function
from rhi.backends.cl.pocl.kernel_cache import KernelCache
from rhi.conformance.shaders import Colored
from rhi.conformance.shapes import rectangle

INCLUDE_FOLDERS = ("/usr/share/pocl/include", *map(str, Path("/usr/lib").glob("llvm-*/lib/clang/*/include")))
EXTENSION = re.compile(r"(?<!_)half\b(?! \*)|half\d|u?int __.*\bdot\(")
"""Forms that belong to optional extensions."""
HEADER_ONLY = "kernel void use(global uint *words, int count) { words[0] = (uint)ldexp(3.0f, count); }"


def normalise(declaration: str) -> str:
    """Write a declaration of the header as those here, without the names of parameters."""
    for short, long in (
        ("__ovld __cnfn", "__attribute__((overloadable, const))"),
        ("__ovld __purefn", "__attribute__((overloadable, pure))"),
        ("__ovld __conv", "__attribute__((overloadable, convergent))"),
        ("_CL_OVERLOADABLE _CL_READNONE", "__attribute__((overloadable, const))"),
        ("__ovld", "__attribute__((overloadable))"),
    ):
        declaration = declaration.replace(short, long)
    head, parameters = declaration.split(")) ", 1)
    name, parameters = parameters.rstrip(")").split("(")
    kinds = []
    for parameter in parameters.split(",") if parameters else ():
        words = re.findall(r"\w+|\*", parameter)
        if words[-1] != "*" and len(words) > 1 and not words[-1].startswith("__"):
            words.pop()
        kinds.append(" ".join(words).replace("__", "").replace("volatile ", "").replace("const ", ""))
    return f"{head})) {name.strip()}({', '.join(kinds)})"


def drop_qualifiers(declaration: str) -> str:
    """Return a declaration without what makes no difference to which function is called."""
    head, parameters = declaration.split(")) ", 1)
    return f"{head})) {re.sub('(const|volatile) ', '', parameters)}"


@pytest.fixture(scope="module")
def header() -> dict[str, set[str]]:
    """The declarations of a driver's header, by name."""
    folder = next(
        (
            Path(include_folder)
            for include_folder in INCLUDE_FOLDERS
            if (Path(include_folder) / "opencl-c.h").exists()
        ),
        None,
    )
    if folder is None:
        pytest.skip("no header is installed")
    text = (folder / "opencl-c.h").read_text(encoding="utf-8")
    additions = folder / "_clang_opencl.h"  # PoCL's own additions
    text += additions.read_text(encoding="utf-8") if additions.exists() else ""
    text = re.sub(r"//[^\n]*|/\*.*?\*/|^ *#[^\n]*(?:\\\n[^\n]*)*", "", text, flags=re.DOTALL | re.MULTILINE)
    forms: dict[str, set[str]] = defaultdict(set)
    form = r"(\w[\w\s]*?(?:__ovld|_CL_OVERLOADABLE)[\w\s]*?\b(\w+)\s*\([^()]*\))\s*;"
    for declaration, name in re.findall(form, text):
        forms[name].add(normalise(" ".join(declaration.split())))
    assert len(forms) > 400
    return forms


def test_each_declared_function_has_the_forms_of_the_header(header: dict[str, set[str]]) -> None:
    compared, wrong = 0, {}
    for name, expected in header.items():
        declared = {drop_qualifiers(declaration) for declaration in declare_function(name)}
        if declared:
            compared += 1
            named = any(
                re.search(r"(global|local|private|constant) \w+ \*", declaration) for declaration in expected
            )
            forms = {
                declaration
                for declaration in expected
                if not EXTENSION.search(declaration)
                and not (named and re.search(r"[(,] ?\w+ \*", declaration))
            }
            wrong |= {name: (declared - forms, forms - declared)} if declared != forms else {}
    assert wrong == {}
    assert compared > 600


def test_whatever_else_the_header_has_is_left_to_it(header: dict[str, set[str]]) -> None:
    texts = {name: declare(f"kernel void f(void) {{ {name}(); }}") for name in header}
    assert {
        name for name, text in texts.items() if text is not None and not list(declare_function(name))
    } == set()


def header_constants() -> Iterator[str]:
    for folder in INCLUDE_FOLDERS[:1]:
        text = (Path(folder) / "opencl-c-base.h").read_text(encoding="utf-8")
        yield from re.findall(r"^\s*#define ([A-Za-z]\w*)", text, re.MULTILINE)
        types = r"^typedef [^;]*?(\w+)(?: __attribute__\(\(ext_vector_type\(\d+\)\)\))?;"
        yield from re.findall(types, text, re.MULTILINE)


@pytest.mark.skipif(
    not (Path(INCLUDE_FOLDERS[0]) / "opencl-c-base.h").exists(), reason="no header is installed"
)
def test_constants_and_types_are_declared_or_left_to_the_header() -> None:
    names = {name for name in header_constants() if not name.startswith(("cl_", "workDimension"))}
    assert {"INFINITY", "uint16", "CLK_NORMALIZED_COORDS_TRUE", "FLT_MAX"} < names
    texts = {name: declare(f"kernel void f(void) {{ {name} }}") for name in names}
    assert {
        name for name, text in texts.items() if text is not None and not re.search(rf"\b{name}\b", text)
    } == set()


@pytest.fixture
def requests(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, tuple[str, ...]]]:
    """The programs that the driver is given, which the cache doesn't know."""
    recorded: list[tuple[str, tuple[str, ...]]] = []
    build = cl_context.build_again
    for name in ("find", "read_code", "store_code", "record"):
        monkeypatch.setattr(KernelCache, name, lambda *_: None)

    def note(opened: Any, source: str, options: tuple[str, ...]) -> Any:
        recorded.append((source, options))
        return build(opened, source, options)

    monkeypatch.setattr(cl_context, "build_again", note)
    return recorded


@pytest.fixture
def needs_declarations() -> None:
    if not open_context().cache.declares:
        pytest.skip("this driver has no header to leave out")


@pytest.mark.usefixtures("needs_declarations")
def test_no_program_of_rhi_needs_the_header(requests: list[tuple[str, tuple[str, ...]]]) -> None:
    with rhi.create_device("cl") as device:
        image = device.texture((8, 8), rhi.Format.RGBA16F, levels=2)
        with device.render_pass(image, clear=(0, 0, 0, 1)):
            device.draw(device.program(Colored), device.mesh(rectangle()))
        image.generate_mipmaps()
        image.read()
    assert len(requests) == 5  # a probe; set-up, vertices and raster; mipmaps
    assert all(GUARD in options for _, options in requests)


@pytest.mark.usefixtures("needs_declarations")
def test_a_program_that_uses_other_functions_gets_the_header(
    cl_kit: ClKit, requests: list[tuple[str, tuple[str, ...]]]
) -> None:
    words = cl_kit.buffer(np.zeros(4, np.uint32))
    cl_kit.backend.bind_storage(0, words, 0, 16)
    cl_kit.dispatch(cl_kit.program(describe_program(HEADER_ONLY)), 1)
    assert cl_kit.words(words, 1) == [3 << 4]
    ((_, options),) = requests
    assert GUARD not in options


@pytest.mark.usefixtures("needs_declarations")
def test_a_driver_that_cannot_do_without_its_header_keeps_it(
    monkeypatch: pytest.MonkeyPatch, requests: list[tuple[str, tuple[str, ...]]]
) -> None:
    broken = "typedef int uint;\nthis is no declaration\n"
    monkeypatch.setattr("rhi.backends.cl.pocl.kernel_cache.declare", lambda source: broken)
    opened = open_context()
    assert not opened.cache.declares
    assert [GUARD in options for _, options in requests] == [True, False]


def test_lines_are_counted_without_the_declarations() -> None:
    request = KernelCache(None, "driver", declares=True).request("kernel void f(void) {}  // as it is\n", ())
    source, options = request.write()
    assert source.split("#line 1\n")[1].startswith("kernel void f(void) {}")
    assert options == (GUARD,)


def test_a_driver_without_the_header_gets_the_program_unchanged() -> None:
    request = KernelCache(None, "driver").request("kernel void f(void) {}\n", ("-w",))
    assert request.write() == ("kernel void f(void) {}\n", ("-w",))
