"""With `Precision.EXACT` each sum, difference and product of floats is the nearest float32, on gl, cl and
NumPy.

Random methods compute with numbers of very different sizes, so that a compiler which rearranges them gives
other numbers: by variables, calls, loops and conditions, into memory, images, indices and results. Python
runs the same text with NumPy's float32.
"""

import random

import numpy as np
import pytest
from nights import rotate_seed

import rhi
import rhi.shading as sl
from rhi.contract.descriptors import Stage

NUMBERS = np.array([1.0, 2.0**24, -(2.0**24), 0.1, 3.0, -1e-3, 16777213.0, 1e8, 7.25], np.float32)
FORMS = 12
ROWS = 64


class Writer:
    """Writes methods of three floats.

    Args:
        products: whether they multiply. OpenCL may round a product and a sum at once.
    """

    def __init__(self, seed, products):
        self.random = random.Random(seed)
        self.products = products

    def value(self, depth, names):
        """Return an expression: sums and differences of earlier values, which cancel often."""
        if depth == 0 or self.random.random() < 0.15:
            return self.random.choice(names)
        left, right = self.value(depth - 1, names), self.value(depth - 1, names)
        kind = self.random.random()
        if kind < 0.1:
            return f"({left} if {self.random.choice(names)} < {self.random.choice(names)} else {right})"
        if kind < 0.2:
            return f"self.add({left}, {right})"
        if kind < 0.3 and self.products:
            return f"({left} * {self.random.choice('abc')})"
        return f"({left} {self.random.choice('+-')} {right})"

    def method(self, number):
        names = ["a", "b", "c"]
        lines = [f"    def f{number}(self, a: float, b: float, c: float) -> float:"]
        for step in range(self.random.randint(1, 3)):
            lines.append(f"        t{step} = {self.value(2, names)}")
            names.append(f"t{step}")
        end = self.random.choice(("return", "if", "while", "for", "augmented", "vector"))
        if end == "if":
            lines += [
                f"        if {self.value(2, names)} > {self.value(2, names)}:",
                f"            return {names[-1]}",
            ]
            lines += [f"        elif {self.value(2, names)} <= c:", "            return c"]
        elif end == "while":
            lines += ["        count = 0", f"        while {self.value(2, names)} > a and count < 3:"]
            lines += ["            count += 1", f"            a += {self.value(1, names)}"]
        elif end == "for":
            lines += ["        s = a", "        error = c", "        for i in range(4):"]  # Kahan's sum
            lines += ["            y = b - error", "            t = s + y", "            error = (t - s) - y"]
            lines += ["            s = t"]
            names += ["s", "error"]
        elif end == "augmented":
            lines += [f"        a += {self.value(2, names)}", f"        a -= {self.value(1, names)}"]
        elif end == "vector":
            lines += [
                f"        v = vec2(a, b) + vec2({self.value(1, names)}, c)",
                "        w = v - vec2(b, c)",
            ]
            names += ["w.x", "w.y"]
        return [*lines, f"        return {self.value(2, names)}"]


HEAD = """
from rhi.shading import *

class Rounded(Shader):
    inputs: Storage[float]
    out: StorageRW[float]

    def add(self, x: float, y: float) -> float:
        return x + y

    def compute(self) -> None:
        i = global_id().x
        a = self.inputs[3 * i]
        b = self.inputs[3 * i + 1]
        c = self.inputs[3 * i + 2]
"""


def write_program(seed, products=True):
    """Return the text of a shader with `FORMS` methods."""
    writer = Writer(seed, products)
    lines = [f"        self.out[i * {FORMS + 1} + {n}] = self.f{n}(a, b, c)" for n in range(FORMS)]
    lines.append(f"        self.out[i * {FORMS + 1} + {FORMS}] = (a + b) - a")
    for number in range(FORMS):
        lines += ["", *writer.method(number)]
    return HEAD + "\n".join(lines) + "\n"


class Vector:
    """Two float32 numbers."""

    def __init__(self, x, y):
        self.x, self.y = x, y

    def __add__(self, other):
        return Vector(self.x + other.x, self.y + other.y)

    def __sub__(self, other):
        return Vector(self.x - other.x, self.y - other.y)


def expected_values(text, inputs):
    """The results of Python with NumPy's float32 (row, form)."""
    names = {"Shader": object, "Storage": list, "StorageRW": list, "vec2": Vector}
    exec(text.replace("from rhi.shading import *", ""), names)
    shader = names["Rounded"]()
    with np.errstate(all="ignore"):
        return np.array(
            [
                [getattr(shader, f"f{n}")(*row) for n in range(FORMS)] + [(row[0] + row[1]) - row[0]]
                for row in inputs
            ],
            np.float32,
        )


def make_inputs(seed):
    return np.random.default_rng(seed).choice(NUMBERS, (ROWS, 3))


def assert_rounded(backend, seeds):
    with rhi.create_device(backend) as device:
        for seed in seeds:
            text, inputs = write_program(seed, backend != "cl"), make_inputs(seed)
            shader = sl.from_source(text)
            out = device.storage(float, ROWS * (FORMS + 1))
            device.dispatch(
                device.program(shader), ROWS, inputs=device.storage(float, inputs.ravel()), out=out
            )
            np.testing.assert_array_equal(
                out.read().reshape(ROWS, -1), expected_values(text, inputs), str(seed)
            )


@pytest.mark.parametrize(("backend", "count"), [("gl", 8), ("cl", 2)])
def test_each_operation_is_rounded_by_itself(backend, count):
    assert_rounded(backend, range(count))


@pytest.mark.parametrize("seed", range(8))
def test_each_operation_is_rounded_by_itself_on_numpy(seed):
    inputs = make_inputs(seed)
    shader = sl.from_source(write_program(seed))
    run = sl.run_compute(shader, ROWS, inputs=inputs.ravel(), out=ROWS * (FORMS + 1))
    np.testing.assert_array_equal(
        run["out"].reshape(ROWS, -1), expected_values(write_program(seed), inputs), str(seed)
    )


@pytest.mark.nightly
@pytest.mark.parametrize(("backend", "count"), [("gl", 400), ("cl", 60)])
def test_each_operation_of_many_programs_is_rounded_by_itself(backend, count):
    assert_rounded(backend, map(rotate_seed, range(1000, 1000 + count)))


class Exact(sl.Shader):
    """A sum in several forms."""

    values: sl.Storage[float]
    out: sl.StorageRW[float]

    def compute(self) -> None:
        total = self.values[0] + self.values[1]
        if total - self.values[0] > 0.0:
            self.out[0] = total - self.values[1]


class Fast(Exact):
    """The same, with the driver's arithmetic."""

    precision = sl.Precision.FAST


@pytest.mark.parametrize("language", ["glsl", "vulkan"])
def test_only_exact_shaders_are_precise(language):
    exact, fast = (sl.compile_shader(shader).emit(language, Stage.COMPUTE).text for shader in (Exact, Fast))
    assert exact.count("precise") == 3
    assert "precise" not in fast
