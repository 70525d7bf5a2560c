"""The parameters of visibility algorithms, and the file that keeps them.

`python -m renderer tune` finds the best b and n for a scene and a device (thesis 6.5.1) and writes such a
file; `render`, `compare visibility` and `debug visibility` read it with `--settings`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Final, Self

from renderer import rules
from renderer.scene.file_versions import KEY
from renderer.scene.files import read_json
from renderer.scene.settings_versions import SETTINGS_VERSIONS
from renderer.visibility.boxes.polytopes import PLANE_COUNTS
from rhi import RhiError, refuse


@dataclass(frozen=True, slots=True)
class VisibilitySettings:
    """The parameters of the algorithms; each uses those that it has.

    Attributes:
        batch: number of hidden nodes that are gathered before they are queried, the thesis's b; 1 or more.
        persistence: number of frames for which a visible leaf isn't queried again, the thesis's n; 1 or more.
        leaf_size: largest number of objects in a leaf; they are queried and drawn together. 1 or more.
        threshold: a box that passes at most this many samples counts as hidden; 0 or more. Above 0 images may
            differ.
        emulated: whether occlusion queries are emulated by two counters and a fence (thesis 4.4.2), as they
            are in any case on a device without its own. Conditional culling can't use emulated ones.
        occluders: the largest number of objects that software occlusion draws; 1 or more.
        occluder_pixels: how many pixels of the image, in width and height, are one for its occluders; 1 or
            more. Above 1 what is seen through narrow gaps between them may be missing.
        pyramid_texels: the largest width and height, in texels of a depth pyramid, of what a box is compared
            with in `depth_pyramid` and `software_depth`; 1 or more. Fewer are coarser, and hide less. In the
            last level, which is at most 16 texels wide and high, there may be more.
        meshlets: whether `depth_pyramid` and `two_pass` cull the meshlets of meshes that are cut into them
            (`SceneBuilder.add_mesh`); else they draw these whole.
        proxy_planes: the number of planes of the convex polytopes that `two_pass` tests in place of boxes: 14 (the
            box with its corners cut), 18 (its edges) or 26 (both); 0 for boxes. Meshes with bounds keep boxes.
    """

    batch: int = 50
    persistence: int = 20
    leaf_size: int = 1
    threshold: int = 0
    emulated: bool = False
    occluders: int = 64
    occluder_pixels: int = 1
    pyramid_texels: int = 8
    meshlets: bool = True
    proxy_planes: int = 0

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_PARAMETER)
        for name in _COUNTS:
            value, least = getattr(self, name), int(name != "threshold")
            if value < least:
                text, allowed = repr(value), f"a whole number of {least} or more"
                refuse(rules.BAD_PARAMETER, f"VisibilitySettings({name}=…)", text, allowed)
        if self.proxy_planes not in (0, *PLANE_COUNTS):
            allowed = "0, 14, 18 or 26"
            refuse(
                rules.BAD_PARAMETER, "VisibilitySettings(proxy_planes=…)", repr(self.proxy_planes), allowed
            )

    def save(self, path: Path, **metadata: Any) -> None:
        """Write the settings as JSON. `metadata` is written too, to say how they were found; `load` ignores
        it."""
        path.write_text(
            json.dumps({KEY: SETTINGS_VERSIONS.current, "visibility": asdict(self), **metadata}, indent=2)
            + "\n",
            encoding="utf-8",
        )

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a file that `save` has written; missing parameters have their defaults.

        Raises:
            ValidationError: `visibility-bad-settings` if the file holds no settings, `file-version` for a newer
                version.
            OSError: the file can't be read.
        """
        call = f"VisibilitySettings.load({str(path)!r})"
        try:
            numbers = SETTINGS_VERSIONS.migrate(dict(read_json(path)), call)["visibility"]
        except RhiError:
            raise
        except (ValueError, KeyError, TypeError) as error:
            refuse(rules.BAD_SETTINGS, call, f"{type(error).__name__}: {error}")
        if not isinstance(numbers, Mapping):
            refuse(rules.BAD_SETTINGS, call, repr(numbers), "an object of names and numbers")
        names = [field.name for field in fields(cls)]
        for name in numbers:
            if name not in names:
                rules.refuse_name(rules.BAD_SETTINGS, call, name, names)
        return cls(**numbers)


_COUNTS: Final = (
    "batch",
    "persistence",
    "leaf_size",
    "threshold",
    "occluders",
    "occluder_pixels",
    "pyramid_texels",
)
"""The parameters that are whole numbers: of 1 or more, a threshold of 0 or more."""

DEFAULTS: Final = VisibilitySettings()
"""The settings of algorithms that are given none."""
