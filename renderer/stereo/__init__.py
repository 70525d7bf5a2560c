"""Stereo: both eyes of a frame, and the ways to show them in one image.

renderer.stereo = Stereo(StereoRig(eye_distance=0.063, convergence=3.0), "dubois")
"""

from renderer.stereo.outputs import ANAGLYPHS as ANAGLYPHS
from renderer.stereo.outputs import GLASSES as GLASSES
from renderer.stereo.outputs import OUTPUTS as OUTPUTS
from renderer.stereo.outputs import SHUTTER as SHUTTER
from renderer.stereo.outputs import compute_brightness as compute_brightness
from renderer.stereo.outputs import compute_rivalry as compute_rivalry
from renderer.stereo.outputs import eye_image_size as eye_image_size
from renderer.stereo.outputs import mix_anaglyph as mix_anaglyph
from renderer.stereo.outputs import view_through_glasses as view_through_glasses
from renderer.stereo.pair import EyePair as EyePair
from renderer.stereo.pair import Stereo as Stereo
from renderer.stereo.pair import compute_rig as compute_rig
from renderer.stereo.reprojection import read_hole_mask as read_hole_mask
from rhi.errors.exports import list_public as _list_public

__all__ = _list_public(globals())
