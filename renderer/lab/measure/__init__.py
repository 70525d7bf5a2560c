"""Measurements: subjects alternate in one process, and results are medians and ratios."""

from renderer.lab.measure.measurement import Measurement as Measurement
from renderer.lab.measure.measurement import alternate as alternate
from renderer.lab.measure.table import format_rows as format_rows
from renderer.lab.measure.table import format_table as format_table
from renderer.lab.measure.table import title_of as title_of
from rhi.errors.exports import list_public as _list_public

__all__ = _list_public(globals())
