"""Images of one draw: a texture, a mesh and a pass that a test needs for nothing else."""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

from numpy.typing import ArrayLike, NDArray

from rhi import Device, Format, Primitive, State
from rhi.conformance.shaders import Colored
from rhi.device.resources.meshes import VertexSource
from rhi.shading import Shader


def draw_once(
    device: Device,
    source: tuple[int, int] | NDArray[Any],
    format: Format,
    rows: VertexSource | int,
    /,
    *states: State,
    shader: type[Shader] = Colored,
    indices: ArrayLike | None = None,
    primitive: Primitive = Primitive.TRIANGLES,
    samples: int = 1,
    clear: tuple[float, float, float, float] | None = None,
    **bindings: Any,
) -> NDArray[Any]:
    """Return the texels (height, width, channels) of a new texture, of a size or with texels, after one draw
    of vertices into it. One of several samples is resolved at the end of the pass; depth begins at 0."""
    with (
        device.texture(source, format, samples=samples) as image,
        device.mesh(rows, indices, primitive=primitive) as mesh,
        nullcontext() if samples == 1 else device.texture(source, format) as resolved,
    ):
        if format.is_depth:
            target = device.render_pass(depth=image, clear_depth=0.0)
        else:
            target = device.render_pass(image, clear=clear, resolve=resolved)
        with target, device.states(*states):
            device.draw(device.program(shader), mesh, **bindings)
        return (resolved or image).read()
