"""`assets`: list models and what they use by their content.

  python -m renderer assets
  python -m renderer assets models
  python -m renderer convert models/old.obj models/new.glb

Files are remembered when they are loaded, or when a folder is listed. One that a scene names and that was
moved is then found by its content: in its folder and below, or where it was seen. `convert` writes a model in
another format.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Final

from renderer.cli import options
from renderer.cli.output import note
from renderer.cli.subcommand import Subcommand
from renderer.content.file_index import FileIndex, list_files
from renderer.content.models import FORMATS
from renderer.scene.files import read_file

_SUFFIXES: Final = (*FORMATS, ".bin", ".mtl", ".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tga")

_OPTIONS: Final = (
    options.file(
        "folder",
        "folder to list, and to remember for later searches (default: all remembered folders)",
        "FOLDER",
        nargs="?",
    ),
    options.JSON,
)


def _run(arguments: argparse.Namespace) -> None:
    index, paths = FileIndex(), []
    if arguments.folder is not None:
        arguments.folder.stat()  # raises OSError if it doesn't exist
        for file in list_files(arguments.folder.absolute()):
            if file.suffix.lower() in _SUFFIXES:
                try:
                    index.note(file, read_file(file, file.stat().st_size), file)
                    paths.append(str(file))
                except OSError as error:
                    note(f"left out: {error}")
        index.save()
    listed = index if arguments.folder is None else paths
    rows = [{"path": path, "is_there": Path(path).exists(), **index[path]._asdict()} for path in listed]
    if arguments.json:
        print(json.dumps(rows))
        return
    for row in rows:
        where = row["path"] if row["is_there"] else f"{row['path']} (not there)"
        print(f"{row['id'][:12]}  {row['bytes']:>13,} bytes  {len(row['users'])} users  {where}")


COMMAND: Final = Subcommand(
    "assets", "list models and what they use by their content", _OPTIONS, _run, __doc__
)
