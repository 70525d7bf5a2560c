"""The techniques by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from renderer.techniques.deferred import Deferred
from renderer.techniques.deferred_by_cells import ClusteredDeferred, TiledDeferred
from renderer.techniques.deferred_plus import DeferredPlus
from renderer.techniques.forward import Forward
from renderer.techniques.forward_multipass import ForwardMultipass
from renderer.techniques.forward_plus import Clustered, ForwardPlus
from renderer.techniques.inferred import Inferred
from renderer.techniques.light_indexed import LightIndexed
from renderer.techniques.light_pre_pass import LightPrePass
from renderer.techniques.technique import Technique

TECHNIQUES: Final[dict[str, Callable[..., Technique]]] = {
    technique.name: technique
    for technique in (
        Forward,
        ForwardMultipass,
        Deferred,
        LightPrePass,
        Inferred,
        LightIndexed,
        ForwardPlus,
        Clustered,
        TiledDeferred,
        ClusteredDeferred,
        DeferredPlus,
    )
}
"""Constructors of all techniques, by name. Their parameters have the names and defaults of
`TechniqueSettings`."""
