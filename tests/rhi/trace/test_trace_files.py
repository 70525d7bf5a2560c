"""Files that aren't whole traces, or were made to do harm, are refused by rule and never half-read."""

from __future__ import annotations

import io
import json
import os
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from trace_kit import VERSION_1, edit_line, record, rewrite

import rhi
from rhi.conformance.validation.refusal import refuses
from rhi.errors import Rule
from rhi.trace import load, rules, save


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return record(tmp_path / "t.zip")


def refused(path: Path, rule: Rule, **options: Any) -> str:
    with refuses(rule) as refusal:
        load(path, **options)
    return refusal.error.given


def header(change: Callable[[dict[str, Any]], None]) -> Callable[[dict[str, bytes]], None]:
    def edit(members: dict[str, bytes]) -> None:
        value = json.loads(members["trace.json"])
        change(value)
        members["trace.json"] = json.dumps(value).encode()

    return edit


# -- the file ------------------------------------------------------------------------------------------------


def test_a_missing_file_is_the_systems_error(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        load(tmp_path / "none.zip")


@pytest.mark.parametrize("data", [b"", b"text", b"PK\x05\x06" + bytes(3)])
def test_a_file_that_is_not_a_zip_is_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "t.zip"
    path.write_bytes(data)
    refused(path, rules.TRACE_FILE)


def test_a_file_cut_off_anywhere_is_refused(file: Path) -> None:
    data = file.read_bytes()
    for length in (10, len(data) // 2, len(data) - 1):
        file.write_bytes(data[:length])
        refused(file, rules.TRACE_FILE)
    file.write_bytes(data)
    load(file)


@settings(max_examples=150)
@given(position=st.floats(0, 1, exclude_max=True), value=st.integers(1, 255))
def test_a_flipped_byte_is_refused_or_harmless(tmp_path: Path, position: float, value: int) -> None:
    data = bytearray(VERSION_1.read_bytes())
    data[int(position * len(data))] ^= value
    path = tmp_path / "t.zip"
    path.write_bytes(data)
    try:
        trace = load(path)
    except rhi.ValidationError as error:
        if not error.rule.id.startswith("trace-"):
            raise
    else:
        assert str(trace.stream) == str(load(VERSION_1).stream)


@pytest.mark.parametrize("name", ["trace.json", "commands.jsonl"])
def test_a_missing_member_is_refused(file: Path, name: str) -> None:
    refused(rewrite(file, lambda members: members.pop(name) and None), rules.TRACE_FILE)


@pytest.mark.parametrize(
    "name",
    [
        "../evil.npy",
        "/etc/passwd",
        "arrays/../../x.npy",
        "arrays/01.npy",
        "arrays/0.npy/",
        "readme.txt",
        "arrays\\0.npy",
        "programs/1.vertex.GLSL",
        "programs/0.vertex.glsl",
        "C:evil.npy",
    ],
)
def test_other_names_are_refused(file: Path, name: str) -> None:
    def add(members: dict[str, bytes]) -> None:
        members[name] = b"x"

    # Python for Windows reads a backslash as a slash.
    expected = name if os.sep == "/" else name.replace("arrays\\0.npy", "arrays/0.npy twice")
    assert refused(rewrite(file, add), rules.TRACE_MEMBER) == expected


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_a_member_that_is_there_twice_is_refused(file: Path) -> None:
    with zipfile.ZipFile(file, "a") as archive:
        archive.writestr("arrays/0.npy", b"x")
    refused(file, rules.TRACE_MEMBER)


def test_a_bomb_is_refused_before_it_is_unpacked(file: Path) -> None:
    def add(members: dict[str, bytes]) -> None:
        members["arrays/9999.npy"] = bytes(200 << 20)

    bomb = rewrite(file, add)
    assert bomb.stat().st_size < 1 << 20
    refused(bomb, rules.TRACE_SIZE, max_bytes=100 << 20)


def test_the_size_allowed_is_a_sharp_bound(file: Path) -> None:
    with zipfile.ZipFile(file) as archive:
        size = sum(info.file_size for info in archive.infolist())
    load(file, max_bytes=size)
    refused(file, rules.TRACE_SIZE, max_bytes=size - 1)


def test_a_size_that_lies_is_refused(file: Path) -> None:
    data = bytearray(file.read_bytes())
    with zipfile.ZipFile(file) as archive:
        info = archive.getinfo("commands.jsonl")
    offset = data.index(b"commands.jsonl", data.index(b"PK\x01\x02")) - 46
    assert data[offset + 24 : offset + 28] == struct.pack("<I", info.file_size)
    data[offset + 24 : offset + 28] = struct.pack("<I", 100)
    file.write_bytes(data)
    refused(file, rules.TRACE_FILE)


def test_an_encrypted_member_is_refused(file: Path) -> None:
    data = bytearray(file.read_bytes())
    data[data.index(b"PK\x01\x02") + 8] |= 1
    file.write_bytes(data)
    refused(file, rules.TRACE_FILE)


def test_other_compressions_are_refused(file: Path) -> None:
    other = file.with_name("other.zip")
    with zipfile.ZipFile(file) as source, zipfile.ZipFile(other, "w", zipfile.ZIP_BZIP2) as target:
        for name in source.namelist():
            target.writestr(name, source.read(name))
    refused(other, rules.TRACE_FILE)


def test_a_save_that_fails_leaves_the_old_file(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = file.read_bytes()
    monkeypatch.setattr("rhi.trace.file.encode", lambda value: 1 / 0)
    with rhi.create_device("null") as device:
        device.buffer(4)
        with pytest.raises(ZeroDivisionError):
            save(device, file)
    assert file.read_bytes() == before
    assert list(file.parent.iterdir()) == [file]


# -- its header ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("version", [0, 3, "1", None, 1.0, True])
def test_another_version_is_refused(file: Path, version: object) -> None:
    refused(rewrite(file, header(lambda h: h.update(version=version))), rules.TRACE_VERSION)


@pytest.mark.parametrize(
    "change",
    [
        {"format": "zip"},
        {"commands": "87"},
        {"sites": 1},
        {"sites": [["a.py", "1", "f"]]},
        {"backend": None},
        {"sites": [["a.py", 1]]},
    ],
)
def test_a_wrong_header_is_refused(file: Path, change: dict[str, object]) -> None:
    refused(rewrite(file, header(lambda h: h.update(change))), rules.TRACE_FILE)


@pytest.mark.parametrize("text", [b"", b"[]", b"{", b"\xff", b"[" * 100_000])
def test_a_header_that_is_no_json_object_is_refused(file: Path, text: bytes) -> None:
    refused(rewrite(file, lambda members: members.update({"trace.json": text})), rules.TRACE_FILE)


@pytest.mark.parametrize("difference", [-1, 1])
def test_a_wrong_count_is_refused(file: Path, difference: int) -> None:
    refused(rewrite(file, header(lambda h: h.update(commands=h["commands"] + difference))), rules.TRACE_COUNT)


# -- its commands --------------------------------------------------------------------------------------------


def test_a_line_that_is_no_json_is_refused(file: Path) -> None:
    def cut(members: dict[str, bytes]) -> None:
        lines = members["commands.jsonl"].splitlines(keepends=True)
        members["commands.jsonl"] = b"".join([lines[0], b'{"op":\n', *lines[2:]])

    assert "line 2" in refused(rewrite(file, cut), rules.TRACE_FILE)


def argument(op: str, name: str, value: object) -> tuple[str, Callable[[dict[str, Any]], None]]:
    def change(line: dict[str, Any]) -> None:
        container = line["arguments"]
        *path, last = name.split(".")
        for part in path:
            container = container[int(part) if part.isdigit() else part]
        container[int(last) if last.isdigit() else last] = value

    return op, change


@pytest.mark.parametrize(
    ("op", "change"),
    [
        ("draw", lambda line: line.update(op="drew")),
        ("draw", lambda line: line.update(op=["draw"])),
        ("draw", lambda line: line.update(extra=1)),
        ("draw", lambda line: line.update(arguments=[])),
        ("draw", lambda line: line["arguments"].pop("count")),
        ("draw", lambda line: line["arguments"].update(more=1)),
        ("draw", lambda line: line.update(site=10_000)),
        ("draw", lambda line: line.update(site=-1)),
        ("draw", lambda line: line.update(failure="x")),
        argument("draw", "count", "3"),
        argument("draw", "count", True),
        argument("draw", "count", 3.5),
        argument("draw", "count", 1 << 64),
        argument("draw", "primitive", "TRIANGLE"),
        argument("draw", "primitive", "__class__"),
        argument("create_texture", "descriptor.format", "RGBA9"),
        argument("create_texture", "descriptor.size", [1]),
        argument("create_texture", "descriptor.size", [1, 2, 3]),
        argument("create_texture", "descriptor.colour", 1),
        argument("create_program", "descriptor.stages", ["VERTEX", "GEOMETRY"]),
        argument("create_program", "descriptor.emit", "x"),
        argument("set_states", "changes", [{"type": "CullMode", "value": "SIDE"}]),
        argument("set_states", "changes", [{"type": "int", "value": 1}]),
        argument("set_states", "changes", [{"type": "ColorWrite", "value": []}]),
        argument("set_states", "changes", [{"type": "Viewport", "value": {"x": "0"}}]),
        argument("set_states", "changes", [{"type": "Scissor", "value": {"width": -1}}]),
        argument("begin_pass", "descriptor", None),
    ],
)
def test_commands_that_are_not_of_the_contract_are_refused(
    file: Path, op: str, change: Callable[[dict[str, Any]], None]
) -> None:
    assert "line " in refused(edit_line(file, op, change), rules.TRACE_COMMAND)


@pytest.mark.parametrize(
    ("op", "change"),
    [
        argument("draw", "vertex_array", 99),
        argument("draw", "vertex_array", 1),
        argument("draw", "count", -1),
        argument("draw", "first", -3),
        argument("draw", "base_vertex", 1 << 60),
        argument("bind_program", "program", 3),
        argument("bind_uniform", "slot", -1),
        argument("bind_uniform", "offset", 8),
        argument("bind_uniform", "buffer", 7),
        argument("bind_texture", "sampler", 8),
        argument("write_buffer", "offset", 1 << 40),
        argument("write_buffer", "offset", -1),
        argument("copy_buffer", "size", 33),
        argument("create_texture", "descriptor.levels", 9),
        argument("create_texture", "descriptor.levels", 1 << 40),
        argument("create_texture", "descriptor.samples", 3),
        argument("create_texture", "descriptor.size", [0, 4]),
        argument("create_texture", "texture", 1),
        argument("create_buffer", "buffer", 0),
        argument("create_buffer", "descriptor.size", 0),
        argument("create_vertex_array", "descriptor.program", 7),
        argument("create_vertex_array", "descriptor.streams.0.buffer", 99),
        argument("begin_pass", "descriptor.depth.texture", 8),
        argument("begin_pass", "descriptor.depth.level", 1),
        argument("begin_pass", "descriptor.size", [8, 8]),
        argument("write_texture", "region.x", 1),
        argument("write_texture", "region.x", -1),
        argument("write_texture", "level", 3),
        argument("dispatch", "x", 0),
        argument("draw_indirect", "draws", 1 << 20),
        argument("draw_indirect", "stride", 4),
        argument("signal", "value", 0),
        argument("present", "texture", 1),
        ("end_pass", lambda line: line.update(op="pop_label")),
        ("push_label", lambda line: line.update(op="end_pass", arguments={})),
        ("begin_query", lambda line: line.update(op="end_query")),
    ],
)
def test_a_command_that_no_device_would_have_issued_is_refused(
    file: Path, op: str, change: Callable[[dict[str, Any]], None]
) -> None:
    refused_value = refused(edit_line(file, op, change), rules.TRACE_REFERENCE)
    assert refused_value.startswith("line ")


def test_resources_larger_than_any_memory_are_refused(file: Path) -> None:
    refused(edit_line(file, *argument("create_buffer", "descriptor.size", 1 << 40)), rules.TRACE_SIZE)


def test_a_field_that_a_file_lacks_takes_its_default(file: Path) -> None:
    def drop(line: dict[str, Any]) -> None:
        descriptor = line["arguments"]["descriptor"]
        for name in ("writes_memory", "early_depth"):
            del descriptor[name]

    trace = load(edit_line(file, "create_program", drop))
    assert str(trace.stream) == str(load(file).stream)
    refused(
        edit_line(file, "create_program", lambda line: line["arguments"]["descriptor"].pop("name")),
        rules.TRACE_COMMAND,
    )
    shorter = edit_line(file, "create_texture", lambda line: line["arguments"]["descriptor"].pop("label"))
    assert load(shorter).stream.filter(rhi.Op.CREATE_TEXTURE)[0]["descriptor"].label == ""


# -- its arrays ----------------------------------------------------------------------------------------------


def as_npy(array: np.ndarray[Any, Any]) -> bytes:
    data = io.BytesIO()
    np.lib.format.write_array(data, array, allow_pickle=True)
    return data.getvalue()


def with_array(file: Path, data: bytes) -> Path:
    return rewrite(file, lambda members: members.update({"arrays/0.npy": data}))


def test_the_arrays_are_ordinary_npy_files(file: Path) -> None:
    with zipfile.ZipFile(file) as archive:
        arrays = [np.load(archive.open(name)) for name in archive.namelist() if name.endswith(".npy")]
    assert {array.dtype.str for array in arrays} == {"|u1", "<f2"}
    assert (6, 4, 4, 4) in {array.shape for array in arrays}  # texels keep their shape


@pytest.mark.parametrize(
    "array",
    [
        np.zeros(24, np.int8),
        np.zeros(6, np.float32),
        np.zeros((24, 1), np.uint8),
        np.array([None] * 24),
        np.zeros(24, "c16"),
        np.zeros(24, "U1"),
        np.zeros(24, [("a", "u1")]),
        np.asfortranarray(np.zeros((4, 6), "u1")),
    ],
    ids=str,
)
def test_another_dtype_or_shape_is_refused(file: Path, array: np.ndarray[Any, Any]) -> None:
    load(with_array(file, as_npy(np.zeros(24, np.uint8))))
    refused(with_array(file, as_npy(array)), rules.TRACE_ARRAY)


@pytest.mark.parametrize("length", [0, 6, 40, -1])
def test_an_array_that_is_cut_off_is_refused(file: Path, length: int) -> None:
    refused(with_array(file, as_npy(np.zeros(24, np.uint8))[:length]), rules.TRACE_ARRAY)


def test_a_header_that_promises_too_much_is_refused(file: Path) -> None:
    whole = as_npy(np.zeros(24, np.uint8))
    refused(with_array(file, whole.replace(b"(24,)", b"(9**99,)", 1)), rules.TRACE_ARRAY)
    refused(with_array(file, whole.replace(b"(24,), }  ", b"(2400,), }", 1)), rules.TRACE_ARRAY)


def test_more_bytes_than_the_buffer_has_are_refused(file: Path) -> None:
    refused(with_array(file, as_npy(np.zeros(25, np.uint8))), rules.TRACE_REFERENCE)


@pytest.mark.parametrize("number", [999, -1, "0", None, True])
def test_an_array_that_is_not_there_is_refused(file: Path, number: object) -> None:
    refused(edit_line(file, *argument("write_buffer", "data", number)), rules.TRACE_ARRAY)


# -- its programs --------------------------------------------------------------------------------------------


def test_a_program_without_source_loads_and_says_so_when_it_is_needed(file: Path) -> None:
    def strip(members: dict[str, bytes]) -> None:
        for name in [name for name in members if name.startswith("programs/")]:
            del members[name]

    trace = load(rewrite(file, strip))
    (program, *_) = trace.stream.filter(rhi.Op.CREATE_PROGRAM)
    with pytest.raises(rhi.ShaderError, match=r"^\[trace-source\]"):
        program["descriptor"].emit("glsl", rhi.Stage.VERTEX)
    whole = load(file, trusted=True).stream.filter(rhi.Op.CREATE_PROGRAM)[0]
    assert "void main" in whole["descriptor"].emit("glsl", rhi.Stage.VERTEX).text
