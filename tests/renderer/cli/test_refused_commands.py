"""Bad input of any command is one line, exit code 2, nothing on stdout, and no file."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from renderer.cli import main

CITY = "city:blocks=4"
TUNE = f"tune {CITY},detail=2 --size 64x36 --frames 3 --b 1:8 --n 2"
COMPARE = f"compare visibility {CITY},detail=2 --size 64x36 --frames 3 --backend null"
DEBUG = "debug visibility city:blocks=2,detail=2 --size 16x16"
LIGHTS = "compare light-culling hall:columns=6,rows=2,flags=0,detail=3 --backend gl --size 32x32"
LACKING = dict.fromkeys(("stop_and_wait", "chc", "chc_plus_plus", "conditional"), "draws that run") | {
    "two_pass": "compute shaders and draws that run (allowed: one of none, frustum,"
}
CANNOT = "the device can't run this visibility algorithm"
LACKS = {name: f"{CANNOT}: {name!r} on a null device, which lacks {what}" for name, what in LACKING.items()}
"""Messages about algorithms for which a device that draws nothing lacks something."""

REFUSED = {
    "render ctiy": "did you mean 'city'",
    "render city:block=3": "scene-unknown-key",
    "render city:blocks=0": "scene-bad-value",
    "render missing.glb": "scene-missing-file",
    "render nan.obj --backend null": "scene-bad-vertices",
    "render inf.obj --backend null": "scene-bad-vertices",
    "render empty.ply --backend null": "scene-empty-model",
    f"render {CITY} --backend vulkan": "device-unknown",
    f"render {CITY} --camera nowhere": "camera-unknown-name",
    f"render {CITY} --camera -1,nan,2": "camera-unknown-name",
    f"render {CITY} --camera sky --frame 1800": "camera-frame-range",
    f"render {CITY} --camera sky --frame 1799 --frames 2": "camera-frame-range",
    f"render {CITY} --frame -1": "--frame",
    f"render {CITY} --frames 0": "--frames",
    **{f"render {CITY} --size {size}": "--size" for size in ("0x10", "10x0", "10", "-10x10", "axb")},
    f"render {CITY} --size 1000000x10 --backend null": "texture-size",
    f"render {CITY} --technique magic": "--technique",
    f"render {CITY} --visibility magic": "--visibility",
    f"render {CITY} --depth sideways": "--depth",
    f"render {CITY} --output image.txt": "--output",
    f"render {CITY} --output file/image.png": "file",
    **{
        f"render {CITY} --stereo grey --eye-distance={far}": "is not a length" for far in ("-1", "nan", "far")
    },
    **{f"render {CITY} --visibility {name} --backend null": message for name, message in LACKS.items()},
    "render": "SCENE",
    "demo ctiy": "did you mean 'city'",
    "paint": "paint",
    "": "COMMAND",
    **{f"{COMPARE} --algorithms {name}": message for name, message in LACKS.items()},
    f"{COMPARE} --algorithms frustum,magic": "'magic' is not an algorithm",
    f"{COMPARE} --camera-path grund": "did you mean 'ground'",
    f"{COMPARE} --frame 1798": "camera-frame-range",
    **{
        f"{command} --plot chart.nothing": "--plot: 'chart.nothing'"
        for command in (
            COMPARE,
            "compare techniques grid",
            "compare encodings",
            "compare backends grid",
            "accuracy grid",
        )
    },
    f"render {CITY} --stereo grey --holes holes.nothing --backend null": "--holes: 'holes.nothing'",
    f"{COMPARE} --plot chart.bmp": "--plot: 'chart.bmp' is not the name of a chart",
    f"{TUNE} --b 0:5": "--b",
    f"{TUNE} --b 9:5": "--b",
    f"{TUNE} --n x": "--n",
    **{
        f"{TUNE} --executor {options}": "none of serial, processes"
        for options in ("magic", "processes:0", "dask:")
    },
    f"{TUNE} --camera-path grund": "did you mean 'ground'",
    f"{TUNE} --camera-path walk.json": "walk.json",
    f"{TUNE} --frame 1797": "camera-frame-range",
    f"{TUNE} --backend null": "answers no queries",
    f"{DEBUG} --backend null": "draws nothing",
    f"{DEBUG} --algorithm magic": "--algorithm",
    f"{DEBUG} --camera nowhere": "camera-unknown-name",
    f"{DEBUG} --frame 1800": "camera-frame-range",
    f"{DEBUG} --output culled.nothing": "has no known image extension",
    **{f"view city {options}": "need each other" for options in ("--live swept", "--budget-ms 30")},
    "view city --live swept --budget-ms 30": "swept/pareto_front.json",
    "compare backends city --passes dept": "'dept' is not a pass",
    "compare backends grid --backends gl --passes textured": "measure-no-images",
    "compare backends city:blocks=6 --backends null": "measure-no-rendering",
    "compare backends city:blocks=6 --backends vulkan": "vulkan",
    f"{LIGHTS} --lights 9999": "measure-too-few-lights",
    f"{LIGHTS} --tests plane": "'plane' is not a test",
    f"{LIGHTS} --lights 0": "not a whole number of 1 or more",
    "compare techniques city --lights 4 --backend null": "measure-fixed-scene",
    "compare techniques grid --techniques foward --backend null": "'foward'",
    "compare techniques grid:count=4 --objects 4 --backend null": "count twice",
    "compare techniques grid --objects 0 --backend null": "not a whole number",
    "compare encodings --backend null": "measure-no-shaders",
    "ray-trace city:blocks=1,bloom=0.1": "bloom can't be rendered by single rays",
    "ray-trace city:blocks=1 --bounces 17": "bounces=17: expected 0 to 16",
    "ray-trace city:blocks=1 --refraction-index 9": "refraction_index=9.0: expected 0.25 to 4",
    "ray-trace city:blocks=1 --refraction-index none": "'none' is not a number above 0",
    "effect-costs --rounds 0": "--rounds: '0' is not a whole number of 1 or more",
    "effect-costs --effect fire": "invalid choice: 'fire'",
    **{
        f"accuracy city --budget-ms {ms}": "is not a number above 0"
        for ms in ("0", "-1", "nan", "inf", "much")
    },
    "view nowhere": "scene",
    f"view {CITY} --camera nowhere": "camera-unknown-name",
    f"view {CITY} --script missing.txt": "No such file",
    f"view {CITY} --technique nothing": "invalid choice",
    f"view {CITY} --size 0x3": "is empty",
}


@pytest.mark.parametrize("command", REFUSED)
def test_bad_input_is_one_line(
    command: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("RHI_BACKEND", raising=False)
    for name in ("nan", "inf"):
        Path(f"{name}.obj").write_text(f"v {name} 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n", encoding="utf-8")
    Path("empty.ply").touch()
    Path("file").write_text("not a folder", encoding="utf-8")
    before = sorted(tmp_path.iterdir())
    with pytest.raises(SystemExit) as end:
        main(shlex.split(command))
    output = capsys.readouterr()
    assert (end.value.code, output.out, output.err.count("\n")) == (2, "", 1)
    assert output.err.startswith("error: ")
    assert REFUSED[command] in output.err
    assert sorted(tmp_path.iterdir()) == before
