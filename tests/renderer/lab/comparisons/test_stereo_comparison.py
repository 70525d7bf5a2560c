"""Comparing one eye with two: what is timed."""

from __future__ import annotations

from importlib import import_module
from itertools import count

import pytest

import rhi
from renderer.content import load_scene
from renderer.lab.comparisons.stereo_comparison import compare_stereo
from renderer.scene import StereoRig
from renderer.techniques import Forward


def test_reading_counters_is_not_timed(null: rhi.Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each look at a clock is a second later than the one before, and so is each look at the counters."""
    clock, scene = count(), load_scene("grid:count=4,lights=1")
    read = vars(rhi.Device)["statistics"].fget

    def read_slowly(device: rhi.Device) -> object:
        next(clock)
        return read(device)

    alternate = import_module("renderer.lab.measure.measurement")
    for name in ("perf_counter", "process_time"):
        monkeypatch.setattr(alternate, name, lambda: next(clock))
    monkeypatch.setattr(rhi.Device, "statistics", property(read_slowly))
    path, rig = next(iter(scene.paths.values())), StereoRig(0.06, 2.0)
    rows = compare_stereo(null, {False: scene}, path, rig, [(32, 18)], ["grey"], range(3), Forward)
    reads_of_a_frame = 2  # the renderer's own
    assert [row["milliseconds"] for row in rows] == [1000.0 * (1 + reads_of_a_frame)] * 2
