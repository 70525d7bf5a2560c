"""The shadow maps that a frame needs: those of lights that reach something visible and have a caster.

A cascade of a directional light needs something visible in it and a caster in front of that; a map of a local
light something visible in the light's range and a caster in the map. What doesn't have both is **skipped**.
Maps of local lights are as wide as what the lights light on the screen; if there is no room for all, the
widest are halved first. Where maps are in the atlas, and which of them are drawn, is not decided here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np

from renderer.frame import LOCAL_LIGHTS, Effect, FrameEffects
from renderer.frame.resources import SceneResources
from renderer.light_kinds.kind import LocalLightKind
from renderer.light_kinds.shapes import flag_discs, flag_spheres
from renderer.lights.object_lists import list_lights
from renderer.scene import Camera, Scene
from renderer.scene.arrays import Floats, Indices
from renderer.shadows.cascades import Cascade, fit_cascades
from renderer.shadows.casters import Casters, SceneCasters, cull_dynamic_casters, rotate_boxes
from renderer.shadows.local_light_maps import (
    choose_width,
    compute_map_widths,
    is_cube,
    map_cameras,
    shrink,
    texels_per_tangent,
)
from renderer.shadows.receiver import MAX_CASCADES
from renderer.shadows.shadow_settings import ShadowFilter, ShadowSettings
from renderer.visibility.boxes.volumes import select_inside
from rhi.math.indexing import count_indices

DIRECTIONAL: Final = "directional"
"""The kind of directional lights."""

MapKey = tuple[str, int, int]
"""The name of a map: the kind of its light, the light's row, and which of its maps it is."""

_STEP: Final = 16.0  # metres, by which the depth of what parallel views show is rounded


@dataclass(frozen=True, eq=False, slots=True)
class RequiredMap:
    """A map that the frame needs.

    Attributes:
        pose: the position, axes and projection of its camera, to compare.
        static: the pose and the rows of the casters that can't move: the map is drawn again if it changes.
        is_quiet: whether no caster that may move shades anything visible.
        cascade: of a directional light's map, the cascade.
    """

    key: MapKey
    camera: Camera
    size: int
    casters: Casters
    pose: tuple[object, ...]
    static: tuple[object, ...]
    is_quiet: bool = False
    cascade: Cascade | None = None

    @classmethod
    def make(
        cls, key: MapKey, camera: Camera, size: int, casters: Casters, cascade: Cascade | None = None
    ) -> RequiredMap:
        """Return a map whose casters may all shade something visible."""
        pose = camera.position.tobytes(), camera.rotation.tobytes(), camera.projection
        static = pose, casters.static.tobytes()
        return cls(key, camera, size, casters, pose, static, cascade=cascade)


@dataclass(eq=False, slots=True)
class LocalLightMaps:
    """The maps of a local light, each `width` texels wide: their cameras, the planes (m, p, 4) of their
    frusta, and each as required without the casters that may move. They hold as long as `key` is the same."""

    key: tuple[object, ...]
    width: int
    cameras: list[Camera]
    planes: Floats
    required: list[RequiredMap]
    scale: float


@dataclass(frozen=True, eq=False, slots=True)
class ShadowedLight:
    """A local light that casts a shadow on something visible, and the casters in its range."""

    kind: LocalLightKind
    light_index: int
    light: Any
    width: float
    casters: Casters


class MapPlanner:
    """Plans which shadow maps a frame of a scene needs, and how wide those of local lights are.

    Attributes:
        casters: the casters of the scene.
        cascades: those of directional lights in the last frame: the light's row, and the key of the map, if
            any.
        local_lights: those that have maps: the kind and the row, and the keys of those maps that have a
            caster.
        without_room: the local lights, by kind and row, for whose maps there is no room: they light nothing.
        skipped: the lights, cascades and faces without maps, and why.
    """

    def __init__(self, scene: Scene, settings: ShadowSettings) -> None:
        self.casters = SceneCasters(scene)
        self.cascades: list[tuple[int, Cascade, MapKey | None]] = []
        self.local_lights: list[tuple[str, int, LocalLightMaps, list[MapKey | None]]] = []
        self.without_room: list[tuple[str, int]] = []
        self.skipped: list[tuple[MapKey, str]] = []
        self._settings = settings
        self._has_penumbras = settings.filter is ShadowFilter.PCSS
        self._faces: dict[tuple[str, int], LocalLightMaps] = {}

    def plan_maps(
        self,
        resources: SceneResources,
        effects: FrameEffects,
        cameras: Sequence[Camera],
        visible: Indices,
        size: tuple[int, int],
    ) -> list[RequiredMap]:
        """Return the maps that a frame of this `size` needs, for views of `cameras` and the `visible`
        objects."""
        self.skipped = []
        cascades = self._require_cascades(resources, effects, cameras, visible)
        return cascades + self._require_local_maps(resources, effects, cameras, visible, size)

    def _require_cascades(
        self, resources: SceneResources, effects: FrameEffects, cameras: Sequence[Camera], visible: Indices
    ) -> list[RequiredMap]:
        """Return the maps of the cascades that have something visible and a caster; record all cascades."""
        self.cascades = []
        required: list[RequiredMap] = []
        scene = resources.scene
        if Effect.DIRECTIONAL_SHADOWS not in effects.enabled:
            return required
        depth = _find_depth(scene, cameras[0])
        lights = resources.lights.directional
        rows = np.flatnonzero(lights["casts_shadow"])[:MAX_CASCADES].tolist()
        settings = replace(self._settings, cascades=min(self._settings.cascades, MAX_CASCADES // len(rows)))
        for light_index in rows:
            direction = lights["direction"][light_index].astype(np.float64)
            axes = Camera.look_at((0, 0, 0), direction).rotation
            source = 0.0
            if self._has_penumbras and flag_discs(lights[light_index]):
                source = float(np.tan(0.5 * lights["angular_diameter"][light_index].astype(np.float64)))
            boxes = self.casters.rotate_casters(light_index, axes)
            receivers = rotate_boxes(scene, visible, axes)
            cascades = fit_cascades(cameras, direction, settings, boxes.top, depth, source=source)
            for part, cascade in enumerate(cascades):
                key, casters = (DIRECTIONAL, light_index, part), boxes.select_casters(cascade, receivers)
                if casters is None or not len(casters):
                    reason = "nothing visible is in it" if casters is None else "no caster is in it"
                    self.skipped.append((key, reason))
                    self.cascades.append((light_index, cascade, None))
                else:
                    size = self._settings.cascade_size
                    required.append(RequiredMap.make(key, cascade.camera, size, casters, cascade))
                    self.cascades.append((light_index, cascade, key))
        return required

    def _require_local_maps(
        self,
        resources: SceneResources,
        effects: FrameEffects,
        cameras: Sequence[Camera],
        visible: Indices,
        size: tuple[int, int],
    ) -> list[RequiredMap]:
        """Return the maps of local lights that reach something visible and have a caster; record those
        lights."""
        scene = resources.scene
        settings = self._settings
        shadowed = list[ShadowedLight]()
        lower, upper = scene.objects.lower[visible], scene.objects.upper[visible]
        for row in LOCAL_LIGHTS.values():
            kind = row.kind
            lights = resources.lights.of_kind(row.kind)
            rows = effects.in_view[row.shadows]
            if not len(rows):
                continue
            lit = lights[rows]
            _, reaching = list_lights(lower, upper, lit["position"], lit["range"].astype(np.float64))
            reaches = count_indices(reaching, minlength=len(rows)) > 0
            static, dynamic = self.casters.casters_in_range(kind.name, lights)
            for i, (light_index, width) in enumerate(
                zip(rows.tolist(), compute_map_widths(kind, cameras, size, lit), strict=True)
            ):
                casters = Casters(static[light_index], dynamic[light_index])
                if reaches[i] and len(casters):
                    shadowed.append(ShadowedLight(kind, light_index, lit[i], float(width), casters))
                else:
                    reason = "no caster is in its range" if reaches[i] else "it reaches nothing visible"
                    self.skipped.append(((kind.name, light_index, -1), reason))
        cascades = sum(key is not None for _, _, key in self.cascades)
        room = settings.max_atlas_size**2 - cascades * settings.cascade_size**2
        local_lights = [
            (light, self._aim(scene, light, width)) for light, width in self._choose_widths(shadowed, room)
        ]
        listed = [faces.required for _, faces in local_lights]
        if movers := [i for i, (light, _) in enumerate(local_lights) if len(light.casters.dynamic)]:
            map_casters, shades = cull_dynamic_casters(
                scene,
                np.array([local_lights[i][0].light["position"] for i in movers]),
                np.array([local_lights[i][0].light["range"] for i in movers], np.float64),
                [local_lights[i][1].planes for i in movers],
                [local_lights[i][0].casters.dynamic for i in movers],
                cameras,
            )
            maps = iter(zip(map_casters, shades.tolist(), strict=True))
            for i in movers:
                listed[i] = [_add_moving(required, *next(maps)) for required in listed[i]]
        self.local_lights = []
        for (light, faces), light_maps in zip(local_lights, listed, strict=True):
            keys = [required.key if len(required.casters) else None for required in light_maps]
            if any(keys):
                self.local_lights.append((light.kind.name, light.light_index, faces, keys))
        every = [required for light_maps in listed for required in light_maps]
        self.skipped += [
            (required.key, "no caster is in it") for required in every if not len(required.casters)
        ]
        return [required for required in every if len(required.casters)]

    def _choose_widths(self, local_lights: list[ShadowedLight], room: int) -> list[tuple[ShadowedLight, int]]:
        """Return the local lights that get maps, the most visible ones first, and the width of their maps in
        texels."""
        settings, widths = self._settings, dict[int, int]()
        self.without_room = []
        faces = [self._faces.get((light.kind.name, light.light_index)) for light in local_lights]
        previous_widths = [0 if light_faces is None else light_faces.width for light_faces in faces]
        # By half an octave: lights that are about as visible don't exchange their widths as the eye moves.
        octaves = [round(2.0 * np.log2(max(light.width, 1.0))) for light in local_lights]
        order = sorted(range(len(local_lights)), key=lambda i: (-octaves[i], -previous_widths[i]))
        local_lights = [local_lights[i] for i in order]
        counts = {i: 6 if is_cube(light.kind, light.light) else 1 for i, light in enumerate(local_lights)}
        maps = 0
        for i, light in enumerate(local_lights):
            maps += counts[i]
            if maps * settings.min_size**2 > room:
                self.skipped.append(
                    (
                        (light.kind.name, light.light_index, -1),
                        "no room is left for its shadow maps, so it is disabled",
                    )
                )
                self.without_room.append((light.kind.name, light.light_index))
                maps -= counts[i]
                continue
            widths[i] = choose_width(
                light.width, previous_widths[order[i]], settings.min_size, settings.max_size
            )
        widths = shrink(widths, counts, room, settings.min_size)
        return [(local_lights[i], width) for i, width in widths.items()]

    def _aim(self, scene: Scene, light: ShadowedLight, width: int) -> LocalLightMaps:
        """Return the maps of a local light, reused from an earlier frame if they still hold."""
        name, static = (light.kind.name, light.light_index), light.casters.static
        key = (light.light.tobytes(), width, static.tobytes())
        faces = self._faces.get(name)
        if faces is None or faces.key != key:
            has_penumbras = self._has_penumbras and bool(flag_spheres(light.light))
            aimed = map_cameras(light.kind, light.light, width, has_penumbras=has_penumbras)
            planes = np.stack([camera.frustum.planes for camera in aimed])
            maps = [
                RequiredMap.make(
                    (*name, part if len(aimed) > 1 else -1),
                    camera,
                    width,
                    Casters(select_inside(scene, planes[part], static), static[:0]),
                )
                for part, camera in enumerate(aimed)
            ]
            scale = texels_per_tangent(light.kind, light.light, width, has_penumbras=has_penumbras)
            faces = self._faces[name] = LocalLightMaps(key, width, aimed, planes, maps, scale)
        return faces


def _add_moving(required: RequiredMap, dynamic: Indices, shades: bool) -> RequiredMap:
    """Return a required map with its dynamic casters; `shades` says whether one of them may shade something
    visible."""
    if not len(dynamic):
        return required
    return replace(required, casters=Casters(required.casters.static, dynamic), is_quiet=not shades)


def _find_depth(scene: Scene, camera: Camera) -> tuple[float, float]:
    """Return the least and the greatest distance of the scene along the view, rounded to whole steps."""
    (lower, upper), forward = scene.bounds, camera.forward
    middle = float((0.5 * (lower + upper) - camera.position) @ forward)
    half = float(0.5 * (upper - lower) @ np.abs(forward))
    return float(np.floor((middle - half) / _STEP) * _STEP), float(np.ceil((middle + half) / _STEP) * _STEP)
