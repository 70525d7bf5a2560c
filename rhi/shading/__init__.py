"""The shading language: shaders written once, in annotated Python.

A shader is a class (`Shader`): its fields are its bindings, its methods its stages; structs are classes
(`Struct`); helpers are methods or `@function`s. They are ordinary Python to editors and type checkers, and are
parsed, not run: `compile_shader` makes a typed tree (`rhi.shading.tree`) and from it a program's descriptor.
See docs/shading.md.
"""

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
from rhi.shading.compile import compile_shader, stage_trees
from rhi.shading.function import function, native
from rhi.shading.functions import *  # noqa: F403
from rhi.shading.shader import Shader, shared
from rhi.shading.structs import Struct
from rhi.shading.textures import *  # noqa: F403
from rhi.shading.vectors import *  # noqa: F403

__rhi_internal__ = True

__all__ = [
    "Flat",
    "FragmentDepth",
    "ImageBinding",
    "NoPerspective",
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
    "shared",
    "stage_trees",
    "value_type_of",
]
__all__ += functions.__all__
__all__ += textures.__all__
__all__ += vectors.__all__
