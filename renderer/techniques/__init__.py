"""Techniques: ways to draw a frame. Each is one object, and can be exchanged at run time."""

from collections.abc import Callable
from typing import Final

from renderer.techniques.forward import Forward
from renderer.techniques.forward_multipass import ForwardMultipass
from renderer.techniques.light_indexed import LightIndexed
from renderer.techniques.particles import Particles
from renderer.techniques.technique import Technique

TECHNIQUES: Final[dict[str, Callable[[], Technique]]] = {
    Forward.name: Forward,
    ForwardMultipass.name: ForwardMultipass,
    LightIndexed.name: LightIndexed,
}
"""Constructors of all techniques, by name."""

__all__ = ["TECHNIQUES", "Forward", "ForwardMultipass", "LightIndexed", "Particles", "Technique"]
