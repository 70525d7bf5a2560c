"""`compare`: ways to do the same, side by side; what is compared is a command of its own."""

from __future__ import annotations

from typing import Any

from renderer.cli import compare_backends, compare_visibility


def add_to(commands: Any) -> None:
    """Add the command with all that it compares."""
    parser = commands.add_parser(
        "compare", help="compare ways to do the same", description="Compare ways to do the same."
    )
    subjects = parser.add_subparsers(metavar="SUBJECT", required=True)
    for subject in (compare_visibility, compare_backends):
        subject.add_to(subjects)
