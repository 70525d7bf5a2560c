"""Lane code: what varies and what doesn't, vector memory, precision, functions on arrays; each on every
language."""

import numpy as np
import pytest
from opencl_runner import run_opencl

import rhi.shading as sl
from rhi.errors import ShaderError, ValidationError
from rhi.shading.language import rules

HARD = np.array(
    [
        *(
            0.0,
            -0.0,
            1.0,
            -1.0,
            0.5,
            1.5,
            2.5,
            -2.5,
            np.inf,
            -np.inf,
            np.nan,
            1e-40,
            1e-20,
            1e20,
            65504.0,
            65520.0,
        ),
        *(
            3.4e38,
            -3.4e38,
            1e-7,
            0.1,
            -0.1,
            7.0,
            255.0,
            8388609.0,
            100.25,
            -100.75,
            6e-8,
            6.2e-5,
            2.0,
            3.0,
            4.0,
            5.0,
        ),
    ],
    "f4",
)


class Exact(sl.Shader):
    """Functions whose results are the same everywhere, bit by bit."""

    work_group = (32,)
    a: sl.Storage[float]
    out: sl.StorageRW[float]

    def compute(self) -> None:
        i = sl.global_id().x
        x = self.a[i]
        y = self.a[31 - i]
        at = i * 12
        self.out[at] = sl.floor(x)
        self.out[at + 1] = sl.round(x)
        self.out[at + 2] = sl.abs(x)
        self.out[at + 3] = 1.0 if sl.isnan(x) else 0.0
        self.out[at + 4] = 1.0 if sl.isinf(x) else 0.0
        self.out[at + 5] = 1.0 if x < y else 0.0
        self.out[at + 6] = 1.0 if x != y else 0.0
        self.out[at + 7] = 1.0 if x >= y and not sl.isnan(y) else 0.0
        self.out[at + 8] = x + y
        self.out[at + 9] = x * y
        self.out[at + 10] = 0.0 if sl.isnan(x) else sl.sign(x) + sl.step(1.0, x) + sl.saturate(x)
        self.out[at + 11] = (
            0.0
            if sl.isnan(x) or sl.abs(x) < 1e-7
            else sl.unpack_half_2x16(sl.pack_half_2x16(sl.vec2(x, 0.0))).x
        )


def test_hard_numbers_are_the_same_on_every_lane(run_everywhere, request):
    if "numpy 64" in request.node.name:
        pytest.skip("sums and products of float64 don't round or overflow as those of float32")
    out = run_everywhere(Exact, a=HARD, out=32 * 12)["out"].reshape(32, 12)
    expected = sl.run_compute(Exact, a=HARD, out=32 * 12)["out"].reshape(32, 12)
    np.testing.assert_array_equal(out, expected)
    with np.errstate(all="ignore"):
        np.testing.assert_array_equal(expected[:, 0], np.floor(HARD))
        np.testing.assert_array_equal(expected[:, 8], HARD + HARD[::-1])


class Smooth(sl.Shader):
    """Functions with an error, on varying numbers."""

    work_group = (64,)
    a: sl.Storage[float]
    out: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        i = sl.global_id().x
        x = self.a[i]
        self.out[i * 2] = sl.vec4(sl.exp(x), sl.log2(sl.abs(x) + 0.01), sl.sin(x), sl.pow(sl.abs(x), 1.7))
        self.out[i * 2 + 1] = sl.vec4(
            sl.sqrt(sl.abs(x)), sl.exp2(x), sl.length(sl.vec3(x, 1.0, 2.0)), sl.normalize(sl.vec2(x, 1.0)).x
        )


class SmoothFast(Smooth):
    precision = sl.Precision.FAST


@pytest.mark.parametrize("shader", [Smooth, SmoothFast])
def test_smooth_functions_stay_within_their_error(run_everywhere, shader):
    x = np.linspace(-9, 9, 256).astype("f4")
    out = run_everywhere(shader, 4, a=x, out=512)["out"].reshape(256, 8)
    d = x.astype("f8")
    columns = [np.exp(d), np.log2(np.abs(d) + 0.01), np.sin(d), np.abs(d) ** 1.7]
    columns += [np.sqrt(np.abs(d)), np.exp2(d), np.sqrt(d * d + 5), d / np.sqrt(d * d + 1)]
    expected = np.stack(columns, axis=1)
    np.testing.assert_allclose(out, expected, rtol=3e-5, atol=3e-6)


def test_fast_functions_are_other_functions():
    assert "rhi_fast_pow(" in sl.opencl_kernel(SmoothFast, 16).text
    assert "rhi_fast" not in sl.opencl_kernel(Smooth, 16).text


class Powers(sl.Shader):
    work_group = (64,)
    a: sl.Storage[float]
    out: sl.StorageRW[sl.vec4]

    def compute(self) -> None:
        x = self.a[sl.global_id().x]
        self.out[sl.global_id().x] = sl.vec4(sl.pow(x, 1.0), sl.pow(x, 3.0), sl.pow(x, 32.0), sl.pow(x, 64.0))


class FastPowers(Powers):
    precision = sl.Precision.FAST


@pytest.mark.parametrize("width", [1, 16])
def test_fast_whole_powers_are_a_rounding_off_for_each_factor(width):
    x, exponents = np.geomspace(0.3, 2.5, 256).astype("f4"), np.array([1, 3, 32, 64])
    expected = x.astype("f8")[:, None] ** exponents
    out = run_opencl(FastPowers, width, 4, a=x, out=256)["out"].reshape(256, 4)
    error = np.abs(out / expected - 1)
    assert (error.max(axis=0) <= exponents * 2.0**-24).all()


def test_fast_whole_powers_are_products():
    assert "rhi_power_64(" in sl.opencl_kernel(FastPowers, 16).text
    assert "rhi_fast_pow(" not in sl.opencl_kernel(FastPowers, 16).text
    assert "rhi_power" not in sl.opencl_kernel(Powers, 16).text


@pytest.mark.parametrize("shader", [Powers, FastPowers])
def test_fast_shaders_may_lose_denormals_and_exact_ones_not(shader):
    cubes = run_opencl(shader, 16, 1, a=np.full(64, 1e-13, "f4"), out=64)["out"].reshape(64, 4)[:, 1]
    assert sl.compile_shader(shader).flushes_denormals == (shader is FastPowers)
    assert (np.abs(cubes - 1e-39) <= (1e-39 if shader is FastPowers else 1e-44)).all()


class Particle(sl.Struct):
    position: sl.vec3
    mass: float
    velocity: sl.vec3


class Move(sl.Shader):
    """A work-group that isn't a multiple of the lanes, structs with padding, stores under a mask."""

    work_group = (21,)
    particles: sl.StorageRW[Particle]
    heavy: sl.StorageRW[int]

    def compute(self) -> None:
        i = sl.global_id().x
        if i >= len(self.particles):
            return
        particle = self.particles[i]
        self.particles[i].position = particle.position + particle.velocity * 0.5
        if particle.mass > 4.0:
            self.heavy[1 + sl.atomic_add(self.heavy[0], 1)] = i


def test_structs_move_whatever_the_work_groups_size(run_everywhere):
    particles = np.zeros(50, Particle.dtype)
    particles["position"] = np.arange(150).reshape(50, 3)
    particles["velocity"] = 2.0
    particles["mass"] = np.arange(50) % 9
    out = run_everywhere(Move, 3, particles=particles, heavy=51)
    np.testing.assert_array_equal(out["particles"]["position"], np.arange(150).reshape(50, 3) + 1)
    heavy = np.flatnonzero(np.arange(50) % 9 > 4)
    assert out["heavy"][0] == len(heavy)
    np.testing.assert_array_equal(np.sort(out["heavy"][1 : 1 + len(heavy)]), heavy)


def test_consecutive_elements_are_read_with_vector_loads():
    text = sl.opencl_kernel(Exact, 16).text
    assert "rhi_load_global_1_0(a_," in text
    assert "rhi_any" not in sl.opencl_kernel(Exact, 1).text


@sl.function
def falloff(distance: float, radius: float) -> float:
    if distance >= radius:
        return 0.0
    return sl.clamp(1.0 - distance / radius, 0.0, 1.0) ** 2


@sl.function
def bits(x: float, n: sl.uint) -> int:
    return sl.float_bits_to_int(x) + int(n)


def test_a_function_runs_on_arrays_that_broadcast():
    d = np.linspace(0, 3, 7)
    result = sl.evaluate(falloff, d[:, None], np.array([1.0, 2.0]), dtype=np.float64)
    expected = np.clip(1 - d[:, None] / np.array([1.0, 2.0]), 0, 1) ** 2
    assert result.dtype == np.float64
    np.testing.assert_allclose(result, expected, rtol=1e-15)
    assert sl.evaluate(falloff, d, radius=2.0).dtype == np.float32


@sl.function
def flip(v: sl.vec3) -> sl.vec3:
    return -v


def test_a_function_runs_on_no_elements():
    assert sl.evaluate(falloff, np.zeros(0), 1.0).shape == (0,)
    assert sl.evaluate(flip, np.zeros((0, 3))).shape == (0, 3)
    assert sl.evaluate(flip, np.ones((2, 3))).shape == (2, 3)


def test_a_functions_arguments_have_their_types():
    assert sl.evaluate(bits, 1.0, 2) == 0x3F800002
    with pytest.raises(ValidationError, match="radius") as caught:
        sl.evaluate(falloff, 1.0)
    assert caught.value.rule is rules.WRONG_ARGUMENTS


def test_a_buffer_of_another_layout_is_refused():
    with pytest.raises(ValidationError, match=r"^\[shading-arguments\]"):
        sl.run_compute(Exact, a=HARD.astype("f8"), out=384)


def test_a_width_that_no_device_has_is_refused():
    with pytest.raises(ShaderError):
        sl.opencl_kernel(Exact, 3)


class OneStores(sl.Shader):
    work_group = (32,)
    out: sl.StorageRW[int]

    def compute(self) -> None:
        i = sl.local_index()
        if i % 10 == 3:
            self.out[0] = i


def test_of_lanes_that_store_to_one_place_the_last_wins():
    assert run_opencl(OneStores, 16, out=1)["out"].tolist() == [23]
    assert sl.run_compute(OneStores, out=1)["out"].tolist() == [23]
