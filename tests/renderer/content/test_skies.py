"""Images of environments: painted, and read from files of Radiance and OpenEXR."""

from __future__ import annotations

import sys
from pathlib import Path
from types import ModuleType
from typing import Any, Self

import numpy as np
import pytest
from numpy.typing import NDArray

from renderer.content import load_scene
from renderer.content.skies import paint_sky, read_environment
from renderer.scene import Environment
from rhi import ValidationError


def encode(light: NDArray[Any]) -> NDArray[np.uint8]:
    """Encode light (h, w, 3) with a shared exponent (h, w, 4)."""
    mantissa, exponent = np.frexp(light.max(axis=2))
    scale = np.where(light.max(axis=2) > 0.0, mantissa * 256.0 / np.maximum(light.max(axis=2), 1e-300), 0.0)
    texels = np.zeros((*light.shape[:2], 4), np.uint8)
    texels[..., :3] = np.floor(light * scale[..., None])
    texels[..., 3] = np.where(light.max(axis=2) > 0.0, exponent + 128, 0)
    return texels


def encode_runs(row: NDArray[np.uint8]) -> bytes:
    """Encode a row (w, 4) channel by channel: equal neighbours as runs, others one by one."""
    parts = [b"\x02\x02", len(row).to_bytes(2, "big")]
    for channel in row.T.tolist():
        at = 0
        while at < len(channel):
            end = at
            while end < len(channel) and end - at < 127 and channel[end] == channel[at]:
                end += 1
            single = end - at == 1
            parts.append(bytes([1, channel[at]]) if single else bytes([128 + end - at, channel[at]]))
            at = end
    return b"".join(parts)


def write_radiance(path: Path, light: NDArray[Any], *, has_runs: bool, header: bytes = b"") -> Path:
    texels = encode(light)
    height, width = light.shape[:2]
    data = b"".join(map(encode_runs, texels)) if has_runs else texels.tobytes()
    path.write_bytes(
        b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n" + header + b"\n-Y %d +X %d\n" % (height, width) + data
    )
    return path


@pytest.mark.parametrize("has_runs", [False, True])
@pytest.mark.parametrize("size", [(3, 9), (5, 200), (2, 4)])
def test_files_of_radiance_have_their_light(tmp_path: Path, has_runs: bool, size: tuple[int, int]) -> None:
    if has_runs and size[1] < 8:
        pytest.skip("short rows have no runs")
    rng = np.random.default_rng(7)
    light = 10.0 ** rng.uniform(-4.0, 5.0, (*size, 1)) * rng.uniform(0.01, 1.0, (*size, 3))
    light[0, 0] = 0.0
    light[1, 1:4] = (1e5, 2e4, 0.0)
    image = read_environment(write_radiance(tmp_path / "sky.hdr", light, has_runs=has_runs))
    assert image.dtype == np.float32
    assert np.abs(image - light).max(axis=2) == pytest.approx(0.0, abs=1e9)  # of the same shape
    assert (np.abs(image - light) <= light.max(axis=2, keepdims=True) / 128.0).all()
    assert (image[0, 0] == 0.0).all()
    Environment(image)


def test_the_exposure_is_taken_back(tmp_path: Path) -> None:
    light = np.full((2, 8, 3), 3.0)
    plain = read_environment(write_radiance(tmp_path / "a.hdr", light, has_runs=True))
    exposed = read_environment(
        write_radiance(tmp_path / "b.hdr", light, has_runs=True, header=b"EXPOSURE=2.0\nEXPOSURE=4\n")
    )
    assert exposed == pytest.approx(plain / 8.0)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "begin with"),
        (b"P6\n2 2\n255\n", "begin with"),
        (b"#?RADIANCE\n\n", "rows are"),
        (b"#?RADIANCE\n\n+X 2 -Y 2\n" + bytes(16), "rows are"),
        (b"#?RADIANCE\n\n-Y 2 +X 2\n" + bytes(15), "buffer"),
        (b"#?RADIANCE\n\n-Y 0 +X 2\n", "texels"),
        (b"#?RADIANCE\n\n-Y 99999 +X 99999\n", "texels"),
        (b"#?RADIANCE\nEXPOSURE=0\n\n-Y 2 +X 2\n" + bytes(16), "exposure"),
        (b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 2 +X 2\n" + bytes(16), "XYZ"),
        (b"#?RADIANCE\n\n-Y 1 +X 8\n\x02\x02\x00\x09" + bytes(40), "another width"),
        (b"#?RADIANCE\n\n-Y 1 +X 8\n\x02\x02\x00\x08\xff\x01", "longer"),
        (b"#?RADIANCE\n\n-Y 1 +X 8\n\x02\x02\x00\x08", "range"),
        (b"#?RADIANCE\n\n-Y 1 +X 2\n" + b"\x01\x01\x01\x04" * 2, "old kind"),
    ],
)
def test_files_that_arent_whole_are_refused(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "sky.hdr"
    path.write_bytes(content)
    with pytest.raises(ValidationError, match=f"(?s)scene-environment-file.*{message}|{message}"):
        read_environment(path)


@pytest.mark.parametrize("name", ["sky.png", "sky", "missing.hdr"])
def test_other_files_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ValidationError, match="scene-environment-file"):
        read_environment(tmp_path / name)


def test_open_exr_is_named_where_it_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sky.exr").write_bytes(b"v/1\x01")
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    with pytest.raises(ValidationError, match=r"rhi\[environments\]"):
        read_environment(tmp_path / "sky.exr")


@pytest.mark.parametrize("name", ["RGB", "RGBA", "Y"])
def test_files_of_open_exr_have_their_channels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """With a module in place of the package, which has what is called."""
    pixels = np.arange(2 * 4 * len(name), dtype=np.float16).reshape(2, 4, len(name))

    class Channel:
        def __init__(self) -> None:
            self.pixels = pixels

    class File:
        def __init__(self, path: str) -> None:
            assert path.endswith("sky.exr")

        def __enter__(self) -> Self:
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def channels(self) -> dict[str, Channel]:
            return {name: Channel()}

    module = ModuleType("OpenEXR")
    module.File = File  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "OpenEXR", module)
    (tmp_path / "sky.exr").write_bytes(b"v/1\x01")
    if name == "Y":
        with pytest.raises(ValidationError, match="channels Y"):
            read_environment(tmp_path / "sky.exr")
        return
    assert np.array_equal(read_environment(tmp_path / "sky.exr"), pixels[..., :3].astype(np.float32))


def test_a_painted_sky_is_brightest_around_its_sun_and_has_a_ground() -> None:
    sky = paint_sky((0.0, 1.0, 0.0), 64)
    assert sky.dtype == np.float32
    assert np.unravel_index(sky.max(axis=2).argmax(), (64, 128))[0] == 0
    assert sky[-1].mean() < 0.5 * sky[20].mean()


@pytest.mark.parametrize("text", ["yard:columns=1,lights=0", "city:blocks=2,detail=2"])
def test_scene_text_puts_a_sky_around_scenes(text: str) -> None:
    plain, lit = load_scene(text), load_scene(f"{text},environment=0.5")
    assert plain.environment is None
    assert lit.environment is not None
    assert lit.environment.intensity == 0.5
    assert lit.name.endswith(",environment=0.5")
