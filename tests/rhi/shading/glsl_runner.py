"""Runs compute shaders through moderngl, using only rhi's shading language and a driver."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import moderngl
import numpy as np
import pytest

from rhi.contract.descriptors import BindingKind, Stage
from rhi.contract.layout import Layout, element_dtype
from rhi.shading import Shader, Struct, compile_shader, value_type_of


@pytest.fixture(scope="module")
def context() -> Iterator[moderngl.Context]:
    """An OpenGL context without a window."""
    try:
        context = moderngl.create_context(standalone=True, backend="egl", require=430)
    except Exception as error:
        pytest.skip(f"no OpenGL 4.3 through EGL: {error}")
    yield context
    context.release()


def run_glsl(context: moderngl.Context, shader: type[Shader], groups: Any = 1, **values: Any) -> dict[str, Any]:
    """Run a compute shader on OpenGL and return the contents of each storage buffer afterwards."""
    program = compile_shader(shader)
    compute = context.compute_shader(program.emit("glsl", Stage.COMPUTE).text)
    buffers = {}
    for binding in program.bindings:
        value = values[binding.name]
        if binding.kind is BindingKind.UNIFORM:
            data = value.to_bytes() if isinstance(value, Struct) else value.tobytes()
            buffer = context.buffer(data)
            buffer.bind_to_uniform_block(binding.slot)
            buffers[binding.name] = (buffer, None)
        elif binding.kind is BindingKind.STORAGE:
            dtype = element_dtype(value_type_of(binding.type), Layout.STD430)
            array = np.zeros(value, dtype) if isinstance(value, int) else np.asarray(value)
            buffer = context.buffer(array.tobytes())
            buffer.bind_to_storage_buffer(binding.slot)
            buffers[binding.name] = (buffer, array)
        elif binding.kind is BindingKind.TEXTURE:
            value.use(binding.slot)
        else:
            value.bind_to_image(binding.slot)
    compute.run(*(groups if isinstance(groups, tuple) else (groups,)))
    context.finish()
    results = {}
    for name, (buffer, array) in buffers.items():
        if array is not None:
            results[name] = np.frombuffer(buffer.read(), array.dtype).reshape(array.shape)
        buffer.release()
    compute.release()
    return results
