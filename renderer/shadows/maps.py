"""Shadow maps: those that a frame needs have a place in the atlas, and those that have changed are drawn.

All maps are square tiles of one depth texture, the **atlas**. A map is drawn as a view of its own, from its light, with
its own casters. `renderer.shadows.needed` says which maps a frame needs. A map is kept from frame to frame:

- **kept** if its camera, its casters that can't move and the state of those that may are those that it shows;
- **drawn over a copy** if only casters that may move have changed: what can't move is copied from a second texture,
  which is made when the first caster moves;
- **drawn** from scratch otherwise.

Small maps of lamps, which are far away, take turns: in a frame only some of them are drawn again, those first that were
drawn longest ago. Movers whose shadows aren't in view draw no map of a lamp again.

Maps belong to the frame, not to a view: all views of a frame share them.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer.frame import (
    LAMPS,
    SHADOW_EFFECTS,
    BoundProgram,
    Effect,
    Frame,
    Needs,
    Pass,
    choose_program,
    find_states,
)
from renderer.frame.mirrors import MirroredTable, MirroredValue, split_doubles
from renderer.frame.resources import DRAW_GROUPS
from renderer.scene import Camera, Scene
from renderer.scene.arrays import Rows
from renderer.shaders.depth import DepthOnly
from renderer.shaders.structs import ViewConstants
from renderer.shadows.casters import SceneCasters, find_coverage, find_looks
from renderer.shadows.lamps import turn_into_quaternion
from renderer.shadows.needed import SUN, MapKey, NeededMaps, WantedMap
from renderer.shadows.receiver import (
    DARK,
    MOST_CASCADES,
    NO_MAPS,
    LampTable,
    SunMap,
    SunTable,
)
from renderer.shadows.settings import ShadowSettings
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

LOGGER: Final = logging.getLogger("rhi.shadows")
"""Warns when lamps are dark because there is no room for their shadow maps."""

_COMPARING: Final = SamplerDescriptor(
    mip=None,
    wrap_u=Wrap.CLAMP,
    wrap_v=Wrap.CLAMP,
    minify=Filter.LINEAR,
    magnify=Filter.LINEAR,
    compare=Comparison.GREATER_EQUAL,
)
_BIAS: Final = (0.1, 0.6)  # texels along the normal: at any angle, and times its sine

BindPrograms = Callable[[Frame], Sequence[BoundProgram]]
"""Returns the program that draws depth of a frame's objects, and its bindings."""


class FarDepth(Shader):
    """Draws the farthest depth all over a tile."""

    def vertex(self) -> vec4:
        corner = vertex_index()
        return vec4(float(corner % 2) * 4.0 - 1.0, float(corner // 2) * 4.0 - 1.0, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class MapReport:
    """The report of a map in a frame: whether it was drawn, and why.

    Attributes:
        name: the light and the part of it. size: the width of the map in texels. casters: the objects in it.
        state: drawn, kept or skipped. because: why.
    """

    name: str
    size: int
    casters: int
    state: str
    because: str


@dataclass(eq=False, slots=True)
class ShadowMap:
    """A map in the atlas, and what it shows.

    Attributes:
        view: the constants of its camera. still: what it shows of casters that can't move, None if nothing yet.
        moving: the state of the others in it. copied: what the second texture holds of its tile.
        frame: the number of the frame in which it was drawn last.
    """

    tile: Tile
    view: MirroredValue[ViewConstants]
    still: tuple[object, ...] | None = None
    moving: bytes = b""
    copied: tuple[object, ...] | None = None
    frame: int = 0


@dataclass(eq=False, slots=True)
class MapWork:
    """The shadow maps to be drawn in a frame: maps from scratch, copies, and casters over those."""

    fresh: list[tuple[ShadowMap, Rows]] = field(default_factory=list)
    saved: list[ShadowMap] = field(default_factory=list)
    restored: list[ShadowMap] = field(default_factory=list)
    over: list[tuple[ShadowMap, Rows]] = field(default_factory=list)


class ShadowMaps:
    """The shadow maps of a scene on a device.

    Attributes:
        settings: their choices; they may be exchanged between two frames.
        casters_drawn: the number of objects that were drawn to maps in the last frame.
        dark_lamps: the number of lamps that light nothing in the last frame, because there is no room for their maps.
    """

    def __init__(self, device: Device) -> None:
        self.settings = ShadowSettings()
        self._reported: list[tuple[MapKey, str, str, WantedMap | None]] = []
        self.casters_drawn = 0
        self.dark_lamps = 0
        self._device = device
        self._scene: Scene | None = None
        self._needed: NeededMaps | None = None
        self._material_version = -1  # of the materials that the maps show
        self._used_settings = self.settings
        self._maps: dict[MapKey, ShadowMap] = {}
        self._tree = TileTree(1)
        self._atlas: Texture | None = None
        self._kept: Texture | None = None  # the second texture
        self._triangle = device.mesh(3, label="shadow tile")
        self._lamp_table: MirroredValue[LampTable] | None = None
        self._lamp_textures = {  # by what binds them
            "lamp_slots": MirroredTable(device, Format.R32I, "lamp slots"),
            "lamp_maps": MirroredTable(device, Format.RGBA32F, "lamp maps"),
        }
        self._placements = 0  # how often a tile was given to a map
        self._written: tuple[object, ...] = ()  # what the table of lamps was written from
        self._frame = 0
        self._sun_tables: list[MirroredValue[SunTable]] = []  # of the eyes that there have been
        self._casting: tuple[bytes, ...] = ()  # of the lights of each kind, which ones cast shadows
        self._eye = 0  # whose table is bound

    def count(self, state: str) -> int:
        """Return the number of maps of the last frame that were `drawn`, `kept` or `skipped`."""
        return sum(reported == state for _, reported, _, _ in self._reported)

    @property
    def reports(self) -> list[MapReport]:
        """A report of each map of the last frame."""
        return [_make_report(*reported) for reported in self._reported]

    @property
    def atlas(self) -> Texture:
        """The texture with all maps."""
        assert self._atlas is not None, "maps are updated before they are read"
        return self._atlas

    @property
    def tiles(self) -> dict[MapKey, Tile]:
        """The tile of each map."""
        return {key: one.tile for key, one in self._maps.items()}

    def find(self, name: str) -> Any:
        """Return what a `ShadowReceiver` binds by a name."""
        match name:
            case "suns":
                return self._sun_tables[self._eye].buffer
            case "lamps":
                return self._lamp_table.buffer if self._lamp_table is not None else None
            case "lamp_slots" | "lamp_maps":
                return self._lamp_textures[name].texture
            case "shadow_compare":
                return self.atlas.sampled(_COMPARING)
        return self.atlas

    def update(self, frame: Frame, cameras: Sequence[Camera], bind_programs: BindPrograms) -> None:
        """Bring all maps that a frame needs up to date, for views of `cameras`.

        Args:
            bind_programs: returns the programs that draw what masks leave of objects.
        """
        resources = frame.resources
        scene = resources.scene
        if self._scene is not scene or self._used_settings != self.settings or self._follow_materials(scene):
            self._reset(scene)
        assert self._needed is not None
        self.casters_drawn = 0
        self._frame += 1
        self._tessellations = resources.tessellations
        seen = [resources.find_in_view(camera, np.arange(len(scene.objects))) for camera in cameras]
        visible = np.unique(np.concatenate(seen))
        wanted = self._needed.find(resources, frame.needs, cameras, visible, frame.targets.size)
        self._reported = [(key, "skipped", because, None) for key, because in self._needed.skipped]
        self._count_dark(len(self._needed.dark))
        self._place({one.key: one.size for one in wanted}, shrinks=self._forget_lights(scene))
        self._draw(frame, self._decide(scene, wanted), bind_programs)
        self.aim(frame.camera)
        self._write_lamps(scene, frame.needs)

    def _count_dark(self, count: int) -> None:
        """Note how many lamps are dark, and warn if more are than in the last frame."""
        if count > self.dark_lamps:
            LOGGER.warning(
                "%d lamps light nothing, because there is no room for their shadow maps; "
                "let fewer cast shadows, or shorten their ranges",
                count,
            )
        self.dark_lamps = count

    def aim(self, camera: Camera, eye: int = 0) -> None:
        """Give shaders the places of the maps of directional lights relative to the eye of `camera`, one of the `EYES`
        of a frame. Each eye has a table of its own, which is written only where it has changed."""
        self._eye = eye
        suns = [] if self._needed is None else self._needed.suns
        if not suns:
            return  # no shader reads them
        maps = []
        for number, (row, cascade, key) in enumerate(suns):
            x, y, size = self._maps[key].tile if key is not None else _NO_TILE
            next_row = suns[number + 1][0] if number + 1 < len(suns) else -1
            maps.append(
                SunMap(
                    axes=cascade.camera.rotation,
                    place=cascade.camera.rotation @ (cascade.camera.position - camera.position),
                    texel=cascade.texel,
                    middle=(x + 0.5 * size, y + 0.5 * size),
                    half=0.5 * size,
                    inner=cascade.inner,
                    length=cascade.length if key is not None else 0.0,
                    light=row,
                    is_last=int(next_row != row),
                )
            )
        while len(self._sun_tables) <= eye:
            self._sun_tables.append(MirroredValue(self._device, _make_table([], 0.0)))
        self._sun_tables[eye].write(_make_table(maps, self.settings.bias))

    def _write_lamps(self, scene: Scene, needs: Needs) -> None:
        """Give shaders the maps of lamps, if they have changed."""
        if not any(len(needs.in_view[kind.shadows]) for kind in LAMPS.values()):
            if not needs.counts[Effect.POINT_SHADOWS] + needs.counts[Effect.SPOT_SHADOWS]:
                self._forget_lamps()
            return  # no shader reads them
        assert self._needed is not None
        lamps, points, spots = self._needed.lamps, len(scene.lights.point), len(scene.lights.spot)
        written = (lamps, self._needed.dark, self._placements, points, spots)
        if written == self._written:
            return
        self._written = written
        slots = np.full(points + spots, NO_MAPS, np.int32)
        first = {"point": 0, "spot": points}
        for kind, row in self._needed.dark:
            slots[first[kind] + row] = DARK
        maps: list[tuple[Camera, Tile, float]] = []
        for kind, row, faces, keys in lamps:
            slots[first[kind] + row] = 2 * len(maps) + (len(keys) > 1)
            for camera, key in zip(faces.cameras, keys, strict=True):
                maps.append((camera, _NO_TILE if key is None else self._maps[key].tile, faces.scale))
        bias = self.settings.bias
        table = LampTable(bias=(bias * _BIAS[0], bias * _BIAS[1], bias), points=points)
        if self._lamp_table is None:
            self._lamp_table = MirroredValue(self._device, table)
        self._lamp_table.write(table)
        self._lamp_textures["lamp_slots"].write(slots)
        self._lamp_textures["lamp_maps"].write(_describe_maps(maps))

    def _forget_lights(self, scene: Scene) -> bool:
        """Forget the maps of lights that cast no shadows any more; return whether there were any."""
        lights = {SUN: scene.lights.directional, "point": scene.lights.point, "spot": scene.lights.spot}
        casting = {kind: some["casts_shadow"].astype(bool) for kind, some in lights.items()}
        state = tuple(some.tobytes() for some in casting.values())
        if state == self._casting:
            return False
        self._casting = state
        gone = [key for key in self._maps if key[1] >= len(casting[key[0]]) or not casting[key[0]][key[1]]]
        for key in gone:
            self._forget(key)
        return bool(gone)

    def _place(self, sizes: dict[MapKey, int], *, shrinks: bool = False) -> None:
        """Give each map a tile of its size. Maps that aren't wanted keep theirs until others need the room.

        Args:
            shrinks: whether the atlas becomes smaller if that is large enough.
        """
        for key in [key for key, size in sizes.items() if key in self._maps and self._maps[key].tile.size != size]:
            self._forget(key)
        self._fit(sizes, shrinks=shrinks)
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
            self._placements += 1

    def _fit(self, sizes: dict[MapKey, int], *, shrinks: bool) -> None:
        """Make the atlas large enough for tiles of these sizes, and no larger if it `shrinks`."""
        area = sum(size * size for size in sizes.values())
        side = self._tree.size if self._atlas is not None and not shrinks else 1
        while side * side < area:
            side *= 2
        if self._atlas is not None and side == self._tree.size:
            return
        self._forget_all()
        self._destroy_textures()
        self._tree = TileTree(side)
        self._atlas = self._device.texture((side, side), Format.D32F, label="shadow atlas")

    def _decide(self, scene: Scene, wanted: list[WantedMap]) -> MapWork:
        """Find what is to be drawn of the maps."""
        work, late = MapWork(), list[tuple[int, WantedMap, bytes]]()
        for each in wanted:
            one = self._maps[each.key]
            moving = describe_state(scene, each.casters.moving, self._tessellations)
            is_far = each.size <= self.settings.far_size and each.key[0] != SUN
            if one.still == each.still and one.moving == moving:
                self._report(each.key, "kept", "nothing in it has moved", each)
            elif one.still == each.still and each.is_quiet:
                self._report(each.key, "kept", "what moved in it shades nothing visible", each)
            elif one.still is None or one.still[0] != each.place or not is_far:
                self._add_work(work, each, moving)
            else:
                late.append((one.frame, each, moving))
        late.sort(key=lambda item: item[0])
        for number, (_, each, moving) in enumerate(late):
            if number < self.settings.budget:
                self._add_work(work, each, moving)
            else:
                self._report(each.key, "kept", f"{self.settings.budget} far maps are drawn in a frame", each)
        return work

    def _add_work(self, work: MapWork, wanted: WantedMap, moving: bytes) -> None:
        """Note what is to be drawn of a map that has changed."""
        one, casters, still = self._maps[wanted.key], wanted.casters, wanted.still
        if one.still != still:
            because = "it is new" if one.still is None else "the light, the view or its casters have changed"
            work.fresh.append((one, np.concatenate([casters.still, casters.moving])))
            one.copied = None
            one.view.write(_view_constants(wanted.camera))
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
        one.still, one.moving, one.frame = still, moving, self._frame
        self._report(wanted.key, "drawn", because, wanted)

    def _draw(self, frame: Frame, work: MapWork, bind_programs: BindPrograms) -> None:
        resources = frame.resources
        for _, rows in (*work.fresh, *work.over):
            resources.simulate(rows)
            self.casters_drawn += len(rows)
        self._draw_maps(frame, work.fresh, bind_programs, clears=True)
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
        self._draw_maps(frame, work.over, bind_programs, clears=False)

    def _draw_maps(
        self, frame: Frame, maps: Sequence[tuple[ShadowMap, Rows]], bind_programs: BindPrograms, *, clears: bool
    ) -> None:
        """Draw objects to the tiles of maps, in one pass."""
        if not maps:
            return
        assert self._needed is not None
        device, resources, is_masked = self._device, frame.resources, self._needed.casters.is_masked
        solid: Any = device.program(DepthOnly)
        buffers = {"objects": resources.objects.buffer, "places": resources.places.buffer}
        kinds: list[tuple[bool, Sequence[BoundProgram]]] = [(False, [BoundProgram(solid, buffers)])]
        if any(is_masked[rows].any() for _, rows in maps):
            kinds.append((True, bind_programs(frame)))
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
                    for masked, programs in kinds:
                        drawn = rows if len(kinds) == 1 else rows[is_masked[rows] == masked]
                        groups = resources.group[drawn] % (len(DRAW_GROUPS) * len(programs))  # with one, by states
                        for group in np.unique(groups).tolist():
                            program, bindings = choose_program(programs, group)
                            view = {"view": one.view.buffer}
                            with device.states(*find_states(group)):
                                resources.draw_rows(device, program, bindings | view, drawn[groups == group])

    def _report(self, key: MapKey, state: str, because: str, wanted: WantedMap | None = None) -> None:
        self._reported.append((key, state, because, wanted))

    def _follow_materials(self, scene: Scene) -> bool:
        """Find the casters again where objects are hidden or shown, or have other materials, and return whether all
        maps have to be drawn again, since materials cover something else than what they show."""
        if self._material_version == scene.material_version:
            return False
        self._material_version = scene.material_version
        if self._needed is None or self._needed.casters.coverage != find_coverage(scene):
            return True
        if self._needed.casters.looks != find_looks(scene):
            self._needed.casters = SceneCasters(scene)
        return False

    def _reset(self, scene: Scene) -> None:
        """Begin anew with a scene and the settings."""
        self._forget_all()
        self._destroy_textures()
        self._scene, self._needed = scene, NeededMaps(scene, self.settings)
        self._material_version = scene.material_version
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

    def _forget_lamps(self) -> None:
        """Destroy what tells shaders of the maps of lamps."""
        if self._lamp_table is not None:
            self._lamp_table.destroy()
        for texture in self._lamp_textures.values():
            texture.destroy()
        self._lamp_table = None
        self._written = ()

    def release(self) -> None:
        """Destroy all maps and tables. They are made again when a frame needs them."""
        self._scene = None
        self.dark_lamps = 0
        self._casting = ()
        self._reported = []
        self._forget_all()
        self._destroy_textures()
        for table in self._sun_tables:
            table.destroy()
        self._sun_tables.clear()
        self._forget_lamps()

    def destroy(self) -> None:
        """Destroy all resources on the device."""
        self.release()
        self._triangle.destroy()


def _make_report(key: MapKey, state: str, because: str, wanted: WantedMap | None) -> MapReport:
    kind, row, part = key
    name = f"{kind} light {row}" + (f", {'cascade' if kind == SUN else 'face'} {part}" if part >= 0 else "")
    size, casters = (wanted.size, len(wanted.casters)) if wanted is not None else (0, 0)
    return MapReport(name, size, casters, state, because)


def shadow_passes(needs: Needs, bind_programs: BindPrograms) -> list[Pass[Frame]]:
    """Return the pass that brings shadow maps up to date, if the frame needs any. Its maps outlive the frame.

    Args:
        bind_programs: returns the programs that draw what masks leave of objects, with any `view`.
    """
    reasons = [needs.explain(effect) for effect in SHADOW_EFFECTS if effect in needs.effects]
    if not reasons:
        return []

    def update_maps(frame: Frame) -> None:
        maps = frame.resources.workspace(ShadowMaps)
        if frame.first is None:
            maps.update(frame, [frame.view.around], bind_programs)
        else:  # the left eye's frame has drawn them for both
            maps.aim(frame.camera, 1)

    return [Pass("shadow maps", update_maps, "; ".join(reasons), has_side_effects=True)]


def describe_state(scene: Scene, rows: Rows, tessellations: int = 0) -> bytes:
    """Return bytes that change when one of the objects `rows` moves; those that are simulated always do. Height fields
    do if the triangles are chosen again: `tessellations` says how often they were."""
    if not len(rows):
        return b""
    objects = scene.objects
    seconds = np.float64(scene.seconds).tobytes() if objects.simulated[rows].any() else b""
    fields = list(scene.height_fields)
    chosen = np.int64(tessellations).tobytes() if fields and np.isin(fields, rows).any() else b""
    look = np.stack([rows, objects.mesh[rows], objects.material[rows]])
    return look.tobytes() + scene.nodes.world[objects.node[rows]].tobytes() + seconds + chosen


_NO_TILE: Final = Tile(0, 0, 0)
_NO_VIEW: Final = ViewConstants(relative_view_projection=np.eye(4), eye_high=np.zeros(3), eye_low=np.zeros(3))


def _make_table(maps: list[SunMap], bias: float) -> SunTable:
    empty = SunMap(
        axes=np.eye(3), place=np.zeros(3), texel=1.0, middle=(0, 0), half=0, inner=1, length=0, light=-1, is_last=0
    )
    filled = [*maps, *[empty] * (MOST_CASCADES - len(maps))]
    return SunTable(maps=filled, bias=(bias * _BIAS[0], bias * _BIAS[1], bias), count=len(maps))


def _describe_maps(maps: list[tuple[Camera, Tile, float]]) -> NDArray[np.float32]:
    """Return what shaders read of maps, (2 n, 4): see `ShadowReceiver`."""
    rows = [
        (
            turn_into_quaternion(camera.rotation),
            (tile.x + 0.5 * tile.size, tile.y + 0.5 * tile.size, 0.5 * tile.size, scale),
        )
        for camera, tile, scale in maps
    ]
    return np.array(rows, np.float32).reshape(-1, 4)


def _view_constants(camera: Camera) -> ViewConstants:
    high, low = split_doubles(camera.position)
    return ViewConstants(relative_view_projection=camera.relative_view_projection, eye_high=high, eye_low=low)
