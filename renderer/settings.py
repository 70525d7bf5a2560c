"""Everything that decides how a scene is drawn, in one value: the settings objects of the renderer's parts.

Nothing is set here that isn't set there. What this adds is a file that keeps all of them, and the renderer
that has them. A file may lack any part, and any setting of a part: those have their defaults.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, is_dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any, Final, Self, get_args, get_type_hints

from renderer import rules
from renderer.frame import (
    Blending,
    BloomSettings,
    DepthOfFieldSettings,
    EnvironmentSettings,
    OcclusionSettings,
    TemporalSettings,
    TextureSettings,
)
from renderer.renderer import ANIMATION_LAG, DETAIL_ERROR, FrameResult, Renderer
from renderer.scene import Camera, Depth, Orthographic, PathFrame, Perspective, Scene, StereoRig
from renderer.scene.file_versions import KEY
from renderer.scene.files import read_json
from renderer.scene.settings_versions import SETTINGS_VERSIONS
from renderer.shadows import ShadowSettings
from renderer.stereo import Stereo
from renderer.techniques import Technique, TechniqueSettings
from renderer.tessellation import TessellationSettings
from renderer.visibility import ALGORITHMS, VisibilitySettings, check_algorithm, make_visibility
from rhi import Device, RhiError, refuse
from rhi.shading import Precision


@dataclass(frozen=True, slots=True)
class RenderSettings:
    """The settings of all parts of the renderer.

    Attributes:
        technique: what lights surfaces.
        algorithm: the name of what finds visible objects.
        visibility: that algorithm's parameters.
        shadows: the choices of shadow maps.
        textures: how well textures are read.
        tessellation: how small the triangles of tessellated surfaces are.
        blending: how transparent surfaces that cover each other are blended.
        bloom: how exactly bloom is computed.
        occlusion: how exactly ambient occlusion is computed.
        depth_of_field: how exactly depth of field is computed.
        temporal: whether and how samples of many frames are put together.
        precision: that of the techniques' shaders.
        depth: the direction of depth.
        animation_step: the step of animations in seconds, 0 for every frame.
        animation_lag: the lag allowed for small objects, in pixels, 0 for nothing.
        light_cutoff: the light of a light that is too faint to matter, 0 for none.
        detail_error: the largest error of levels of detail, in pixels, 0 for full meshes.
        simulates_hidden: whether what an absence would change, such as cloth, is simulated where it isn't
            drawn.
        reprojects: whether a second eye's image is made from the first one's.
        far_error: the largest error of the parallax of objects that are drawn once for two eyes, in pixels, 0 to
            draw all for each eye.
        scale: the size at which frames are drawn, in that of the image that is shown: 0.1 to 2.
    """

    technique: TechniqueSettings = field(default_factory=TechniqueSettings)
    algorithm: str = "auto"
    visibility: VisibilitySettings = field(default_factory=VisibilitySettings)
    shadows: ShadowSettings = field(default_factory=ShadowSettings)
    textures: TextureSettings = field(default_factory=TextureSettings)
    tessellation: TessellationSettings = field(default_factory=TessellationSettings)
    blending: Blending = Blending.SORTED
    bloom: BloomSettings = field(default_factory=BloomSettings)
    occlusion: OcclusionSettings = field(default_factory=OcclusionSettings)
    depth_of_field: DepthOfFieldSettings = field(default_factory=DepthOfFieldSettings)
    temporal: TemporalSettings = field(default_factory=TemporalSettings)
    environment: EnvironmentSettings = field(default_factory=EnvironmentSettings)
    precision: Precision = Precision.FAST
    depth: Depth = Depth.REVERSED
    animation_step: float = 0.0
    animation_lag: float = ANIMATION_LAG
    light_cutoff: float = 0.0
    detail_error: float = DETAIL_ERROR
    simulates_hidden: bool = False
    reprojects: bool = False
    far_error: float = 0.0
    scale: float = 1.0

    def __post_init__(self) -> None:
        rules.check_types(self, rules.BAD_RENDER_SETTING)
        if self.algorithm not in ALGORITHMS:
            call = "RenderSettings(algorithm=...)"
            rules.refuse_name(rules.UNKNOWN_ALGORITHM, call, self.algorithm, ALGORITHMS)
        rules.check_non_negative(rules.BAD_STEP, "RenderSettings(animation_step=...)", self.animation_step)
        rules.check_non_negative(rules.BAD_LAG, "RenderSettings(animation_lag=...)", self.animation_lag)
        rules.check_non_negative(rules.BAD_CUTOFF, "RenderSettings(light_cutoff=...)", self.light_cutoff)
        rules.check_non_negative(rules.BAD_DETAIL, "RenderSettings(detail_error=...)", self.detail_error)
        rules.check_non_negative(rules.BAD_STEREO, "RenderSettings(far_error=...)", self.far_error)
        rules.check_scale("RenderSettings(scale=...)", self.scale)

    def get(self, path: str) -> Any:
        """Return a setting by its path, such as `shadows.cascades`."""
        value: Any = self
        for name in path.split("."):
            value = getattr(value, name)
        return value

    def list_paths(self) -> list[str]:
        """Return the paths of all settings that aren't objects of settings themselves."""
        return list(_list_paths(self))

    def change(self, path: str, value: Any) -> Self:
        """Return settings with another value of the setting at a path."""
        changed: Self = _change(self, path.split("."), value)
        return changed

    def change_all(self, changes: Mapping[str, Any]) -> Self:
        """Return settings with other values, by their paths; settings that limit others are changed first."""
        settings = self
        for path, value in changes.items():
            settings = settings.change(path, value)
        return settings

    def adapt_camera(self, camera: Camera) -> Camera:
        """Return a camera with the depth direction of the settings."""
        projection = camera.projection
        assert isinstance(projection, Perspective | Orthographic)
        if projection.depth is self.depth:
            return camera
        return camera.with_projection(replace(projection, depth=self.depth))

    def render(self, renderer: Renderer, path_frame: PathFrame) -> FrameResult:
        """Render a path frame with the depth direction of the settings."""
        return renderer.render(self.adapt_camera(path_frame.camera), path_frame.seconds)

    @contextmanager
    def open(
        self,
        device: Device,
        scene: Scene,
        size: tuple[int, int],
        rig: StereoRig | None = None,
        technique: Technique | None = None,
    ) -> Iterator[Renderer]:
        """Yield a renderer that has these settings, and destroy it at the end. Cameras must be aimed (`aim`).

        Args:
            rig: with one, two eyes are drawn, side by side.
            technique: one that draws instead of that of the
        settings."""
        check_algorithm(self.algorithm, device, "RenderSettings.open")
        visibility = make_visibility(self.algorithm, scene, device, self.visibility)
        try:
            with Renderer(
                device, scene, visibility=visibility, size=size, textures=self.textures
            ) as renderer:
                self.apply_to(renderer, technique)
                if rig is not None:
                    renderer.stereo = Stereo(
                        rig, "side_by_side", is_reprojected=self.reprojects, far_error=self.far_error
                    )
                yield renderer
        finally:
            visibility.destroy()

    def apply_to(self, renderer: Renderer, technique: Technique | None = None) -> None:
        """Give a renderer those of these settings that may be exchanged between two frames: all but how
        textures are read, and which objects are found. `technique` draws instead of that of the settings."""
        renderer.technique = technique or self.technique.make(renderer.scene, renderer.device)
        renderer.blending, renderer.precision, renderer.bloom = self.blending, self.precision, self.bloom
        renderer.occlusion, renderer.depth_of_field = self.occlusion, self.depth_of_field
        renderer.temporal = self.temporal
        renderer.environment = self.environment
        renderer.shadows.settings = self.shadows
        renderer.tessellator.settings = self.tessellation
        renderer.animation_step, renderer.animation_lag = self.animation_step, self.animation_lag
        renderer.light_cutoff, renderer.simulates_hidden = self.light_cutoff, self.simulates_hidden
        renderer.detail_error, renderer.scale = self.detail_error, self.scale

    def save(self, path: Path, **metadata: Any) -> None:
        """Write the settings as JSON. `metadata` is written too, to say how they were found; `load` ignores
        it."""
        parts = {setting.name: to_json(getattr(self, setting.name)) for setting in fields(self)}
        path.write_text(
            json.dumps(
                {
                    KEY: SETTINGS_VERSIONS.current,
                    _FORMAT: parts,
                    "visibility": parts.pop("visibility"),
                    **metadata,
                },
                indent=2,
            )
            + "\n",
            encoding="utf-8",
        )

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read a file that `save` or `python -m renderer tune` has written.

        Raises:
            ValidationError: `visibility-bad-settings` if the file holds no settings, `file-version` for a newer
                version, or the rule that one of them breaks.
            OSError: the file can't be read.
        """
        call = f"RenderSettings.load({str(path)!r})"
        try:
            content = SETTINGS_VERSIONS.migrate(dict(read_json(path)), call)
            parts = {
                **content.get(_FORMAT, {}),
                **({"visibility": content["visibility"]} if "visibility" in content else {}),
            }
            if not parts:
                refuse(rules.BAD_SETTINGS, call, f"neither {_FORMAT} nor visibility")
            settings: Self = from_json(cls, parts, call, cls())
        except RhiError:
            raise
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            refuse(rules.BAD_SETTINGS, call, f"{type(error).__name__}: {error}")
        return settings


_FORMAT: Final = "rendering"
"""The part of a file that has all settings but those of `visibility`, which files of `tune` have, too."""


def _list_paths(part: Any, above: str = "") -> Iterator[str]:
    for setting in fields(part):
        value, path = getattr(part, setting.name), f"{above}{setting.name}"
        if is_dataclass(value):
            yield from _list_paths(value, f"{path}.")
        else:
            yield path


def _change(part: Any, names: list[str], value: Any) -> Any:
    if len(names) > 1:
        value = _change(getattr(part, names[0]), names[1:], value)
    return replace(part, **{names[0]: value})


def to_json(value: Any) -> Any:
    """Return settings as JSON has them: objects by their fields, and choices by their values."""
    if isinstance(value, Enum):
        return value.value
    if is_dataclass(value):
        return {setting.name: to_json(getattr(value, setting.name)) for setting in fields(value)}
    return value


def from_json(kind: Any, value: Any, call: str, default: Any = None) -> Any:
    """Return settings of a type from the output of `to_json`; missing values are those of `default`, or of
    the type if that is None."""
    alternatives = [element for element in get_args(kind) if element is not type(None)]
    if alternatives:
        return None if value is None else from_json(alternatives[0], value, call, default)
    if isinstance(kind, type) and issubclass(kind, Enum):
        return kind(value)
    if not (isinstance(kind, type) and is_dataclass(kind)):
        if not isinstance(value, kind) and not (kind is float and type(value) is int):
            refuse(rules.BAD_SETTINGS, call, repr(value), f"a {kind.__name__}")
        return value
    if not isinstance(value, Mapping):
        refuse(rules.BAD_SETTINGS, call, repr(value), f"the settings of {kind.__name__} by name")
    hints = get_type_hints(kind)
    for name in value:
        if name not in hints:
            rules.refuse_name(rules.BAD_SETTINGS, call, name, hints)
    arguments = {
        name: from_json(hints[name], element, call, getattr(default, name, None))
        for name, element in value.items()
    }
    return kind(**arguments) if default is None else replace(default, **arguments)
