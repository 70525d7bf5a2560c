"""Files that were moved are found by their content: in their folder, where they were seen, and nowhere
else."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import rhi
from renderer.cli import main
from renderer.content import ModelLimits, load_model, load_scene, save_scene

TRIANGLE = "mtllib paint.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of models with what they use, each of which was loaded once."""
    monkeypatch.setenv("RHI_CACHE", str(tmp_path / "cache"))
    models = tmp_path / "models"
    models.mkdir()
    save_scene(load_scene("grid:count=4"), models / "grid.gltf")
    (models / "one.obj").write_text(TRIANGLE, encoding="utf-8")
    (models / "paint.mtl").write_text("newmtl red\nKd 1 0 0\n", encoding="utf-8")
    for name in ("grid.gltf", "one.obj"):
        load_model(models / name)
    return models


def describe(model: Path, limits: ModelLimits | None = None) -> tuple[object, ...]:
    scene = load_model(model, limits)
    return scene.triangle_count, len(scene.objects), scene.materials["base_color"].tolist()


@pytest.mark.parametrize(
    ("model", "moved", "directory"),
    [("grid.gltf", "grid.bin", "below"), ("one.obj", "one.obj", "."), ("one.obj", "paint.mtl", "below")],
)
def test_a_file_is_found_below_the_folder_that_it_was_in(
    folder: Path, model: str, moved: str, directory: str, caplog: pytest.LogCaptureFixture
) -> None:
    before = describe(folder / model)
    (folder / "below").mkdir()
    renamed = (folder / moved).rename(folder / directory / f"renamed{Path(moved).suffix}")
    assert describe(folder / model) == before
    assert [record.getMessage() for record in caplog.records] == [
        f"{folder / moved} isn't there; {renamed} has its content, and is read instead"
    ]


@pytest.mark.parametrize(("old", "is_found"), [(b"Kd 1 0 0", True), (b"Kd 0 1 0", False)])
def test_another_content_of_the_same_size_is_not_taken(folder: Path, old: bytes, is_found: bool) -> None:
    before = describe(folder / "one.obj")
    (folder / "paint.mtl").rename(folder / "other.mtl").write_bytes(b"newmtl red\n" + old + b"\n")
    assert (describe(folder / "one.obj") == before) is is_found


def test_a_model_that_was_never_loaded_is_missing_and_says_how_it_is_found(folder: Path) -> None:
    with pytest.raises(rhi.ValidationError, match=r"scene-missing-file(.|\n)*renderer assets FOLDER"):
        load_model(folder / "two.obj")


def test_a_folder_that_was_moved_is_found_once_it_was_listed(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = describe(folder / "grid.gltf")
    elsewhere = folder.rename(tmp_path / "elsewhere")
    with pytest.raises(rhi.ValidationError):
        load_model(folder / "grid.gltf")
    (elsewhere / "link.bin").symlink_to(elsewhere / "grid.bin")
    (elsewhere / "notes.txt").write_text("none of a model", encoding="utf-8")
    assert main(["assets", str(elsewhere), "--json"]) == 0
    assert describe(folder / "grid.gltf") == before
    names = [Path(row["path"]).name for row in json.loads(capsys.readouterr().out)]
    assert names == ["grid.bin", "grid.gltf", "one.obj", "paint.mtl"]
    assert main(["assets"]) == 0
    lines = capsys.readouterr().out.splitlines()
    for path in (f"{folder / 'grid.bin'} (not there)", f"{elsewhere / 'grid.bin'}"):
        assert any(line.endswith(f"1 users  {path}") for line in lines)


def test_a_file_outside_of_the_model_s_folder_is_read_only_with_the_limit_outside(
    folder: Path, tmp_path: Path
) -> None:
    before = describe(folder / "grid.gltf")
    (tmp_path / "away").mkdir()
    (folder / "grid.bin").rename(tmp_path / "away" / "grid.bin")
    (folder / "link.bin").symlink_to(tmp_path / "away" / "grid.bin")
    main(["assets", str(tmp_path / "away")])
    with pytest.raises(rhi.ValidationError, match=r"grid\.bin: No such file"):
        load_model(folder / "grid.gltf")
    assert describe(folder / "grid.gltf", ModelLimits(outside=True)) == before
