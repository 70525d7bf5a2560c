"""The shading language: shaders written once, in annotated Python, for every backend.

A shader is a class derived from `Shader`. Its fields are its bindings and its methods are its stages. Structs
are classes derived from `Struct`, helpers are methods or `@function`s. To editors and type checkers all of
this is ordinary Python. It is parsed and never run: `compile_shader` builds a typed tree
(`rhi.shading.ir.tree`) and from it the descriptor of a program. See `python -m rhi docs shading`.
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING as _TYPE_CHECKING
from typing import Any as _Any

from rhi.errors.exports import list_public as _list_public
from rhi.shading.language.annotations import Flat as Flat
from rhi.shading.language.annotations import FragmentDepth as FragmentDepth
from rhi.shading.language.annotations import NoPerspective as NoPerspective
from rhi.shading.language.annotations import PointSize as PointSize
from rhi.shading.language.annotations import TargetLayer as TargetLayer
from rhi.shading.language.annotations import value_type_of as value_type_of
from rhi.shading.language.bindings import ImageBinding as ImageBinding
from rhi.shading.language.bindings import Storage as Storage
from rhi.shading.language.bindings import StorageRange as StorageRange
from rhi.shading.language.bindings import StorageRW as StorageRW
from rhi.shading.language.bindings import TableBinding as TableBinding
from rhi.shading.language.bindings import TextureBinding as TextureBinding
from rhi.shading.language.bindings import Uniform as Uniform
from rhi.shading.language.bindings import UniformRange as UniformRange
from rhi.shading.language.builtins import Precision as Precision
from rhi.shading.language.full_screen import FullScreen as FullScreen
from rhi.shading.language.function import function as function
from rhi.shading.language.function import native as native
from rhi.shading.language.functions import *  # noqa: F403
from rhi.shading.language.modules import from_source as from_source
from rhi.shading.language.shader import Shader as Shader
from rhi.shading.language.shader import find_element as find_element
from rhi.shading.language.shader import shared as shared
from rhi.shading.language.structs import Struct as Struct
from rhi.shading.language.texture_tables import TableTexture as TableTexture
from rhi.shading.language.texture_tables import TextureTable as TextureTable
from rhi.shading.language.textures import *  # noqa: F403
from rhi.shading.language.vectors import *  # noqa: F403

if _TYPE_CHECKING:
    from rhi.shading.compile import compile_shader as compile_shader
    from rhi.shading.compile import opencl_kernel as opencl_kernel
    from rhi.shading.compile import stage_trees as stage_trees
    from rhi.shading.emitters import ShaderCode as ShaderCode
    from rhi.shading.emitters import register_language as register_language
    from rhi.shading.evaluation.compute import evaluate as evaluate
    from rhi.shading.evaluation.compute import run_compute as run_compute
    from rhi.shading.evaluation.stages import run_fragment as run_fragment
    from rhi.shading.evaluation.stages import run_vertex as run_vertex
    from rhi.shading.numpy.host_tables import HostTextureTable as HostTextureTable
    from rhi.shading.numpy.host_textures import HostTexture as HostTexture
    from rhi.shading.numpy.kernel import NumpyKernel as NumpyKernel

_LATER = {
    "HostTexture": "numpy.host_textures",
    "HostTextureTable": "numpy.host_tables",
    "NumpyKernel": "numpy.kernel",
    "ShaderCode": "emitters",
    "compile_shader": "compile",
    "evaluate": "evaluation.compute",
    "opencl_kernel": "compile",
    "register_language": "emitters",
    "run_compute": "evaluation.compute",
    "run_fragment": "evaluation.stages",
    "run_vertex": "evaluation.stages",
    "stage_trees": "compile",
}
"""Names whose modules are imported on first use. The compiler is needed when a program is made, the others by
few programs, and they would double the import time."""


def __getattr__(name: str) -> _Any:
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(_import_module(f"{__name__}.{_LATER[name]}"), name)


__all__ = sorted([*_list_public(globals()), *_LATER])
