"""Statements behind `return`, `discard`, `break` and `continue`: on NumPy, and nightly many programs on
devices."""

import numpy as np
import pytest
from nights import rotate_seed

import rhi
from rhi.conformance.operation import test_unreachable as kit
from rhi.shading import run_compute, run_fragment


def on_numpy(text, count, discards):
    """Return the results of a text's methods (method, argument); -1 where a fragment is discarded."""
    shader = kit.shader_of(text)
    if not discards:
        return run_compute(shader, count * kit.ARGUMENTS, out=count * kit.ARGUMENTS)["out"].reshape(count, -1)
    run = run_fragment(shader, covered=np.ones((count, kit.ARGUMENTS), bool))
    (values,) = run.outputs.values()
    return np.where(run.coverage, values[..., 0], -1)


@pytest.mark.parametrize("discards", [False, True])
@pytest.mark.parametrize("seed", range(12))
def test_dead_statements_change_nothing_on_numpy(seed, discards):
    text = kit.write_program(seed, discards)
    np.testing.assert_array_equal(on_numpy(text, kit.METHODS, discards), kit.expected_values(text))


@pytest.mark.parametrize("discards", [False, True])
@pytest.mark.parametrize("lean", [False, True])
def test_each_form_of_dead_code_changes_nothing_on_numpy(discards, lean):
    text, count = kit.write_forms(discards, lean)
    np.testing.assert_array_equal(on_numpy(text, count, discards), kit.expected_values(text, count))


@pytest.mark.nightly
@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu"])
@pytest.mark.parametrize("discards", [False, True])
@pytest.mark.parametrize("part", range(2))
def test_dead_statements_of_random_programs_change_nothing(backend, discards, part):
    """50 programs a night, others each night."""
    run = kit.draw if discards else kit.run_compute
    with rhi.create_device(backend) as device:
        for seed in map(rotate_seed, range(100 + 25 * part, 125 + 25 * part)):
            text = kit.write_program(seed, discards)
            np.testing.assert_array_equal(run(device, text), kit.expected_values(text), str(seed))
