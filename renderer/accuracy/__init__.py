"""What accuracy costs in time: all choices between the two, what each loses, and what it saves."""

from renderer.accuracy.jobs import SweepJob, run_jobs
from renderer.accuracy.knobs import KNOBS, NEUTRAL, Demand, Knob, Truth, Unit, find_knob
from renderer.accuracy.sweep import KnobReport, Situation, ValueRow, sweep_knob

__all__ = [
    "KNOBS",
    "NEUTRAL",
    "Demand",
    "Knob",
    "KnobReport",
    "Situation",
    "SweepJob",
    "Truth",
    "Unit",
    "ValueRow",
    "find_knob",
    "run_jobs",
    "sweep_knob",
]
