"""When the text of a shader is read, and shaders from strings."""

from __future__ import annotations

import importlib
import linecache
import pickle
import sys

import pytest

from rhi.contract.descriptors import Stage
from rhi.errors import ShaderError
from rhi.shading import compile_shader, evaluate, from_source, run_compute

MODULE = """
from rhi.shading import *

@function
def doubled(x: float) -> float:
    return x * 2.0

class Written(Shader):
    out: StorageRW[float]

    def compute(self) -> None:
        self.out[0] = 2.0

class Broken(Shader):
    out: StorageRW[float]

    def compute(self) -> None:
        self.out[0] = missing + 2.0

def make_later() -> type[Shader]:
    class Later(Shader):
        out: StorageRW[float]

        def compute(self) -> None:
            self.out[0] = 2.0

    return Later
"""


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A module of shaders in a file, and a function that writes the file anew."""
    name = f"edited_shaders_{tmp_path.name}"
    path = tmp_path / f"{name}.py"

    def write(text):
        path.write_text(text, encoding="utf-8")
        linecache.checkcache(str(path))

    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    write(MODULE)
    imported = importlib.import_module(name)
    yield imported, write
    del sys.modules[name]


def kernel_of(shader):
    return compile_shader(shader).emit("glsl", Stage.COMPUTE).text


def test_an_edited_file_does_not_change_the_program_of_a_class(module):
    imported, write = module
    write(MODULE.replace("2.0", "33.5"))
    assert run_compute(imported.Written, out=1)["out"].tolist() == [2]
    assert evaluate(imported.doubled, 4.0) == 8


def test_a_file_whose_lines_have_moved_does_not_hide_a_class(module):
    imported, write = module
    write("\n\n\n\n" + MODULE)
    assert run_compute(imported.Written, out=1)["out"].tolist() == [2]


def test_an_emptied_file_does_not_hide_a_class(module):
    imported, write = module
    write("")
    assert run_compute(imported.Written, out=1)["out"].tolist() == [2]


def test_a_class_made_after_an_edit_has_the_text_that_was_imported(module):
    imported, write = module
    write(MODULE.replace("2.0", "33.5"))
    assert run_compute(imported.make_later(), out=1)["out"].tolist() == [2]


def test_a_reloaded_module_has_the_new_text_and_old_classes_keep_theirs(module):
    imported, write = module
    old = imported.Written
    write(MODULE.replace("2.0", "33.5"))
    importlib.reload(imported)
    assert run_compute(imported.Written, out=1)["out"].tolist() == [33.5]
    assert run_compute(old, out=1)["out"].tolist() == [2]


def test_an_error_shows_the_line_that_was_compiled_not_the_edited_one(module):
    imported, write = module
    write(MODULE.replace("missing + 2.0", "something else entirely"))
    with pytest.raises(ShaderError) as error:
        compile_shader(imported.Broken)
    assert "self.out[0] = missing + 2.0" in str(error.value)
    assert "something else" not in str(error.value)


def test_an_error_with_the_text_of_its_file_can_be_pickled(module):
    imported, _ = module
    with pytest.raises(ShaderError) as error:
        compile_shader(imported.Broken)
    copy = pickle.loads(pickle.dumps(error.value))
    assert str(copy) == str(error.value)
    assert type(copy.site.file) is str


def test_a_class_without_readable_text_is_refused_when_it_is_compiled():
    names = {"__name__": "nowhere"}
    exec(compile(MODULE, "<nowhere>", "exec"), names)
    with pytest.raises(ShaderError, match=r"^\[shading-no-source\]") as error:
        compile_shader(names["Written"])
    assert "from_source" in str(error.value)


def test_a_text_of_another_function_is_refused():
    """Code whose file was replaced before its class was made."""
    names = {"__name__": "nowhere"}
    linecache.cache["<replaced>"] = (0, None, MODULE.replace("def compute", "def other").splitlines(True), "")
    try:
        exec(compile(MODULE, "<replaced>", "exec"), names)
        with pytest.raises(ShaderError, match=r"^\[shading-no-source\]") as error:
            compile_shader(names["Written"])
    finally:
        del linecache.cache["<replaced>"]
    assert "without `compute` on line 11" in str(error.value)


# -- from strings


def test_from_source_returns_the_last_shader_of_a_text():
    assert from_source(MODULE).__name__ == "Broken"


def test_from_source_passes_over_imported_shaders_and_other_classes():
    text = f"from {__name__} import IMPORTED\n{MODULE}\nclass Light(Struct):\n    power: float\n"
    assert from_source(text.replace("class Broken", "class Last")).__name__ == "Last"


IMPORTED = from_source(MODULE)


def test_from_source_returns_the_named_objects_in_order():
    doubled, shader = from_source(MODULE, "doubled", "Written")
    assert evaluate(doubled, 4.0) == 8
    assert run_compute(shader, out=1)["out"].tolist() == [2]
    assert from_source(MODULE, "Written").__name__ == "Written"


def test_two_texts_under_one_name_keep_their_own_lines():
    first = from_source(MODULE, "Written", file="buffer")
    second = from_source(MODULE.replace("2.0", "33.5"), "Written", file="buffer")
    assert "33.5" not in kernel_of(first)
    assert "33.5" in kernel_of(second)


def test_a_class_that_a_text_makes_later_has_its_text_too():
    make = from_source(MODULE, "make_later", file="buffer")
    from_source("from rhi.shading import *\n" + MODULE, file="buffer")
    assert run_compute(make(), out=1)["out"].tolist() == [2]


def test_a_text_sees_only_the_names_that_are_passed_with_it():
    text = MODULE.replace("2.0", "LIMIT")
    assert run_compute(from_source(text, "Written", scope={"LIMIT": 7.5}), out=1)["out"].tolist() == [7.5]
    with pytest.raises(ShaderError, match="LIMIT"):
        compile_shader(from_source(text, "Written"))


def test_annotations_of_a_text_may_be_postponed():
    text = "from __future__ import annotations\n" + MODULE
    assert run_compute(from_source(text, "Written"), out=1)["out"].tolist() == [2]


def test_from_source_leaves_nothing_behind():
    modules, files = set(sys.modules), set(linecache.cache)
    compile_shader(from_source(MODULE, "Written", file="<gone>"))
    assert set(sys.modules) == modules
    assert set(linecache.cache) == files


ERRORS = [
    ("x = 1\ny = (2\n", 2, "SyntaxError", "y = (2"),
    ("x = 1\n\n1 / 0\n", 3, "ZeroDivisionError", "1 / 0"),
    ("def f():\n    return {}['key']\n\nf()\n", 2, "KeyError", "return {}"),
    ("from rhi.shading import *\nclass Lit(Shadr):\n    pass\n", 2, "'Shadr'", "did you mean 'Shader'"),
]


@pytest.mark.parametrize(("text", "line", "value", "excerpt"), ERRORS, ids=[row[2] for row in ERRORS])
def test_a_text_that_fails_is_refused_at_its_line(text, line, value, excerpt):
    with pytest.raises(ShaderError, match=r"^\[shading-text\]") as error:
        from_source(text, file="buffer.py")
    assert (error.value.site.file, error.value.site.line) == ("buffer.py", line)
    assert value in str(error.value)
    assert excerpt in str(error.value)


def test_an_error_of_the_language_points_into_the_text():
    with pytest.raises(ShaderError, match=r"^\[shading-unknown-name\]") as error:
        compile_shader(from_source(MODULE, file="buffer.py"))
    assert (error.value.site.file, error.value.site.line) == ("buffer.py", 18)
    assert "self.out[0] = missing + 2.0" in str(error.value)


def test_a_text_without_shaders_or_without_the_name_is_refused():
    with pytest.raises(ShaderError, match="no shader"):
        from_source("x = 1")
    with pytest.raises(ShaderError) as error:
        from_source(MODULE, "Writen")
    assert "did you mean 'Written'" in str(error.value)
    assert error.value.allowed == "doubled, Written, Broken, make_later"
