"""The exam: hard cases, each with a reference, a tolerance and a measurement, for any device.

for row in examine(device, select_cases([])):
    print(row.case, row.description, row.error, row.passed)
"""

from renderer.lab.exam.case import Case, CaseImage, CaseResult, stop_at_first_failure
from renderer.lab.exam.examination import ExamRow, examine, examine_elsewhere
from renderer.lab.exam.table import CASES, select_cases

__all__ = [
    "CASES",
    "Case",
    "CaseImage",
    "CaseResult",
    "ExamRow",
    "examine",
    "examine_elsewhere",
    "select_cases",
    "stop_at_first_failure",
]
