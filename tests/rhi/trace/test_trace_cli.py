"""`python -m rhi trace`."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from testing_kit import gl_works
from trace_kit import VERSION_1, edit_line, record_much

import rhi
from rhi.__main__ import main
from rhi.trace import load
from rhi.trace.cli import encode_png

requires_gl = pytest.mark.skipif(not gl_works(), reason="no GL device here")
FAULT = """
import rhi
from rhi import Op


def presents(trace):
    return len(trace.stream.filter(Op.PRESENT)) > 0
"""


def test_show_prints_the_commands(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["trace", "show", str(VERSION_1)]) == 0
    output = capsys.readouterr()
    assert output.out.strip("\n") == str(load(VERSION_1).stream)
    assert output.err == "87 commands, 6 draws, 0 failed, 0 refused; recorded on null\n"


def test_show_keeps_to_a_label_and_a_limit(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["trace", "show", str(VERSION_1), "--label", "sun", "--limit", "3"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert lines[-1].startswith("… and ")


@requires_gl
def test_replay_writes_the_last_presented_image(tmp_path: Path) -> None:
    output = tmp_path / "out.png"
    assert (
        main(["trace", "replay", str(VERSION_1), "--backend", "gl", "--trust", "--output", str(output)]) == 0
    )
    with rhi.create_device("gl") as device:
        expected = record_much(device).read()[:, :, :3]
    assert np.array_equal(np.asarray(Image.open(output)), expected)


def test_diff_says_by_its_exit_code_whether_they_differ(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["trace", "diff", str(VERSION_1), str(VERSION_1)]) == 0
    assert capsys.readouterr().out == "no differences\n"
    copy = tmp_path / "t.zip"
    copy.write_bytes(VERSION_1.read_bytes())
    changed = edit_line(copy, "draw", lambda line: line["arguments"].update(instances=7))
    assert main(["trace", "diff", str(VERSION_1), str(changed)]) == 1
    assert "instances: 1 → 7" in capsys.readouterr().out


def test_reduce_writes_a_trace_and_a_test(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fault = tmp_path / "fault.py"
    fault.write_text(FAULT, encoding="utf-8")
    small, test = tmp_path / "small.zip", tmp_path / "test_small.py"
    written = ["--output", str(small), "--test", str(test)]
    assert main(["trace", "reduce", str(VERSION_1), f"{fault}:presents", *written]) == 0
    assert len(load(small)) == 2
    assert "present(" in capsys.readouterr().out
    assert "from rhi import Op" in test.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "arguments",
    [
        ["show", "none.zip"],
        ["show", __file__],
        ["replay", str(VERSION_1), "--backend", "nul"],
        pytest.param(["replay", str(VERSION_1), "--backend", "gl"], marks=requires_gl),
        ["reduce", str(VERSION_1), "nothing"],
        ["reduce", str(VERSION_1), "nothing:presents"],
        ["reduce", str(VERSION_1), "math:presents"],
    ],
)
def test_an_error_of_the_trace_command_is_one_line(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["trace", *arguments]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: ")
    assert error.count("\n") == 1


def test_without_a_command_the_report_is_as_before(capsys: pytest.CaptureFixture[str]) -> None:
    main([])
    assert "rhi.create_device() would choose" in capsys.readouterr().out


@pytest.mark.parametrize("dtype", ["u1", "u2", "f4", "f2"])
@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_a_png_holds_the_texels(dtype: str, channels: int) -> None:
    values = np.arange(5 * 7 * channels).reshape(5, 7, channels) % 256
    scale = {"u1": 1, "u2": 257, "f4": 1 / 255, "f2": 1 / 255}[dtype]
    pixels = np.asarray(Image.open(io.BytesIO(encode_png((values * scale).astype(dtype)))))
    expected = values[:, :, 0] if channels < 3 else values[:, :, :3]
    assert np.abs(pixels.astype(int) - expected).max() <= (1 if dtype == "f2" else 0)


def test_a_png_of_texels_out_of_range_is_clamped() -> None:
    texels = np.array([[[-1.0], [np.nan], [2.0], [np.inf]]], np.float32)
    assert np.asarray(Image.open(io.BytesIO(encode_png(texels)))).tolist() == [[0, 0, 255, 255]]
