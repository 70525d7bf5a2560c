"""A port that has been written up to one step: the GL backend without the methods of later steps.

`RHI_PORT_STEP=4 pytest --pyargs rhi.conformance… --rhi-backend partial_backends:create_backend` runs the kit
on a port whose steps 1 to 4 are written.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

from rhi.backends.gl import create_backend as create_gl_backend
from rhi.conformance.port_steps import STEPS

STEP = "RHI_PORT_STEP"


def create_backend(*, validation: bool = False) -> Any:
    """Create a backend that has the methods of the steps up to `RHI_PORT_STEP`; the others aren't written."""
    whole: Any = create_gl_backend(validation=validation)
    written = int(os.environ[STEP])
    members: dict[str, object] = {"capabilities": property(lambda _: whole.capabilities)}
    for number, step in enumerate(STEPS, 1):
        for name in step.methods:
            if name != "capabilities":
                members[name] = _part(whole, name) if number <= written else staticmethod(_missing(name))
    for name in ("resume", "make_current", "release_current", "hand_back"):  # of what holds a context of GL
        members[name] = _part(whole, name)
    return type("PartialBackend", (), members)()


def _part(whole: Any, name: str) -> property:
    """Return a method of the whole, as it is at each call: of a context that isn't current, methods are
    others."""
    return property(lambda _: getattr(whole, name))


def _missing(name: str) -> Callable[..., None]:
    def method(*arguments: object) -> None:
        raise NotImplementedError(name)

    method.__code__ = method.__code__.replace(co_name=name)  # the kit names a missing method by its frame
    return method
