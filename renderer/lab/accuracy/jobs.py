"""Sweeps as jobs: they run on any executor, and a sweep that was interrupted continues where it stopped.

A job is a shard of one quality setting's sweep. Its result is a file, named by a hash of all that it depends
on: the setup, the quality setting as it is declared, the shard, and the scene's file if it is one. A file is
complete or isn't there: it is written under another name, and then renamed. So a sweep that was interrupted
continues where it stopped, and after a change of one quality setting only that one is measured again.

The longest jobs start first, so that no process waits long for another at the end.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import asdict, dataclass, replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any, Final

import rhi
from renderer.lab.accuracy import sweep
from renderer.lab.accuracy.choice import ParetoPoint, combine, compute_pareto_front, make_plain
from renderer.lab.accuracy.quality_settings import QUALITY_SETTINGS, ErrorUnit, Requirement
from renderer.settings import to_json
from rhi_screen.executors import as_completed

_VERSION: Final = 7
"""Part of each job's hash. Raise it with any change of what is measured or stored."""


_FLOAT64_FRAMES: Final = 12
"""The time of an image in float64, in frames."""
_TRACED_FRAMES: Final = 200
"""The time of a ray-traced image, in frames."""
_MAPS: Final = 2
"""The factor by which shadow maps lengthen frames."""


@dataclass(frozen=True, slots=True)
class SweepJob:
    """A shard of the sweep of a quality setting."""

    setup: sweep.SweepSetup
    setting: str
    shard: sweep.SweepShard = sweep.WHOLE_SWEEP

    @property
    def key(self) -> str:
        """A hash of all that the result depends on, except machines."""
        scene = Path(self.setup.scene)
        content = sha256(scene.read_bytes()).hexdigest() if scene.is_file() else ""
        setting = QUALITY_SETTINGS[self.setting]
        measured = (
            setting.path,
            setting.values,
            setting.unit,
            setting.reference,
            setting.base_settings,
            setting.requirement,
            setting.history_frames,
            setting.option,
        )
        shard = self.shard.number, self.shard.count
        setup = replace(self.setup, flicker_weight=0.0)  # it weighs results, and measures nothing
        parts = [_VERSION, rhi.__version__, to_json(setup), content, self.setting, shard, repr(measured)]
        return _hash(parts)

    @property
    def effort(self) -> float:
        """About how many frames the job draws. Orders jobs; it doesn't predict their time."""
        setting, setup = QUALITY_SETTINGS[self.setting], self.setup
        if setting.is_encoding:
            return float(len(setting.values))
        views, rounds = (len(self.shard.take(range(count))) for count in (setup.views, setup.rounds))
        frames = len(setting.values) * (setting.history_frames + views + 1 + rounds)
        reference_frames = views * (
            setting.reference.scale**2
            + _FLOAT64_FRAMES * (setting.reference.is_float64 or setting.unit is ErrorUnit.LIGHTS)
        )
        reference_frames = views * _TRACED_FRAMES if setting.reference.rays else reference_frames
        return (frames + reference_frames) * (_MAPS if setting.requirement is Requirement.SHADOWS else 1.0)

    def run(self) -> sweep.SettingSample:
        """Measure the shard."""
        return sweep.sweep_shard(self.setup, self.setting, self.shard)


def list_jobs(setup: sweep.SweepSetup, quality_settings: Iterable[str]) -> list[SweepJob]:
    """The jobs of the sweeps of quality settings."""
    return [
        SweepJob(setup, name, shard) for name in quality_settings for shard in sweep.list_shards(setup, name)
    ]


def order_jobs(jobs: Iterable[SweepJob]) -> list[SweepJob]:
    """The jobs in the order of their start, longest first."""
    return sorted(jobs, key=lambda job: -job.effort)


def run_jobs(
    jobs: Sequence[SweepJob],
    executor: Executor,
    folder: Path | None,
    progress: Callable[[Iterable[Any], int], Iterable[Any]] = lambda items, total: items,
) -> list[sweep.SettingReport]:
    """Run jobs, as many at a time as the executor allows, and return the report of each quality setting, in
    the order of their first jobs.

    If a job fails, the others are finished and stored before its error is raised.

    Args:
        folder: stores results, and is read for earlier ones; None stores nothing.
        progress: wraps an iterable, given its length: the jobs of a serial executor, the results of others.
    """
    stored = {} if folder is None else {job: load_sample(folder / f"{job.key}.json") for job in jobs}
    left = [job for job in order_jobs(jobs) if stored.get(job) is None]
    futures: dict[SweepJob, Future[sweep.SettingSample]] = {}
    for job in progress(left, len(left)):
        futures[job] = executor.submit(SweepJob.run, job)
        if folder is not None:
            futures[job].add_done_callback(partial(_save_result, folder / f"{job.key}.json"))
    for _ in progress(as_completed(executor, futures.values()), len(left)):
        pass
    samples_by_setting: dict[str, list[sweep.SettingSample]] = {}
    for job in jobs:
        samples_by_setting.setdefault(job.setting, []).append(stored.get(job) or futures[job].result())
    return [sweep.join_shards(samples) for samples in samples_by_setting.values()]


def load_or_compute_pareto_front(
    setup: sweep.SweepSetup,
    reports: Sequence[sweep.SettingReport],
    folder: Path | None,
    progress: Callable[[range], Iterable[int]] = lambda rounds: rounds,
    values_in_use: Mapping[str, str] | None = None,
) -> list[ParetoPoint]:
    """The Pareto front (`compute_pareto_front`); read from the folder if it was computed from the same
    reports. A stored front without `values_in_use` is read, too, if it has a point with these values: so a
    second choice looks at the same points as the first."""
    if folder is None:
        return compute_pareto_front(setup, reports, progress, values_in_use=values_in_use)
    in_use = dict(values_in_use or {})
    measured = [_VERSION, to_json(setup), [asdict(report) for report in reports]]
    path, first_path = (folder / f"pareto-front-{_hash([*measured, values])}.json" for values in (in_use, {}))
    points = _load_front(path, setup)
    if points is None and in_use:
        first_points = _load_front(first_path, setup) or []
        points = first_points if any(point.values == in_use for point in first_points) else None
    if points is None:
        points = compute_pareto_front(setup, reports, progress, values_in_use=values_in_use)
        _write_whole(path, json.dumps([asdict(point) | {"settings": None} for point in points]))
    return points


def _load_front(path: Path, setup: sweep.SweepSetup) -> list[ParetoPoint] | None:
    """The points of a stored front; None if there is none, or it is damaged."""
    try:
        stored_points = json.loads(path.read_text(encoding="utf-8"))
        base = make_plain(setup.settings)
        return [
            ParetoPoint(**point | {"settings": combine(base, point["values"])}) for point in stored_points
        ]
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _hash(parts: object) -> str:
    return sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()[:24]


def _write_whole(path: Path, text: str) -> None:
    """Write a file completely or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_suffix(f".{os.getpid()}.part")
    beside.write_text(text, encoding="utf-8")
    beside.replace(path)


def _save_result(path: Path, future: Future[sweep.SettingSample]) -> None:
    """Store the result of a job as soon as it is finished: the process may end before the others are."""
    if not future.cancelled() and future.exception() is None:
        save_sample(path, future.result())


def save_sample(path: Path, sample: sweep.SettingSample) -> None:
    """Write the result of a job."""
    _write_whole(path, json.dumps(asdict(sample)))


def load_sample(path: Path) -> sweep.SettingSample | None:
    """Read the result of a job; None if there is no file or a damaged one, so that it is measured again."""
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        values = {value: _read_sample(value_sample) for value, value_sample in stored["values"].items()}
        return sweep.SettingSample(
            **stored | {"values": values, "reference_ratios": tuple(stored["reference_ratios"])}
        )
    except (OSError, ValueError, TypeError, KeyError):
        return None


def _read_sample(stored: dict[str, Any]) -> sweep.ValueSample:
    lists = {name: tuple(stored[name]) for name in ("seconds", "processor_seconds", "flips", "differences")}
    worst = None if stored["worst"] is None else tuple(stored["worst"])
    return sweep.ValueSample(
        **stored | lists | {"worst": worst, "sums": tuple((a, b) for a, b in stored["sums"])}
    )
