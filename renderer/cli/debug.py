"""`debug`: pictures of what the renderer does; of what is a command of its own."""

from __future__ import annotations

from typing import Any

from renderer.cli import debug_visibility


def add_to(commands: Any) -> None:
    """Add the command with all that it pictures."""
    parser = commands.add_parser(
        "debug", help="picture what the renderer does", description="Picture what the renderer does."
    )
    subjects = parser.add_subparsers(metavar="SUBJECT", required=True)
    for subject in (debug_visibility,):
        subject.add_to(subjects)
