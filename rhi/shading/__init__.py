"""The shading language: shaders written once, in annotated Python, for every backend.

A shader is a class derived from `Shader`. Its fields are its bindings and its methods are its stages. Structs are
classes derived from `Struct`, helpers are methods or `@function`s. To editors and type checkers all of this is ordinary
Python. It is parsed and never run: `compile_shader` builds a typed tree (`rhi.shading.ir.tree`) and from it the
descriptor of a program. See docs/shading.md.
"""

from typing import TYPE_CHECKING, Any

from rhi.shading.compile import compile_shader, opencl_kernel, stage_trees
from rhi.shading.emitters import ShaderCode, register_language
from rhi.shading.language import functions, textures, vectors
from rhi.shading.language.annotations import Flat, FragmentDepth, NoPerspective, PointSize, value_type_of
from rhi.shading.language.bindings import (
    ImageBinding,
    Storage,
    StorageRange,
    StorageRW,
    TextureBinding,
    Uniform,
    UniformRange,
)
from rhi.shading.language.builtins import Precision
from rhi.shading.language.function import function, native
from rhi.shading.language.functions import *  # noqa: F403
from rhi.shading.language.modules import from_source
from rhi.shading.language.shader import Shader, shared
from rhi.shading.language.structs import Struct
from rhi.shading.language.textures import *  # noqa: F403
from rhi.shading.language.vectors import *  # noqa: F403

if TYPE_CHECKING:
    from rhi.shading.evaluation.compute import evaluate, run_compute
    from rhi.shading.evaluation.stages import run_fragment, run_vertex
    from rhi.shading.numpy.kernel import NumpyKernel
    from rhi.shading.numpy.textures import HostTexture


def __getattr__(name: str) -> Any:
    if name in ("evaluate", "run_compute"):  # few programs need these, and they take as long to import as all the rest
        from rhi.shading.evaluation import compute

        return getattr(compute, name)
    if name in ("run_fragment", "run_vertex"):
        from rhi.shading.evaluation import stages

        return getattr(stages, name)
    if name == "NumpyKernel":
        from rhi.shading.numpy.kernel import NumpyKernel

        return NumpyKernel
    if name == "HostTexture":
        from rhi.shading.numpy.textures import HostTexture

        return HostTexture
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


__all__ = [
    "Flat",
    "FragmentDepth",
    "HostTexture",
    "ImageBinding",
    "NoPerspective",
    "NumpyKernel",
    "PointSize",
    "Precision",
    "Shader",
    "ShaderCode",
    "Storage",
    "StorageRW",
    "StorageRange",
    "Struct",
    "TextureBinding",
    "Uniform",
    "UniformRange",
    "compile_shader",
    "evaluate",
    "from_source",
    "function",
    "native",
    "opencl_kernel",
    "register_language",
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
