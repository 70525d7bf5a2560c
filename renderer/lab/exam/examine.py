"""Runs cases on a device, and makes a row of the table of each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from renderer.lab.exam.case import Case, Found
from rhi import Device


@dataclass(frozen=True, slots=True)
class ExamRow:
    """The outcome of a case on a device.

    Attributes:
        error: None if the case doesn't apply, or could not be measured.
        passed: None if the case doesn't apply.
        asks: what the case asks of a device: that it draws, or computes, or nothing.
        remark: what the device lacks, which statement doesn't hold, or what was raised; mostly empty.
    """

    case: int
    backend: str
    about: str
    reference: str
    tolerance: float
    unit: str
    error: float | None
    passed: bool | None
    asks: str
    remark: str = ""

    def as_record(self) -> dict[str, Any]:
        """Return the row for JSON, which has no infinity and no NaN."""
        record = asdict(self)
        if self.error is not None and not np.isfinite(self.error):
            record["error"] = str(self.error)
        return record


def examine(device: Device, cases: Iterable[Case]) -> Iterator[ExamRow]:
    """Yield a row for each case as soon as it is measured. What a case raises is a failure of the device in this case,
    and the next one follows."""
    for case in cases:
        lack = case.find_lack(device.capabilities)
        if lack is not None:
            yield _make_row(case, device, None, None, f"needs {lack}")
            continue
        try:
            found = case.measure(device)
        except Exception as error:  # whatever a port raises
            yield _make_row(case, device, None, False, f"{type(error).__name__}: {error}".splitlines()[0])
            continue
        yield _make_row(case, device, found.error, case.judge(found), _explain(found))


def _make_row(case: Case, device: Device, error: float | None, passed: bool | None, remark: str) -> ExamRow:
    return ExamRow(
        case.number,
        device.backend_name,
        case.about,
        case.reference,
        case.tolerance,
        case.unit,
        None if error is None else float(error),
        passed,
        case.asks,
        remark,
    )


def _explain(found: Found) -> str:
    return "; ".join(f"not: {statement}" for statement, is_true in found.holds.items() if not is_true)
