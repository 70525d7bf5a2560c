"""Measurements: what is compared alternates in one process, and results are medians and ratios."""

from renderer.measure.alternate import Measurement, alternate
from renderer.measure.frames import FrameCost, measure_frame, settle
from renderer.measure.table import format_records, format_rows, format_table, title_of

__all__ = [
    "FrameCost",
    "Measurement",
    "alternate",
    "format_records",
    "format_rows",
    "format_table",
    "measure_frame",
    "settle",
    "title_of",
]
