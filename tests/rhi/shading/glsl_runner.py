"""Runs compute shaders through moderngl, using only rhi's shading language and a driver."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import moderngl
import numpy as np
import pytest
from opencl_runner import binding_words

from rhi.contract.descriptors import BindingKind, Stage
from rhi.shading import Shader, compile_shader


@pytest.fixture(scope="module")
def context() -> Iterator[moderngl.Context]:
    """An OpenGL context without a window."""
    try:
        context = moderngl.create_context(standalone=True, backend="egl", require=430)
    except Exception as error:
        pytest.skip(f"no OpenGL 4.3 through EGL: {error}")
    yield context
    context.release()


class GlslBuffers:
    """The resources that a shader binds, on OpenGL."""

    def __init__(self, context: moderngl.Context, shader: type[Shader], bindings: dict[str, Any]) -> None:
        descriptor, words = compile_shader(shader), binding_words(shader, bindings)
        self.all: list[moderngl.Buffer] = []
        self.written: dict[str, tuple[moderngl.Buffer, Any]] = {}
        for binding in descriptor.bindings:
            value = words[binding.name]
            uniform = binding.kind is BindingKind.UNIFORM
            memory = context.buffer((value if uniform else value[1]).tobytes() or bytes(4))
            self.all.append(memory)
            if uniform:
                memory.bind_to_uniform_block(binding.slot)
            else:
                memory.bind_to_storage_buffer(binding.slot)
                if binding.writes:
                    self.written[binding.name] = (memory, value[0])

    def finish(self) -> dict[str, Any]:
        """Return the contents of the writable buffers and release all resources."""
        results = {
            name: np.frombuffer(memory.read(), whole.dtype).reshape(whole.shape)
            for name, (memory, whole) in self.written.items()
        }
        for memory in self.all:
            memory.release()
        return results


def run_glsl(
    context: moderngl.Context, shader: type[Shader], groups: Any = 1, **values: Any
) -> dict[str, Any]:
    """Run a compute shader on OpenGL and return the contents of each writable buffer afterwards."""
    compute = context.compute_shader(compile_shader(shader).emit("glsl", Stage.COMPUTE).text)
    buffers = GlslBuffers(context, shader, values)
    compute.run(*(groups if isinstance(groups, tuple) else (groups,)))
    context.finish()
    compute.release()
    return buffers.finish()
