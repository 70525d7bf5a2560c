"""The shading language: shaders written once, in annotated Python.

A shader is a class (`Shader`): its fields are its bindings, its methods its stages; structs are classes
(`Struct`); helpers are methods or `@function`s. They are ordinary Python to editors and type checkers, and are
parsed, not run: `compile_shader` makes a typed tree (`rhi.shading.tree`) and from it a program's descriptor.
See docs/shading.md.
"""

from typing import TYPE_CHECKING, Any

from rhi.shading import functions, textures, vectors
from rhi.shading.annotations import Flat, FragmentDepth, NoPerspective, value_type_of
from rhi.shading.bindings import (
    ImageBinding,
    Storage,
    StorageRange,
    StorageRW,
    TextureBinding,
    Uniform,
    UniformRange,
)
from rhi.shading.builtins import Precision
from rhi.shading.compile import compile_shader, opencl_kernel, stage_trees
from rhi.shading.function import function, native
from rhi.shading.functions import *  # noqa: F403
from rhi.shading.shader import Shader, shared
from rhi.shading.structs import Struct
from rhi.shading.textures import *  # noqa: F403
from rhi.shading.vectors import *  # noqa: F403

if TYPE_CHECKING:
    from rhi.shading.evaluate import run_compute
    from rhi.shading.evaluate_stages import run_fragment, run_vertex
    from rhi.shading.numpy_textures import HostTexture

__rhi_internal__ = True


def __getattr__(name: str) -> Any:
    if name == "run_compute":  # which few programs need, and which takes as long to import as all the rest
        from rhi.shading.evaluate import run_compute

        return run_compute
    if name in ("run_fragment", "run_vertex"):
        from rhi.shading import evaluate_stages

        return getattr(evaluate_stages, name)
    if name == "HostTexture":
        from rhi.shading.numpy_textures import HostTexture

        return HostTexture
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


__all__ = [
    "Flat",
    "FragmentDepth",
    "HostTexture",
    "ImageBinding",
    "NoPerspective",
    "Precision",
    "Shader",
    "Storage",
    "StorageRW",
    "StorageRange",
    "Struct",
    "TextureBinding",
    "Uniform",
    "UniformRange",
    "compile_shader",
    "function",
    "native",
    "opencl_kernel",
    "run_compute",
    "run_fragment",
    "run_vertex",
    "shared",
    "stage_trees",
    "value_type_of",
]
__all__ += functions.__all__
__all__ += textures.__all__
__all__ += vectors.__all__
