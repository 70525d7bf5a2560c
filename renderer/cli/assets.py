"""`assets`: list models and images by their content."""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict
from pathlib import Path
from typing import Final

from renderer.cli import options
from renderer.cli.output import note
from renderer.cli.subcommand import Subcommand
from renderer.content.file_index import FileIndex, walk
from renderer.content.models import FORMATS

_KINDS: Final = {
    **dict.fromkeys(FORMATS, "model"),
    **dict.fromkeys((".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tga"), "image"),
    ".bin": "buffer",
}
_NOTES: Final = """\
  python -m renderer assets
  python -m renderer assets models
  python -m renderer convert models/old.obj models/new.glb

Files are remembered when they are loaded, or when a folder is listed. One that a scene names and that was moved is then
found by its content: in its folder and below, or where it was seen. `convert` writes a model in another format."""

_OPTIONS: Final = (
    options.file("folder", "folder whose files are listed, and remembered from now on (default: those that are)",
                 "FOLDER", nargs="?"),
    options.JSON,
)  # fmt: skip


def _run(given: argparse.Namespace) -> None:
    index = FileIndex()
    if given.folder is None:
        records = list(index.records.values())
    else:
        given.folder.stat()  # an OSError if it isn't there
        records = []
        for file in walk(given.folder):
            if file.suffix.lower() in _KINDS:
                try:
                    records.append(index.note(file))
                except OSError as error:
                    note(f"left out: {error}")
        index.save()
    rows = [
        {
            "kind": _KINDS.get(Path(each.path).suffix.lower(), "other"),
            "is_there": Path(each.path).exists(),
            **asdict(each),
        }
        for each in records
    ]
    if given.json:
        print(json.dumps(rows))
        return
    for row in rows:
        where = row["path"] if row["is_there"] else f"{row['path']} (not there)"
        print(f"{row['id'][:12]}  {row['kind']:<6}  {row['bytes']:>13,} bytes  {len(row['users'])} users  {where}")


COMMAND: Final = Subcommand("assets", "list models and images by their content", _OPTIONS, _run, _NOTES)
