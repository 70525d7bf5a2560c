"""Fixtures that run compute shaders on a bare OpenGL context, on OpenCL and on NumPy, using no part of rhi
but the shading language."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import moderngl
import numpy as np
import pytest
from glsl_runner import context as context
from glsl_runner import run_glsl
from opencl_runner import run_opencl

from rhi.contract.descriptors import ProgramDescriptor
from rhi.shading import Shader, compile_shader, run_compute

Run = Callable[..., dict[str, Any]]


@pytest.fixture
def run(context: moderngl.Context) -> Run:
    """`run(shader, groups=1, name=array_or_count_or_struct…)` returns each writable buffer's contents
    afterwards."""

    return partial(run_glsl, context)


@pytest.fixture(params=["glsl", "opencl 1", "opencl 4", "opencl 16", "numpy 32", "numpy 64"])
def run_everywhere(request: pytest.FixtureRequest, context: moderngl.Context) -> Run:
    """`run` once for each language, and for OpenCL with one lane and with 16."""
    language, _, number = request.param.partition(" ")
    if language == "glsl":
        return partial(run_glsl, context)
    if language == "opencl":
        return lambda shader, groups=1, **values: run_opencl(shader, int(number), groups, **values)
    dtype = np.float32 if number == "32" else np.float64
    return partial(run_compute, dtype=dtype)


@pytest.fixture
def link(context: moderngl.Context) -> Callable[[type[Shader]], ProgramDescriptor]:
    """Compile a shader's stages on the driver and return its descriptor."""

    def link(shader: type[Shader]) -> ProgramDescriptor:
        program = compile_shader(shader)
        texts = {f"{stage.value}_shader": program.emit("glsl", stage).text for stage in program.stages}
        if "compute_shader" in texts:
            context.compute_shader(texts["compute_shader"]).release()
        else:
            context.program(**texts).release()
        return program

    return link
