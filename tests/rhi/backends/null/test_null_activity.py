"""Timelines as text, as plots and as traces."""

import json
import sys

import pytest

import rhi
from rhi.backends.null import Activity, ActivityTimeline, FrameActivity, Lane, Span
from rhi.backends.null.simulation.activity import ActivityLog


@pytest.fixture
def timeline():
    log = ActivityLog()
    log.add_stall(400, 800, "wait(1)")
    log.add_idle(Activity.STARVED, 0, 200)
    log.add_idle(Activity.HALTED, 500, 600, "counter")
    log.begin_label(200, "frame")
    log.begin_label(300, "shadows")
    log.end_label(400)
    log.end_label(800)
    log.present(350)
    log.done.append(800)
    log.present(900)
    return log.timeline(1000, 800)


def test_the_time_between_stalls_is_busy(timeline):
    spans = [(span.activity, span.start, span.end) for span in timeline.lane(Lane.CPU)]
    assert spans == [(Activity.BUSY, 0, 400), (Activity.STALLED, 400, 800), (Activity.BUSY, 800, 1000)]
    assert timeline.total(Lane.GPU, Activity.BUSY) == 300 + 200
    assert timeline.total(Lane.GPU, Activity.STARVED) == 200 + 200
    assert timeline.total(Lane.GPU, Activity.STARVED, 100, 900) == 100 + 100


def test_frames_know_when_they_were_done(timeline):
    assert timeline.frames == (FrameActivity(0, 350, 800, 1), FrameActivity(350, 900, None, 1))
    assert [frame.latency for frame in timeline.frames] == [800, None]


def test_labels_come_in_the_order_in_which_they_begin(timeline):
    assert [(label.name, label.start, label.end) for label in timeline.labels] == [
        ("frame", 200, 800),
        ("shadows", 300, 400),
    ]


def test_text_shows_each_lane_as_a_bar_and_each_frame_as_a_row(timeline):
    lines = timeline.format(10).splitlines()
    assert lines[1].startswith("CPU ████░░░░██  █ busy 0.600 µs, ░ stalled 0.400 µs")
    assert lines[2].startswith("GPU ··███▒██··  █ busy 0.500 µs, · starved 0.400 µs, ▒ halted 0.100 µs")
    assert lines[4].split() == ["0", *"0.350 0.000 0.150 0.200 0.800".replace(" ", " µs ").split(), "µs", "1"]
    assert lines[5].split()[-3:] == ["not", "done", "1"]
    assert str(timeline) == timeline.format()


def test_an_empty_timeline_prints():
    assert "busy 0.000" in str(ActivityLog().timeline(0, 0))


def test_the_chart_has_each_span_in_its_color(timeline, tmp_path):
    figure = timeline.plot(tmp_path / "timeline.png")
    (axes,) = figure.axes
    cpu, gpu, *labels = axes.collections[:4]
    assert len(cpu.get_paths()) == 3
    assert len(gpu.get_paths()) == 5
    assert len(labels) == 2
    assert [label.get_text() for label in axes.get_yticklabels()] == ["CPU", "GPU"]
    assert (tmp_path / "timeline.png").read_bytes().startswith(b"\x89PNG")


def test_a_chart_without_matplotlib_is_refused_by_name(timeline, monkeypatch):
    timeline.plot()
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(rhi.DeviceError) as error:
        timeline.plot()
    assert error.value.rule.id == "plot-library"
    assert "rhi[renderer]" in str(error.value)


def test_the_trace_has_a_slice_for_each_span_in_microseconds(timeline, tmp_path):
    timeline.save(tmp_path / "trace.json")
    events = json.loads((tmp_path / "trace.json").read_text(encoding="utf-8"))["traceEvents"]
    names = {event["tid"]: event["args"]["name"] for event in events if event["ph"] == "M"}
    slices = [event for event in events if event["ph"] == "X"]
    assert len(slices) == len(timeline.spans) + len(timeline.labels)
    (stall,) = [event for event in slices if event["name"] == "stalled: wait(1)"]
    assert (names[stall["tid"]], stall["ts"], stall["dur"]) == ("CPU", 0.4, 0.4)
    (shadows,) = [event for event in slices if event["name"] == "shadows"]
    assert (names[shadows["tid"]], shadows["ts"], shadows["dur"]) == ("GPU labels", 0.3, 0.1)


def test_a_timeline_is_a_value(timeline):
    twin = ActivityTimeline(timeline.spans, timeline.labels, timeline.frames, timeline.end)
    assert twin == timeline
    assert Span(Lane.CPU, Activity.BUSY, 1, 4).nanoseconds == 3
