"""Techniques: ways to draw a frame. Each is one object, and can be exchanged at run time."""

from renderer.techniques.auto import AutoTechnique as AutoTechnique
from renderer.techniques.deferred import Deferred as Deferred
from renderer.techniques.deferred_by_cells import ClusteredDeferred as ClusteredDeferred
from renderer.techniques.deferred_by_cells import TiledDeferred as TiledDeferred
from renderer.techniques.deferred_plus import DeferredPlus as DeferredPlus
from renderer.techniques.forward import Forward as Forward
from renderer.techniques.forward_multipass import ForwardMultipass as ForwardMultipass
from renderer.techniques.forward_plus import Clustered as Clustered
from renderer.techniques.forward_plus import ForwardPlus as ForwardPlus
from renderer.techniques.inferred import Inferred as Inferred
from renderer.techniques.light_indexed import LightIndexed as LightIndexed
from renderer.techniques.light_pre_pass import LightPrePass as LightPrePass
from renderer.techniques.parts.fxaa import FxaaTechnique as FxaaTechnique
from renderer.techniques.resource_capture import ResourceCapture as ResourceCapture
from renderer.techniques.table import TECHNIQUES as TECHNIQUES
from renderer.techniques.technique import Technique as Technique
from renderer.techniques.technique_settings import TechniqueSettings as TechniqueSettings
from renderer.techniques.technique_settings import to_technique as to_technique
from rhi.errors.exports import list_public as _list_public

__all__ = _list_public(globals())
