"""Rules for the text of the rasteriser's kernels."""

from __future__ import annotations

import re
from functools import cache
from importlib.resources import files
from typing import Final

import numpy as np
import pyopencl as cl
import pytest

from rhi.backends.cl.cl_context import QUICK, open_context
from rhi.backends.cl.pocl.kernel_cache import strip_comments
from rhi.backends.cl.raster.kernel_structs import BATCH_STRUCT, DRAW_STRUCT, VIEW_STRUCT
from rhi.backends.cl.raster.kernel_text import declare_struct
from rhi.backends.cl.raster.merger import MERGER_STRUCT
from rhi.contract.descriptors import TextureKind
from rhi.shading.language.builtins import Precision
from rhi.shading.opencl.opencl_textures import textures_text

_STRUCTS = {"Batch": BATCH_STRUCT, "Draw": DRAW_STRUCT, "View": VIEW_STRUCT, "Merger": MERGER_STRUCT}

_HEADER = re.compile(r"^(?!typedef\b|struct\b)(\w[^;{}#=]*\)) *\{", re.M)


def list_structs_by_value(text: str) -> list[str]:
    """Return the heads of functions that take or return a struct, instead of the address of one."""
    text = strip_comments(text)
    structs = "|".join(re.findall(r"^\} *(\w+);", text, re.M))
    by_value = re.compile(rf"\b(?:{structs})\s+\w")
    return [head for head in _HEADER.findall(text) if by_value.search(head)]


def test_kernels_give_structs_by_address() -> None:
    """PoCL never frees the types of a function's structs, so programs that come and go would make a process
    grow."""
    kernels = files("rhi.backends.cl.raster").joinpath("kernels")
    text = "\n".join(
        kernel_file.read_text(encoding="utf-8")
        for kernel_file in kernels.iterdir()
        if kernel_file.name.endswith(".cl")
    )
    text += "".join(declare_struct(*kernel_file) for kernel_file in _STRUCTS.items())
    assert len(_HEADER.findall(text)) > 100
    assert not list_structs_by_value(text)


@pytest.mark.parametrize(
    ("head", "by_value"),
    [
        ("INLINE Pair split(int a)", True),
        ("bool holds(global const int *a, const Pair pair)", True),
        ("SEPARATE void split(\n    int a, Pair b\n)", True),
        ("INLINE void split(int a, Pair *pair)", False),
        ("bool holds(global const Pair *pairs, int pair)", False),
    ],
)
def test_structs_passed_by_value_are_listed(head: str, by_value: bool) -> None:
    text = f"typedef struct {{\n    int a, b;\n}} Pair;\n\n{head} {{\n    Pair c, d;\n    use(c, d);\n}}\n"
    assert list_structs_by_value(text) == ([head] if by_value else [])


@pytest.mark.parametrize("name", _STRUCTS)
def test_declared_structs_lie_in_memory_as_their_dtypes(name: str) -> None:
    struct = _STRUCTS[name]
    offsets = "".join(
        f"answer[{index}] = (uint)(ulong)&((global {name} *)0)->{field};"
        for index, field in enumerate(struct.names or ())
    )
    size = f"answer[{len(struct)}] = sizeof({name});"
    source = f"{declare_struct(name, struct)}kernel void lay_out(global uint *answer) {{ {offsets}{size} }}"
    context, answer = open_context(), np.zeros(len(struct) + 1, np.uint32)
    memory = cl.Buffer(context.context, cl.mem_flags.READ_WRITE, answer.nbytes)
    kernel = context.compile(source, QUICK).find("lay_out")
    kernel.set_args(memory)
    cl.enqueue_nd_range_kernel(context.queue, kernel, (1,), (1,))
    cl.enqueue_copy(context.queue, answer, memory)
    assert struct.fields is not None
    expected = [struct.fields[field][1] for field in struct.names or ()]
    assert answer.tolist() == [*expected, struct.itemsize]


# -- chains of calls -----------------------------------------------------------------------------------------

_FUNCTION: Final = re.compile(r"^static (RHI_\w+) \w+ (\w+)\((?:[^\n]*\}$|.*?^\})", re.M | re.S)
"""A function of a line, or of several whose last is a brace."""


def count_chains(text: str, root: str) -> int:
    """Return for how many chains of calls PoCL copies functions into a quick kernel that calls one of them.

    A chain leads from the kernel to any function below it, and may leave out links. What is inlined in quick
    kernels too is part of its callers.
    """
    bodies = {match[2]: (match[1], match[0]) for match in _FUNCTION.finditer(text)}
    names = {
        caller: {name for name in re.findall(r"\b(\w+)\(", body) if name in bodies and name != caller}
        for caller, (_, body) in bodies.items()
    }

    @cache
    def list_called(caller: str) -> frozenset[str]:
        called: set[str] = set()
        for name in names[caller]:
            called |= list_called(name) | (set() if bodies[name][0] == "RHI_FUSED" else {name})
        return frozenset(called)

    @cache
    def count(name: str) -> int:
        return 1 + sum(count(called) for called in list_called(name))

    return count(root)


def test_quick_kernels_that_sample_have_few_chains_of_calls() -> None:
    """Each link more doubles them, and what PoCL copies."""
    text, _, _ = textures_text(16, [TextureKind.D2], Precision.EXACT).partition("#else  // calls of textures")
    chains = count_chains(text, "rhi_sample_grad")
    called = count_chains(text.replace("RHI_FUSED", "RHI_INLINE"), "rhi_sample_grad")
    assert 100 < chains < 6_000
    assert called > 5 * chains, "the control: more links are counted"
