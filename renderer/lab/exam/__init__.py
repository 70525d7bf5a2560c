"""The exam: hard cases, each with a reference, a tolerance and a measurement, for any device.

for row in examine(device, find_cases([])):
    print(row.case, row.about, row.error, row.passed)
"""

from renderer.lab.exam.case import Case, Found, Picture
from renderer.lab.exam.examine import ExamRow, examine
from renderer.lab.exam.table import CASES, find_cases

__all__ = ["CASES", "Case", "ExamRow", "Found", "Picture", "examine", "find_cases"]
