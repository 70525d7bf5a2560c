"""`python -m rhi new-backend NAME`: writes the package that a port starts from.

The package can be installed, registers itself and runs the kit at once. Every method of the contract is there
and raises NotImplementedError, so each test fails with the name of the method that it needs. The methods are
generated from `Backend`, in the order of `steps`.
"""

from __future__ import annotations

import inspect
import keyword
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from rhi.conformance.port_steps import STEPS
from rhi.contract.backend import Backend
from rhi.device.registry import backend_names
from rhi.errors import refuse
from rhi.errors.rules import DEVICE_ARGUMENT

LINE: Final = 110

_PROJECT: Final = """\
[build-system]
requires = ["setuptools>=68"]
build-backend = "setuptools.build_meta"

[project]
name = "rhi-{name}"
version = "0.1.0"
description = "A backend of rhi"
requires-python = ">=3.11"
dependencies = ["rhi"]

[project.optional-dependencies]
test = ["rhi[test]"]

[project.entry-points."rhi.backends"]
{name} = "rhi_{name}:create_backend"
"""

_README: Final = """\
# rhi-{name}

A backend of `rhi`. Install it; the kit then tells what to write next:

```sh
pip install --editable .[test]
pytest --pyargs rhi.conformance --rhi-backend {name} -q
```

`rhi_{name}/backend.py` has the methods in the order to write them; `python -m rhi docs porting` explains what
each must do.
"""

_INIT: Final = '''\
"""The {name} backend of rhi: `rhi.create_device("{name}")`."""

from rhi.contract import Backend

from rhi_{name}.backend import {type}

__rhi_internal__ = True  # errors name the line that called rhi, not one of this module

__all__ = ["{type}", "create_backend"]


def create_backend(*, validation: bool = False) -> Backend:
    """Create a device. With `validation`, messages of the driver are raised as exceptions.

    Raises:
        rhi.DeviceError: `device-driver` if the driver can't be used; the tip names what to install.
    """
    return {type}()
'''

_BACKEND: Final = '''\
"""The {name} backend: rhi's contract on …"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from rhi.contract import (
    BufferDescriptor,
    BufferId,
    Capabilities,
    Id,
    PassDescriptor,
    Primitive,
    ProgramDescriptor,
    ProgramId,
    QueryId,
    QueryKind,
    Region,
    SamplerDescriptor,
    SamplerId,
    StateChange,
    TextureDescriptor,
    TextureId,
    VertexArrayDescriptor,
    VertexArrayId,
)
from typing_extensions import Buffer as BytesLike

__rhi_internal__ = True  # errors name the line that called rhi, not one of this module


class {type}:
    """One device; see `rhi.contract.Backend`."""

    def __init__(self) -> None:
        self._capabilities = Capabilities(backend="{name}", device="unknown", driver="0.1.0")

    @property
    def capabilities(self) -> Capabilities:
        """The features and limits of this device. Set to False what the platform lacks: its tests are
        then skipped."""
        return self._capabilities

    def close(self) -> None:
        """Release everything. No call follows."""
'''


def write_package(name: str, folder: Path) -> Path:
    """Write the package `rhi-NAME` into a folder and return the path of the package.

    Raises:
        ValidationError: `device-argument` if the name is invalid, or is that of a backend that exists.
        FileExistsError: the package's folder exists.
    """
    call = f"python -m rhi new-backend {name}"
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or keyword.iskeyword(name):
        refuse(DEVICE_ARGUMENT, call, repr(name), "lower-case letters, digits and underscores")
    if name in backend_names():
        refuse(DEVICE_ARGUMENT, call, f"{name!r}, which is a backend here", "a name that no backend has")
    names = {"name": name, "type": f"{''.join(part.capitalize() for part in name.split('_'))}Backend"}
    root = folder / f"rhi-{name}"
    package = root / f"rhi_{name}"
    package.mkdir(parents=True)
    (root / "pyproject.toml").write_text(_PROJECT.format(**names), encoding="utf-8")
    (root / "README.md").write_text(_README.format(**names), encoding="utf-8")
    (package / "__init__.py").write_text(_INIT.format(**names), encoding="utf-8")
    (package / "backend.py").write_text(
        _BACKEND.format(**names) + "\n".join(_methods()) + "\n", encoding="utf-8"
    )
    return root


def _methods() -> Iterator[str]:
    """Yield the source of each method that the template doesn't contain already, under the title of its
    step."""
    for number, step in enumerate(STEPS, 1):
        missing = [method for method in step.methods if method not in ("capabilities", "close")]
        if missing:
            heading = f"    # -- {number}: {step.title} "
            yield f"\n{heading}{'-' * (LINE - 4 - len(heading))}"
        for method in missing:
            yield f"\n{_method(method)}"


def _method(name: str) -> str:
    function = getattr(Backend, name)
    signature = inspect.signature(function)
    parameters = ", ".join(map(str, signature.parameters.values()))
    head = f"    def {name}({parameters}) -> {signature.return_annotation}:"
    head = head.replace("'", "")
    if len(head) > LINE:
        parameters = "".join(f"        {parameter},\n" for parameter in signature.parameters.values())
        head = f"    def {name}(\n{parameters}    ) -> {signature.return_annotation}:".replace("'", "")
    text = textwrap.indent(f'"""{inspect.cleandoc(function.__doc__)}"""', "        ")
    return f'{head}\n{text}\n        raise NotImplementedError("{name}")'
