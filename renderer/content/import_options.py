"""Options of a model file: scale and position, parts left out, merged meshes, levels of detail, meshlets, compressed
images.

They are said by `load_model(…, options=…)`, or in a scene's text: `model.glb:scale=0.01,centre`. All are checked
before anything is added to a scene.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Final

import numpy as np

from renderer import rules
from renderer.content.compression import check_compression, compress_images
from renderer.content.limits import Budget, ModelLimits
from renderer.light_kinds.kind import LightKind
from renderer.light_kinds.table import LIGHT_KINDS
from renderer.scene.arrays import Floats
from renderer.scene.images import Compression
from renderer.scene.meshlets import check_meshlet_size
from renderer.scene.paths import CameraPath
from renderer.scene.scene_builder import SceneBuilder
from rhi.errors import describe_value, refuse
from rhi.math import Camera, Orthographic, Perspective, Projection

_SCALES: Final = (1e-6, 1e6)
_SEPARATOR: Final = "|"
_LIMIT_WORDS: Final = ("outside", "unlimited")
_FLAGS: Final = ("centre", "merge")
_KEYS: Final = ("scale", "without", "levels", "meshlet_size", "compress")
_COUNTS: Final = ("levels", "meshlet_size")
_MOST_LEVELS: Final = 12


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """The changes to a model file as it is read.

    Attributes:
        scale: the factor of all lengths, 10⁻⁶ to 10⁶: of positions, near and far planes, ranges and radii of
            lights. Local lights get scale² of their intensity, so that a camera that is scaled, too, sees the
            same image.
        centre: whether the middle of the bounding box of all objects moves to the origin.
        without: names of nodes or meshes that are left out, with what is below these nodes. `*`, `?` and
            `[abc]` are those of `fnmatch`; case matters.
        merge: whether objects with equal materials become one mesh, where they never move apart. Fewer draws,
            but they are culled together. Blended ones stay apart: they are sorted by distance.
        levels: up to so many simplified versions of each mesh are made, 0 to 12, with bounds of their errors
            (`simplify`). Meshes with skins or morph targets have none.
        meshlet_size: the most triangles of a meshlet, 8 to 4,096 (`SceneBuilder.add_mesh`), 0 for whole meshes. Those
            with skins or morph targets stay whole.
        compress: the format in which images of 8 bits get blocks, with mip levels, for devices that store it; normal
            maps have BC5. It needs the package etcpak.
    """

    scale: float = 1.0
    centre: bool = False
    without: tuple[str, ...] = ()
    merge: bool = False
    levels: int = 0
    meshlet_size: int = 0
    compress: Compression = Compression.NONE

    def __post_init__(self) -> None:
        call = "ImportOptions"
        (scale,) = rules.check_numbers(rules.BAD_IMPORT, call, scale=self.scale)
        low, high = _SCALES
        if not low <= scale <= high:
            refuse(rules.BAD_IMPORT, f"{call}(scale=...)", self.scale, f"{low:g} to {high:g}")
        for name in _FLAGS:
            if not isinstance(getattr(self, name), bool | np.bool_):
                value = describe_value(getattr(self, name))
                refuse(rules.BAD_IMPORT, f"{call}({name}=...)", value, "True or False")
        if not isinstance(self.compress, Compression):
            refuse(rules.BAD_IMPORT, f"{call}(compress=...)", describe_value(self.compress), "a Compression")
        check_compression(rules.BAD_IMPORT, f"{call}(compress=...)", self.compress)
        patterns = self.without
        is_list = isinstance(patterns, Sequence) and not isinstance(patterns, str | bytes)
        if not is_list or not all(isinstance(pattern, str) and pattern for pattern in patterns):
            allowed = "a sequence of names or patterns, none of them empty"
            refuse(rules.BAD_IMPORT, f"{call}(without=...)", describe_value(patterns), allowed)
        levels = rules.check_count(rules.BAD_IMPORT, f"{call}(levels=...)", self.levels, 0)
        if levels > _MOST_LEVELS:
            refuse(rules.BAD_IMPORT, f"{call}(levels=...)", levels, f"0 to {_MOST_LEVELS}")
        object.__setattr__(self, "levels", levels)
        size = check_meshlet_size(rules.BAD_IMPORT, call, self.meshlet_size)
        object.__setattr__(self, "meshlet_size", size)
        object.__setattr__(self, "scale", scale)
        object.__setattr__(self, "without", tuple(patterns))

    @property
    def moves(self) -> bool:
        """True if positions change."""
        return self.centre or self.scale != 1.0

    def leaves_out(self, name: str) -> bool:
        """True if a part of this name is left out."""
        return any(fnmatchcase(name, pattern) for pattern in self.without)

    def flag_left_out(self, nodes: Iterable[tuple[int, str]]) -> list[bool]:
        """Return which nodes are left out, by their names or with a node above.

        Args:
            nodes: the parent's row, -1 for none, and the name of each node, parents before children.
        """
        flags: list[bool] = []
        for parent, name in nodes:
            flags.append((parent >= 0 and flags[parent]) or self.leaves_out(name))
        return flags

    def check_names(self, path: str, names: Iterable[str]) -> None:
        """Refuse patterns that match none of the names of a file's nodes and meshes."""
        present = sorted({name for name in names if name})
        for pattern in self.without:
            if not any(fnmatchcase(name, pattern) for name in present):
                call = f"load_model({path!r}, without={pattern!r})"
                rules.refuse_name(rules.UNKNOWN_PART, call, pattern, present or ["parts have no names"])


def parse_model_options(call: str, text: str) -> tuple[ModelLimits, ImportOptions]:
    """Parse the options of a model file in a scene's text: words and `key=value`, with commas between them.

    The words are `outside`, `unlimited`, `centre` and `merge`, the keys `scale`, `levels`, `meshlet_size`, `compress`
    and `without`, whose patterns have `|` between them.

    Raises:
        ValidationError: `scene-spec-syntax`, `scene-unknown-key`, `scene-bad-import`.
    """
    words: dict[str, str] = {}
    for part in text.split(","):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if name not in (*_LIMIT_WORDS, *_FLAGS, *_KEYS):
            rules.refuse_name(rules.UNKNOWN_KEY, call, name, (*_LIMIT_WORDS, *_FLAGS, *_KEYS))
        if bool(equals) != (name in _KEYS):
            refuse(rules.SPEC_SYNTAX, call, part, f"{name}=…" if name in _KEYS else f"{name} alone")
        if name in words:
            refuse(rules.SPEC_SYNTAX, call, f"{name} twice", "each word once")
        words[name] = value
    limits = ModelLimits(*(np.inf,) * 4) if "unlimited" in words else ModelLimits()
    try:
        scale = float(words.get("scale", "1"))
    except ValueError:
        refuse(rules.BAD_IMPORT, call, f"scale={words['scale']}", "a number")
    counts = {}
    for name in _COUNTS:
        try:
            counts[name] = int(words.get(name, "0"))
        except ValueError:
            refuse(rules.BAD_IMPORT, call, f"{name}={words[name]}", "a whole number")
    compress = words.get("compress", Compression.NONE.value)
    if compress not in [compression.value for compression in Compression]:
        allowed = ", ".join(compression.value for compression in Compression)
        refuse(rules.BAD_IMPORT, call, f"compress={compress}", allowed)
    without = tuple(words["without"].split(_SEPARATOR)) if "without" in words else ()
    options = ImportOptions(
        scale, "centre" in words, without, "merge" in words, **counts, compress=Compression(compress)
    )
    return replace(limits, outside="outside" in words), options


class ModelPlacement:
    """Scales and moves what is added to a builder between `begin` and `finish`.

    Attributes:
        root: the node below which the nodes of the file are to be added, or -1.
    """

    def __init__(self, builder: SceneBuilder, options: ImportOptions) -> None:
        self._builder, self._options = builder, options
        self._first_object, self._first_mesh = builder.object_count, builder.mesh_count
        self._first_lights = [len(builder.lights.of_kind(kind)) for kind in LIGHT_KINDS]
        self._views = frozenset(builder.views)
        self._first_image = builder.image_count
        self._offset = np.zeros(3)
        self.root = builder.add_node(name="import") if options.moves else -1

    def finish(self, budget: Budget) -> None:
        """Apply the options to all that was added since. Merged meshes count as vertices of the budget."""
        builder, scale = self._builder, self._options.scale
        if self._options.moves:
            if self._options.centre and builder.object_count > self._first_object:
                lower, upper = builder.compute_bounds(self._first_object)
                self._offset = -0.5 * scale * (lower + upper)
            matrix = np.diag([scale, scale, scale, 1.0])
            matrix[:3, 3] = self._offset
            builder.set_local(self.root, matrix)
            for kind, first in zip(LIGHT_KINDS, self._first_lights, strict=True):
                self._move_lights(kind, first)
            for name in builder.views.keys() - self._views:
                builder.views[name] = self._move_view(name, builder.views[name])
        if self._options.merge:
            builder.merge_objects(
                self._first_object, self._first_mesh, lambda count: budget.spend("vertices", count)
            )
        if self._options.levels:
            builder.simplify_meshes(self._first_mesh, self._options.levels)
        if self._options.meshlet_size:
            builder.cut_meshes(self._first_mesh, self._options.meshlet_size)
        if self._options.compress is not Compression.NONE:
            compress_images(builder, self._first_image, self._options.compress)

    def move_path(self, path: CameraPath) -> CameraPath:
        """Return a camera path of the file with these options."""
        positions, targets = self._move(path.positions), self._move(path.targets)
        return CameraPath(
            positions, targets, _scale_projection(path.projection, self._options.scale), path.ups
        )

    def _move(self, positions: Floats) -> Floats:
        return positions * self._options.scale + self._offset

    def _move_lights(self, kind: LightKind, first: int) -> None:
        """Place the lights of a kind from the index `first` on. Those at nodes move with these."""
        if not kind.has_range:
            return
        scale, lights = self._options.scale, self._builder.lights.of_kind(kind)
        is_free = np.ones(len(lights), bool)
        is_free[self._builder.list_attached_lights(kind)] = False
        is_free[:first] = False
        lights["position"][is_free] = self._move(lights["position"][is_free])
        for name, factor in (("range", scale), ("source_radius", scale), ("intensity", scale**2)):
            lights[name][first:] *= factor
        if kind.has_shapes:
            for name in ("source_right", "source_up"):
                lights[name][first:] *= scale

    def _move_view(self, name: str, view: Camera) -> Camera:
        is_free = name not in self._builder.attached_views
        position = self._move(view.position) if is_free else view.position
        return replace(
            view, position=position, projection=_scale_projection(view.projection, self._options.scale)
        )


def _scale_projection(projection: Projection, scale: float) -> Projection:
    if isinstance(projection, Perspective):
        return replace(projection, near=projection.near * scale, far=projection.far * scale)
    assert isinstance(projection, Orthographic)
    height = projection.height * scale
    return replace(projection, height=height, near=projection.near * scale, far=projection.far * scale)
