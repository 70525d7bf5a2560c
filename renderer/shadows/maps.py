"""Shadow maps: which maps a frame needs, and drawing those that have changed.

All maps are square tiles of one depth texture, the **atlas**. A map is drawn as a view of its own, from its light, with
its own casters (`renderer.shadows.casters`). It is kept from frame to frame:

- **kept** if its camera, its casters that can't move and the state of those that may are those that it shows;
- **drawn over a copy** if only casters that may move have changed: what can't move is copied from a second texture,
  which is made when the first caster moves;
- **drawn** from scratch otherwise. A map without a caster, or without anything visible in reach, is **skipped**.

Maps belong to the frame, not to a view: all views of a frame share them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

from renderer.frame import Effect, Frame, Needs, Pass
from renderer.frame.passes import WINDINGS
from renderer.frame.resources import MirroredValue, SceneResources, split_doubles
from renderer.scene import Camera, Scene
from renderer.scene.arrays import Rows
from renderer.shaders.depth import DepthOnly
from renderer.shaders.structs import ViewConstants
from renderer.shadows.cascades import Cascade, fit_cascades
from renderer.shadows.casters import Casters, SceneCasters, turn_boxes
from renderer.shadows.receiver import MOST_CASCADES, SunMap, SunTable
from renderer.shadows.settings import ShadowFilter, ShadowSettings
from renderer.shadows.tiles import Tile, TileTree
from rhi import (
    Comparison,
    CullMode,
    DepthFunction,
    DepthTest,
    DepthWrite,
    Device,
    Filter,
    Format,
    Region,
    SamplerDescriptor,
    Scissor,
    Texture,
    Viewport,
    Wrap,
)
from rhi.shading import Shader, vec4, vertex_index

__rhi_internal__ = True

SHADOW_EFFECTS: Final = (Effect.SUN_SHADOWS,)
"""The effects that call for shadow maps."""

_COMPARING: Final = SamplerDescriptor(
    mip=None,
    wrap_u=Wrap.CLAMP,
    wrap_v=Wrap.CLAMP,
    minify=Filter.LINEAR,
    magnify=Filter.LINEAR,
    compare=Comparison.GREATER_EQUAL,
)
_STEP: Final = 16.0  # metres, by which the depth of what parallel views show is rounded
_BIAS: Final = (0.1, 0.6)  # texels along the normal: at any angle, and times its sine

MapKey = tuple[str, int, int]
"""The name of a map: the kind of its light, the light's row, and which of its maps it is."""


class FarDepth(Shader):
    """Draws the farthest depth all over a tile."""

    def vertex(self) -> vec4:
        corner = vertex_index()
        return vec4(float(corner % 2) * 4.0 - 1.0, float(corner // 2) * 4.0 - 1.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class MapReport:
    """What became of a map in a frame.

    Attributes:
        name: the light and the part of it. size: the width of the map in texels. casters: the objects in it.
        state: drawn, kept or skipped. because: why.
    """

    name: str
    size: int
    casters: int
    state: str
    because: str


@dataclass(frozen=True, eq=False, slots=True)
class WantedMap:
    """A map that the frame needs."""

    key: MapKey
    camera: Camera
    size: int
    casters: Casters


@dataclass(eq=False, slots=True)
class ShadowMap:
    """A map in the atlas, and what it shows.

    Attributes:
        view: the constants of its camera. still: what it shows of casters that can't move, None if nothing yet.
        moving: the state of the others in it. copied: what the second texture holds of its tile.
    """

    tile: Tile
    view: MirroredValue[ViewConstants]
    still: tuple[object, ...] | None = None
    moving: bytes = b""
    copied: tuple[object, ...] | None = None


@dataclass(eq=False, slots=True)
class MapWork:
    """What is to be drawn in a frame: maps from scratch, copies, and casters over those."""

    fresh: list[tuple[ShadowMap, Rows]] = field(default_factory=list)
    saved: list[ShadowMap] = field(default_factory=list)
    restored: list[ShadowMap] = field(default_factory=list)
    over: list[tuple[ShadowMap, Rows]] = field(default_factory=list)


class ShadowMaps:
    """The shadow maps of a scene on a device.

    Attributes:
        settings: their choices; they may be exchanged between two frames.
        reports: what became of each map of the last frame.
        casters_drawn: the number of objects that were drawn to maps in the last frame.
    """

    def __init__(self, device: Device) -> None:
        self.settings = ShadowSettings()
        self.reports: list[MapReport] = []
        self.casters_drawn = 0
        self._device = device
        self._scene: Scene | None = None
        self._casters: SceneCasters | None = None
        self._used_settings = self.settings
        self._maps: dict[MapKey, ShadowMap] = {}
        self._tree = TileTree(1)
        self._atlas: Texture | None = None
        self._kept: Texture | None = None  # the second texture
        self._triangle = device.mesh(3, label="shadow tile")
        self._sun_table = MirroredValue(device, _make_table([], 0.0))
        self._suns: list[tuple[int, Cascade, MapKey | None]] = []  # the key of those with a map

    def count(self, state: str) -> int:
        """Return the number of maps of the last frame that were `drawn`, `kept` or `skipped`."""
        return sum(report.state == state for report in self.reports)

    @property
    def atlas(self) -> Texture:
        """The texture with all maps."""
        assert self._atlas is not None, "maps are updated before they are read"
        return self._atlas

    @property
    def tiles(self) -> dict[MapKey, Tile]:
        """The tile of each map."""
        return {key: one.tile for key, one in self._maps.items()}

    def bind_filter(self) -> tuple[str, dict[str, Any]]:
        """Return the name of the part that reads the atlas, and its bindings."""
        filter = self.settings.filter
        name = f"{filter.value}_shadows"
        if filter is ShadowFilter.HARDWARE:
            return name, {"shadow_compare": self.atlas.sampled(_COMPARING)}
        return name, {"shadow_atlas": self.atlas}

    def bind_sun(self) -> tuple[list[str], dict[str, Any]]:
        """Return the names of the parts of the shadows of directional lights, and their bindings."""
        name, bindings = self.bind_filter()
        return ["sun_shadows", name], bindings | {"suns": self._sun_table.buffer}

    def update(self, frame: Frame, cameras: Sequence[Camera]) -> None:
        """Bring all maps that a frame needs up to date, for views of `cameras`."""
        resources = frame.resources
        scene = resources.scene
        if self._scene is not scene or self._used_settings != self.settings:
            self._reset(scene)
        assert self._casters is not None
        self.reports = []
        self.casters_drawn = 0
        wanted = self._want_suns(resources, frame.needs, cameras, self._casters)
        self._place({one.key: one.size for one in wanted})
        work = MapWork()
        for one in wanted:
            self._decide(scene, one, work)
        self._draw(resources, work)
        self.aim(frame.camera)

    def aim(self, camera: Camera) -> None:
        """Give shaders the places of all maps relative to the eye of `camera`."""
        maps = []
        for number, (row, cascade, key) in enumerate(self._suns):
            x, y, size = self._maps[key].tile if key is not None else _NO_TILE
            next_row = self._suns[number + 1][0] if number + 1 < len(self._suns) else -1
            maps.append(
                SunMap(
                    axes=cascade.camera.rotation,
                    origin=cascade.camera.position - camera.position,
                    texel=cascade.texel,
                    middle=(x + 0.5 * size, y + 0.5 * size),
                    half=0.5 * size,
                    inner=cascade.inner,
                    length=cascade.length if key is not None else 0.0,
                    light=row,
                    is_last=int(next_row != row),
                )
            )
        self._sun_table.write(_make_table(maps, self.settings.bias))

    def _want_suns(
        self, resources: SceneResources, needs: Needs, cameras: Sequence[Camera], casters: SceneCasters
    ) -> list[WantedMap]:
        """Return the cascades that have something visible and a caster, and note all of them."""
        self._suns = []
        wanted: list[WantedMap] = []
        scene = resources.scene
        if Effect.SUN_SHADOWS not in needs.effects:
            return wanted
        seen = [resources.find_in_view(camera, np.arange(len(scene.objects))) for camera in cameras]
        visible = np.unique(np.concatenate(seen))
        depth = _find_depth(scene, cameras[0])
        rows = np.flatnonzero(scene.lights.directional["casts_shadow"])[:MOST_CASCADES].tolist()
        settings = replace(self.settings, cascades=min(self.settings.cascades, MOST_CASCADES // len(rows)))
        for row in rows:
            direction = scene.lights.directional["direction"][row].astype(np.float64)
            axes = Camera.look_at((0, 0, 0), direction).rotation
            boxes = casters.turn(axes)
            receivers = turn_boxes(scene, visible, axes)
            for part, cascade in enumerate(fit_cascades(cameras, direction, settings, boxes.top, depth)):
                key, found = ("directional", row, part), boxes.find(cascade, receivers)
                if found is None or not len(found):
                    reason = "nothing visible is in it" if found is None else "no caster is in it"
                    self._report(key, 0, 0, "skipped", reason)
                    self._suns.append((row, cascade, None))
                else:
                    wanted.append(WantedMap(key, cascade.camera, self.settings.cascade_size, found))
                    self._suns.append((row, cascade, key))
        return wanted

    def _place(self, sizes: dict[MapKey, int]) -> None:
        """Give each map a tile of its size. Maps that aren't wanted keep theirs until others need the room."""
        for key in [key for key, size in sizes.items() if key in self._maps and self._maps[key].tile.size != size]:
            self._forget(key)
        self._grow(sizes)
        for key, size in sorted(sizes.items(), key=lambda item: -item[1]):
            if key in self._maps:
                continue
            tile = self._tree.take(size)
            if tile is None:
                for other in [other for other in self._maps if other not in sizes]:
                    self._forget(other)
                tile = self._tree.take(size)
            if tile is None:  # the free tiles are too small, though all of them together are large enough
                self._forget_all()
                self._place(sizes)
                return
            self._maps[key] = ShadowMap(tile, MirroredValue(self._device, _NO_VIEW))

    def _grow(self, sizes: dict[MapKey, int]) -> None:
        """Make the atlas large enough for tiles of these sizes."""
        area = sum(size * size for size in sizes.values())
        side = self._tree.size if self._atlas is not None else 1
        while side * side < area:
            side *= 2
        if self._atlas is not None and side == self._tree.size:
            return
        self._forget_all()
        self._destroy_textures()
        self._tree = TileTree(side)
        self._atlas = self._device.texture((side, side), Format.D32F, label="shadow atlas")

    def _decide(self, scene: Scene, wanted: WantedMap, work: MapWork) -> None:
        """Note what is to be drawn of a map."""
        one, casters, camera = self._maps[wanted.key], wanted.casters, wanted.camera
        still = (
            camera.position.tobytes(), camera.rotation.tobytes(), camera.projection, casters.still.tobytes()
        )  # fmt: skip
        moving = describe_state(scene, casters.moving)
        if one.still == still and one.moving == moving:
            self._report(wanted.key, one.tile.size, len(casters), "kept", "nothing in it has moved")
            return
        if one.still != still:
            because = "it is new" if one.still is None else "the light, the view or its casters have changed"
            rows = np.concatenate([casters.still, casters.moving])
            work.fresh.append((one, rows))
            one.copied = None
            one.view.write(_view_constants(camera))
        else:
            because = "a caster has moved"
            if one.copied == still:
                work.restored.append(one)
            else:
                if one.moving:
                    work.fresh.append((one, casters.still))
                work.saved.append(one)
                one.copied = still
            if len(casters.moving):
                work.over.append((one, casters.moving))
        one.still, one.moving = still, moving
        self._report(wanted.key, one.tile.size, len(casters), "drawn", because)

    def _draw(self, resources: SceneResources, work: MapWork) -> None:
        for _, rows in (*work.fresh, *work.over):
            resources.simulate(rows)
            self.casters_drawn += len(rows)
        self._draw_maps(resources, work.fresh, clears=True)
        if work.saved and self._kept is None:
            size = self.atlas.size
            self._kept = self._device.texture(size, Format.D32F, label="shadow maps of what can't move")
        for source, target, maps in (
            (self._atlas, self._kept, work.saved),
            (self._kept, self._atlas, work.restored),
        ):
            for one in maps:
                assert source is not None
                assert target is not None
                x, y, side = one.tile
                source.copy_to(target, region=Region(x, y, side, side), x=x, y=y)
        self._draw_maps(resources, work.over, clears=False)

    def _draw_maps(
        self, resources: SceneResources, maps: Sequence[tuple[ShadowMap, Rows]], *, clears: bool
    ) -> None:
        """Draw objects to the tiles of maps, in one pass."""
        if not maps:
            return
        device = self._device
        program: Any = device.program(DepthOnly)
        objects, places = resources.objects.buffer, resources.places.buffer
        faces = CullMode.FRONT if self.settings.back_faces else CullMode.BACK
        with (
            device.render_pass(None, self.atlas),
            device.states(DepthTest.ON, DepthWrite.ON, DepthFunction.GREATER, faces),
        ):
            for one, rows in maps:
                x, y, size = one.tile
                with device.states(Viewport(x, y, size, size), Scissor(x, y, size, size)):
                    if clears:
                        with device.states(DepthFunction.ALWAYS, CullMode.NONE):
                            device.draw(device.program(FarDepth), self._triangle)
                    for mirrored, winding in WINDINGS:
                        part = rows[resources.find_winding(rows, mirrored=mirrored)]
                        if part.size:
                            with device.states(winding):
                                device.draw_many(
                                    program,
                                    resources.mesh,
                                    resources.draws[part],
                                    view=one.view.buffer,
                                    objects=objects,
                                    places=places,
                                )

    def _report(self, key: MapKey, size: int, casters: int, state: str, because: str) -> None:
        kind, row, part = key
        name = f"{kind} light {row}, {'cascade' if kind == 'directional' else 'face'} {part}"
        self.reports.append(MapReport(name, size, casters, state, because))

    def _reset(self, scene: Scene) -> None:
        """Begin anew with a scene and the settings."""
        self._forget_all()
        self._destroy_textures()
        self._scene, self._casters = scene, SceneCasters(scene)
        self._used_settings = self.settings

    def _forget(self, key: MapKey) -> None:
        one = self._maps.pop(key)
        self._tree.give_back(one.tile)
        one.view.destroy()

    def _forget_all(self) -> None:
        for key in list(self._maps):
            self._forget(key)

    def _destroy_textures(self) -> None:
        for texture in (self._atlas, self._kept):
            if texture is not None:
                texture.destroy()
        self._atlas = self._kept = None

    def destroy(self) -> None:
        """Destroy all resources on the device."""
        self._forget_all()
        self._destroy_textures()
        self._sun_table.destroy()
        self._triangle.destroy()


def shadow_passes(needs: Needs) -> list[Pass[Frame]]:
    """Return the pass that brings shadow maps up to date, if the frame needs any. Its maps outlive the frame."""
    reasons = [needs.explain(effect) for effect in SHADOW_EFFECTS if effect in needs.effects]
    if not reasons:
        return []
    return [Pass("shadow maps", _update_maps, "; ".join(reasons), has_side_effects=True)]


def _update_maps(frame: Frame) -> None:
    maps = frame.resources.workspace(ShadowMaps)
    if frame.first is None:
        maps.update(frame, [frame.view.around])
    else:  # the left eye's frame has drawn them for both
        maps.aim(frame.camera)


def describe_state(scene: Scene, rows: Rows) -> bytes:
    """Return bytes that change when one of the objects `rows` moves; those that are simulated always do."""
    if not len(rows):
        return b""
    objects = scene.objects
    seconds = np.float64(scene.seconds).tobytes() if objects.simulated[rows].any() else b""
    return rows.tobytes() + scene.nodes.world[objects.node[rows]].tobytes() + seconds


def _find_depth(scene: Scene, camera: Camera) -> tuple[float, float]:
    """Return the least and the greatest distance of the scene along the view, rounded to whole steps."""
    (lower, upper), forward = scene.bounds, camera.forward
    middle = float((0.5 * (lower + upper) - camera.position) @ forward)
    half = float(0.5 * (upper - lower) @ np.abs(forward))
    return float(np.floor((middle - half) / _STEP) * _STEP), float(np.ceil((middle + half) / _STEP) * _STEP)


_NO_TILE: Final = Tile(0, 0, 0)
_NO_VIEW: Final = ViewConstants(relative_view_projection=np.eye(4), eye_high=np.zeros(3), eye_low=np.zeros(3))


def _make_table(maps: list[SunMap], bias: float) -> SunTable:
    empty = SunMap(
        axes=np.eye(3), origin=np.zeros(3), texel=1.0, middle=(0, 0), half=0, inner=0, length=0, light=-1, is_last=0
    )
    filled = [*maps, *[empty] * (MOST_CASCADES - len(maps))]
    return SunTable(maps=filled, bias=(bias * _BIAS[0], bias * _BIAS[1], bias), count=len(maps))


def _view_constants(camera: Camera) -> ViewConstants:
    high, low = split_doubles(camera.position)
    return ViewConstants(relative_view_projection=camera.relative_view_projection, eye_high=high, eye_low=low)
