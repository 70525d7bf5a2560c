"""The bounds of a scene's mesh parts, by which devices cull meshlets."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from renderer.scene.arrays import list_ranges
from renderer.scene.meshes import Meshes
from renderer.scene.meshlets import bound_meshlets
from renderer.shaders import Meshlet
from rhi.math.indexing import repeat_each


def make_meshlets(meshes: Meshes) -> NDArray[Any]:
    """Return the bounds of all mesh parts, in the order of `make_mesh_parts`: (parts,) of `Meshlet`. Whole meshes and
    levels have the mesh's box and no cone."""
    every = np.arange(len(meshes))
    mesh = np.concatenate([every, repeat_each(every, np.diff(meshes.level_begins))])
    cut = repeat_each(every, np.diff(meshes.meshlet_begins))
    bounds = np.zeros(len(mesh) + len(cut), Meshlet.dtype)
    whole, meshlets = bounds[: len(mesh)], bounds[len(mesh) :]
    whole["lower"], whole["upper"] = meshes.lower[mesh], meshes.upper[mesh]
    whole["cosine"], whole["drawn_as"] = -1.0, np.arange(len(mesh))
    if len(cut):
        ranges = meshes.meshlet_ranges
        counts = ranges["index_count"].astype(np.int64)
        indices = meshes.indices[list_ranges(ranges["first_index"].astype(np.int64), counts)].astype(np.int64)
        positions = meshes.vertices["position"][indices + repeat_each(ranges["base_vertex"], counts)]
        boundaries = bound_meshlets(positions, (np.cumsum(counts) - counts) // 3)
        for name in ("lower", "upper", "axis", "cosine", "radius"):
            meshlets[name] = getattr(boundaries, name)
        meshlets["drawn_as"] = cut
    return bounds
