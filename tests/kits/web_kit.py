"""Programs that run in node as in a page, or skips that name what is missing."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scripts"))

import run_in_node  # noqa: E402

TIMEOUT = 900.0


def require_pyodide() -> None:
    """Fetch the packages of `run_in_node.py`, Pyodide among them, or skip the test."""
    try:
        run_in_node.fetch()
    except (OSError, SystemExit, subprocess.CalledProcessError) as error:
        pytest.skip(f"packages for node can't be had: {error}")


def require_node(*, gpu: bool = True) -> None:
    """Fetch what programs in node need, or skip the test; without `gpu`, what a page without WebGPU needs."""
    require_pyodide()
    obstacle = run_in_node.find_obstacle(gpu=gpu)
    if obstacle is not None:
        pytest.skip(obstacle)


def run_kit(backend: str, *options: str, gpu: bool = True) -> subprocess.CompletedProcess[str]:
    """Run the conformance kit in node."""
    arguments = ["--tb=short", "-rfs", "--pyargs", "rhi.conformance", "--rhi-backend", backend, *options]
    return run_in_node.run(ROOT / "tests" / "kits" / "web_pytest.py", arguments, gpu=gpu, capture=True)


def run_program(
    text: str,
    folder: Path,
    *arguments: str,
    jspi: bool = True,
    gpu: bool = True,
    packages: Sequence[str] = ("numpy",),
) -> str:
    """Run the text of a program in node, assert that it succeeds, and return what it prints."""
    program = folder / "program.py"  # shaders are compiled from files
    program.write_text(text, encoding="utf-8")
    done = run_in_node.run(
        program,
        arguments,
        jspi=jspi,
        gpu=gpu,
        packages=packages,
        folders=[ROOT / "examples" / "programs"],
        capture=True,
        timeout=TIMEOUT,
    )
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-4000:]
    return done.stdout


def check_kit(output: str, expected: Mapping[str, str]) -> int:
    """Assert that the kit was run and that only expected tests failed; return how many passed."""
    totals = re.findall(r"total +(\d+) passed +(\d+) failed", output)
    assert totals, output[-8000:]
    names = set(re.findall(r"^FAILED \S*?::(.+?)(?: - .*)?$", output, re.MULTILINE))
    assert len(names) == sum(int(failed) for _, failed in totals), output[-8000:]
    assert {name for name in names if not any(map(name.startswith, expected))} == set(), output[-20000:]
    return sum(int(passed) for passed, _ in totals)


_SCISSOR = "test_the_same_triangle_has_the_same_depth_whatever_the_scissor[web-direct-"
_TABLE = "test_an_enlarged_image_of_a_table_is_filtered_and_wrapped_as_a_texture"
EXPECTED_FAILURES = {
    **{
        f"{_SCISSOR}{size}-clipped]": "SwiftShader's rasteriser"
        for size in ("(3, 2)", "(23, 17)", "(70, 64)")
    },
    "test_a_query_counts_by_the_depth_function[web-direct-native-DepthFunction.EQUAL]": "SwiftShader interpolates "
    "a depth of .5 to another number than a clear to .5 stores",
    "test_each_operator_of_scalars_and_vectors[web-direct-float-": "SwiftShader's pow: inf and NaN",
    "test_the_ends_of_a_format_s_range_are_cleared_to[web-direct-RGB10A2UI]": "Dawn clears RGB10A2UI to 255 at most",
    **dict.fromkeys(
        (
            "test_a_triangle_with_a_corner_just_behind_the_eye_is_drawn[web-direct]",
            "test_a_clipped_triangle_covers_the_texels_that_float64_computes[web-direct-",
            "test_small_triangles_of_a_tilted_plane_have_the_distance_of_the_plane[web-direct-",
            "test_each_sample_has_the_color_of_the_triangle_that_covers_its_position[web-direct-4]",
        ),
        "SwiftShader's rasteriser",
    ),
    "test_a_cube_is_filtered_across_its_edges[web-direct]": "SwiftShader reads what memory held beyond a face's edge",
    f"{_TABLE}[web-direct-MIRROR-CLAMP-NEAREST]": "SwiftShader selects other texels where a mirrored texture repeats",
}
"""Tests of the kit that fail in node and in Chromium, by the beginnings of their names, and why. Those of SwiftShader
fail with wgpu on it too; the clear of Dawn fails in plain JavaScript."""

ENDLESS = (
    "(test_far_indirect_arguments_read_the_mesh and (count or instances))",
    "(test_random_indirect_arguments_read_the_mesh and (plain or instanced))",
)
"""Tests that draw up to 2³² vertices or instances, each of which SwiftShader shades on the CPU."""
