"""Programs: drivers' messages lead to Python lines, and additions to main keep the line numbers."""

from __future__ import annotations

import pytest
from gl_kit import FRAGMENT, FULL, VERTEX, GlKit, describe_program

import rhi
from rhi.backends.gl.gl_driver_log import make_shader_error
from rhi.backends.gl.gl_programs import add_alpha_test
from rhi.contract.descriptors import Stage, StageText
from rhi.contract.states import AlphaFunction, AlphaReference, AlphaTest, CullMode
from rhi.errors import ShaderError
from rhi.shading import Shader, StorageRW, Struct, Uniform, uint

SOURCE = StageText("first\nsecond\nthird", (("a.py", 10), ("b.py", 20), ("c.py", 30)))


@pytest.mark.parametrize(
    "message",
    [
        "0:2(5): error: `x' undeclared",
        "0(2) : error C1503: undefined variable",
        "ERROR: 0:2: 'x' : undeclared identifier",
    ],
    ids=["mesa", "nvidia", "others"],
)
def test_a_drivers_line_leads_to_the_python_line(message: str) -> None:
    error = make_shader_error(describe_program(), message, Stage.FRAGMENT, SOURCE)
    assert error.rule.id == "shader-driver"
    assert str(error.site) == "b.py:20"
    assert "GLSL line 2: second" in error.given


@pytest.mark.parametrize(("line", "site"), [(1, "a.py:10"), (3, "c.py:30")])
def test_driver_errors_in_the_first_and_last_line_have_their_python_line(line: int, site: str) -> None:
    error = make_shader_error(describe_program(), f"0:{line}(1): error", Stage.FRAGMENT, SOURCE)
    assert str(error.site) == site


@pytest.mark.parametrize("line", [0, 4])
def test_a_line_outside_the_source_is_left_alone(line: int) -> None:
    error = make_shader_error(describe_program(), f"0:{line}(1): error", Stage.FRAGMENT, SOURCE)
    assert "GLSL line" not in error.given
    assert error.site is not None
    assert error.site.file == __file__


def test_a_message_of_the_linker_has_no_line() -> None:
    error = make_shader_error(describe_program(), "error: no main", None, StageText(""))
    assert "linking" in error.call
    assert error.given == "error: no main"


def test_a_refused_stage_names_the_python_line_and_leaves_the_id_unused(gl_kit: GlKit) -> None:
    fragment = FRAGMENT.replace("1.0, 0.0", "missing, 0.0")
    origins = tuple((f"line{number}.py", number) for number in range(1, 5))
    program = gl_kit.new_id()
    with pytest.raises(ShaderError, match="missing") as caught:
        gl_kit.backend.create_program(program, describe_program(fragment=fragment, origins=origins))
    assert "fragment stage" in caught.value.call
    assert str(caught.value.site) == "line3.py:3"
    gl_kit.backend.create_program(program, describe_program())


def test_stages_that_do_not_fit_are_a_shader_error(gl_kit: GlKit) -> None:
    fragment = "#version 430\nin vec3 nobody_writes_this;\nout vec4 color;\n"
    fragment += "void main() { color = vec4(nobody_writes_this, 1.0); }"
    with pytest.raises(ShaderError, match="nobody_writes_this") as caught:
        gl_kit.program(describe_program(fragment=fragment))
    assert "linking" in caught.value.call


def test_the_alpha_test_moves_no_line() -> None:
    source = add_alpha_test(describe_program(), AlphaFunction.GREATER)
    assert source is not None
    lines = source.text.split("\n")
    assert (
        lines[: len(FRAGMENT.split("\n")) - 1] == FRAGMENT.replace("main", "rhi_inner_main").split("\n")[:-1]
    )
    assert "color.a > rhi_alpha_reference" in source.text


@pytest.mark.parametrize("function", [AlphaFunction.ALWAYS, AlphaFunction.NEVER])
def test_only_an_alpha_test_that_can_drop_something_changes_the_program(function: AlphaFunction) -> None:
    assert (add_alpha_test(describe_program(), function) is None) == (function is AlphaFunction.ALWAYS)


def test_a_program_without_alpha_is_not_tested() -> None:
    descriptor = describe_program()
    object.__setattr__(descriptor, "outputs", ())
    assert add_alpha_test(descriptor, AlphaFunction.GREATER) is None


def test_the_variant_for_an_alpha_test_is_made_when_it_is_first_drawn_with(gl_kit: GlKit) -> None:
    program, image = gl_kit.program(describe_program()), gl_kit.texture()
    shape = gl_kit.shape(program, FULL)
    variants = gl_kit.backend._programs._programs[program].variants
    gl_kit.set(CullMode.NONE)
    gl_kit.begin(image)
    gl_kit.backend.bind_program(program)
    gl_kit.draw(shape)
    assert variants == {}
    for reference, drawn in ((0.4, 255), (0.6, 0)):
        gl_kit.set(AlphaTest.ON, AlphaReference(reference))
        gl_kit.begin(image)
        gl_kit.draw(shape)
        assert (gl_kit.read(image)[..., 0] == drawn).all()
    assert list(variants) == [AlphaFunction.GREATER]


def test_destroying_the_bound_program_leaves_later_states_alone(gl_kit: GlKit) -> None:
    program = gl_kit.program(describe_program())
    gl_kit.backend.bind_program(program)
    gl_kit.backend.destroy(program)
    gl_kit.set(AlphaTest.ON)


def test_main_may_be_written_with_void(gl_kit: GlKit) -> None:
    gl_kit.program(describe_program(vertex=VERTEX.replace("main()", "main( void )")))


# -- llvmpipe's limit of turns, which the backend's page states ----------------------------------------------


class Iterations(Struct):
    first: uint
    second: uint


class Counted(Shader):
    """Counts the turns of two loops."""

    work_group = (1,)
    iterations: Uniform[Iterations]
    counts: StorageRW[uint]

    def compute(self) -> None:
        a = uint(0)
        while a < self.iterations.first:
            a += uint(1)
        b = uint(0)
        while b < self.iterations.second:
            b += uint(1)
        self.counts[0] = a
        self.counts[1] = b


@pytest.mark.parametrize(
    ("requested", "executed"),
    [
        ((65534, 1), (65534, 1)),
        ((65535, 0), (65535, 0)),
        ((65536, 0), (65535, 0)),
        ((40000, 40000), (40000, 25534)),
    ],
)
def test_llvmpipe_ends_loops_after_65535_iterations_in_all(
    requested: tuple[int, int], executed: tuple[int, int]
) -> None:
    with rhi.create_device("gl") as device:
        if "llvmpipe" not in device.capabilities.device:
            pytest.skip("a limit of llvmpipe")
        counts, iterations = (
            device.storage(uint, 2),
            device.uniform(Iterations(first=requested[0], second=requested[1])),
        )
        device.dispatch(device.program(Counted), 1, iterations=iterations, counts=counts)
        assert tuple(counts.read()) == executed
