"""What accuracy costs in time: all choices between the two, what each loses, and what it saves."""

from renderer.lab.accuracy.choice import CheckedChoice, FrontPoint, choose, find_choices, find_front
from renderer.lab.accuracy.jobs import SweepJob, keep_front, list_jobs, run_jobs
from renderer.lab.accuracy.knobs import KNOBS, NEUTRAL, Demand, Knob, Truth, Unit, find_knob
from renderer.lab.accuracy.sweep import KnobReport, Situation, ValueRow, sweep_knob

__all__ = [
    "KNOBS",
    "NEUTRAL",
    "CheckedChoice",
    "Demand",
    "FrontPoint",
    "Knob",
    "KnobReport",
    "Situation",
    "SweepJob",
    "Truth",
    "Unit",
    "ValueRow",
    "choose",
    "find_choices",
    "find_front",
    "find_knob",
    "keep_front",
    "list_jobs",
    "run_jobs",
    "sweep_knob",
]
