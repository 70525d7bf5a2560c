"""Every built-in and operator keeps its stated error, in every language, on a dense sample and on hard
inputs: NaN, zeros of both signs, denormals, infinities, extremes, negative operands of // and %."""

from collections import defaultdict
from contextlib import ExitStack, contextmanager
from functools import cache, partial

import numpy as np
import pytest
from glsl_runner import run_glsl
from nightly_reasons import FEWER_CASES
from opencl_runner import built_together, run_opencl

from rhi.shading import Precision, compile_shader, opencl_kernel, run_compute
from rhi.shading.language.builtins import BUILTINS, SideEffect
from rhi.testing.accuracy.probes import WORK_GROUP, all_probes, builtin_probes, count_units, worst_units

PROBES = all_probes()


@cache
def shader_of(probe, precision):
    return probe.shader("Single", precision)


def call(run, probe, arguments, precision=Precision.EXACT):
    """Return the results of a probe's shader; rows are padded to whole work-groups, so that a vector has
    lanes of all kinds."""
    rows = np.concatenate([arguments, np.repeat(arguments[:1], -len(arguments) % WORK_GROUP, axis=0)])
    size = probe.evaluate(arguments[:1], np.float32).shape[1]
    results = run(
        shader_of(probe, precision), len(rows) // WORK_GROUP, inputs=rows.ravel(), results=len(rows) * size
    )
    return probe.numbers(results["results"].reshape(len(rows), size))[: len(arguments)]


def lanes(width, shader, groups, **values):
    return run_opencl(shader, width, groups, **values)


@pytest.fixture
def runners(context):
    return {
        "glsl": ("glsl", partial(run_glsl, context), Precision.EXACT),
        "one lane": ("exact", partial(lanes, 1), Precision.EXACT),
        "16 lanes": ("exact", partial(lanes, 16), Precision.EXACT),
        "16 lanes, fast": ("fast", partial(lanes, 16), Precision.FAST),
        "numpy": ("numpy", run_compute, Precision.EXACT),
    }


def excess(runner, probe):
    """Describe the errors of a probe that exceed its bound; "" if none does."""
    name, run, precision = runner
    if precision is Precision.FAST and not has_fast_code(probe):
        return ""
    inputs = np.concatenate([probe.sample(4096), probe.hard_inputs()])
    if name == "exact" and probe.name in ("sin", "cos"):  # beyond 2^50 lanes have numbers from -1 to 1
        size = np.abs(inputs.view(np.float32)).ravel()
        inputs = inputs[~((size > 2.0**50) & (size < np.inf))]
    results = call(run, probe, inputs, precision)
    units = worst_units(probe, inputs, results, name)
    worst = int(units.argmax())
    if units[worst] <= getattr(probe.error, name):
        return ""
    arguments = {name: column[worst] for name, column in probe.columns(inputs).items()}
    exact = probe.evaluate(inputs[worst : worst + 1], np.float64)
    return f"{probe}: {units[worst]} units at {arguments}: {results[worst]}, not {exact[0]}"


def has_fast_code(probe):
    texts = {
        opencl_kernel(probe.shader("Single", precision), 16).text.partition("\n")[2]
        for precision in Precision
    }
    return len(texts) == 2


@pytest.mark.nightly_cases("16 lanes", "16 lanes, fast", reason=FEWER_CASES)
@pytest.mark.slow
@pytest.mark.parametrize(
    "runner",
    ["glsl", pytest.param("one lane", marks=pytest.mark.nightly), "16 lanes", "16 lanes, fast", "numpy"],
)
def test_every_builtin_and_operator_keeps_its_stated_error(runners, runner):
    with all_built(runner):
        wrong = list(filter(None, (excess(runners[runner], probe) for probe in PROBES)))
    assert not wrong, "\n".join(wrong)


@contextmanager
def all_built(runner):
    """Build the kernels of all probes that an OpenCL way runs, in a few programs."""
    precision = Precision.FAST if runner.endswith("fast") else Precision.EXACT
    probes = [probe for probe in PROBES if precision is Precision.EXACT or has_fast_code(probe)]
    widths = {"one lane": 1, "16 lanes": 16, "16 lanes, fast": 16}
    with ExitStack() as stack:
        if runner in widths:
            for group in batched_by_options(shader_of(probe, precision) for probe in probes):
                stack.enter_context(built_together(group, widths[runner]))
        yield


def batched_by_options(shaders):
    """Shaders that are built with the same options."""
    groups = defaultdict(list)
    for shader in shaders:
        groups[compile_shader(shader).flushes_denormals].append(shader)
    return groups.values()


def test_every_function_of_its_arguments_is_probed():
    probed = {probe.name for probe in PROBES}
    inputs = {name for name, row in BUILTINS.items() if not row.overloads[0].parameters}
    effects = {name for name, row in BUILTINS.items() if row.effect is not SideEffect.NONE}
    assert probed >= set(BUILTINS) - inputs - effects - {"ddx", "ddy", "fwidth", "uniform", "broadcast_first"}


def test_float64_agrees_with_the_standard_librarys_functions():
    """The reference is also checked against Python: `VALUES` of the built-ins' tests come from Python, in
    float64."""
    import math

    for name, function in {
        "sin": math.sin,
        "exp": math.exp,
        "log": math.log,
        "atan2": math.atan2,
        "pow": math.pow,
    }.items():
        (probe,) = builtin_probes(BUILTINS[name])
        inputs = probe.sample(256)
        expected = [function(*map(float, row)) for row in zip(*probe.columns(inputs).values(), strict=True)]
        np.testing.assert_allclose(probe.evaluate(inputs, np.float64)[:, 0], expected, rtol=1e-15)


def words(*rows):
    return np.array(rows, np.float32).view(np.uint32)


(SINE,) = builtin_probes(BUILTINS["sin"])
(LOG,) = builtin_probes(BUILTINS["log"])
(DOT,) = builtin_probes(BUILTINS["dot"])


def test_a_unit_of_error_is_the_last_place_of_the_exact_float():
    exact = np.float32(np.sin(1.0))
    next_one = np.nextafter(exact, np.float32(2))
    (units,) = count_units(SINE, words([1.0]), np.array([[next_one]]))[0]
    assert 0.5 < units < 1.5
    assert count_units(SINE, words([1.0]), np.array([[exact]]))[0, 0] <= 0.5


def test_a_unit_of_error_of_a_composed_function_is_relative_to_its_arguments():
    inputs = words([1.0, 1.0, 0.0, 1.0, -1.0 + 1e-6, 0.0])  # two products that cancel
    off = DOT.evaluate(inputs, np.float64) + 1e-7
    assert count_units(DOT, inputs, off)[0, 0] < 2
    assert count_units(DOT, inputs, off + 1e-5)[0, 0] > 20


@pytest.mark.parametrize(
    ("argument", "result", "units"),
    [(np.nan, np.nan, 0), (np.nan, 0.0, np.inf), (1.0, np.nan, np.inf), (1e-40, 0.0, 0), (np.inf, np.nan, 0)],
)
def test_nan_must_stay_nan_and_denormals_may_be_zero(argument, result, units):
    assert count_units(SINE, words([argument]), np.array([[result]], np.float32))[0, 0] == units


def test_a_bound_says_nothing_of_results_that_are_undefined():
    assert worst_units(LOG, words([-1.0]), np.array([[5.0]]), "exact")[0] == 0
    assert worst_units(LOG, words([2.0]), np.array([[5.0]]), "exact")[0] > 1e6
    assert worst_units(SINE, words([1e9]), np.array([[5.0]]), "fast")[0] == 0
    assert worst_units(SINE, words([1e9]), np.array([[5.0]]), "exact")[0] > 1e6


@pytest.mark.nightly_cases("[48]", reason=FEWER_CASES)
@pytest.mark.parametrize("width", [1, 4, 8])
def test_fast_functions_keep_their_error_with_any_number_of_lanes(width):
    for name, row in BUILTINS.items():
        if row.fast:
            (probe,) = builtin_probes(row)
            assert not excess(("fast", partial(lanes, width), Precision.FAST), probe), name


@pytest.mark.parametrize("name", ["sin", "cos", "tan"])
@pytest.mark.parametrize("width", [4, 8, 16])
def test_an_angle_does_not_depend_on_the_angles_of_other_lanes(name, width):
    """PoCL 3.1's vector functions are off by .008 in all lanes if one is above 1e7."""
    (probe,) = builtin_probes(BUILTINS[name])
    alone, beside = words(*[[6e-8]] * WORK_GROUP), words(*[[6e-8]] * WORK_GROUP)
    beside[::width] = words([1e20])
    results = [call(partial(lanes, width), probe, angles) for angles in (alone, beside)]
    changed = np.flatnonzero(results[0] != results[1])
    np.testing.assert_array_equal(changed, np.arange(0, WORK_GROUP, width))


def test_fast_angles_are_never_above_one():
    angles = words(*[[x] for x in (1e9, -1e20, 3e38, 1e5, 12345.0)])
    for name in ("sin", "cos"):
        (probe,) = builtin_probes(BUILTINS[name])
        assert (np.abs(call(partial(lanes, 16), probe, angles, Precision.FAST)) <= 1).all()
