"""The needs of each effect: a ladder of scenes, what a rung adds to a frame, and that removing it takes this away."""

from renderer.lab.need.counting import SIZE as SIZE
from renderer.lab.need.counting import Ascent as Ascent
from renderer.lab.need.counting import compare as compare
from renderer.lab.need.counting import count_rung as count_rung
from renderer.lab.need.counting import remove_rung as remove_rung
from renderer.lab.need.ladder import LADDER as LADDER
from renderer.lab.need.ladder import Rung as Rung
from renderer.lab.need.report import RungRow as RungRow
from renderer.lab.need.report import count_need as count_need
from renderer.lab.need.report import find_rungs as find_rungs
from renderer.lab.need.report import show_added as show_added
from renderer.lab.need.report import show_removed as show_removed
from renderer.lab.need.report import time_need as time_need
from renderer.lab.need.timing import time_asking as time_asking
from rhi.errors.exports import list_public as _list_public

__all__ = _list_public(globals())
