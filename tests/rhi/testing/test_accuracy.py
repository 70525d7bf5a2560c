"""`python -m rhi shading accuracy`: measurements of error and time, the table, the plot, and broken
bounds."""

import json
from dataclasses import replace

import numpy as np
import pytest
from nightly_reasons import CHEAPER_TEST

import rhi
from rhi.contract.formats import Format
from rhi.shading.language.builtins import BUILTINS, ErrorBound
from rhi.testing.accuracy import report as accuracy
from rhi.testing.accuracy.sample_probes import SAMPLE_PROBES, SHADERS


def test_a_row_has_the_error_the_bound_and_the_time_of_a_builtin_on_a_backend():
    (row,) = accuracy.measure(["exp"], ["numpy"])
    assert (row.builtin, row.backend, row.precision) == ("exp(float)", "numpy", "")
    assert 0 < row.median_ulp < row.max_ulp <= row.bound_ulp == BUILTINS["exp"].error.numpy
    assert row.is_within_bound
    assert row.nanoseconds > 0
    (x,) = row.worst_input
    exact = np.exp(np.float64(x))
    got = np.exp(np.float32(x))
    assert np.abs(got - exact) / np.spacing(np.float32(exact)) == pytest.approx(row.max_ulp)


@pytest.mark.slow
def test_opencl_has_a_row_for_each_precision():
    rows = list(accuracy.measure(["exp2"], ["cl"]))
    if not rows:
        pytest.skip("no OpenCL")
    exact, fast = rows
    assert [exact.precision, fast.precision] == ["exact", "fast"]
    assert exact.max_ulp < fast.max_ulp
    assert all(row.is_within_bound for row in rows)


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
@pytest.mark.slow
def test_samples_of_textures_have_rows_and_fast_ones_a_cheaper_curve():
    rows = {(row.builtin, row.precision): row for row in accuracy.measure(["sample_lod"], ["cl"])}
    if not rows:
        pytest.skip("no OpenCL")
    exact, fast = (rows["sample_lod(RGBA8_SRGB)", precision] for precision in ("exact", "fast"))
    assert 100 * exact.max_ulp < fast.max_ulp
    assert rows["sample_lod(R32F)", "exact"].max_ulp == rows["sample_lod(R32F)", "fast"].max_ulp
    assert all(row.is_within_bound for row in rows.values())


@pytest.mark.parametrize("precision", SHADERS)
def test_samples_are_dispatched_with_the_bindings_of_their_shaders(precision):
    with rhi.create_device("null") as device:
        for probe in SAMPLE_PROBES:
            inputs, results, _ = accuracy._sample_on_device(device, probe, precision)
            assert inputs.shape == results.shape


def test_a_sample_is_compared_with_float64_in_units_of_float32_s_step_at_1():
    (probe,) = (probe for probe in SAMPLE_PROBES if probe.format is Format.R32F)
    samples = probe.sample(100)
    exact = probe.evaluate(samples, np.float64)
    assert not probe.count_units(samples, exact).any()
    exact[7, 0] += 3 * 2.0**-23
    assert np.flatnonzero(probe.count_units(samples, exact)).tolist() == [7]
    assert probe.count_units(samples, exact)[7] == pytest.approx(3)


def test_a_sample_that_is_off_by_more_than_is_stated_is_marked(monkeypatch, capsys):
    (probe,) = (probe for probe in SAMPLE_PROBES if probe.format is Format.R32F)
    monkeypatch.setattr(accuracy, "SAMPLE_PROBES", (probe,))
    assert accuracy.main(["accuracy", "--backend", "numpy", "--builtin", "sample_lod"]) == 0
    monkeypatch.setattr(accuracy, "SAMPLE_PROBES", (replace(probe, error=ErrorBound(numpy=1)),))
    assert accuracy.main(["accuracy", "--backend", "numpy", "--builtin", "sample_lod"]) == 1
    assert "**broken**" in capsys.readouterr().out


def test_the_command_prints_json_and_draws(tmp_path, capsys):
    chart_path = tmp_path / "accuracy.png"
    assert (
        accuracy.main(
            ["accuracy", "--json", "--backend", "numpy", "--builtin", "sqrt", "--plot", str(chart_path)]
        )
        == 0
    )
    (row,) = json.loads(capsys.readouterr().out)["rows"]
    assert {"builtin", "backend", "precision", "median_ulp", "max_ulp", "worst_input", "nanoseconds"} <= set(
        row
    )
    assert chart_path.read_bytes()[:4] == b"\x89PNG"


def test_a_bound_that_is_broken_is_marked_and_fails_the_command(monkeypatch, capsys):
    monkeypatch.setattr(accuracy, "all_probes", lambda: [probe_with(ErrorBound(numpy=0.25))])
    assert accuracy.main(["accuracy", "--backend", "numpy", "--builtin", "sqrt"]) == 1
    assert "**broken**" in capsys.readouterr().out
    monkeypatch.setattr(
        accuracy, "all_probes", lambda: [probe_with(ErrorBound(numpy=0.5, domain=((0, 1e6),)))]
    )
    assert accuracy.main(["accuracy", "--backend", "numpy", "--builtin", "sqrt"]) == 0


def probe_with(error):
    from rhi.testing.accuracy.probes import builtin_probes

    (probe,) = builtin_probes(BUILTINS["sqrt"])
    return replace(probe, error=replace(error, defined="a >= 0"))


def test_an_unknown_built_in_is_refused_by_name(capsys):
    assert accuracy.main(["accuracy", "--backend", "numpy", "--builtin", "sine"]) == 2
    assert "no such built-in" in capsys.readouterr().err
