"""Generated fragment stages, like the compute stages of `test_shading_lane_programs`. They also discard, in
called functions too, and take differences between pixels, so that helpers run."""

import numpy as np
import pytest
from hypothesis import given, seed, settings
from hypothesis import strategies as st
from stage_runner import run_fragment_glsl, run_fragment_lanes, run_fragment_numpy
from test_shading_lane_programs import N, blocks, program_settings

from rhi.shading import from_source

FRAGMENTS = """from rhi.shading import *

class Placed(Struct):
    clip: vec4
    offset: int

class Buffers(Shader):
    given: Storage[int]
    out: StorageRW[int]
    sums: StorageRW[int]

class Test(Buffers):

    def vertex(self) -> Placed:
        return Placed(clip=vec4(0.0), offset=0)

    def helper(self, x: int, y: int) -> int:
{helper}
        return x

    def fragment(self, v: Placed) -> int:
        at = fragment_coordinate()
        i = int(at.x) + 8 * int(at.y)
        x = self.given[i] + v.offset
        y = i % 7
        z = 1{slope}
        table = array(int, 4)
{body}
        return x * 31 + y * 7 + z + table[1] + table[3]
"""
SLOPE = " + int(ddx(float(y)))"


@st.composite
def stages(draw):
    def text(block):
        return "\n".join("        " + line for line in block)

    helper = text(draw(blocks(2, result="y", names=("x", "y"), discards=True)))
    body = text(draw(blocks(result="y", discards=True)))
    return FRAGMENTS.format(helper=helper, body=body, slope=SLOPE if draw(st.booleans()) else "")


def check(source, context):
    shader = from_source(source)
    given_values = (np.arange(N, dtype="i4") * 37) % 23 - 8
    values = {"given": given_values, "out": N, "sums": 16}
    offset = {"offset": np.array(1, "i4")}
    expected = run_fragment_glsl(context, shader, offset, (8, 8), **values)
    others = {
        "16 lanes": run_fragment_lanes(shader, offset, (8, 8), **values),
        "NumPy": run_fragment_numpy(shader, offset, (8, 8), **values),
    }
    coverage = expected["coverage"]
    for language, results in others.items():
        for name in ("out", "sums", "coverage"):
            np.testing.assert_array_equal(results[name], expected[name], f"{language}: {name}\n{source}")
        message = f"{language}: result\n{source}"
        np.testing.assert_array_equal(results["color"][coverage], expected["color"][coverage], message)


@program_settings(10)
@given(source=stages())
def test_fragments_mean_the_same_in_every_language(source, context):
    check(source, context)


@pytest.mark.nightly
@pytest.mark.parametrize("piece", range(10))
def test_a_thousand_fragment_stages_mean_the_same_in_every_language(piece, context):
    """A hundred programs for each seed; `-k "[7]"` repeats one seed."""

    @seed(piece)
    @settings(program_settings(100), derandomize=False)
    @given(source=stages())
    def piece_of_them(source):
        check(source, context)

    piece_of_them()
