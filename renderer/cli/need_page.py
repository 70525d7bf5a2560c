"""The text of `docs/need.md`, around the tables that `need` measures."""

from __future__ import annotations

from typing import Final

PAGE: Final = '''x {command} {added} {removed}'''
