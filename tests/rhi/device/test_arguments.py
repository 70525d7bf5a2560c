"""Every parameter of every public method, given every kind of wrong value: refused by a rule, or allowed by the docs.

Nothing else happens: no Python error comes out of the inside or of a backend, and the device draws as before.
"""

from __future__ import annotations

import enum
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from calls import EXCEPTIONS, NOT_USED, SAMPLES, House, check_drawing, given_arguments, run

import rhi
from rhi.conformance.shapes import rectangle

PLAIN: dict[str, Any] = {
    "1.5": 1.5, "True": True, "None": None, "-1": -1, "2**70": 2**70, "'x'": "x", "nan": float("nan"),
    "inf": float("inf"), "1e300": 1e300, "an enum's member": NOT_USED, "an enum": enum.Enum, "object()": object(),
    "[]": [], "[1.5]": [1.5], "[[1], [1, 2]]": [[1], [1, 2]], "{}": {}, "b'x'": b"x", "1j": 1j, "a class": int,
    "a function": len, "float32": np.float32(0.5), "int64": np.int64(-7), "bool_": np.bool_(True),
    "array of objects": np.array([object()]), "array of text": np.array(["x"]), "array of nan": np.full(4, np.nan),
    "array of bools": np.ones(2, bool), "array of 2**70": np.array([2**70]), "range": range(3), "{1: 2}": {1: 2},
    "what has no hash": memoryview(np.full(2, 0.5)),
}  # fmt: skip


@pytest.fixture(scope="module", params=["null", "gl", "cl"])
def street(request: pytest.FixtureRequest) -> Iterator[tuple[House, dict[str, Any]]]:
    """A house on a device of each backend, and the wrong values: also objects of another device, and destroyed ones."""
    with rhi.create_device(request.param, record=False) as device, rhi.create_device("null") as other:
        house, foreign, ruin = House(device), House(other), House(device)
        wrong = dict(PLAIN)
        for resource in house.resources:
            wrong[f"a {type(resource).__name__}"] = resource
        for resource in foreign.resources:
            wrong[f"another device's {type(resource).__name__}"] = resource
        for resource in ruin.resources:
            if type(resource) is not rhi.Program:  # of which a device has one for each shader
                resource.destroy()
                wrong[f"a destroyed {type(resource).__name__}"] = resource
        wrong["a target of another device"] = foreign.image.at()
        wrong["a binding"] = house.image.sampled(house.sampler)
        wrong["the device"] = device
        yield house, wrong


@pytest.mark.parametrize("name", SAMPLES)
def test_a_wrong_argument_is_refused_by_a_rule(street: tuple[House, dict[str, Any]], name: str) -> None:
    house, wrong = street
    sample = SAMPLES[name]
    if not all(getattr(house.device.capabilities, need) for need in sample.needs):
        pytest.skip(f"{house.device.backend_name} lacks {sample.needs}")
    house.mesh.vertices.write(rectangle())  # type: ignore[union-attr]
    right = given_arguments(house, sample)
    run(house, sample, right)
    faults = []
    for parameter, (_, takes) in sample.parameters.items():
        for shown, value in wrong.items():
            try:
                run(house, sample, right | {parameter: value})
            except rhi.RhiError:
                continue
            except BaseException as error:
                faults.append(f"{parameter}={shown}: {error!r}")
            else:
                if not takes(house, value):
                    faults.append(f"{parameter}={shown}: accepted")
    check_drawing(house)
    assert not faults, "\n".join(faults)


ODD: dict[str, Any] = {
    "a NUL": "a\0b", "a surrogate": "\ud800", "0-d": np.array(3), "empty": np.zeros((0, 4), "f4"), "2**31": 1 << 31,
    "strided": np.zeros((8, 8), "f4")[::2, ::-1], "big endian": np.zeros(4, ">f4"), "complex": np.zeros(4, "c16"),
    "dates": np.array(["2020-01-01"], "M8[D]"), "masked": np.ma.masked_array([1.0, 2.0], [True, False]),
    "a generator": (i for i in range(3)), "a set": {1, 2}, "-0.0": -0.0, "2**63 - 1": (1 << 63) - 1, "...": ...,
    "2**64 - 1": np.uint64(2**64 - 1), "(2**40, 1)": (2**40, 1), "a slice": slice(0, 2),
    "{'position': [1]}": {"position": [1]},
}  # fmt: skip
"""Values that are wrong in a way of their own."""


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(4))
def test_several_wrong_arguments_at_once_are_refused_by_a_rule(street: tuple[House, dict[str, Any]], seed: int) -> None:
    house, random = street[0], np.random.default_rng(seed)
    odd = [*(street[1] | ODD).items()]
    odd += [(f"[{name}]", [value]) for name, value in odd]
    faults = []
    for name, sample in SAMPLES.items():
        if not all(getattr(house.device.capabilities, need) for need in sample.needs):
            continue
        for _ in range(12 if len(sample.parameters) else 0):
            house.mesh.vertices.write(rectangle())  # type: ignore[union-attr]
            count = random.integers(1, min(len(sample.parameters), 3) + 1)
            chosen = random.choice([*sample.parameters], count, replace=False).tolist()
            given = {parameter: odd[random.integers(len(odd))] for parameter in chosen}
            try:
                run(house, sample, given_arguments(house, sample) | {one: value for one, (_, value) in given.items()})
            except rhi.RhiError:
                continue
            except BaseException as error:
                faults.append(f"{name}, { {one: shown for one, (shown, _) in given.items()} }: {error!r}")
    check_drawing(house)
    assert not faults, "\n".join(faults)


def as_numpy(value: Any) -> Any:
    """Return a number or flag as NumPy's own type; None for anything else."""
    if isinstance(value, bool):
        return np.bool_(value)
    if isinstance(value, int):
        return np.int32(value)
    return np.float32(value) if isinstance(value, float) else None


@pytest.mark.parametrize("name", SAMPLES)
def test_numpys_numbers_are_numbers(street: tuple[House, dict[str, Any]], name: str) -> None:
    house, sample = street[0], SAMPLES[name]
    if not all(getattr(house.device.capabilities, need) for need in sample.needs):
        pytest.skip(f"{house.device.backend_name} lacks {sample.needs}")
    right = given_arguments(house, sample)
    for parameter, value in right.items():
        if as_numpy(value) is not None:
            run(house, sample, right | {parameter: as_numpy(value)})
    check_drawing(house)


def test_every_exception_is_that_of_a_parameter() -> None:
    assert sum(len(sample.parameters) for sample in SAMPLES.values()) > 360
    names = {
        key
        for name, sample in SAMPLES.items()
        for parameter in sample.parameters
        for key in (f"{name}.{parameter}", f"{name.rpartition('.')[2]}.{parameter}", parameter)
    }
    assert not EXCEPTIONS.keys() - names
