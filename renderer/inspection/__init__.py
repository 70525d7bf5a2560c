"""Inspects frames from outside: their times pass by pass, their cost, and the textures of their plan as
images.

The viewer, the lab and the commands use it; it computes no references and compares nothing.
"""

from renderer.inspection.frame_cost import FrameCost as FrameCost
from renderer.inspection.frame_cost import measure_frame as measure_frame
from renderer.inspection.frame_cost import settle as settle
from renderer.inspection.frame_times import CapturedFrame as CapturedFrame
from renderer.inspection.frame_times import PassTime as PassTime
from renderer.inspection.frame_times import capture_frames as capture_frames
from renderer.inspection.frame_times import list_passes as list_passes
from renderer.inspection.frame_times import write_frames as write_frames
from renderer.inspection.texture_images import color_indices as color_indices
from renderer.inspection.texture_images import texture_to_image as texture_to_image
from rhi.errors.exports import list_public as _list_public

__all__ = _list_public(globals())
