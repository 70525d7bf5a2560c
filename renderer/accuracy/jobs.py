"""Sweeps as jobs: on any executor, and without doing anything twice after a crash.

A job is a knob in a situation. Its result is a file of its own, named by a hash of all that the result depends on: the
situation, the knob as it is declared, and the scene's file if it is one. A file is complete or isn't there: it is
written under another name, and then renamed. So a sweep that was interrupted goes on where it stopped, and after a
change of one knob only that one is measured again.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor, Future, as_completed
from dataclasses import asdict, dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

import rhi
from renderer.accuracy.choice import FrontPoint, combine, find_front, make_plain
from renderer.accuracy.knobs import KNOBS
from renderer.accuracy.sweep import KnobReport, Situation, ValueRow, sweep_knob
from renderer.settings import to_plain

__rhi_internal__ = True

_VERSION: Final = 2
"""To be raised with any change of what is measured or stored."""


@dataclass(frozen=True, slots=True)
class SweepJob:
    """The sweep of a knob."""

    situation: Situation
    knob: str

    @property
    def key(self) -> str:
        """A hash of all that the result depends on, machines aside."""
        scene = Path(self.situation.scene)
        content = sha256(scene.read_bytes()).hexdigest() if scene.is_file() else ""
        knob = KNOBS[self.knob]
        measured = knob.path, knob.values, knob.unit, knob.truth, knob.within, knob.demand, knob.remembers
        parts = [_VERSION, rhi.__version__, to_plain(self.situation), content, self.knob, repr(measured)]
        return _hash(parts)

    def run(self) -> KnobReport:
        """Measure the knob."""
        return sweep_knob(self.situation, self.knob)


def run_jobs(
    jobs: Sequence[SweepJob],
    executor: Executor,
    folder: Path | None,
    progress: Callable[[Iterable[Any], int], Iterable[Any]] = lambda items, total: items,
) -> list[KnobReport]:
    """Return the report of each job, in this order; as many run at a time as the executor allows.

    If one fails, the others are finished and kept, and then its error is raised.

    Args:
        folder: where results are kept, and found again; None keeps none.
        progress: wraps what is waited for, given how much it is: the jobs of a serial executor, the results of others.
    """
    known = {} if folder is None else {job: load_report(folder / f"{job.key}.json") for job in jobs}
    left = [job for job in jobs if known.get(job) is None]
    futures: dict[SweepJob, Future[KnobReport]] = {}
    for job in progress(left, len(left)):
        futures[job] = executor.submit(SweepJob.run, job)
        if folder is not None:
            futures[job].add_done_callback(partial(_keep, folder / f"{job.key}.json"))
    for _ in progress(as_completed(futures.values()), len(left)):
        pass
    return [known.get(job) or futures[job].result() for job in jobs]


def keep_front(
    situation: Situation,
    reports: Sequence[KnobReport],
    folder: Path | None,
    progress: Callable[[range], Iterable[int]] = lambda rounds: rounds,
) -> list[FrontPoint]:
    """Return the combinations of knobs (`find_front`), those that the folder holds if they were found from the same
    reports."""
    if folder is None:
        return find_front(situation, reports, progress)
    parts = [_VERSION, to_plain(situation), [asdict(report) for report in reports]]
    path = folder / f"front-{_hash(parts)}.json"
    try:
        found = json.loads(path.read_text())
        base = make_plain(situation.settings)
        return [FrontPoint(**point | {"settings": combine(base, point["values"])}) for point in found]
    except (OSError, ValueError, TypeError, KeyError):
        points = find_front(situation, reports, progress)
        _write_whole(path, json.dumps([asdict(point) | {"settings": None} for point in points]))
        return points


def _hash(parts: object) -> str:
    return sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:24]


def _write_whole(path: Path, text: str) -> None:
    """Write a file, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_suffix(f".{os.getpid()}.part")
    beside.write_text(text)
    beside.replace(path)


def _keep(path: Path, future: Future[KnobReport]) -> None:
    """Keep the result of a job as soon as it is there: the process may end before the others are."""
    if not future.cancelled() and future.exception() is None:
        save_report(path, future.result())


def save_report(path: Path, report: KnobReport) -> None:
    """Write a report."""
    _write_whole(path, json.dumps(asdict(report)))


def load_report(path: Path) -> KnobReport | None:
    """Read a report; None if there is none, or if it is damaged: then it is measured again."""
    try:
        found = json.loads(path.read_text())
        rows = [
            ValueRow(**row | {"worst": None if row["worst"] is None else tuple(row["worst"])}) for row in found["rows"]
        ]
        return KnobReport(**found | {"rows": tuple(rows)})
    except (OSError, ValueError, TypeError, KeyError):
        return None
