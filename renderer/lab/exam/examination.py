"""Runs cases on a device, and makes a table row of each."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from renderer.lab.exam.case import Case, CaseResult
from renderer.lab.exam.table import CASES
from rhi import Device, create_device
from rhi_screen.executors import as_completed, is_lost


@dataclass(frozen=True, slots=True)
class ExamRow:
    """The outcome of a case on a device.

    Attributes:
        error: None if the case doesn't apply, or could not be measured.
        passed: None if the case doesn't apply.
        device_use: how the case uses a device: it draws, or computes, or doesn't use it.
        remark: the missing capability, the condition that doesn't hold, or the exception; mostly empty.
    """

    case: int
    backend: str
    description: str
    reference: str
    tolerance: float
    unit: str
    error: float | None
    passed: bool | None
    device_use: str
    remark: str = ""

    def as_record(self) -> dict[str, Any]:
        """The row for JSON, which has no infinity and no NaN."""
        record = asdict(self)
        if self.error is not None and not np.isfinite(self.error):
            record["error"] = str(self.error)
        return record


def examine(device: Device, cases: Iterable[Case]) -> Iterator[ExamRow]:
    """Yield a row for each case as soon as it is measured. An exception of a case counts as a failure of the
    device, and the next case follows."""
    for case in cases:
        lack = case.find_missing_capability(device.capabilities)
        if lack is not None:
            yield _make_row(case, device.backend_name, None, None, f"needs {lack}")
            continue
        try:
            result = case.measure(device)
        except Exception as error:  # ports may raise anything
            yield _make_row(
                case, device.backend_name, None, False, f"{type(error).__name__}: {error}".splitlines()[0]
            )
            continue
        yield _make_row(case, device.backend_name, result.error, case.passes(result), _explain(result))


def examine_elsewhere(
    executor: Executor, backends: Iterable[str], cases: Sequence[Case]
) -> Iterator[ExamRow]:
    """Yield a row for each case on each backend, in the order in which an executor finishes them.

    A case that ends its process has failed; others aren't affected.
    """
    calls = {
        executor.submit(examine_case, backend, case.number): (backend, case)
        for backend in backends
        for case in cases
    }
    for future in as_completed(executor, calls):
        error = future.exception()
        if error is None:
            yield future.result()
        elif is_lost(error):
            backend, case = calls[future]
            yield _make_row(case, backend, None, False, "its process ended")
        else:
            raise error


def examine_case(backend: str, number: int) -> ExamRow:
    """Examine a case on a new device of a backend, on a worker."""
    with create_device(backend) as device:
        (row,) = examine(device, [CASES[number]])
        return row


def _make_row(case: Case, backend: str, error: float | None, passed: bool | None, remark: str) -> ExamRow:
    return ExamRow(
        case.number,
        backend,
        case.description,
        case.reference,
        case.tolerance,
        case.unit,
        None if error is None else float(error),
        passed,
        case.device_use,
        remark,
    )


def _explain(result: CaseResult) -> str:
    return "; ".join(f"not: {description}" for description, is_true in result.holds.items() if not is_true)
