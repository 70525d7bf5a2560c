"""The rules of the shading language: one table, in the order in which the compiler checks them."""

from __future__ import annotations

from typing import Final

from rhi.errors import Rule

NO_SOURCE: Final = Rule(
    "shading-no-source",
    "the source of a shader can't be read",
    "shaders are compiled from their Python source: define them in a file or a notebook cell, or make them "
    "with "
    "rhi.shading.from_source(text)",
)
TEXT: Final = Rule("shading-text", "a text doesn't define the requested shader")
SYNTAX: Final = Rule("shading-unsupported", "the shading language doesn't support this Python syntax")
UNKNOWN_NAME: Final = Rule("shading-unknown-name", "a name is not defined")
UNKNOWN_MEMBER: Final = Rule("shading-unknown-member", "a value has no such field, component or method")
NOT_SHADING: Final = Rule(
    "shading-not-shading", "a shader uses a Python object that the shading language doesn't support"
)
ANNOTATION: Final = Rule("shading-annotation", "an annotation is missing or names no shading type")
WRONG_TYPE: Final = Rule("shading-type", "an expression has the wrong type")
WRONG_ARGUMENTS: Final = Rule("shading-arguments", "a call's arguments don't match the function's signature")
TYPE_CHANGED: Final = Rule(
    "shading-type-changed",
    "a variable keeps the type of its first value",
    "use a second variable, or convert the value",
)
UNASSIGNED: Final = Rule(
    "shading-unassigned",
    "a variable is read where it may not have a value",
    "give it a value on every path that leads here",
)
NOT_WRITABLE: Final = Rule("shading-not-writable", "this can't be assigned to")
RECURSION: Final = Rule(
    "shading-recursion",
    "a function calls itself, directly or through others",
    "use a loop; devices have no stack",
)
MISSING_RETURN: Final = Rule(
    "shading-missing-return",
    "a function may end without returning a value",
    "return a value on every path",
)
OUT_OF_RANGE: Final = Rule("shading-out-of-range", "a constant is outside the allowed range")
TOO_LARGE: Final = Rule("shading-too-large", "an array has more elements than a shader can hold")
TOO_DEEP: Final = Rule(
    "shading-too-deep",
    "a shader is nested too deeply",
    "give parts of it names on lines of their own, or use a loop",
)
EVALUATED_TWICE: Final = Rule(
    "shading-evaluated-twice",
    "an operand with a side effect would be evaluated twice",
    "assign it to a variable on a line of its own first",
)
STAGE: Final = Rule("shading-stage", "this is not available in this stage")
STAGES: Final = Rule("shading-stages", "a shader's stages don't fit together")
INTERFACE: Final = Rule("shading-interface", "a stage's inputs or outputs are not valid")
BINDING: Final = Rule("shading-binding", "a binding is not valid")
UNUSED_BINDING: Final = Rule(
    "shading-unused-binding",
    "a shader declares a binding that none of its methods uses",
    "use it or remove it",
)
SHADOWED_BINDING: Final = Rule(
    "shading-shadowed-binding",
    "the name of an inherited binding is used for something else",
    "choose another name: draws of the base and of the subclass bind the same names",
)
BARRIER: Final = Rule(
    "shading-barrier",
    "all invocations of a work-group must reach a barrier together",
    "move the barrier out of conditions, loops and early returns that differ within the work-group",
)
INDEX: Final = Rule(
    "shading-index",
    "an index is out of bounds (found on the device)",
    "without `checked`, a read returns the nearest element and a write is dropped",
)
NONUNIFORM: Final = Rule(
    "shading-nonuniform",
    "uniform(x) was given values that differ between invocations (found on the device)",
    "use uniform only for values that are the same in all active invocations",
)
ENDLESS: Final = Rule(
    "shading-endless",
    "a loop doesn't end (found on the device)",
    "bound it with `for … in range(…)`, or split the work over several dispatches; OpenCL ends a `while` loop "
    "after 2²⁰ iterations, llvmpipe any loop after 65,535, and both go on with wrong values",
)
RACE: Final = Rule(
    "shading-race",
    "invocations store different values to the same element",
    "use an atomic, or let a single invocation store",
)
NATIVE: Final = Rule("shading-native", "a native function can't be used here")
LANGUAGE: Final = Rule("shading-language", "the name of a device language is taken")
SPIRV: Final = Rule("shading-spirv", "a stage can't be compiled to SPIR-V")
STRUCT: Final = Rule("shading-struct", "a struct is not valid here")
STRUCT_VALUE: Final = Rule("shading-struct-value", "a value doesn't match the field of a struct")
VECTOR_VALUE: Final = Rule("shading-vector-value", "these numbers don't form this vector or matrix")
DEVICE_ONLY: Final = Rule(
    "shading-device-only",
    "shading functions run on the device, inside shaders",
    "use math or NumPy on the CPU",
)
RELOAD: Final = Rule(
    "shading-reload",
    "an edit changes something that can't be replaced while the program runs",
    "undo the change, or restart the program",
)
