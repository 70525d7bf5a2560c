"""The dump of shader texts: it sees what changed, and the language writes the recorded texts (nightly)."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from rhi.shading import Shader, Storage, StorageRW, function, global_id

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "scripts"))

from dump_shaders import RECORDED_TEXTS, compare, definition_of, read_dump, texts_of, write_dump  # noqa: E402

BEFORE = {
    "kit.Same": {"definition": "aaaa", "vertex-glsl": "1111", "vertex-opencl16": "2222"},
    "kit.Other": {"definition": "bbbb", "vertex-glsl": "3333"},
}


def test_a_dump_is_read_as_it_was_written() -> None:
    assert read_dump(write_dump(BEFORE)) == BEFORE


def test_a_text_that_changed_though_its_shader_says_the_same_is_named() -> None:
    now = BEFORE | {"kit.Same": BEFORE["kit.Same"] | {"vertex-opencl16": "9999"}}
    assert compare(BEFORE, now) == (["kit.Same vertex-opencl16"], 4 + 1)
    assert compare(BEFORE, BEFORE) == ([], 4 + 1)


def test_a_language_that_a_shader_no_longer_has_is_named() -> None:
    now = BEFORE | {"kit.Same": {"definition": "aaaa", "vertex-glsl": "1111", "vertex-vulkan": "4444"}}
    assert compare(BEFORE, now)[0] == ["kit.Same vertex-opencl16", "kit.Same vertex-vulkan"]


def test_shaders_that_say_something_else_or_are_missing_are_compared_on_demand_only() -> None:
    now = {"kit.Other": {"definition": "cccc", "vertex-glsl": "5555"}}
    assert compare(BEFORE, now) == ([], 0)
    differ, _ = compare(BEFORE, now, everything=True)
    assert {"kit.Other vertex-glsl", "kit.Same vertex-glsl"} <= set(differ)


@function
def doubled(value: float) -> float:
    return value * 2.0


@function
def tripled(value: float) -> float:
    return value * FACTOR


FACTOR = 3.0


class Plain(Shader):
    inputs: Storage[float]
    outputs: StorageRW[float]
    scale = 1.0
    work_group = (64,)

    def compute(self) -> None:
        i = int(global_id().x)
        self.outputs[i] = self.scale * doubled(self.inputs[i])


class ScalingShader(Plain):
    scale = 2.0


class Tripled(Plain):
    def compute(self) -> None:
        i = int(global_id().x)
        self.outputs[i] = self.scale * tripled(self.inputs[i])


class Refused(Plain):
    def compute(self) -> None:
        self.outputs[0] = self.missing  # type: ignore[attr-defined]


class Checked(Plain):
    checked = True


def test_the_definition_of_a_shader_includes_its_numbers_functions_and_constants(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    definition = [definition_of(shader) for shader in (Plain, ScalingShader, Tripled)]
    assert len(set(definition)) == 3
    monkeypatch.setitem(globals(), "FACTOR", 4.0)
    assert [
        definition_of(shader) == before
        for shader, before in zip((Plain, ScalingShader, Tripled), definition, strict=True)
    ] == [
        True,
        True,
        False,
    ]


def test_a_refusal_is_a_text_and_origins_are_added_on_demand() -> None:
    assert list(texts_of(Refused, origins=False)) == ["refused"]
    plain, lines = (texts_of(Plain, origins=origins)["compute-glsl"] for origins in (False, True))
    assert "void main()" in plain
    assert "test_shader_texts.py" not in plain
    assert re.search(r"^tests/test_shader_texts.py:\d+$", lines, re.MULTILINE)


def test_a_text_that_names_its_file_is_the_same_wherever_the_tree_lies() -> None:
    text = texts_of(Checked, origins=False)["compute-numpy"]
    assert "tests/test_shader_texts.py" in text
    assert str(ROOT) not in text


@pytest.mark.nightly
def test_the_language_writes_the_recorded_texts() -> None:
    run = subprocess.run(
        [sys.executable, ROOT / "scripts" / "dump_shaders.py", "--compare", RECORDED_TEXTS],
        capture_output=True,
        text=True,
        check=False,
        encoding="utf-8",
    )
    again = "python scripts/dump_shaders.py -o tests/shader_texts.txt"
    assert run.returncode == 0, (
        f"these texts changed; if they are meant to, `{again}`:\n{run.stdout}\n{run.stderr}"
    )
    (compared,) = re.findall(r"^(\d+) compared", run.stderr, re.MULTILINE)
    recorded = sum(len(row) for row in read_dump(RECORDED_TEXTS.read_text(encoding="utf-8")).values())
    assert int(compared) > recorded / 2, f"most shaders say something else than the record: `{again}`"
