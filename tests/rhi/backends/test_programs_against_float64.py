"""Random programs of all formats and states do on a device what the interpreter in float64 allows.

Programs of one theme share their pipelines, so a backend that compiles per pipeline compiles little. A
program that fails is printed as a small one that fails too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from known_faults import CL, FAULTS, LLVMPIPE, SMALLEST

import rhi
from rhi.conformance import reference
from rhi.conformance.programs import EXACT, Program, Tolerances, check, interpret
from rhi.conformance.programs import model as step_types
from rhi.conformance.programs.generator import FORMATS, make_program, make_theme
from rhi.conformance.programs.intervals import Interval
from rhi.conformance.programs.merging import blend
from rhi.conformance.programs.model import (
    Draw,
    Image,
    Part,
    Pass,
    ShaderKind,
    Shape,
    Step,
    Subresource,
    Write,
    to_python,
)
from rhi.conformance.programs.reducer import reduce
from rhi.conformance.programs.runner import compare, run
from rhi.contract.formats import DEPTH_FORMATS

PROGRAMS = 6
"""Programs of a theme."""

THEMES = [
    *(pytest.param(backend, range(3), id=f"few-{backend}") for backend in ("gl", "cl")),
    # On wgpu up to the first theme that samples what its pass resolves to, which WebGPU refuses.
    *(
        pytest.param(backend, range(100, end), id=f"many-{backend}", marks=pytest.mark.nightly)
        for backend, end in (("gl", 400), ("cl", 400), ("wgpu", 174))
    ),
]
ALL_FORMATS = rhi.Capabilities("", "", "")


def rules_of(device: rhi.Device) -> Tolerances:
    if device.backend_name == "cl":
        return CL
    return LLVMPIPE if "llvmpipe" in device.capabilities.device else EXACT


@pytest.mark.parametrize(("backend", "themes"), THEMES)
def test_results_of_random_programs_are_within_the_bounds_of_float64(backend: str, themes: range) -> None:
    for number in themes:
        with rhi.create_device(backend) as device:
            rules = rules_of(device)
            theme = make_theme(number, device.capabilities)
            for seed in range(PROGRAMS):
                program = make_program(1000 * number + seed, theme)
                if check(device, program, rules):
                    small = reduce(program, lambda p: bool(check(device, p, rules)), 400)
                    report = "\n".join(map(str, check(device, small, rules)))
                    pytest.fail(f"theme {number}, program {seed}:\n{to_python(small)}\n{report}")


# -- the driver's faults -------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def llvmpipe() -> Iterator[rhi.Device]:
    with rhi.create_device("gl") as device:
        if "llvmpipe" not in device.capabilities.device:
            pytest.skip(f"{device.capabilities.device} isn't llvmpipe")
        yield device


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_a_fault_of_llvmpipe_is_still_there(llvmpipe: rhi.Device, fault: object) -> None:
    """Its smallest program differs if it isn't excepted, passes if it is, and passes on cl."""
    program = SMALLEST[fault]
    others = replace(LLVMPIPE, faults=tuple(other for other in FAULTS if other is not fault))
    assert check(llvmpipe, program, others)
    assert not check(llvmpipe, program, LLVMPIPE)
    with rhi.create_device("cl") as device:
        assert not check(device, program, CL)


# -- the interpreter -----------------------------------------------------------------------------------------


def colors(seed: int, count: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 9, (count, 4)) / 8


@pytest.mark.parametrize("operation", list(rhi.BlendOperation), ids=lambda value: value.name)
@pytest.mark.parametrize("factor", list(rhi.BlendFactor), ids=lambda value: value.name)
def test_blending_of_intervals_contains_that_of_their_ends(
    factor: rhi.BlendFactor, operation: rhi.BlendOperation
) -> None:
    """Of exact numbers it is that of the reference; of intervals it contains all that lies between."""
    function = rhi.BlendFunction(factor, factor, operation)
    constant = rhi.BlendColor(0.25, 0.5, 0.75, 1.0)
    numbers = (0.25, 0.5, 0.75, 1.0)
    source, stored = colors(1, 40), colors(2, 40)
    exact = blend(rhi.Format.RGBA32F, function, constant, Interval.of(source), Interval.of(stored), EXACT)
    expected = reference.blend(function, source, stored, numbers)
    assert np.abs(exact.low - expected).max() < 1e-6
    assert np.abs(exact.high - expected).max() < 1e-6
    around = Interval.of(source).widen(0.125), Interval.of(stored).widen(0.125)
    wide = blend(rhi.Format.RGBA32F, function, constant, *around, EXACT)
    for seed in range(3):
        moves = np.random.default_rng(seed).uniform(-0.125, 0.125, (2, 40, 4))
        inside = reference.blend(function, source + moves[0], stored + moves[1], numbers)
        assert (wide.low - 1e-9 <= inside).all()
        assert (inside <= wide.high + 1e-9).all()


SQUARE = Shape(
    rhi.Primitive.QUADS,
    tuple(
        (x, y, 0.25, 1.0, 0.5, 0.25, 1.0, 0.5) for x, y in ((1.0, 1.0), (1.0, 6.0), (7.0, 6.0), (7.0, 1.0))
    ),
)
DRAW = Draw(
    ShaderKind.FLAT,
    0,
    (Part(0, 4),),
    (8, 8),
    (rhi.DepthFunction.LESS, rhi.StencilTest.ON, rhi.CullMode.NONE),
    query=0,
)
PASS = Pass((Subresource(0),), Subresource(1), (DRAW, DRAW), ((0.25, 0.5, 0.0, 1.0),), 0.5, 7)
IMAGES = (Image((8, 8), rhi.Format.RGBA8), Image((8, 8), rhi.Format.D24S8))
STATES: list[rhi.State] = [
    rhi.CullMode.FRONT,
    rhi.CullMode.BACK,
    rhi.DepthFunction.LESS_EQUAL,
    rhi.DepthFunction.NEVER,
    rhi.Scissor(1, 1, 6, 4),
    rhi.ColorWrite(green=False),
    rhi.BlendFunction.ADDITIVE,
    rhi.BlendFunction.MULTIPLY,
    rhi.StencilFront(rhi.Comparison.GREATER),
    rhi.StencilFront(both_pass=rhi.StencilOperation.INCREMENT),
    rhi.StencilFront(depth_fail=rhi.StencilOperation.INVERT),
    rhi.StencilReference(9, 9),
]


@pytest.mark.parametrize("state", STATES, ids=str)
def test_a_state_that_a_device_ignores_is_seen(llvmpipe: rhi.Device, state: rhi.State) -> None:
    """The results of a program without a state lie outside of what the program with it allows, and the
    reverse."""
    around = (
        () if not isinstance(state, rhi.StencilReference) else (rhi.StencilFront(rhi.Comparison.LESS_EQUAL),)
    )
    facing = () if state is not rhi.CullMode.BACK else (rhi.FrontFace.CLOCKWISE,)
    before = replace(DRAW, states=(*DRAW.states, *around, *facing))
    after = replace(before, states=(*(s for s in before.states if type(s) is not type(state)), state))
    programs = [Program(IMAGES, (SQUARE,), (replace(PASS, draws=(d, d)),), 1) for d in (before, after)]
    results = [run(llvmpipe, program) for program in programs]
    allowed = [interpret(program, LLVMPIPE) for program in programs]
    for i in range(2):
        assert not compare(results[i], allowed[i])
        assert compare(results[i], allowed[1 - i])


def test_most_texels_have_one_possible_value() -> None:
    """Else the interpreter would allow anything. Images of integers and of floats are told apart by their
    widths."""
    sharp = total = 0
    for number in range(12):
        theme = make_theme(number, ALL_FORMATS)
        for result in interpret(make_program(number, theme)):
            width = result.high - result.low
            sharp += int((width <= 1e-6 * np.maximum(1.0, np.abs(result.high))).sum())
            total += width.size
    assert sharp > 0.9 * total


# -- the generator -------------------------------------------------------------------------------------------


def test_themes_have_all_formats_and_shader_kinds() -> None:
    themes = [make_theme(number, ALL_FORMATS) for number in range(250)]
    kinds = [kind for theme in themes for kind in theme.kinds]
    assert {f for kind in kinds for f in kind.colors} == set(FORMATS)
    assert {kind.depth for kind in kinds} == {None, *DEPTH_FORMATS}
    assert {pipeline.shader for kind in kinds for pipeline in kind.pipelines} == set(ShaderKind)
    assert {kind.samples for kind in kinds} == {1, 2, 4}


def test_a_theme_of_integers_and_no_colors_at_all_has_shapes_for_both() -> None:
    themes = [make_theme(number, ALL_FORMATS) for number in range(250)]
    mixed = [
        theme
        for theme in themes
        if {f.is_integer for kind in theme.kinds for f in kind.colors} == {True}
        and any(not kind.colors for kind in theme.kinds)
    ]
    assert mixed
    assert all(make_program(seed, theme).steps for theme in mixed for seed in range(20))


def test_programs_have_all_steps_states_and_kinds_of_textures() -> None:
    programs = [make_program(seed, make_theme(seed // 4, ALL_FORMATS)) for seed in range(400)]
    steps = [step for program in programs for step in program.steps]
    assert {type(step) for step in steps} == set(Step.__args__)
    draws = [draw for step in steps if isinstance(step, Pass) for draw in step.draws]
    # Where lines end differs from platform to platform, and what a platform has alone is its own.
    left_out = {rhi.LineWidth, rhi.PolygonMode, rhi.PlatformState}
    assert {type(state) for draw in draws for state in draw.states} == set(rhi.State.__args__) - left_out
    assert {draw.method for draw in draws} == set(step_types.DrawMethod)
    assert {image.kind for program in programs for image in program.images} == set(rhi.TextureKind)
    assert {
        level
        for p in programs
        for s in p.steps
        if isinstance(s, Pass)
        for level in (s.colors[0].level if s.colors else 0,)
    } == {0, 2}


def test_equal_seeds_make_equal_programs() -> None:
    theme = make_theme(5, ALL_FORMATS)
    assert make_program(7, theme) == make_program(7, theme)
    assert make_program(7, theme) != make_program(8, theme)


# -- small programs ------------------------------------------------------------------------------------------


def test_a_program_is_printed_as_python_that_makes_it() -> None:
    program = make_program(3, make_theme(2, ALL_FORMATS))
    names = {**vars(rhi), **vars(step_types)}
    assert eval(to_python(program), names) == program


def test_a_failing_program_is_reduced_to_its_failing_part() -> None:
    """Of a program that fails because of one state, one step with one draw of one primitive with that state
    is left."""
    guilty = replace(
        DRAW, states=(rhi.CullMode.NONE, rhi.ColorWrite(red=False)), parts=(Part(0, 4, 3), Part(0, 4))
    )
    more = Write(Subresource(0), 0, 0, 2, 2, 1)
    program = Program(IMAGES, (SQUARE,), (more, PASS, replace(PASS, draws=(DRAW, guilty)), more), 1)

    def fails(proposal: Program) -> bool:
        passes = [step for step in proposal.steps if isinstance(step, Pass)]
        return any(rhi.ColorWrite(red=False) in draw.states for step in passes for draw in step.draws)

    small = reduce(program, fails)
    assert len(small.steps) == 1
    assert isinstance(small.steps[0], Pass)
    (draw,) = small.steps[0].draws
    assert draw == Draw(ShaderKind.FLAT, 0, draw.parts, (8, 8), (rhi.ColorWrite(red=False),))
    assert [(part.count, part.instances) for part in draw.parts] == [(1, 1)]
    assert small.steps[0].depth is None
    assert small.steps[0].clear == (None,)
