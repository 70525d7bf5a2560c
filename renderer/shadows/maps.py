"""Shadow maps: tiles of an atlas for all maps that a frame needs; those that have changed are drawn again.

All maps are square tiles of one depth texture, the **atlas**. A map is drawn as a view of its own, from its
light, with its own casters. `renderer.shadows.map_planner` says which maps a frame needs. A map is kept from
frame to frame:

- **kept** if its camera, its casters that can't move and the state of those that may are those that it shows;
- **drawn over a copy** if only casters that may move have changed: what can't move is copied from a second
  texture, which is made when the first caster moves;
- **drawn** from scratch otherwise.

Small maps of local lights, which are far away, take turns: in a frame only some of them are drawn again,
those first that were drawn longest ago. Movers whose shadows aren't in view draw no map of a local light
again.

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
    LOCAL_LIGHTS,
    SHADOW_EFFECTS,
    BoundProgram,
    Effect,
    Frame,
    FrameEffects,
    FramePass,
    choose_program,
    draw_group_states,
)
from renderer.frame.mirrors import MirroredTable, MirroredValue, split_doubles
from renderer.frame.resources import DRAW_GROUPS, SceneResources
from renderer.light_kinds.table import LIGHT_KINDS, LOCAL_LIGHT_KINDS
from renderer.scene import Camera, Scene
from renderer.scene.arrays import Indices
from renderer.scene.lights import Lights
from renderer.shaders.depth import DepthOnly
from renderer.shaders.structs import ViewConstants
from renderer.shadows.casters import SceneCasters, appearance_key, coverage_key
from renderer.shadows.huge_casters import MAX_RECEIVER_ROUNDING, CutCaster, cut_to_map, widest_receiver
from renderer.shadows.local_light_maps import quaternion_from_axes
from renderer.shadows.map_planner import DIRECTIONAL, MapKey, MapPlanner, RequiredMap
from renderer.shadows.receiver import (
    MAX_CASCADES,
    NO_ATLAS_ROOM,
    NO_SHADOW,
    CascadeMap,
    CascadeTable,
    LocalShadowTable,
    scale_bias,
)
from renderer.shadows.shadow_settings import ShadowSettings
from renderer.shadows.tile_allocator import Tile, TileAllocator
from renderer.visibility.detail import DetailLimit
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
    UniformBuffer,
    Viewport,
    Wrap,
)
from rhi.shading import Shader, TextureBinding, vec4, vertex_index

LOGGER: Final = logging.getLogger("rhi.shadows")
"""Warns of local lights without room for their shadow maps, and of objects that are too wide for float32."""
_COARSE_RECEIVER: Final = (
    "shadows of the sun on object %d (mesh %r) are off by up to %.2g m, because float32 rounds its points: it "
    "is %.3g m wide; divide it into objects of at most %.3g m"
)
_COARSE_CASTER: Final = (
    "the sun's shadow of object %d (mesh %r) is off by up to %.2g m, because float32 rounds its corners, and a "
    "mask, a simulated or tessellated mesh or a mesh of many triangles isn't cut to the map: it is %.3g m wide; "
    "divide it into objects of at most %.3g m"
)

_COMPARING: Final = SamplerDescriptor(
    mip=None,
    wrap_u=Wrap.CLAMP,
    wrap_v=Wrap.CLAMP,
    minify=Filter.LINEAR,
    magnify=Filter.LINEAR,
    compare=Comparison.GREATER_EQUAL,
)

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
        name: the light and the part of it.
        size: the width of the map in texels.
        casters: the objects in it.
        state: drawn, kept or skipped.
        reason: why.
    """

    name: str
    size: int
    casters: int
    state: str
    reason: str


@dataclass(eq=False, slots=True)
class ShadowMap:
    """A map in the atlas, and what it shows.

    Attributes:
        view: the constants of its camera.
        static: the pose and the casters that can't move which it shows, None if nothing yet.
        dynamic: the state of the other casters in it.
        copied: what the second texture holds of its tile.
        frame: the number of the frame in which it was drawn last.
        required: the map as it was drawn last.
        upper_views: the constants of its casters' upper cameras.
    """

    tile: Tile
    view: MirroredValue[ViewConstants]
    static: tuple[object, ...] | None = None
    dynamic: bytes = b""
    copied: tuple[object, ...] | None = None
    frame: int = 0
    required: RequiredMap | None = None
    upper_views: list[MirroredValue[ViewConstants]] = field(default_factory=list)

    def require(self, device: Device, required: RequiredMap) -> None:
        """Prepare to draw the map with these casters."""
        self.required = required
        upper = required.casters.upper
        while len(self.upper_views) < len(upper):
            self.upper_views.append(MirroredValue(device, _NO_VIEW))
        for view, (camera, _) in zip(self.upper_views, upper, strict=False):
            view.write(_view_constants(camera))

    def parts(self, rows: Indices) -> list[tuple[UniformBuffer[ViewConstants], Viewport, Indices]]:
        """Return the draws of casters `rows`: the view, the viewport, and those of them that are drawn so.
        What reaches above the map is drawn at its near plane, also if the rest of the object is drawn in its
        depth range. Huge casters are left out."""
        assert self.required is not None
        x, y, size = self.tile
        casters = self.required.casters
        within = rows
        if len(casters.beyond) or len(casters.huge):
            within = rows[~np.isin(rows, np.concatenate([casters.beyond, casters.huge]))]
        parts = [(self.view.buffer, Viewport(x, y, size, size), within)]
        for view, (_, upper) in zip(self.upper_views, casters.upper, strict=False):
            parts.append((view.buffer, Viewport(x, y, size, size, 1.0, 1.0), rows[np.isin(rows, upper)]))
        return parts

    def destroy(self) -> None:
        """Destroy the constants of the map's cameras."""
        for view in (self.view, *self.upper_views):
            view.destroy()
        self.upper_views.clear()


@dataclass(eq=False, slots=True)
class MapUpdates:
    """The shadow maps to be drawn in a frame: maps from scratch, copies, and casters over those."""

    redrawn: list[tuple[ShadowMap, Indices]] = field(default_factory=list)
    copied_out: list[ShadowMap] = field(default_factory=list)
    copied_back: list[ShadowMap] = field(default_factory=list)
    drawn_over: list[tuple[ShadowMap, Indices]] = field(default_factory=list)


class ShadowMaps:
    """The shadow maps of a scene on a device.

    Attributes:
        settings: they may be replaced between two frames.
        casters_drawn: the number of objects that were drawn to maps in the last frame.
        unshadowed_lights: the number of local lights that light nothing in the last frame, because there is
            no room for their maps.
        coarse_objects: the indices of objects that were seen, or cast shadows and can't be cut, and are so wide
            that float32 rounds their points by more than the shadows of the sun are fine.
    """

    def __init__(self, device: Device) -> None:
        self.settings = ShadowSettings()
        self._reported: list[tuple[MapKey, str, str, RequiredMap | None]] = []
        self.casters_drawn = 0
        self.unshadowed_lights = 0
        self.coarse_objects: set[int] = set()
        self._widest = 0.0  # the largest extent of an object in metres
        self._device = device
        self._scene: Scene | None = None
        self._needed: MapPlanner | None = None
        self._material_version = -1  # of the materials that the maps show
        self._used_settings = self.settings, 0.0  # and the error of levels of detail
        self._maps: dict[MapKey, ShadowMap] = {}
        self._tree = TileAllocator(1)
        self._atlas: Texture | None = None
        self._static_atlas: Texture | None = None  # the second texture
        self._triangle = device.mesh(3, label="shadow tile")
        self._local_light_table: MirroredValue[LocalShadowTable] | None = None
        self._local_light_textures = {  # by what binds them
            "shadow_slots": MirroredTable(device, Format.R32I, "shadow slots"),
            "local_shadow_maps": MirroredTable(device, Format.RGBA32F, "local shadow maps"),
            "shadow_sources": MirroredTable(device, Format.R32F, "shadow sources"),
        }
        self._placements = 0  # how often a tile was given to a map
        self._written: tuple[object, ...] = ()  # what the table of local lights was written from
        self._written_sources = b""  # what the radii of sources were written from
        self._frame = 0
        self._sun_tables: list[MirroredValue[CascadeTable]] = []  # of the eyes that there have been
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
        assert self._atlas is not None, "shadow maps must be updated before they are read"
        return self._atlas

    @property
    def tiles(self) -> dict[MapKey, Tile]:
        """The tile of each map."""
        return {key: shadow_map.tile for key, shadow_map in self._maps.items()}

    @property
    def cascade_table(self) -> UniformBuffer[CascadeTable]:
        """The cascades of directional lights, as the eye that is drawn sees them."""
        return self._sun_tables[self._eye].buffer

    @property
    def local_shadow_table(self) -> UniformBuffer[LocalShadowTable] | None:
        """The settings of the maps of local lights; None before the first map."""
        return None if self._local_light_table is None else self._local_light_table.buffer

    @property
    def shadow_slots(self) -> Texture | None:
        """The number of the first map of each local light."""
        return self._local_light_textures["shadow_slots"].texture

    @property
    def local_shadow_maps(self) -> Texture | None:
        """The matrices and tiles of the maps of local lights."""
        return self._local_light_textures["local_shadow_maps"].texture

    @property
    def shadow_sources(self) -> Texture | None:
        """The radius in metres of the source of each local light; None if no penumbra is filtered."""
        return self._local_light_textures["shadow_sources"].texture

    @property
    def compared_atlas(self) -> TextureBinding:
        """The texture with all maps, sampled by comparison with a depth."""
        return self.atlas.sampled(_COMPARING)

    def update(self, frame: Frame, cameras: Sequence[Camera], bind_programs: BindPrograms) -> None:
        """Bring all maps that a frame needs up to date, for views of `cameras`.

        Args:
            bind_programs: returns the programs that draw what masks leave of objects.
        """
        resources = frame.resources
        scene = resources.scene
        used_settings = self.settings, resources.detail_error
        if self._scene is not scene or self._used_settings != used_settings or self._follow_materials(scene):
            self._reset(scene)
            self._used_settings = used_settings
        assert self._needed is not None
        self.casters_drawn = 0
        self._frame += 1
        self._tessellations, self._facing_key = resources.tessellations, resources.get_facing_key()
        seen = [resources.select_in_view(camera, np.arange(len(scene.objects))) for camera in cameras]
        visible = np.unique(np.concatenate(seen))
        required = self._needed.plan_maps(resources, frame.effects, cameras, visible, frame.targets.size)
        self._reported = [(key, "skipped", reason, None) for key, reason in self._needed.skipped]
        self._warn_without_room(len(self._needed.without_room))
        self._warn_of_rounding(scene, visible)
        for required_map in required:
            if required_map.cascade is not None and len(required_map.casters.uncut):
                uncut, texel = required_map.casters.uncut, required_map.cascade.texel
                self._warn_of_objects(_COARSE_CASTER, scene, uncut, texel)
        self._allocate_tiles(
            {required_map.key: required_map.size for required_map in required},
            shrinks=self._forget_lights(resources.lights),
        )
        self._draw(frame, self._decide(scene, required), bind_programs)
        self.aim(frame.camera)
        self._write_local_lights(resources.lights, frame.effects)
        self._write_sources(resources.lights, frame.effects)

    def _warn_without_room(self, count: int) -> None:
        """Count the local lights that are dark, and warn if more are than in the last frame."""
        if count > self.unshadowed_lights:
            LOGGER.warning(
                "%d local lights are disabled, because there is no room for their shadow maps; "
                "make fewer lights cast shadows, or shorten their ranges",
                count,
            )
        self.unshadowed_lights = count

    def _warn_of_rounding(self, scene: Scene, visible: Indices) -> None:
        """Warn, once for each object, of visible ones so wide that float32 rounds their points by more than
        the shadows of the sun are fine."""
        assert self._needed is not None
        texels = [cascade.texel for _, cascade, key in self._needed.cascades if key is not None]
        if texels and self._widest > widest_receiver(min(texels)):
            self._warn_of_objects(_COARSE_RECEIVER, scene, visible, min(texels))

    def _warn_of_objects(self, message: str, scene: Scene, rows: Indices, texel: float) -> None:
        """Warn, once for each object, of those so wide that float32 rounds their points by more than a map with
        this texel is fine."""
        objects, limit = scene.objects, widest_receiver(texel)
        extent = (objects.upper[rows] - objects.lower[rows]).max(1, initial=0.0)
        is_wide = extent > limit
        for row, width in zip(rows[is_wide].tolist(), extent[is_wide].tolist(), strict=True):
            if row not in self.coarse_objects:
                self.coarse_objects.add(row)
                error = width / limit * MAX_RECEIVER_ROUNDING * texel
                LOGGER.warning(message, row, scene.meshes.names[objects.mesh[row]], error, width, limit)

    def aim(self, camera: Camera, eye: int = 0) -> None:
        """Write the table of the cascades, whose positions are relative to the eye of `camera`, one of the
        `MAX_EYES` of a frame. Each eye has a table of its own, which is written only where it has changed. It
        has no cascades if none of them has a map, as in a view of the sky."""
        self._eye = eye
        cascades = [] if self._needed is None else self._needed.cascades
        if not cascades:
            return  # no shader reads them
        if all(key is None for _, _, key in cascades):
            cascades = []  # so that the table stays as it is while the eye moves
        maps = []
        for number, (light_index, cascade, key) in enumerate(cascades):
            x, y, size = self._maps[key].tile if key is not None else _NO_TILE
            next_row = cascades[number + 1][0] if number + 1 < len(cascades) else -1
            maps.append(
                CascadeMap(
                    axes=cascade.camera.rotation,
                    middle=cascade.camera.rotation @ (cascade.camera.position - camera.position),
                    texel=cascade.texel,
                    center=(x + 0.5 * size, y + 0.5 * size),
                    half=0.5 * size,
                    inner=cascade.inner,
                    length=cascade.length if key is not None else 0.0,
                    light=light_index,
                    is_last=int(next_row != light_index),
                    source=cascade.source,
                )
            )
        while len(self._sun_tables) <= eye:
            self._sun_tables.append(MirroredValue(self._device, _make_table([], 0.0)))
        self._sun_tables[eye].write(_make_table(maps, self.settings.bias))

    def _write_local_lights(self, lights: Lights, effects: FrameEffects) -> None:
        """Write the table, slots and tiles of the local lights' maps, if they have changed."""
        if not any(len(effects.in_view[row.shadows]) for row in LOCAL_LIGHTS.values()):
            if not any(effects.counts[row.shadows] for row in LOCAL_LIGHTS.values()):
                self._destroy_local_tables()
            return  # no shader reads them
        assert self._needed is not None
        local_lights, ends = self._needed.local_lights, [0]
        for kind in LOCAL_LIGHT_KINDS:
            ends.append(ends[-1] + len(lights.of_kind(kind)))
        written = (local_lights, self._needed.without_room, self._placements, ends)
        if written == self._written:
            return
        self._written = written
        slots = np.full(ends[-1], NO_SHADOW, np.int32)
        first = {kind.name: begin for kind, begin in zip(LOCAL_LIGHT_KINDS, ends, strict=False)}
        for name, light_index in self._needed.without_room:
            slots[first[name] + light_index] = NO_ATLAS_ROOM
        maps: list[tuple[Camera, Tile, float]] = []
        for name, light_index, faces, keys in local_lights:
            slots[first[name] + light_index] = 2 * len(maps) + (len(keys) > 1)
            for camera, key in zip(faces.cameras, keys, strict=True):
                maps.append((camera, _NO_TILE if key is None else self._maps[key].tile, faces.scale))
        bias = self.settings.bias
        table = LocalShadowTable(bias=scale_bias(bias), **_first_slots(first))
        if self._local_light_table is None:
            self._local_light_table = MirroredValue(self._device, table)
        self._local_light_table.write(table)
        self._local_light_textures["shadow_slots"].write(slots)
        self._local_light_textures["local_shadow_maps"].write(_describe_maps(maps))

    def _write_sources(self, lights: Lights, effects: FrameEffects) -> None:
        """Write the radii of the local lights' sources, if the frame filters penumbras."""
        sources = self._local_light_textures["shadow_sources"]
        if Effect.LOCAL_PENUMBRAS not in effects.enabled:
            if not (effects.filters_penumbras and effects.counts[Effect.LOCAL_PENUMBRAS]):
                sources.destroy()
                self._written_sources = b""
            return
        radii = np.concatenate([lights.of_kind(kind)["source_radius"] for kind in LOCAL_LIGHT_KINDS])
        if radii.tobytes() != self._written_sources:
            self._written_sources = radii.tobytes()
            sources.write(radii)

    def _forget_lights(self, lights: Lights) -> bool:
        """Forget the maps of lights that cast no shadows any more; return whether there were any."""
        casting = {kind.name: lights.of_kind(kind)["casts_shadow"].astype(bool) for kind in LIGHT_KINDS}
        state = tuple(casts.tobytes() for casts in casting.values())
        if state == self._casting:
            return False
        self._casting = state
        removed = [key for key in self._maps if key[1] >= len(casting[key[0]]) or not casting[key[0]][key[1]]]
        for key in removed:
            self._forget(key)
        return bool(removed)

    def _allocate_tiles(self, sizes: dict[MapKey, int], *, shrinks: bool = False) -> None:
        """Allocate a tile of its size to each map. Maps that the frame doesn't need keep theirs until others
        need the room.

        Args:
            shrinks: whether the atlas becomes smaller if a smaller one is large enough.
        """
        for key in [
            key for key, size in sizes.items() if key in self._maps and self._maps[key].tile.size != size
        ]:
            self._forget(key)
        self._fit(sizes, shrinks=shrinks)
        for key, size in sorted(sizes.items(), key=lambda item: -item[1]):
            if key in self._maps:
                continue
            tile = self._tree.allocate(size)
            if tile is None:
                for other in [other for other in self._maps if other not in sizes]:
                    self._forget(other)
                tile = self._tree.allocate(size)
            if tile is None:  # the free tiles are too small, though all of them together are large enough
                self._forget_all()
                self._allocate_tiles(sizes)
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
        self._tree = TileAllocator(side)
        self._atlas = self._device.texture((side, side), Format.D32F, label="shadow atlas")

    def _decide(self, scene: Scene, required: list[RequiredMap]) -> MapUpdates:
        """Return which maps are drawn again, copied or kept, and report why."""
        work, late = MapUpdates(), list[tuple[int, RequiredMap, bytes]]()
        for required_map in required:
            shadow_map = self._maps[required_map.key]
            dynamic = casters_state_key(
                scene, required_map.casters.dynamic, self._tessellations, self._facing_key
            )
            is_far = required_map.size <= self.settings.far_size and required_map.key[0] != DIRECTIONAL
            if shadow_map.static == required_map.static and shadow_map.dynamic == dynamic:
                self._report(required_map.key, "kept", "nothing in it has moved", required_map)
            elif shadow_map.static == required_map.static and required_map.is_quiet:
                self._report(
                    required_map.key, "kept", "what moved in it shades nothing visible", required_map
                )
            elif shadow_map.static is None or shadow_map.static[0] != required_map.pose or not is_far:
                self._add_work(work, required_map, dynamic)
            else:
                late.append((shadow_map.frame, required_map, dynamic))
        late.sort(key=lambda item: item[0])
        for number, (_, required_map, dynamic) in enumerate(late):
            if number < self.settings.budget:
                self._add_work(work, required_map, dynamic)
            else:
                self._report(
                    required_map.key,
                    "kept",
                    f"{self.settings.budget} far maps are drawn in a frame",
                    required_map,
                )
        return work

    def _add_work(self, work: MapUpdates, required: RequiredMap, dynamic: bytes) -> None:
        """Add a map that has changed to the frame's updates."""
        shadow_map = self._maps[required.key]
        casters = required.casters
        static = required.static
        shadow_map.require(self._device, required)
        if shadow_map.static != static:
            reason = (
                "it is new"
                if shadow_map.static is None
                else "the light, the view or its casters have changed"
            )
            work.redrawn.append((shadow_map, np.concatenate([casters.static, casters.dynamic])))
            shadow_map.copied = None
            shadow_map.view.write(_view_constants(required.camera))
        else:
            reason = "a caster has moved"
            if shadow_map.copied == static:
                work.copied_back.append(shadow_map)
            else:
                if shadow_map.dynamic:
                    work.redrawn.append((shadow_map, casters.static))
                work.copied_out.append(shadow_map)
                shadow_map.copied = static
            if len(casters.dynamic):
                work.drawn_over.append((shadow_map, casters.dynamic))
        shadow_map.static, shadow_map.dynamic, shadow_map.frame = static, dynamic, self._frame
        self._report(required.key, "drawn", reason, required)

    def _draw(self, frame: Frame, work: MapUpdates, bind_programs: BindPrograms) -> None:
        resources = frame.resources
        for _, rows in (*work.redrawn, *work.drawn_over):
            resources.simulate(rows)
            self.casters_drawn += len(rows)
        self._draw_maps(frame, work.redrawn, bind_programs, clears=True)
        if work.copied_out and self._static_atlas is None:
            size = self.atlas.size
            self._static_atlas = self._device.texture(
                size, Format.D32F, label="shadow maps of what can't move"
            )
        for source, target, maps in (
            (self._atlas, self._static_atlas, work.copied_out),
            (self._static_atlas, self._atlas, work.copied_back),
        ):
            for shadow_map in maps:
                assert source is not None
                assert target is not None
                x, y, side = shadow_map.tile
                source.copy_to(target, region=Region(x, y, side, side), x=x, y=y)
        self._draw_maps(frame, work.drawn_over, bind_programs, clears=False)

    def _draw_maps(
        self,
        frame: Frame,
        maps: Sequence[tuple[ShadowMap, Indices]],
        bind_programs: BindPrograms,
        *,
        clears: bool,
    ) -> None:
        """Draw objects to the tiles of maps, in one pass."""
        if not maps:
            return
        assert self._needed is not None
        device = self._device
        resources = frame.resources
        is_masked = self._needed.casters.is_masked
        solid: Any = device.program(DepthOnly)
        buffers = {"objects": resources.objects.buffer, "object_positions": resources.object_positions.buffer}
        kinds: list[tuple[bool, Sequence[BoundProgram]]] = [(False, [BoundProgram(solid, buffers)])]
        if any(is_masked[rows].any() for _, rows in maps):
            kinds.append((True, bind_programs(frame)))
        faces = CullMode.FRONT if self.settings.back_faces else CullMode.BACK
        with (
            device.render_pass(None, self.atlas),
            device.states(DepthTest.ON, DepthWrite.ON, DepthFunction.GREATER, faces),
        ):
            for shadow_map, rows in maps:
                x, y, size = shadow_map.tile
                assert shadow_map.required is not None
                limit = None
                if resources.uses_levels:
                    cameras = [shadow_map.required.camera]
                    limit = DetailLimit.compute(cameras, (size, size), resources.detail_error)
                for number, (view, viewport, casters) in enumerate(shadow_map.parts(rows)):
                    with device.states(viewport, Scissor(x, y, size, size)):
                        if number == 0:
                            if clears:
                                with device.states(DepthFunction.ALWAYS, CullMode.NONE):
                                    device.draw(device.program(FarDepth), self._triangle)
                            self._draw_huge(resources, shadow_map, rows)
                        for masked, programs in kinds:
                            drawn = casters if len(kinds) == 1 else casters[is_masked[casters] == masked]
                            # With one program, groups differ by their states alone.
                            groups = resources.group[drawn] % (len(DRAW_GROUPS) * len(programs))
                            for group in np.unique(groups).tolist():
                                program, bindings = choose_program(programs, group)
                                bindings = bindings | {"view": view}
                                with device.states(*draw_group_states(group)):
                                    resources.draw_objects(
                                        device, program, bindings, drawn[groups == group], limit
                                    )

    def _draw_huge(self, resources: SceneResources, shadow_map: ShadowMap, rows: Indices) -> None:
        """Draw those of the casters `rows` that are huge beside a map, cut to it."""
        required = shadow_map.required
        if required is None or required.cascade is None or not len(required.casters.huge):
            return
        huge = rows[np.isin(rows, required.casters.huge)]
        groups = resources.group[huge] % len(DRAW_GROUPS)
        for group in np.unique(groups).tolist():
            triangles = cut_to_map(resources.scene, huge[groups == group], required.cascade)
            if not len(triangles):
                continue
            vertices = np.zeros(3 * len(triangles), [("position", "<f4", 3)])
            vertices["position"] = triangles.reshape(-1, 3)
            mesh = self._device.mesh(vertices, label="huge casters")
            with self._device.states(*draw_group_states(group)):
                self._device.draw(self._device.program(CutCaster), mesh, view=shadow_map.view.buffer)
            mesh.destroy()

    def _report(self, key: MapKey, state: str, reason: str, required: RequiredMap | None = None) -> None:
        self._reported.append((key, state, reason, required))

    def _follow_materials(self, scene: Scene) -> bool:
        """Collect the casters again if objects were hidden or shown, or have other materials. Return whether
        all maps have to be drawn again: materials are transparent, masks or two-sided otherwise than the maps
        show."""
        if self._material_version == scene.material_version:
            return False
        self._material_version = scene.material_version
        if self._needed is None or self._needed.casters.coverage != coverage_key(scene):
            return True
        if self._needed.casters.appearance != appearance_key(scene):
            self._needed.casters = SceneCasters(scene)
        return False

    def _reset(self, scene: Scene) -> None:
        """Start with a new scene or new settings: no map is reused."""
        self._forget_all()
        self._destroy_textures()
        self._scene, self._needed = scene, MapPlanner(scene, self.settings)
        self._widest = float((scene.objects.upper - scene.objects.lower).max(initial=0.0))
        self.coarse_objects.clear()
        self._material_version = scene.material_version

    def _forget(self, key: MapKey) -> None:
        shadow_map = self._maps.pop(key)
        self._tree.free(shadow_map.tile)
        shadow_map.destroy()

    def _forget_all(self) -> None:
        for key in list(self._maps):
            self._forget(key)

    def _destroy_textures(self) -> None:
        for texture in (self._atlas, self._static_atlas):
            if texture is not None:
                texture.destroy()
        self._atlas = self._static_atlas = None

    def _destroy_local_tables(self) -> None:
        """Destroy the table and the textures with the local lights' maps."""
        if self._local_light_table is not None:
            self._local_light_table.destroy()
        for texture in self._local_light_textures.values():
            texture.destroy()
        self._local_light_table = None
        self._written = ()
        self._written_sources = b""

    def release(self) -> None:
        """Destroy all maps and tables. They are made again when a frame needs them."""
        self._scene = None
        self.unshadowed_lights = 0
        self._casting = ()
        self._reported = []
        self._forget_all()
        self._destroy_textures()
        for table in self._sun_tables:
            table.destroy()
        self._sun_tables.clear()
        self._destroy_local_tables()

    def destroy(self) -> None:
        """Destroy all resources on the device."""
        self.release()
        self._triangle.destroy()


def _make_report(key: MapKey, state: str, reason: str, required: RequiredMap | None) -> MapReport:
    kind, light_index, part = key
    name = f"{kind} light {light_index}" + (
        f", {'cascade' if kind == DIRECTIONAL else 'face'} {part}" if part >= 0 else ""
    )
    size, casters = (required.size, len(required.casters)) if required is not None else (0, 0)
    return MapReport(name, size, casters, state, reason)


def shadow_passes(effects: FrameEffects, bind_programs: BindPrograms) -> list[FramePass[Frame]]:
    """Return the pass that brings shadow maps up to date, if the frame needs any. Its maps outlive the frame.

    Args:
        bind_programs: returns the programs that draw what masks leave of objects, with any `view`.
    """
    reasons = [effects.explain(effect) for effect in SHADOW_EFFECTS if effect in effects.enabled]
    if not reasons:
        return []

    def update_maps(frame: Frame) -> None:
        maps = frame.resources.workspace(ShadowMaps)
        if frame.first is None:
            maps.update(frame, [frame.view.around], bind_programs)
        else:  # the left eye's frame has drawn them for both
            maps.aim(frame.camera, 1)

    return [FramePass("shadow maps", update_maps, "; ".join(reasons), has_side_effects=True)]


def casters_state_key(scene: Scene, rows: Indices, tessellations: int = 0, facing_key: bytes = b"") -> bytes:
    """Return bytes that change when one of the objects `rows` moves; those that are simulated always do.
    Tessellated surfaces do if the triangles are chosen again: `tessellations` says how often they were. Simulations
    that face the eye do if it moves: `facing_key` says where it is."""
    if not len(rows):
        return b""
    objects = scene.objects
    has_simulated = objects.simulated[rows].any()
    seconds = np.float64(scene.seconds).tobytes() + facing_key if has_simulated else b""
    fields = list(scene.tessellated)
    triangle_choices = np.int64(tessellations).tobytes() if fields and np.isin(fields, rows).any() else b""
    look = np.stack([rows, objects.mesh[rows], objects.material[rows]])
    return look.tobytes() + scene.nodes.world[objects.node[rows]].tobytes() + seconds + triangle_choices


_NO_TILE: Final = Tile(0, 0, 0)
_NO_VIEW: Final = ViewConstants(relative_view_projection=np.eye(4), eye_high=np.zeros(3), eye_low=np.zeros(3))


def _first_slots(first: dict[str, int]) -> dict[str, int]:
    """Return the fields of a `LocalShadowTable` that say with which slot each kind of lights but the first
    begins."""
    return {f"{kind.name}_slots": first[kind.name] for kind in LOCAL_LIGHT_KINDS[1:]}


def _make_table(maps: list[CascadeMap], bias: float) -> CascadeTable:
    empty = CascadeMap(
        axes=np.eye(3),
        middle=np.zeros(3),
        texel=1.0,
        center=(0, 0),
        half=0,
        inner=1,
        length=0,
        light=-1,
        is_last=0,
        source=0.0,
    )
    filled = [*maps, *[empty] * (MAX_CASCADES - len(maps))]
    return CascadeTable(maps=filled, bias=scale_bias(bias), count=len(maps))


def _describe_maps(maps: list[tuple[Camera, Tile, float]]) -> NDArray[np.float32]:
    """Return two texels (2 n, 4) for each map, its rotation and its tile: see `ShadowMapReader`."""
    rows = [
        (
            quaternion_from_axes(camera.rotation),
            (tile.x + 0.5 * tile.size, tile.y + 0.5 * tile.size, 0.5 * tile.size, scale),
        )
        for camera, tile, scale in maps
    ]
    return np.array(rows, np.float32).reshape(-1, 4)


def _view_constants(camera: Camera) -> ViewConstants:
    high, low = split_doubles(camera.position)
    return ViewConstants(relative_view_projection=camera.relative_view_projection, eye_high=high, eye_low=low)
