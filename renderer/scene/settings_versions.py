"""The versions of files of settings, and the names that settings had in older ones."""

from __future__ import annotations

from typing import Any, Final

from renderer.scene.file_versions import Fields, FileVersions, rename_fields


def rename_settings(parts: Any) -> None:
    """Give settings of version 1, as a file has them, the names of version 2, in place."""
    rename_fields(parts, {"glow": "bloom", "simulates_unseen": "simulates_hidden"})
    if isinstance(parts, dict):
        rename_fields(parts.get("bloom"), {"tames_sparks": "karis_average"})
        rename_fields(parts.get("tessellation"), {"unseen": "out_of_view_scale"})
        sizes = {"smallest": "min_size", "largest": "max_size", "largest_atlas": "max_atlas_size"}
        rename_fields(parts.get("shadows"), sizes)


def _migrate_1(content: Fields) -> Fields:
    rename_settings(content.get("rendering"))
    return content


SETTINGS_VERSIONS: Final = FileVersions("settings", (_migrate_1,))
"""Version 2 renamed settings."""
