"""What each effect needs: a ladder of scenes, what each rung adds to a frame, and that removing it takes this away."""

from renderer.lab.need.counting import SIZE, Ascent, compare, count_rung, remove_rung
from renderer.lab.need.ladder import LADDER, Rung
from renderer.lab.need.report import RungRow, count_need, find_rungs, show_added, show_removed, time_need
from renderer.lab.need.timing import time_asking

__all__ = [
    "LADDER",
    "SIZE",
    "Ascent",
    "Rung",
    "RungRow",
    "compare",
    "count_need",
    "count_rung",
    "find_rungs",
    "remove_rung",
    "show_added",
    "show_removed",
    "time_asking",
    "time_need",
]
