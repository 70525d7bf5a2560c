"""Stereo: both eyes of a frame, and the ways to show them in one image.

renderer.stereo = Stereo(StereoRig(eye_distance=0.063, convergence=3.0), "dubois")
"""

from renderer.stereo.outputs import ANAGLYPHS, OUTPUTS, fit_picture, mix_anaglyph
from renderer.stereo.pair import EyePair, Stereo
from renderer.stereo.reprojection import find_holes
from renderer.stereo.rigs import find_rig

__all__ = [
    "ANAGLYPHS",
    "OUTPUTS",
    "EyePair",
    "Stereo",
    "find_holes",
    "find_rig",
    "fit_picture",
    "mix_anaglyph",
]
