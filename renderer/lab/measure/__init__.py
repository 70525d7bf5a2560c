"""Measurements: what is compared alternates in one process, and results are medians and ratios."""

from renderer.lab.measure.alternate import Measurement, alternate
from renderer.lab.measure.frames import FrameCost, measure_frame, settle
from renderer.lab.measure.table import format_records, format_rows, format_table, title_of

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
