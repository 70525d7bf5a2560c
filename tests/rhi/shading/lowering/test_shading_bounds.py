"""Bounds of clip positions: the stages for which they exist, and that they hold."""

from __future__ import annotations

from itertools import product

import numpy as np
import pyopencl as cl
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from opencl_runner import buffer, build_text, queue

import rhi.shading as sl
from rhi.contract.descriptors import Stage


class Vertex(sl.Struct):
    position: sl.vec3
    uv: sl.vec2
    bone: int


class View(sl.Struct):
    matrix: sl.mat4
    offset: sl.vec3
    time: float
    swaps_axes: int


class Transform(sl.Struct):
    linear: sl.mat3
    offset: sl.vec3


class Base(sl.Shader):
    view: sl.Uniform[View]
    transforms: sl.Storage[Transform]

    def vertex(self, v: Vertex) -> sl.vec4:
        return self.view.matrix @ sl.vec4(
            self.world_position(v), self.transforms[sl.instance_index()].offset.x
        )

    def world_position(self, v: Vertex) -> sl.vec3:
        return v.position


class AffineTransform(Base):
    def world_position(self, v: Vertex) -> sl.vec3:
        thing = self.transforms[sl.instance_index()]
        return thing.linear @ v.position + (thing.offset - self.view.offset)


class Swayed(Base):
    """A shader whose non-affine part is the same for all vertices."""

    def world_position(self, v: Vertex) -> sl.vec3:
        world_position = -v.position * sl.cos(self.view.time)
        world_position.y -= self.view.offset.x / self.view.time
        world_position = world_position + sl.vec3(0.0, sl.dot(v.position, self.view.offset), 2.0)
        return world_position.xyz


class Flat(Base):
    def world_position(self, v: Vertex) -> sl.vec3:
        return sl.vec3(v.uv, 1.0)


class Squared(Base):
    def world_position(self, v: Vertex) -> sl.vec3:
        return v.position * v.uv.x


class Divided(Base):
    def world_position(self, v: Vertex) -> sl.vec3:
        return self.view.offset / v.position.x


class Rounded(Base):
    def world_position(self, v: Vertex) -> sl.vec3:
        return sl.vec3(float(int(v.position.x)), v.uv)


class Pulled(Base):
    def world_position(self, v: Vertex) -> sl.vec3:
        return self.transforms[sl.vertex_index()].offset


class Skinned(Base):
    def world_position(self, v: Vertex) -> sl.vec3:
        return self.transforms[v.bone].linear @ v.position


class Folded(Base):
    def world_position(self, v: Vertex) -> sl.vec3:
        world_position = v.position
        if world_position.x < 0.0:
            world_position.x = 0.0
        return world_position


class ConditionalSwizzle(Base):
    """Affine in either case, but not plain assignments."""

    def world_position(self, v: Vertex) -> sl.vec3:
        world_position = v.position
        if self.view.swaps_axes != 0:
            world_position = world_position.zyx
        return world_position


class Heights(Base):
    heights: sl.Texture2D

    def world_position(self, v: Vertex) -> sl.vec3:
        return v.position + self.heights.sample_lod(v.uv, 0.0).xyz


class Marking(Base):
    marks: sl.StorageRW[int]

    def world_position(self, v: Vertex) -> sl.vec3:
        self.marks[sl.vertex_index()] = 1
        return v.position


class Constant(Base):
    def world_position(self, v: Vertex) -> sl.vec3:
        return self.view.offset


class Checked(Base):
    checked = True


class Shaded(sl.Struct):
    clip: sl.vec4
    light: float
    bent: sl.vec3


class ShadedVarying(Base):
    """Only the position must be affine; other outputs may be arbitrary."""

    def vertex(self, v: Vertex) -> Shaded:
        return Shaded(
            clip=self.view.matrix @ sl.vec4(v.position, 1.0),
            light=sl.cos(v.uv.x) / v.uv.y,
            bent=self.transforms[v.bone].offset,
        )

    def fragment(self, v: Shaded) -> sl.vec4:
        return sl.vec4(v.bent, v.light)


def boxed(shader: type[sl.Shader]) -> list[int] | None:
    """Return the input words that the bounds depend on, None without bounds."""
    text = sl.compile_shader(shader).emit("opencl16", Stage.VERTEX).text
    lines = [line for line in text.splitlines() if line.startswith("#define RHI_BOXED")]
    assert ("rhi_bounds(" in text) == bool(lines)
    return [int(word[5:-1]) for line in lines for word in line.split()[2:]] if lines else None


@pytest.mark.parametrize("shader", [Base, AffineTransform, Swayed, ShadedVarying])
def test_affine_positions_are_bounded_by_their_inputs(shader: type[sl.Shader]) -> None:
    assert boxed(shader) == [0, 1, 2]


def test_only_words_that_positions_depend_on_count() -> None:
    assert boxed(Flat) == [3, 4]


@pytest.mark.parametrize(
    "shader",
    [
        Squared,
        Divided,
        Rounded,
        Pulled,
        Skinned,
        Folded,
        ConditionalSwizzle,
        Heights,
        Marking,
        Constant,
        Checked,
    ],
)
def test_other_positions_are_not_bounded(shader: type[sl.Shader]) -> None:
    assert boxed(shader) is None


def test_bounds_read_nothing_by_a_vertex() -> None:
    """A corner's other inputs are unknown: an index among them would read anywhere."""
    text = sl.compile_shader(ShadedVarying).emit("opencl16", Stage.VERTEX).text
    whole, bounds = text.split("#define RHI_BOXED")
    assert "transforms_" in whole.split("void rhi_vertex")[1].split("{", 1)[1]
    assert "transforms_" not in bounds.split("{", 1)[1]


# -- that they hold ------------------------------------------------------------------------------------------

KERNEL = """
kernel void run(global const uint *view, global const uint *transforms, int count, global const float *boxes,
                global const float *shares, global float *out) {
    int round = get_global_id(0);
    boxes += 6 * round;
    uint16 inputs[7], corners[8], whole[64];
    uint reaches[7];
    for (int k = 0; k < 3; ++k) {
        float low = boxes[k], high = boxes[3 + k];
        inputs[k] = as_uint16((RHI_LANES >> k & 1) == 0 ? (float16)(low) : (float16)(high));
        reaches[k] = as_uint(fmax(fabs(low), fabs(high)));
    }
    rhi_bounds(view, transforms, count, inputs, reaches, RHI_LANES, round, 0, (int16)(-1), corners);
    for (int k = 0; k < 3; ++k) {
        float16 share = vload16(3 * round + k, shares);
        float16 at = boxes[k] * (1.0f - share) + boxes[3 + k] * share;
        inputs[k] = as_uint16(clamp(at, (float16)(boxes[k]), (float16)(boxes[3 + k])));
    }
    rhi_vertex(view, transforms, count, inputs, RHI_LANES, round, 0, (int16)(-1), whole);
    for (int i = 0; i < 8; ++i) vstore16(as_float16(corners[i]), 12 * round + i, out);
    for (int i = 0; i < 4; ++i) vstore16(as_float16(whole[i]), 12 * round + 8 + i, out);
}
"""
ROUNDS = 512


@pytest.fixture(scope="module", params=[AffineTransform, Swayed])
def kernel(request: pytest.FixtureRequest) -> cl.Kernel:
    text = sl.compile_shader(request.param).emit("opencl16", Stage.VERTEX).text + KERNEL
    return cl.Kernel(build_text(text), "run")


@given(seed=st.integers(0, 2**32 - 1), scale=st.floats(-8, 5), spread=st.floats(0, 12), flat=st.booleans())
@example(seed=0, scale=-6.0, spread=1.0, flat=False)
@example(seed=0, scale=5.0, spread=12.0, flat=False)
def test_positions_lie_between_those_of_corners_but_for_the_slack(
    kernel: cl.Kernel, seed: int, scale: float, spread: float, flat: bool
) -> None:
    """Draw terms of all magnitudes, some of which cancel, and boxes of all sizes, down to a few float steps
    or flat."""
    rng = np.random.default_rng(seed)

    def random(*shape: int) -> np.ndarray:
        sizes = 10.0 ** np.clip(rng.normal(0.0, spread, shape), -42, 32)
        return (rng.choice([-1, 1], shape) * sizes).astype(np.float32)

    view = np.zeros(32, np.float32)
    view[:20] = random(20)
    transforms = random(ROUNDS, 16)
    middle = random(ROUNDS, 3)
    size = np.abs(middle) * np.float32(10.0**scale) * rng.random((ROUNDS, 3)).astype(np.float32)
    if flat:
        size[:, rng.integers(3)] = 0
    boxes = np.stack([middle - size, middle + size], axis=1)
    shares = rng.choice([rng.random((ROUNDS, 3, 16)), rng.integers(0, 2, (ROUNDS, 3, 16))]).astype(np.float32)
    out = np.zeros((ROUNDS, 12, 16), np.float32)
    target = buffer(out)
    arguments = buffer(view), buffer(transforms), np.int32(ROUNDS), buffer(boxes), buffer(shares), target
    kernel(queue(), (ROUNDS,), None, *arguments).wait()
    cl.enqueue_copy(queue(), out, target)
    corners, slacks, positions = out[:, :4], out[:, 4:8, :1], out[:, 8:]
    is_finite = np.isfinite(slacks[..., 0])
    assert is_finite.any() or spread > 2
    pairs = (0, None), (1, None), (2, None), (3, None), (3, 0), (3, 1), (3, 2)
    for sign, (column, other) in product((1, -1), pairs):
        sure = is_finite[:, column] if other is None else is_finite[:, column] & is_finite[:, other]
        here, there = corners[sure, column], positions[sure, column].astype(np.float64)
        slack = slacks[sure, column].astype(np.float64)
        if other is not None:  # in float32, as planes of the view are tested
            with np.errstate(over="ignore"):
                here = here + sign * corners[sure, other]
            there, slack = there + sign * positions[sure, other], slack + slacks[sure, other]
        finite = np.isfinite(here).all(axis=1)  # a sum beyond the largest float has the right sign
        here, there, slack = here[finite], there[finite], slack[finite]
        assert (there >= here.min(axis=1, keepdims=True) - slack).all()
        assert (there <= here.max(axis=1, keepdims=True) + slack).all()
