"""Measurements: what is compared alternates in one process, and results are medians and ratios."""

from renderer.lab.measure.alternate import Measurement as Measurement
from renderer.lab.measure.alternate import alternate as alternate
from renderer.lab.measure.frames import FrameCost as FrameCost
from renderer.lab.measure.frames import measure_frame as measure_frame
from renderer.lab.measure.frames import settle as settle
from renderer.lab.measure.table import format_rows as format_rows
from renderer.lab.measure.table import format_table as format_table
from renderer.lab.measure.table import title_of as title_of
from rhi.errors.exports import list_public as _list_public

__all__ = _list_public(globals())
