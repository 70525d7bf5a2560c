"""A GL backend beside another context, for the conformance kit: `--rhi-backend hosted_backend:create`."""

from __future__ import annotations

import moderngl

from rhi.backends.gl import create_backend
from rhi.backends.gl.gl_backend import GlBackend

_hosts: list[moderngl.Context] = []


def create(*, validation: bool = False) -> GlBackend:
    """Create a host, which lives as long as the process, and a backend beside it."""
    _hosts.append(
        moderngl.create_context(
            330, standalone=True, backend="egl", libgl="libEGL.so.1", libegl="libEGL.so.1"
        )
    )
    return create_backend(validation=validation, context="current")
