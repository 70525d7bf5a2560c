"""What accuracy costs in time: all choices between the two, what each loses, and what it saves."""

from renderer.accuracy.jobs import Job, run_jobs
from renderer.accuracy.knobs import KNOBS, NEUTRAL, Demand, Knob, Truth, Unit, find_knob
from renderer.accuracy.sweep import KnobReport, Situation, ValueRow, sweep_knob

__all__ = [
    "KNOBS",
    "NEUTRAL",
    "Demand",
    "Job",
    "Knob",
    "KnobReport",
    "Situation",
    "Truth",
    "Unit",
    "ValueRow",
    "find_knob",
    "run_jobs",
    "sweep_knob",
]
