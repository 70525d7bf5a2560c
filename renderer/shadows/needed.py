"""The shadow maps that a frame needs: those of lights that reach something visible and have a caster.

A cascade of a directional light needs something visible in it and a caster in front of that; a map of a lamp something
visible in the lamp's range and a caster in the map. What doesn't have both is **skipped**. Maps of lamps are as wide as
what the lamps light on the screen; if there is no room for all, the widest are halved first. Where maps are in the
atlas, and which of them are drawn, is not decided here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from renderer.frame import Effect, Needs
from renderer.frame.resources import SceneResources
from renderer.lights.lists import list_lights
from renderer.scene import Camera, Scene
from renderer.scene.arrays import Floats, Rows
from renderer.shadows.cascades import Cascade, fit_cascades
from renderer.shadows.casters import Casters, SceneCasters, find_moving, turn_boxes
from renderer.shadows.lamps import aim_maps, choose_width, find_scale, find_widths, is_cube, shrink
from renderer.shadows.receiver import MOST_CASCADES
from renderer.shadows.settings import ShadowSettings
from renderer.visibility.boxes.volumes import find_inside

SUN: Final = "directional"
"""The kind of directional lights."""

MapKey = tuple[str, int, int]
"""The name of a map: the kind of its light, the light's row, and which of its maps it is."""

_STEP: Final = 16.0  # metres, by which the depth of what parallel views show is rounded


@dataclass(frozen=True, eq=False, slots=True)
class WantedMap:
    """A map that the frame needs.

    Attributes:
        place: what its camera is. still: the same, and which casters can't move: the map is drawn again if it changes.
        is_quiet: whether no caster that may move shades anything visible.
    """

    key: MapKey
    camera: Camera
    size: int
    casters: Casters
    place: tuple[object, ...]
    still: tuple[object, ...]
    is_quiet: bool = False

    @classmethod
    def make(cls, key: MapKey, camera: Camera, size: int, casters: Casters) -> WantedMap:
        """Return a map whose casters may all shade something visible."""
        place = camera.position.tobytes(), camera.rotation.tobytes(), camera.projection
        return cls(key, camera, size, casters, place, (place, casters.still.tobytes()))


@dataclass(eq=False, slots=True)
class LampMaps:
    """The maps of a lamp, each `width` texels wide: their cameras, the planes (m, p, 4) of what they see, and what is
    wanted of each without the casters that may move. They hold as long as `key` is the same."""

    key: tuple[object, ...]
    width: int
    cameras: list[Camera]
    planes: Floats
    wanted: list[WantedMap]
    scale: float


@dataclass(frozen=True, eq=False, slots=True)
class WantedLamp:
    """A lamp that casts a shadow on something visible, and the casters in its range."""

    kind: str
    row: int
    light: Any
    width: float
    casters: Casters


class NeededMaps:
    """Finds the maps that frames of a scene need, with the settings that they have.

    Attributes:
        casters: the casters of the scene.
        suns: of the last frame, the cascades of directional lights: the light's row, and the key of the map, if any.
        lamps: the lamps that have maps: the kind and the row, and the keys of those maps that have a caster.
        dark: the lamps, by kind and row, for whose maps there is no room: they light nothing.
        skipped: the lights, cascades and faces without maps, and why.
    """

    def __init__(self, scene: Scene, settings: ShadowSettings) -> None:
        self.casters = SceneCasters(scene)
        self.suns: list[tuple[int, Cascade, MapKey | None]] = []
        self.lamps: list[tuple[str, int, LampMaps, list[MapKey | None]]] = []
        self.dark: list[tuple[str, int]] = []
        self.skipped: list[tuple[MapKey, str]] = []
        self._settings = settings
        self._faces: dict[tuple[str, int], LampMaps] = {}

    def find(
        self,
        resources: SceneResources,
        needs: Needs,
        cameras: Sequence[Camera],
        visible: Rows,
        size: tuple[int, int],
    ) -> list[WantedMap]:
        """Return the maps that a frame of this `size` needs, for views of `cameras` and the `visible` objects."""
        self.skipped = []
        suns = self._want_suns(resources, needs, cameras, visible)
        return suns + self._want_lamps(resources, needs, cameras, visible, size)

    def _want_suns(
        self, resources: SceneResources, needs: Needs, cameras: Sequence[Camera], visible: Rows
    ) -> list[WantedMap]:
        """Return the cascades that have something visible and a caster, and note all of them."""
        self.suns = []
        wanted: list[WantedMap] = []
        scene = resources.scene
        if Effect.SUN_SHADOWS not in needs.effects:
            return wanted
        depth = _find_depth(scene, cameras[0])
        rows = np.flatnonzero(scene.lights.directional["casts_shadow"])[:MOST_CASCADES].tolist()
        settings = replace(self._settings, cascades=min(self._settings.cascades, MOST_CASCADES // len(rows)))
        for row in rows:
            direction = scene.lights.directional["direction"][row].astype(np.float64)
            axes = Camera.look_at((0, 0, 0), direction).rotation
            boxes = self.casters.turn(row, axes)
            receivers = turn_boxes(scene, visible, axes)
            for part, cascade in enumerate(fit_cascades(cameras, direction, settings, boxes.top, depth)):
                key, found = (SUN, row, part), boxes.find(cascade, receivers)
                if found is None or not len(found):
                    reason = "nothing visible is in it" if found is None else "no caster is in it"
                    self.skipped.append((key, reason))
                    self.suns.append((row, cascade, None))
                else:
                    wanted.append(WantedMap.make(key, cascade.camera, self._settings.cascade_size, found))
                    self.suns.append((row, cascade, key))
        return wanted

    def _want_lamps(
        self,
        resources: SceneResources,
        needs: Needs,
        cameras: Sequence[Camera],
        visible: Rows,
        size: tuple[int, int],
    ) -> list[WantedMap]:
        """Return the maps of lamps that reach something visible and have a caster, and note all of them."""
        scene, settings, found = resources.scene, self._settings, list[WantedLamp]()
        lower, upper = scene.objects.lower[visible], scene.objects.upper[visible]
        for kind, lights, rows in (
            ("point", resources.lights.point, needs.in_view[Effect.POINT_SHADOWS]),
            ("spot", resources.lights.spot, needs.in_view[Effect.SPOT_SHADOWS]),
        ):
            if not len(rows):
                continue
            some = lights[rows]
            _, reaching = list_lights(lower, upper, some["position"], some["range"].astype(np.float64))
            reaches = np.bincount(reaching, minlength=len(rows)) > 0
            still, moving = self.casters.find_in_reach(kind, lights)
            for i, (row, width) in enumerate(zip(rows.tolist(), find_widths(cameras, size, some), strict=True)):
                casters = Casters(still[row], moving[row])
                if reaches[i] and len(casters):
                    found.append(WantedLamp(kind, row, some[i], float(width), casters))
                else:
                    reason = "no caster is in its range" if reaches[i] else "it reaches nothing visible"
                    self.skipped.append(((kind, row, -1), reason))
        suns = sum(key is not None for _, _, key in self.suns)
        room = settings.largest_atlas**2 - suns * settings.cascade_size**2
        lamps = [(lamp, self._aim(scene, lamp, width)) for lamp, width in self._choose_widths(found, room)]
        listed = [faces.wanted for _, faces in lamps]
        if movers := [i for i, (lamp, _) in enumerate(lamps) if len(lamp.casters.moving)]:
            shown, shades = find_moving(
                scene,
                np.array([lamps[i][0].light["position"] for i in movers]),
                np.array([lamps[i][0].light["range"] for i in movers], np.float64),
                [lamps[i][1].planes for i in movers],
                [lamps[i][0].casters.moving for i in movers],
                cameras,
            )
            maps = iter(zip(shown, shades.tolist(), strict=True))
            for i in movers:
                listed[i] = [_add_moving(one, *next(maps)) for one in listed[i]]
        self.lamps = []
        for (lamp, faces), maps_of_lamp in zip(lamps, listed, strict=True):
            keys = [one.key if len(one.casters) else None for one in maps_of_lamp]
            if any(keys):
                self.lamps.append((lamp.kind, lamp.row, faces, keys))
        every = [one for maps_of_lamp in listed for one in maps_of_lamp]
        self.skipped += [(one.key, "no caster is in it") for one in every if not len(one.casters)]
        return [one for one in every if len(one.casters)]

    def _choose_widths(self, lamps: list[WantedLamp], room: int) -> list[tuple[WantedLamp, int]]:
        """Return the lamps that get maps, and how wide these are. The most visible lamps come first."""
        settings, chosen = self._settings, dict[int, int]()
        self.dark = []
        faces = [self._faces.get((lamp.kind, lamp.row)) for lamp in lamps]
        held = [0 if one is None else one.width for one in faces]
        # By half an octave: lamps that are about as visible don't exchange their widths as the eye moves.
        octaves = [round(2.0 * np.log2(max(lamp.width, 1.0))) for lamp in lamps]
        order = sorted(range(len(lamps)), key=lambda i: (-octaves[i], -held[i]))
        lamps = [lamps[i] for i in order]
        counts = {i: 6 if is_cube(lamp.light) else 1 for i, lamp in enumerate(lamps)}
        maps = 0
        for i, lamp in enumerate(lamps):
            maps += counts[i]
            if maps * settings.smallest**2 > room:
                self.skipped.append(
                    ((lamp.kind, lamp.row, -1), "there is no room left for its maps: it lights nothing")
                )
                self.dark.append((lamp.kind, lamp.row))
                maps -= counts[i]
                continue
            chosen[i] = choose_width(lamp.width, held[order[i]], settings.smallest, settings.largest)
        chosen = shrink(chosen, counts, room, settings.smallest)
        return [(lamps[i], width) for i, width in chosen.items()]

    def _aim(self, scene: Scene, lamp: WantedLamp, width: int) -> LampMaps:
        """Return the maps of a lamp."""
        name, still = (lamp.kind, lamp.row), lamp.casters.still
        key = (lamp.light.tobytes(), width, still.tobytes())
        faces = self._faces.get(name)
        if faces is None or faces.key != key:
            aimed = aim_maps(lamp.light, width)
            planes = np.stack([camera.frustum.planes for camera in aimed])
            maps = [
                WantedMap.make(
                    (*name, part if len(aimed) > 1 else -1),
                    camera,
                    width,
                    Casters(find_inside(scene, planes[part], still), still[:0]),
                )
                for part, camera in enumerate(aimed)
            ]
            faces = self._faces[name] = LampMaps(key, width, aimed, planes, maps, find_scale(lamp.light, width))
        return faces


def _add_moving(wanted: WantedMap, moving: Rows, shades: bool) -> WantedMap:
    """Return a map with casters that may move, which may shade something visible if it says so."""
    if not len(moving):
        return wanted
    return replace(wanted, casters=Casters(wanted.casters.still, moving), is_quiet=not shades)


def _find_depth(scene: Scene, camera: Camera) -> tuple[float, float]:
    """Return the least and the greatest distance of the scene along the view, rounded to whole steps."""
    (lower, upper), forward = scene.bounds, camera.forward
    middle = float((0.5 * (lower + upper) - camera.position) @ forward)
    half = float(0.5 * (upper - lower) @ np.abs(forward))
    return float(np.floor((middle - half) / _STEP) * _STEP), float(np.ceil((middle + half) / _STEP) * _STEP)
