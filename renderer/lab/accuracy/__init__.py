"""The price of accuracy in time: all choices between the two, what each loses, and what it saves."""

from renderer.lab.accuracy.choice import CheckedChoice as CheckedChoice
from renderer.lab.accuracy.choice import FrontPoint as FrontPoint
from renderer.lab.accuracy.choice import choose as choose
from renderer.lab.accuracy.choice import find_choices as find_choices
from renderer.lab.accuracy.choice import find_front as find_front
from renderer.lab.accuracy.choice import leave_to_trials as leave_to_trials
from renderer.lab.accuracy.jobs import SweepJob as SweepJob
from renderer.lab.accuracy.jobs import keep_front as keep_front
from renderer.lab.accuracy.jobs import list_jobs as list_jobs
from renderer.lab.accuracy.jobs import run_jobs as run_jobs
from renderer.lab.accuracy.knobs import KNOBS as KNOBS
from renderer.lab.accuracy.knobs import NEUTRAL as NEUTRAL
from renderer.lab.accuracy.knobs import Demand as Demand
from renderer.lab.accuracy.knobs import Knob as Knob
from renderer.lab.accuracy.knobs import Truth as Truth
from renderer.lab.accuracy.knobs import Unit as Unit
from renderer.lab.accuracy.knobs import find_knob as find_knob
from renderer.lab.accuracy.sweep import KnobReport as KnobReport
from renderer.lab.accuracy.sweep import Situation as Situation
from renderer.lab.accuracy.sweep import ValueRow as ValueRow
from renderer.lab.accuracy.sweep import sweep_knob as sweep_knob
from rhi.errors.exports import list_public as _list_public

__all__ = _list_public(globals())
