"""Random programs: what a device does in any order of passes, states, copies and writes, checked by float64.

- `steps`: a program is data, a tuple of steps of frozen dataclasses. `to_python` prints it.
- `generator`: random programs of a theme: a few pipelines with everything else random, so that a backend that
  compiles per pipeline compiles little.
- `runner` executes a program on a device; `interpreter` computes what it may leave there, as `intervals`:
  `coverage` in exact integers, `merging` in float64. `tolerances` holds what devices may choose. `check`
  compares the two.
- `reducer` shrinks a program that fails.
"""

from rhi.conformance.programs.interpreter import interpret
from rhi.conformance.programs.model import Program
from rhi.conformance.programs.runner import check, run
from rhi.conformance.programs.tolerances import EXACT, Effect, Fault, Tolerances

__all__ = ["EXACT", "Effect", "Fault", "Program", "Tolerances", "check", "interpret", "run"]
