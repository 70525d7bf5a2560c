"""Sweeps as jobs: on any executor, and without doing anything twice after a crash.

A job is a share of a knob's sweep in a situation. What it has found is a file of its own, named by a hash of all that
it depends on: the situation, the knob as it is declared, the share, and the scene's file if it is one. A file is
complete or isn't there: it is written under another name, and then renamed. So a sweep that was interrupted goes on
where it stopped, and after a change of one knob only that one is measured again.

The longest jobs are handed out first, so that at the end no process waits for long for another one's.
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
from renderer.lab.accuracy import sweep
from renderer.lab.accuracy.choice import FrontPoint, combine, find_front, make_plain
from renderer.lab.accuracy.knobs import KNOBS, Demand, Unit
from renderer.settings import to_plain

_VERSION: Final = 4
"""To be raised with any change of what is measured or stored."""


_FLOAT64_FRAMES: Final = 12
"""The number of frames that take as long as a picture in float64."""
_JUDGED_FRAMES: Final = 200
"""The number of frames that take as long as the judge's picture."""
_MAPS: Final = 2
"""The factor by which frames take longer whose shadow maps are drawn, too."""


@dataclass(frozen=True, slots=True)
class SweepJob:
    """A share of the sweep of a knob."""

    situation: sweep.Situation
    knob: str
    share: sweep.SweepShare = sweep.WHOLE

    @property
    def key(self) -> str:
        """A hash of all that the result depends on, machines aside."""
        scene = Path(self.situation.scene)
        content = sha256(scene.read_bytes()).hexdigest() if scene.is_file() else ""
        knob = KNOBS[self.knob]
        measured = knob.path, knob.values, knob.unit, knob.truth, knob.within, knob.demand, knob.remembers, knob.option
        share = self.share.number, self.share.count
        parts = [_VERSION, rhi.__version__, to_plain(self.situation), content, self.knob, share, repr(measured)]
        return _hash(parts)

    @property
    def effort(self) -> float:
        """About how many frames it draws: to order jobs, not to say how long they take."""
        knob, situation = KNOBS[self.knob], self.situation
        if knob.is_encoding:
            return float(len(knob.values))
        views, rounds = (len(self.share.take(range(count))) for count in (situation.views, situation.rounds))
        frames = len(knob.values) * (knob.remembers + views + 1 + rounds)
        judged = views * (knob.truth.scale**2 + _FLOAT64_FRAMES * (knob.truth.is_float64 or knob.unit is Unit.LIGHTS))
        judged = views * _JUDGED_FRAMES if knob.truth.rays else judged
        return (frames + judged) * (_MAPS if knob.demand is Demand.SHADOWS else 1.0)

    def run(self) -> sweep.KnobSample:
        """Measure the share."""
        return sweep.sweep_share(self.situation, self.knob, self.share)


def list_jobs(situation: sweep.Situation, knobs: Iterable[str]) -> list[SweepJob]:
    """Return the jobs of the sweeps of some knobs."""
    return [SweepJob(situation, name, share) for name in knobs for share in sweep.list_shares(situation, name)]


def order_jobs(jobs: Iterable[SweepJob]) -> list[SweepJob]:
    """Return the jobs in the order in which they are handed out, the longest first."""
    return sorted(jobs, key=lambda job: -job.effort)


def run_jobs(
    jobs: Sequence[SweepJob],
    executor: Executor,
    folder: Path | None,
    progress: Callable[[Iterable[Any], int], Iterable[Any]] = lambda items, total: items,
) -> list[sweep.KnobReport]:
    """Return the report of each knob, in the order of their first jobs; as many run at a time as the executor allows.

    If one fails, the others are finished and kept, and then its error is raised.

    Args:
        folder: where results are kept, and found again; None keeps none.
        progress: wraps what is waited for, given how much it is: the jobs of a serial executor, the results of others.
    """
    known = {} if folder is None else {job: load_sample(folder / f"{job.key}.json") for job in jobs}
    left = [job for job in order_jobs(jobs) if known.get(job) is None]
    futures: dict[SweepJob, Future[sweep.KnobSample]] = {}
    for job in progress(left, len(left)):
        futures[job] = executor.submit(SweepJob.run, job)
        if folder is not None:
            futures[job].add_done_callback(partial(_keep, folder / f"{job.key}.json"))
    for _ in progress(as_completed(futures.values()), len(left)):
        pass
    found: dict[str, list[sweep.KnobSample]] = {}
    for job in jobs:
        found.setdefault(job.knob, []).append(known.get(job) or futures[job].result())
    return [sweep.join_shares(samples) for samples in found.values()]


def keep_front(
    situation: sweep.Situation,
    reports: Sequence[sweep.KnobReport],
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


def _keep(path: Path, future: Future[sweep.KnobSample]) -> None:
    """Keep the result of a job as soon as it is there: the process may end before the others are."""
    if not future.cancelled() and future.exception() is None:
        save_sample(path, future.result())


def save_sample(path: Path, sample: sweep.KnobSample) -> None:
    """Write what a job has found."""
    _write_whole(path, json.dumps(asdict(sample)))


def load_sample(path: Path) -> sweep.KnobSample | None:
    """Read what a job has found; None if there is no file, or if it is damaged: then it is measured again."""
    try:
        found = json.loads(path.read_text())
        values = {value: _read_sample(one) for value, one in found["values"].items()}
        return sweep.KnobSample(**found | {"values": values, "truth_ratios": tuple(found["truth_ratios"])})
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _read_sample(found: dict[str, Any]) -> sweep.ValueSample:
    lists = {name: tuple(found[name]) for name in ("seconds", "processor_seconds", "flips")}
    worst = None if found["worst"] is None else tuple(found["worst"])
    return sweep.ValueSample(**found | lists | {"worst": worst, "sums": tuple((a, b) for a, b in found["sums"])})
