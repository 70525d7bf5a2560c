"""The text of kernels: the files in kernels/, and the structs that they share with the host."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Any, Final

import numpy as np

from rhi.backends.cl.pocl.kernel_cache import strip_comments

_TYPES: Final = {"u8": "ulong", "i4": "int", "u4": "uint", "f4": "float"}


@cache
def read_kernels(name: str) -> str:
    """Return the text of a file in kernels/, without comments."""
    return strip_comments(files(__package__).joinpath("kernels", f"{name}.cl").read_text(encoding="utf-8"))


def declare_struct(name: str, struct: np.dtype[Any]) -> str:
    """Return the declaration in OpenCL C of a dtype that lies in memory as C would lay it out."""
    rows = [
        f"    {_TYPES[struct[field].base.str[1:]]} "
        f"{field}{''.join(f'[{count}]' for count in struct[field].shape)};\n"
        for field in struct.names or ()
    ]
    return f"typedef struct {{\n{''.join(rows)}}} {name};\n"
