"""`tune`: the pairs tried, the executors, and the files written."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from contextlib import chdir
from dataclasses import asdict
from math import log
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from command_reports import read_report
from hypothesis import given
from hypothesis import strategies as st
from nightly_reasons import CHEAPER_TEST
from PIL import Image

import rhi
from renderer.cli import main
from renderer.content import load_scene
from renderer.lab.accuracy.tuning import ParameterPair, PathFrames, Trial, search, select_best, try_pairs
from renderer.visibility import VisibilitySettings
from rhi_screen.executors import SerialExecutor, make_executor
from tests.renderer.conftest import open_device

COMMAND = ["tune", "city:blocks=4,detail=2", "--size", "64x36", "--frames", "3", "--b", "1:8", "--n", "2"]


class Valley:
    """Ratios with a single minimum in place of measurements; records the pairs requested."""

    def __init__(self, lowest: tuple[float, float]) -> None:
        self.lowest = lowest
        self.rounds: list[list[ParameterPair]] = []

    def try_all(self, pairs: list[ParameterPair]) -> list[Trial]:
        self.rounds.append(pairs)
        return [self.trial(*pair) for pair in pairs]

    def trial(self, batch: int, persistence: int) -> Trial:
        away = [log(value / low) ** 2 for value, low in zip((batch, persistence), self.lowest, strict=True)]
        return Trial(batch, persistence, 1.0, 1.0, 1.0 + sum(away), 0, 0, 0, 0)


ranges = st.tuples(st.integers(1, 200), st.integers(1, 200)).map(lambda ends: (min(ends), max(ends)))


@given(ranges, ranges, st.integers(1, 6))
def test_every_trial_is_within_the_ranges_and_runs_once(
    batches: ParameterPair, persistences: ParameterPair, rounds: int
) -> None:
    valley = Valley((30.0, 7.0))
    trials = list(search(batches, persistences, rounds, valley.try_all))
    pairs = [(trial.batch, trial.persistence) for trial in trials]
    assert len(set(pairs)) == len(pairs)
    assert all(batches[0] <= b <= batches[1] and persistences[0] <= n <= persistences[1] for b, n in pairs)
    assert {(b, n) for b in batches for n in persistences} <= set(pairs)  # the corners, always
    assert len(valley.rounds) == rounds


@pytest.mark.parametrize("lowest", [(1.0, 1.0), (7.0, 31.0), (33.0, 5.0), (100.0, 40.0), (64.0, 12.0)])
def test_the_search_reaches_the_minimum(lowest: tuple[float, float]) -> None:
    valley = Valley(lowest)
    trials = list(search((1, 100), (1, 40), 4, valley.try_all))
    best = select_best(trials, 1)[0]
    assert best.batch == pytest.approx(lowest[0], rel=0.2, abs=1)
    assert best.persistence == pytest.approx(lowest[1], rel=0.2, abs=1)
    assert len(trials) < 45  # of 4,000


def test_of_equal_times_fewer_queries_are_better() -> None:
    trials = [Trial(b, 1, 1.0, 1.0, 0.9, 0, 0, queries, 0) for b, queries in ((1, 50), (2, 20), (3, 30))]
    assert [trial.batch for trial in select_best(trials)] == [2, 3, 1]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def tuned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """A folder with the files that `tune` has written, and what it has printed."""
    folder = tmp_path_factory.mktemp("tuned")
    with open_device("gl"), chdir(folder):
        report = read_report(*COMMAND, "--backend", "gl", "--rounds", "2", "--output", "new/tuned", "--json")
    return folder / "new/tuned", report


def read_trials(folder: Path) -> list[dict[str, str]]:
    with (folder / "trials.csv").open() as file:
        return list(csv.DictReader(file))


def test_tune_writes_a_row_for_each_trial(tuned: tuple[Path, dict[str, Any]]) -> None:
    rows = read_trials(tuned[0])
    assert {int(row["batch"]) for row in rows} >= {1, 2, 4, 8}
    assert {int(row["persistence"]) for row in rows} == {2}
    assert all(float(row["ratio"]) > 0.0 and int(row["queries"]) > 0 for row in rows)


def test_tune_plots_its_trials(tuned: tuple[Path, dict[str, Any]]) -> None:
    assert np.asarray(Image.open(tuned[0] / "trials.png")).std() > 10


def test_tune_writes_the_best_of_its_finals(tuned: tuple[Path, dict[str, Any]]) -> None:
    folder, report = tuned
    assert report["visibility"]["batch"] == VisibilitySettings.load(folder / "settings.json").batch
    assert report["ratio"] <= 1.0
    assert {final["batch"] for final in report["finals"]} <= {
        int(row["batch"]) for row in read_trials(folder)
    }


def test_compare_reads_the_settings_that_tune_writes(
    tuned: tuple[Path, dict[str, Any]], capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["--frames", "1", "--algorithms", "chc_plus_plus"]
    assert main(["compare", "visibility", *share_settings(tuned[0]), *arguments]) == 0
    compared = json.loads(capsys.readouterr().out)
    assert compared["settings"] == asdict(VisibilitySettings())
    assert compared["optimized"] == tuned[1]["visibility"]
    assert [row["algorithm"] for row in compared["rows"]] == ["chc_plus_plus", "optimized_chc_plus_plus"]


def test_render_reads_the_settings_that_tune_writes(
    tuned: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    output = ["--output", str(tmp_path / "city.png")]
    assert main(["render", *share_settings(tuned[0]), "--visibility", "chc_plus_plus", *output]) == 0


def share_settings(folder: Path) -> list[str]:
    return [
        "city:blocks=4,detail=2",
        "--size",
        "64x36",
        "--settings",
        str(folder / "settings.json"),
        "--json",
    ]


@pytest.mark.usefixtures("gl")
def test_trials_go_along_a_walk_that_render_recorded(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record = ["--camera", "sky", "--frame", "700", "--frames", "5", "--record", "walks/one.json"]
    assert main(["render", COMMAND[1], "--backend", "null", "--size", "64x36", *record]) == 0
    walks: list[PathFrames] = []

    def try_none(path_frames: PathFrames, pairs: list[ParameterPair]) -> list[Trial]:
        walks.append(path_frames)
        return [Trial(*pair, 1.0, 1.0, 1.0, 0, 0, 0, 0) for pair in pairs]

    monkeypatch.setattr("renderer.cli.tune.try_pairs", try_none)
    assert main([*COMMAND, "--rounds", "1", "--camera-path", "walks/one.json"]) == 0
    sky = load_scene(COMMAND[1]).paths["sky"]
    for path_frames in walks:
        assert len(path_frames.path) == 4
        assert all(
            np.allclose(path_frames.path.camera(i).position, sky.camera(700 + i).position) for i in range(4)
        )
        assert all(
            np.allclose(path_frames.path.camera(i).rotation, sky.camera(700 + i).rotation) for i in range(4)
        )
    assert len(walks) == 5  # four pairs, and those that decide


@pytest.mark.nightly_cases("native", reason=CHEAPER_TEST)
@pytest.mark.usefixtures("gl")
@pytest.mark.parametrize("kind", ["native", pytest.param("emulated", marks=pytest.mark.nightly)])
def test_the_requested_kind_of_queries_is_tuned_rendered_and_saved(
    here: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    emulations: set[bool] = set()
    make_set = rhi.Device.query_set

    def note(device: rhi.Device, size: int, *, emulated: bool = False) -> rhi.QuerySet:
        emulations.add(emulated)
        return make_set(device, size, emulated=emulated)

    monkeypatch.setattr(rhi.Device, "query_set", note)
    expected = {kind == "emulated"}
    assert main([*COMMAND, "--backend", "gl", "--rounds", "1", "--queries", kind]) == 0
    assert emulations == expected
    assert VisibilitySettings.load(here / "tuned/settings.json").emulated is (kind == "emulated")
    shared = ["render", COMMAND[1], "--size", "64x36", "--backend", "gl", "--visibility", "chc_plus_plus"]
    for extra in (["--settings", "tuned/settings.json"], ["--queries", kind]):
        emulations.clear()
        assert main([*shared, *extra]) == 0
        assert emulations == expected
    emulations.clear()
    assert main([*shared, "--settings", "tuned/settings.json", "--queries", "native"]) == 0
    assert emulations == {False}  # the option counts more than the file


class Counter(SerialExecutor):
    """Keeps the functions of all calls submitted to its kind."""

    ran: ClassVar[list[object]] = []

    def submit(self, fn, /, *args, **kwargs):  # type: ignore[no-untyped-def]
        self.ran.append(fn)
        return super().submit(fn, *args, **kwargs)


@pytest.mark.nightly_cases(reason=CHEAPER_TEST)
@pytest.mark.usefixtures("gl")
def test_the_executor_runs_the_trials(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Counter.ran.clear()
    monkeypatch.setattr("rhi_screen.executors.SerialExecutor", Counter)
    assert main([*COMMAND, "--rounds", "1"]) == 0
    assert Counter.ran == [try_pairs] * 5  # four, and those that decide against each other


@pytest.mark.nightly
@pytest.mark.usefixtures("gl")
def test_processes_run_the_trials(here: Path) -> None:
    assert main([*COMMAND, "--rounds", "1", "--executor", "processes:2"]) == 0
    assert len((here / "tuned/trials.csv").read_text(encoding="utf-8").splitlines()) == 5


CLUSTER = """
import sys
from distributed import LocalCluster
from renderer.cli import main

with LocalCluster(
    n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None, protocol="tcp"
) as cluster:
    main([*sys.argv[1:], "--executor", f"dask:{cluster.scheduler_address}"])
    stories = [worker.state.log for worker in cluster.workers.values()]
done = [sum(event[1:3] == ("executing", "memory") for event in story) for story in stories]
print(f"{len(done)} workers, {sum(done)} tasks")
"""


@pytest.mark.nightly
@pytest.mark.usefixtures("gl")
def test_a_dask_cluster_of_two_workers_runs_the_trials(here: Path) -> None:
    """Runs in a process of its own, so that warnings of dask on a slow machine don't fail the test."""
    pytest.importorskip("distributed")
    command = [sys.executable, "-c", CLUSTER, *COMMAND, "--rounds", "1"]
    run = subprocess.run(command, cwd=here, capture_output=True, text=True, check=False, encoding="utf-8")
    assert run.returncode == 0, run.stderr
    assert run.stdout.splitlines()[-1] == "2 workers, 5 tasks"  # four trials, and the deciding one
    assert len((here / "tuned/trials.csv").read_text(encoding="utf-8").splitlines()) == 5


def test_without_dask_its_executor_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> None:
        raise ModuleNotFoundError(name)

    monkeypatch.setattr("rhi_screen.executors.import_module", missing)
    with pytest.raises(rhi.DeviceError, match=r"rhi\[dask\]"), make_executor("dask:tcp://nowhere:1"):
        pass


@pytest.mark.parametrize("executor", ["serial", pytest.param("processes:1", marks=pytest.mark.nightly)])
def test_a_trial_that_is_refused_says_why(
    here: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, executor: str
) -> None:
    # As on a machine of a cluster that can't do what this one can.
    monkeypatch.setattr("renderer.cli.tune.list_algorithms", lambda device: ["chc_plus_plus"])
    with pytest.raises(SystemExit):
        main([*COMMAND, "--backend", "null", "--rounds", "1", "--executor", executor])
    error = capsys.readouterr().err
    assert "null-samples" in error
    assert error.count("\n") == 1


@pytest.mark.usefixtures("gl")
def test_the_best_pair_is_tried_with_leaves_of_several_objects(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tried = []

    def try_none(
        path_frames: PathFrames, pairs: list[ParameterPair], threshold: int = 0, leaf_size: int = 1
    ) -> list[Trial]:
        tried.append(leaf_size)
        ratio = 0.5 if leaf_size == 4 else 0.9
        return [Trial(*pair, 1.0, 1.0, ratio, 0, 0, 0, 0, leaf_size) for pair in pairs]

    monkeypatch.setattr("renderer.cli.tune.try_pairs", try_none)
    assert main([*COMMAND, "--rounds", "1", "--leaf-size", "1:16"]) == 0
    assert [size for size in tried if size != 1] == [2, 4, 8, 16]
    (settings_path,) = here.glob("**/settings.json")
    assert VisibilitySettings.load(settings_path).leaf_size == 4
