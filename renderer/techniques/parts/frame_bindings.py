"""The bindings of a frame's shaders: `FrameBindings` declares each name once, with its type.

A shader declares `fog: sl.Uniform[FogConstants]`, and whoever draws with it need not mention the fog: the
binding is looked up by the name of the declaration, here. A name is read only if a program has it, so a frame
makes nothing that its shaders don't bind. A technique passes the bindings that only it has with the draw
(`shader_bindings`).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Final, NoReturn, Self, overload

from renderer import rules
from renderer.frame import SHADOW_EFFECTS, Effect, EnvironmentMaps, Frame
from renderer.frame.fog import bind_fog, bind_haze
from renderer.frame.lobe_fits import LobeTable
from renderer.frame.pixel_rays import bind_rays
from renderer.frame.scene_images import SceneImages
from renderer.light_kinds.directional import DirectionalLight
from renderer.light_kinds.kind import LocalLightKind
from renderer.light_kinds.table import LOCAL_LIGHT_KINDS
from renderer.scene.material_instances import MAX_SHADERS
from renderer.shaders.decals import Decal, DecalGrid
from renderer.shaders.environment import EnvironmentConstants
from renderer.shaders.fog import FogConstants
from renderer.shaders.pixels import PixelRays
from renderer.shaders.structs import (
    Ambient,
    Haze,
    Material,
    Object,
    ObjectPosition,
    TextureUse,
    ViewConstants,
)
from renderer.shadows import ShadowMaps
from renderer.shadows.receiver import CascadeTable, LocalShadowTable
from rhi import StorageBuffer, Texture, TextureTable, UniformBuffer, refuse
from rhi.shading import TextureBinding


class PlanTexture:
    """A texture of the frame's plan, bound by its name there; None if the plan has no such texture."""

    def __set_name__(self, owner: type[FrameBindings], name: str) -> None:
        self.name = name

    @overload
    def __get__(self, bindings: None, owner: type[FrameBindings]) -> Self: ...
    @overload
    def __get__(
        self, bindings: FrameBindings, owner: type[FrameBindings] | None = None
    ) -> Texture | None: ...
    def __get__(
        self, bindings: FrameBindings | None, owner: type[FrameBindings] | None = None
    ) -> Self | Texture | None:
        return self if bindings is None else bindings.frame.targets.get(self.name)


class ImageArrayBinding:
    """An array of the scene's images with its sampler: of colours, or of data; None if the scene has fewer
    arrays."""

    def __init__(self, index: int, *, is_color: bool) -> None:
        self.index = index
        self.is_color = is_color

    @overload
    def __get__(self, bindings: None, owner: type[FrameBindings]) -> Self: ...
    @overload
    def __get__(
        self, bindings: FrameBindings, owner: type[FrameBindings] | None = None
    ) -> TextureBinding | None: ...
    def __get__(
        self, bindings: FrameBindings | None, owner: type[FrameBindings] | None = None
    ) -> Self | TextureBinding | None:
        if bindings is None:
            return self
        images = bindings.scene_images
        if images is None:
            return None
        arrays = images.colors if self.is_color else images.data
        return arrays[self.index] if self.index < len(arrays) else None


class FrameBindings:
    """The resources of a frame that its shaders bind, each under the name that the shaders declare.

    `bindings[name]` looks a name up, and refuses one that the frame has nothing for
    (`technique-missing-binding`).

    Attributes:
        frame: the frame, whose targets exist.
        scene_images: the images of the scene; None if its materials have none.
    """

    def __init__(self, frame: Frame) -> None:
        self.frame = frame

    def __getitem__(self, name: str) -> Any:
        """The resource to bind by a name.

        Raises:
            ValidationError: the frame has no resource of this name (`technique-missing-binding`).
        """
        read = BINDINGS.get(name)
        resource = None if read is None else read(self)
        if resource is None:
            self._refuse(name)
        return resource

    def _refuse(self, name: str) -> NoReturn:
        call = f"a shader's binding {name!r}"
        if name not in BINDINGS:
            rules.refuse_name(rules.MISSING_BINDING, call, name, BINDINGS)
        refuse(rules.MISSING_BINDING, call, f"{name!r}, which this frame's scene, plan or effects lack")

    # The view

    @property
    def view(self) -> UniformBuffer[ViewConstants]:
        """The camera's matrix and position."""
        return self.frame.view.buffer

    @property
    def rays(self) -> UniformBuffer[PixelRays]:
        """The rays through the pixels of the frame's targets."""
        return bind_rays(self.frame)

    # The scene

    @property
    def objects(self) -> StorageBuffer[Object] | None:
        """The objects' transforms, materials and light lists."""
        return self.frame.resources.objects.buffer

    @property
    def object_positions(self) -> StorageBuffer[ObjectPosition] | None:
        """The objects' positions and meshes."""
        return self.frame.resources.object_positions.buffer

    @property
    def materials(self) -> StorageBuffer[Material] | None:
        """The materials' constants."""
        return self.frame.resources.materials.buffer

    @property
    def scene_images(self) -> SceneImages | None:
        """The images of the scene; None if its materials have none."""
        return self.frame.resources.images

    @property
    def textures(self) -> StorageBuffer[TextureUse] | None:
        """The array, layer and transform of each texture of the scene."""
        images = self.scene_images
        return None if images is None else images.table

    @property
    def image_table(self) -> TextureTable | None:
        """The scene's colours, if they are in a table."""
        images = self.scene_images
        return None if images is None or images.tables is None else images.tables[0]

    @property
    def map_table(self) -> TextureTable | None:
        """The scene's data, if they are in a table."""
        images = self.scene_images
        return None if images is None or images.tables is None else images.tables[1]

    images = ImageArrayBinding(0, is_color=True)
    images_1 = ImageArrayBinding(1, is_color=True)
    images_2 = ImageArrayBinding(2, is_color=True)
    images_3 = ImageArrayBinding(3, is_color=True)
    images_4 = ImageArrayBinding(4, is_color=True)
    images_5 = ImageArrayBinding(5, is_color=True)
    images_6 = ImageArrayBinding(6, is_color=True)
    images_7 = ImageArrayBinding(7, is_color=True)
    maps = ImageArrayBinding(0, is_color=False)
    maps_1 = ImageArrayBinding(1, is_color=False)
    maps_2 = ImageArrayBinding(2, is_color=False)
    maps_3 = ImageArrayBinding(3, is_color=False)
    maps_4 = ImageArrayBinding(4, is_color=False)
    maps_5 = ImageArrayBinding(5, is_color=False)
    maps_6 = ImageArrayBinding(6, is_color=False)
    maps_7 = ImageArrayBinding(7, is_color=False)

    @property
    def decals(self) -> StorageBuffer[Decal] | None:
        """The decals that may cover something."""
        return self.frame.resources.decals.decals.buffer

    @property
    def decal_cells(self) -> Texture | None:
        """The table of the decals in each cell of their grid."""
        return self.frame.resources.decals.cells.texture

    @property
    def decal_grid(self) -> UniformBuffer[DecalGrid] | None:
        """The constants of that grid."""
        return self.frame.resources.decals.grid

    # Light

    @property
    def ambient(self) -> UniformBuffer[Ambient]:
        """The scene's ambient light."""
        return self.frame.resources.ambient.buffer

    @property
    def directional_lights(self) -> StorageBuffer[DirectionalLight] | None:
        """The directional lights."""
        return self.frame.resources.directional.buffer

    def local_lights(self, kind: LocalLightKind) -> StorageBuffer[Any] | None:
        """The lights of a kind with positions relative to the eye, bound as `point_lights`, `spot_lights`."""
        return self.frame.resources.local_lights[kind.name].buffer

    @property
    def source_radii(self) -> Texture | None:
        """The source radii of local lights in metres, a channel for each kind."""
        return self.frame.resources.source_radii.texture

    @property
    def source_shapes(self) -> Texture | None:
        """The shapes of local lights that are rectangles or tubes, two texels for each light."""
        return self.frame.resources.source_shapes

    @property
    def lobe_fits(self) -> TextureBinding:
        """The table of lobes by which such lights are lit."""
        return self.frame.resources.workspace(LobeTable).binding

    @property
    def light_list(self) -> StorageBuffer[int] | None:
        """The light lists of the objects, one after the other."""
        return self.frame.resources.light_list.buffer

    @property
    def fog(self) -> UniformBuffer[FogConstants] | None:
        """The scene's fog, with heights relative to the eye."""
        return None if self.frame.resources.scene.fog is None else bind_fog(self.frame)

    @property
    def haze(self) -> UniformBuffer[Haze]:
        """The scene's haze."""
        return bind_haze(self.frame)

    @property
    def _environment_maps(self) -> EnvironmentMaps | None:
        """The maps of the environment; None in a frame that needs none."""
        frame = self.frame
        if frame.effects.enabled.isdisjoint((Effect.ENVIRONMENT, Effect.SKY_BOX)):
            return None
        return frame.resources.workspace(EnvironmentMaps)

    @property
    def environment(self) -> TextureBinding | None:
        """The light that surfaces mirror, filtered for each roughness."""
        maps = self._environment_maps
        return None if maps is None else maps.filtered

    @property
    def environment_image(self) -> TextureBinding | None:
        """The image of the environment."""
        maps = self._environment_maps
        return None if maps is None else maps.image

    @property
    def environment_constants(self) -> UniformBuffer[EnvironmentConstants] | None:
        """The constants of the environment."""
        maps = self._environment_maps
        return None if maps is None else maps.constants

    # Shadows

    @property
    def _shadow_maps(self) -> ShadowMaps | None:
        """The shadow maps; None in a frame without shadows."""
        frame = self.frame
        return (
            None
            if frame.effects.enabled.isdisjoint(SHADOW_EFFECTS)
            else frame.resources.workspace(ShadowMaps)
        )

    @property
    def cascade_table(self) -> UniformBuffer[CascadeTable] | None:
        """The cascades of directional lights."""
        maps = self._shadow_maps
        return None if maps is None else maps.cascade_table

    @property
    def local_shadow_table(self) -> UniformBuffer[LocalShadowTable] | None:
        """The settings that the maps of local lights share."""
        maps = self._shadow_maps
        return None if maps is None else maps.local_shadow_table

    @property
    def shadow_slots(self) -> Texture | None:
        """The number of the first map of each local light."""
        maps = self._shadow_maps
        return None if maps is None else maps.shadow_slots

    @property
    def local_shadow_maps(self) -> Texture | None:
        """The matrices and tiles of the maps of local lights."""
        maps = self._shadow_maps
        return None if maps is None else maps.local_shadow_maps

    @property
    def shadow_sources(self) -> Texture | None:
        """The radii of the sources of local lights whose penumbras are filtered."""
        maps = self._shadow_maps
        return None if maps is None else maps.shadow_sources

    @property
    def shadow_compare(self) -> TextureBinding | None:
        """The atlas of shadow maps, sampled by comparison."""
        maps = self._shadow_maps
        return None if maps is None else maps.compared_atlas

    @property
    def shadow_atlas(self) -> Texture | None:
        """The atlas of shadow maps, texel by texel."""
        maps = self._shadow_maps
        return None if maps is None else maps.atlas

    # Textures of the plan; those of several samples per pixel are named by `name_samples`

    depth = PlanTexture()
    ambient_occlusion = PlanTexture()
    turned_occlusion = PlanTexture()
    contact_shadows = PlanTexture()
    depth_samples = PlanTexture()
    surface = PlanTexture()
    surface_samples = PlanTexture()
    material = PlanTexture()
    material_samples = PlanTexture()
    details = PlanTexture()
    details_samples = PlanTexture()
    shininess = PlanTexture()
    packed = PlanTexture()
    packed_samples = PlanTexture()
    distances_samples = PlanTexture()
    vertex_colors = PlanTexture()
    vertex_colors_samples = PlanTexture()
    visible_objects = PlanTexture()
    light_indices = PlanTexture()
    lit = PlanTexture()
    fragments = PlanTexture()
    volumes = PlanTexture()


def _read_local_lights(bindings: FrameBindings, *, kind: LocalLightKind) -> StorageBuffer[Any] | None:
    return bindings.local_lights(kind)


def _read_parameters(bindings: FrameBindings, *, number: int) -> StorageBuffer[Any] | None:
    parameters = bindings.frame.resources.parameters
    return parameters[number - 1].buffer if number <= len(parameters) else None


def _collect_bindings() -> dict[str, Callable[[FrameBindings], Any]]:
    attributes = vars(FrameBindings).items()
    kinds = property, PlanTexture, ImageArrayBinding
    return {
        name: attribute.__get__
        for name, attribute in attributes
        if isinstance(attribute, kinds) and not name.startswith("_") and name != "scene_images"
    } | {
        **{f"{kind.name}_lights": partial(_read_local_lights, kind=kind) for kind in LOCAL_LIGHT_KINDS},
        **{
            f"parameters_{number}": partial(_read_parameters, number=number)
            for number in range(1, MAX_SHADERS + 1)
        },
    }


FOLLOW_CAMERA: Final = frozenset({"fog", "rays"})
"""The bindings whose constants depend on the camera, and are uploaded for each frame; those of `view` are
uploaded by the view itself."""
BINDINGS: Final = _collect_bindings()
"""How each binding is read, by its name: the attributes of `FrameBindings`, and the kinds of local lights."""
