"""Checked shaders report an index out of range with its line; the text of other shaders is unchanged."""

import inspect
import os
import subprocess
import sys

import numpy as np
import pytest
from opencl_runner import queue, run_opencl

import rhi
import rhi.shading as sl
from rhi.errors import ShaderError

RUNNERS = {
    "one lane": lambda shader, **values: run_opencl(shader, 1, **values),
    "16 lanes": lambda shader, **values: run_opencl(shader, 16, **values),
    "numpy": sl.run_compute,
}


@pytest.fixture(params=RUNNERS)
def run(request):
    return RUNNERS[request.param]


class Plain(sl.Shader):
    work_group = (32,)
    which: sl.Storage[int]
    a: sl.Storage[float]
    out: sl.StorageRW[float]

    def compute(self) -> None:
        i = sl.global_id().x
        table = sl.array(float, 4)
        table[i & 3] = 1.0
        v = sl.vec3(float(i), 2.0, 3.0)
        if i != 5:
            x = self.a[self.which[i]]
            y = table[self.which[i] & 3] + v[self.which[i] % 3]
            self.out[self.which[i]] = x + y


class Checked(Plain):
    checked = True


class TooFarInArray(Checked):
    def compute(self) -> None:
        i = sl.global_id().x
        table = sl.array(float, 4)
        table[self.which[i]] = 1.0
        self.out[i] = table[3] + self.a[0]


class TooFarInVector(Checked):
    def compute(self) -> None:
        i = sl.global_id().x
        v = sl.vec3(float(i), 2.0, 3.0)
        self.out[i] = v[self.which[i]] + self.a[0]


def line_of(shader, text):
    lines, first = inspect.getsourcelines(shader)
    return first + next(number for number, line in enumerate(lines) if text in line)


def values(**changes):
    which = np.arange(32, dtype="i4")
    for at, index in changes.items():
        which[int(at[1:])] = index
    return {"which": which, "a": np.ones(32, "f4"), "out": 32}


@pytest.mark.parametrize("index", [32, -1, 1 << 30, -(1 << 31)])
def test_an_index_outside_a_buffer_is_an_error_with_its_line(run, index):
    with pytest.raises(ShaderError, match=r"^\[shading-index\]") as caught:
        run(Checked, **values(i9=index))
    assert f"index {index}" in str(caught.value)
    assert "0 to 31" in str(caught.value)
    assert caught.value.site.file == __file__
    assert caught.value.site.line == line_of(Plain, "x = self.a[")


def test_indices_up_to_the_last_one_are_not_errors(run):
    out = run(Checked, **values(i9=31))["out"]
    np.testing.assert_array_equal(out, sl.run_compute(Plain, **values(i9=31))["out"])


def test_an_index_of_an_invocation_that_does_not_take_part_is_not_one(run):
    run(Checked, **values(i5=99))
    with pytest.raises(ShaderError):
        run(Checked, **values(i4=99))


@pytest.mark.parametrize(
    ("shader", "text", "first_outside"), [(TooFarInArray, "table[self", 4), (TooFarInVector, "v[self", 3)]
)
def test_an_index_outside_an_array_or_a_vector_is_an_error(run, shader, text, first_outside):
    inside = {**values(), "which": np.arange(32, dtype="i4") % first_outside}
    run(shader, **inside)
    inside["which"][17] = first_outside
    with pytest.raises(ShaderError, match=f"0 to {first_outside - 1}") as caught:
        run(shader, **inside)
    assert caught.value.site.line == line_of(shader, text)


class StoresTooFar(Checked):
    def compute(self) -> None:
        self.out[sl.global_id().x + self.which[0]] = self.a[0]


def test_a_store_out_of_range_is_reported_and_writes_nothing(run):
    run(StoresTooFar, **values(i0=0))
    with pytest.raises(ShaderError) as caught:
        run(StoresTooFar, **values(i0=1))
    assert caught.value.site.line == line_of(StoresTooFar, "self.out[")


class Same(Checked):
    def compute(self) -> None:
        i = sl.global_id().x
        self.out[i] = self.a[sl.uniform(self.which[i])]


@pytest.mark.parametrize("width", [4, 16])
def test_uniform_of_values_that_differ_is_an_error(width):
    same = {**values(), "which": np.repeat([3, 4], 16).astype("i4")}
    run_opencl(Same, width, **same)
    same["which"][20] = 5
    with pytest.raises(ShaderError, match=r"^\[shading-nonuniform\]") as caught:
        run_opencl(Same, width, **same)
    assert caught.value.site.line == line_of(Same, "uniform(")


class First(Checked):
    def compute(self) -> None:
        i = sl.global_id().x
        self.out[i] = self.a[sl.broadcast_first(self.which[i])]


def test_values_that_are_broadcast_may_differ(run):
    results = run(First, **{**values(), "which": np.repeat([3, 4], 16).astype("i4")})
    assert set(np.unique(results["out"])) <= set(values()["a"][[3, 4]].tolist())


def test_a_shader_that_is_not_checked_is_not_a_word_longer():
    for width in (1, 4, 8, 16):
        plain, checked = sl.opencl_kernel(Plain, width).text, sl.opencl_kernel(Checked, width).text
        assert "rhi_check" not in plain
        assert "rhi_faults" not in plain
        assert checked.count("rhi_check(") > 5
        without = type("Plain", (Checked,), {"checked": False, "__module__": __name__})
        assert sl.opencl_kernel(without, width).text.splitlines()[1:] == plain.splitlines()[1:]
    assert not sl.compile_shader(Plain).checked
    assert sl.compile_shader(Checked).checked


def test_the_environment_turns_it_on():
    code = "from rhi.shading import Shader; print(Shader.checked)"
    for value, expected in (("1", "True"), ("0", "False"), ("", "False")):
        environment = {**os.environ, "RHI_SHADING_CHECKED": value}
        run = subprocess.run(
            [sys.executable, "-c", code],
            env=environment,
            capture_output=True,
            text=True,
            check=True,
            encoding="utf-8",
        )
        assert run.stdout.strip() == expected


def test_a_device_raises_the_error_of_a_checked_dispatch_and_goes_on():
    queue()  # or the test is skipped
    with rhi.create_device("cl") as device:
        program = device.program(Checked)
        a, out = device.storage(float, np.ones(32, "f4")), device.storage(float, 32)
        wrong, right = (device.storage(int, values(i9=at)["which"]) for at in (77, 3))
        with pytest.raises(ShaderError, match="index 77"):
            device.dispatch(program, 1, which=wrong, a=a, out=out)
        device.dispatch(program, 1, which=right, a=a, out=out)
        np.testing.assert_array_equal(out.read(), sl.run_compute(Plain, **values(i9=3))["out"])
