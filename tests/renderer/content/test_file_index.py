"""Files that were moved are found by their content: in their folder, where they were seen, and nowhere else."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import rhi
from renderer.cli import main
from renderer.content import ModelLimits, file_index, load_model, load_scene, save_scene
from renderer.content.assets import hash_content
from renderer.content.file_index import FileIndex
from renderer.scene import Scene

TRIANGLE = "mtllib paint.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of models with what they use, each of which was loaded once."""
    monkeypatch.setenv("RHI_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(file_index, "find_cache", rhi.find_cache)
    made = tmp_path / "models"
    made.mkdir()
    save_scene(load_scene("grid:count=4"), made / "grid.gltf")
    document = json.loads((made / "grid.gltf").read_text())
    document |= {"images": [{"uri": "orange.png"}], "textures": [{"source": 0}]}
    for material in document["materials"]:
        material["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    (made / "grid.gltf").write_text(json.dumps(document))
    Image.new("RGB", (4, 4), (255, 128, 0)).save(made / "orange.png")
    (made / "one.obj").write_text(TRIANGLE)
    (made / "paint.mtl").write_text("newmtl red\nKd 1 0 0\n")
    for name in ("grid.gltf", "one.obj"):
        load_model(made / name)
    return made


def describe(scene: Scene) -> tuple[object, ...]:
    colors = [image[0, 0].tolist() for image in scene.images]
    return scene.triangle_count, len(scene.objects), colors, scene.materials["base_color"].tolist()


@pytest.mark.parametrize(
    ("model", "moved"),
    [(name, used) for name, more in (("grid.gltf", ("grid.bin", "orange.png")), ("one.obj", ("paint.mtl",)))
     for used in (name, *more)],
)  # fmt: skip
def test_a_file_is_found_below_the_folder_that_it_was_in(
    folder: Path, model: str, moved: str, caplog: pytest.LogCaptureFixture
) -> None:
    before = describe(load_model(folder / model))
    place = folder if model == moved else folder / "below"  # a model's own folder has what it names
    place.mkdir(exist_ok=True)
    found = (folder / moved).rename(place / f"renamed{Path(moved).suffix}")
    assert describe(load_model(folder / model)) == before
    assert [record.getMessage() for record in caplog.records] == [
        f"{folder / moved} isn't there; {found} has its content, and is read instead"
    ]
    content = bytearray(found.read_bytes())
    content[-1] ^= 1
    found.write_bytes(content)
    caplog.clear()
    after = describe(load_model(folder / model)) if moved in ("orange.png", "paint.mtl") else None
    if after is None:
        with pytest.raises(rhi.ValidationError, match=r"scene-(missing-file|unreadable-model)"):
            load_model(folder / model)
    assert after != before, "another content of the same size isn't taken"
    assert not caplog.records


def test_a_model_that_was_never_loaded_is_missing_and_says_how_it_is_found(folder: Path) -> None:
    shutil.copy(folder / "one.obj", folder / "two.obj")
    (folder / "two.obj").rename(folder / "three.obj")
    with pytest.raises(rhi.ValidationError, match=r"renderer assets FOLDER") as error:
        load_model(folder / "two.obj")
    assert error.value.rule.id == "scene-missing-file"


def test_a_folder_that_was_moved_is_found_once_it_was_listed(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = describe(load_model(folder / "grid.gltf"))
    folder.rename(tmp_path / "elsewhere")
    with pytest.raises(rhi.ValidationError):
        load_model(folder / "grid.gltf")
    (tmp_path / "elsewhere" / "link.png").symlink_to(tmp_path / "elsewhere" / "orange.png")
    assert main(["assets", str(tmp_path / "elsewhere"), "--json"]) == 0
    assert describe(load_model(folder / "grid.gltf")) == before
    rows = {Path(row["path"]).name: row for row in json.loads(capsys.readouterr().out)}
    assert {name: row["kind"] for name, row in rows.items()} == {
        "grid.bin": "buffer", "grid.gltf": "model", "one.obj": "model", "orange.png": "image",
    }  # fmt: skip
    assert main(["assets"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(str(folder / "grid.bin (not there)") in line and "1 users" in line for line in lines)
    assert any(line.endswith(str(tmp_path / "elsewhere" / "grid.bin")) and "1 users" in line for line in lines)


@pytest.mark.parametrize("is_allowed", [False, True])
def test_what_a_model_names_is_read_outside_only_if_that_may_be(folder: Path, tmp_path: Path, is_allowed: bool) -> None:
    (tmp_path / "away").mkdir()
    (folder / "grid.bin").rename(tmp_path / "away" / "grid.bin")
    (folder / "link.bin").symlink_to(tmp_path / "away" / "grid.bin")
    main(["assets", str(tmp_path / "away")])
    limits = ModelLimits(outside=is_allowed)
    if is_allowed:
        assert len(load_model(folder / "grid.gltf", limits).objects) == 4
    else:
        with pytest.raises(rhi.ValidationError, match=r"grid\.bin: No such file"):
            load_model(folder / "grid.gltf", limits)


def test_a_file_that_has_not_changed_is_not_hashed_again(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hashed: list[int] = []

    def note_hash(content: bytes) -> bytes:
        hashed.append(len(content))
        return hash_content(content)

    monkeypatch.setattr(file_index, "hash_content", note_hash)
    load_model(folder / "one.obj")
    assert hashed == []
    (folder / "one.obj").write_text(f"{TRIANGLE}# more\n")
    load_model(folder / "one.obj")
    assert hashed == [len(TRIANGLE) + 7]


def test_the_files_that_were_used_last_are_remembered(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    load_model(folder / "grid.gltf")
    for most, names in (
        (4, ["paint.mtl", "grid.gltf", "grid.bin", "orange.png"]),
        (3, ["grid.gltf", "grid.bin", "orange.png"]),
    ):
        monkeypatch.setattr(file_index, "MOST", most)
        FileIndex().save()
        assert sorted(Path(path).name for path in FileIndex().records) == sorted(names)


@pytest.mark.parametrize("text", ["", "[", "[1]", "{}", '[{"path": 3}]'])
def test_a_damaged_index_knows_nothing(folder: Path, tmp_path: Path, text: str) -> None:
    path = tmp_path / "cache" / "files" / "index.json"
    assert len(FileIndex().records) == 5
    path.write_text(text)
    assert FileIndex().records == {}
    assert np.isfinite(load_model(folder / "one.obj").bounds).all()
    assert len(FileIndex().records) == 2
