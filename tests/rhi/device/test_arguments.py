"""Every parameter of every public method, given every kind of wrong value: refused by a rule, or allowed by
the docs.

Nothing else happens: no Python error comes out of the inside or of a backend, and the device draws as before.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from calls import EXCEPTIONS, NOT_USED, SAMPLES, CallHarness, check_drawing, make_arguments, run

import rhi
from rhi.conformance.shapes import rectangle

PLAIN: dict[str, Any] = {
    "1.5": 1.5,
    "True": True,
    "None": None,
    "-1": -1,
    "2**70": 2**70,
    "'x'": "x",
    "nan": float("nan"),
    "inf": float("inf"),
    "1e300": 1e300,
    "an enum's member": NOT_USED,
    "an enum": enum.Enum,
    "object()": object(),
    "[]": [],
    "[1.5]": [1.5],
    "[[1], [1, 2]]": [[1], [1, 2]],
    "{}": {},
    "b'x'": b"x",
    "1j": 1j,
    "a class": int,
    "a function": len,
    "float32": np.float32(0.5),
    "int64": np.int64(-7),
    "bool_": np.bool_(True),
    "array of objects": np.array([object()]),
    "array of text": np.array(["x"]),
    "array of nan": np.full(4, np.nan),
    "array of bools": np.ones(2, bool),
    "array of 2**70": np.array([2**70]),
    "range": range(3),
    "{1: 2}": {1: 2},
    "what has no hash": memoryview(np.full(2, 0.5)),
}


@pytest.fixture(scope="module", params=["null", "gl", "cl"])
def harness_and_wrong_values(request: pytest.FixtureRequest) -> Iterator[tuple[CallHarness, dict[str, Any]]]:
    """A harness on each backend, and wrong values: among them objects of another device and destroyed
    objects."""
    with rhi.create_device(request.param, record=False) as device, rhi.create_device("null") as other:
        harness, foreign, ruin = CallHarness(device), CallHarness(other), CallHarness(device)
        wrong = dict(PLAIN)
        for resource in harness.resources:
            wrong[f"a {type(resource).__name__}"] = resource
        for resource in foreign.resources:
            wrong[f"another device's {type(resource).__name__}"] = resource
        for resource in ruin.resources:
            if type(resource) is not rhi.Program:  # of which a device has one for each shader
                resource.destroy()
                wrong[f"a destroyed {type(resource).__name__}"] = resource
        wrong["a target of another device"] = foreign.image.at()
        wrong["a binding"] = harness.image.sampled(harness.sampler)
        wrong["the device"] = device
        yield harness, wrong


@pytest.mark.parametrize("name", SAMPLES)
def test_a_wrong_argument_is_refused_by_a_rule(
    harness_and_wrong_values: tuple[CallHarness, dict[str, Any]], name: str
) -> None:
    harness, wrong = harness_and_wrong_values
    sample = SAMPLES[name]
    if not all(getattr(harness.device.capabilities, need) for need in sample.needs):
        pytest.skip(f"{harness.device.backend_name} lacks {sample.needs}")
    harness.mesh.vertices.write(rectangle())  # type: ignore[union-attr]
    right = make_arguments(harness, sample)
    run(harness, sample, right)
    faults = []
    for parameter, (_, takes) in sample.parameters.items():
        for description, value in wrong.items():
            try:
                run(harness, sample, right | {parameter: value})
            except rhi.RhiError:
                continue
            except BaseException as error:
                faults.append(f"{parameter}={description}: {error!r}")
            else:
                if not takes(harness, value):
                    faults.append(f"{parameter}={description}: accepted")
    check_drawing(harness)
    assert not faults, "\n".join(faults)


ODD: dict[str, Any] = {
    "a NUL": "a\0b",
    "a surrogate": "\ud800",
    "0-d": np.array(3),
    "empty": np.zeros((0, 4), "f4"),
    "2**31": 1 << 31,
    "strided": np.zeros((8, 8), "f4")[::2, ::-1],
    "big endian": np.zeros(4, ">f4"),
    "complex": np.zeros(4, "c16"),
    "dates": np.array(["2020-01-01"], "M8[D]"),
    "masked": np.ma.masked_array([1.0, 2.0], [True, False]),
    "a generator": (i for i in range(3)),
    "a set": {1, 2},
    "-0.0": -0.0,
    "2**63 - 1": (1 << 63) - 1,
    "...": ...,
    "2**64 - 1": np.uint64(2**64 - 1),
    "(2**40, 1)": (2**40, 1),
    "a slice": slice(0, 2),
    "{'position': [1]}": {"position": [1]},
}
"""Values that are wrong in a way of their own."""


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(4))
def test_several_wrong_arguments_at_once_are_refused_by_a_rule(
    harness_and_wrong_values: tuple[CallHarness, dict[str, Any]], seed: int
) -> None:
    harness, random = harness_and_wrong_values[0], np.random.default_rng(seed)
    odd = [*(harness_and_wrong_values[1] | ODD).items()]
    odd += [(f"[{name}]", [value]) for name, value in odd]
    faults = []
    for name, sample in SAMPLES.items():
        if not all(getattr(harness.device.capabilities, need) for need in sample.needs):
            continue
        for _ in range(12 if len(sample.parameters) else 0):
            harness.mesh.vertices.write(rectangle())  # type: ignore[union-attr]
            count = random.integers(1, min(len(sample.parameters), 3) + 1)
            parameters = random.choice([*sample.parameters], count, replace=False).tolist()
            arguments = {parameter: odd[random.integers(len(odd))] for parameter in parameters}
            try:
                wrong = {parameter: value for parameter, (_, value) in arguments.items()}
                run(harness, sample, make_arguments(harness, sample) | wrong)
            except rhi.RhiError:
                continue
            except BaseException as error:
                descriptions = {parameter: description for parameter, (description, _) in arguments.items()}
                faults.append(f"{name}, {descriptions}: {error!r}")
    check_drawing(harness)
    assert not faults, "\n".join(faults)


def as_numpy(value: Any) -> Any:
    """Return a number or flag as NumPy's own type; None for anything else."""
    if isinstance(value, bool):
        return np.bool_(value)
    if isinstance(value, int):
        return np.int32(value)
    return np.float32(value) if isinstance(value, float) else None


@pytest.mark.parametrize("name", SAMPLES)
def test_numpys_numbers_are_numbers(
    harness_and_wrong_values: tuple[CallHarness, dict[str, Any]], name: str
) -> None:
    harness, sample = harness_and_wrong_values[0], SAMPLES[name]
    if not all(getattr(harness.device.capabilities, need) for need in sample.needs):
        pytest.skip(f"{harness.device.backend_name} lacks {sample.needs}")
    right = make_arguments(harness, sample)
    for parameter, value in right.items():
        if as_numpy(value) is not None:
            run(harness, sample, right | {parameter: as_numpy(value)})
    check_drawing(harness)


def test_every_exception_is_that_of_a_parameter() -> None:
    assert sum(len(sample.parameters) for sample in SAMPLES.values()) > 360
    names = {
        key
        for name, sample in SAMPLES.items()
        for parameter in sample.parameters
        for key in (f"{name}.{parameter}", f"{name.rpartition('.')[2]}.{parameter}", parameter)
    }
    assert not EXCEPTIONS.keys() - names
