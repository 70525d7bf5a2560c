"""The kinds of lights: a leaf module for each, and the table that lists them.

A leaf has all that is particular to its kind: the array that a scene stores, the struct that shaders read,
the light that arrives at a point, the volume that it can reach, the aim of its shadow maps, its place in glTF
and its name in explanations. All else (the scene, culling, shadows, techniques, files) goes over the table. A
new kind is a leaf and a row of the table.
"""

from renderer.light_kinds.kind import LightKind as LightKind
from renderer.light_kinds.kind import LocalLightKind as LocalLightKind
from renderer.light_kinds.table import LIGHT_KINDS as LIGHT_KINDS
from renderer.light_kinds.table import LOCAL_LIGHT_KINDS as LOCAL_LIGHT_KINDS
