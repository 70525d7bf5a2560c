"""Programs: shader modules of their stages, and layouts of their bindings.

- Each kind of binding has a group: uniforms 0, storage 1, textures and samplers 2, images 3.
- Uniforms have dynamic offsets, so a group depends on buffers and sizes only: draws that walk through a ring
  share it.
- Uniform slots have even bindings. The odd ones are pads, buffers that no shader reads, where a driver can't
  read the fourth of a stage (`is_fourth_uniform_faulty`).
- A layout says whether a texture of floats is filtered. Depth that is read as floats isn't, nor are other
  formats on some devices, so a program has a layout for each set of slots with such textures.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from operator import itemgetter
from typing import Any, Final

from rhi.backends.webgpu.implementation import GpuObject, Implementation, ModuleError
from rhi.backends.webgpu.webgpu_errors import translate_errors
from rhi.backends.webgpu.webgpu_flags import GpuShaderStage
from rhi.backends.webgpu.webgpu_formats import DIMENSIONS, FORMATS
from rhi.contract.descriptors import BindingKind, Id, ProgramDescriptor, Stage, TextureKind
from rhi.contract.driver_log import make_driver_error
from rhi.contract.layout import FLOAT, INT
from rhi.contract.states import MAX_TARGETS
from rhi.shading.glsl.vulkan import SETS
from rhi.shading.language.types import ImageType, TextureType
from rhi.shading.wgsl.wgsl_stages import read_declarations

_VISIBILITY: Final = {
    Stage.VERTEX: GpuShaderStage.VERTEX,
    Stage.FRAGMENT: GpuShaderStage.FRAGMENT,
    Stage.COMPUTE: GpuShaderStage.COMPUTE,
}
_DEPTH: Final = "@builtin(frag_depth)"
_FAULTY: Final = 3
"""Number of uniform buffers of a stage before the one that some drivers can't read."""
_ACCESS: Final = {"read": "read-only", "write": "write-only", "read_write": "read-write"}


def _make_selection(slots: tuple[int, ...]) -> Callable[[Mapping[int, int]], tuple[int, ...]]:
    """Return a function that selects the values of slots, in C where there are several."""
    if len(slots) > 1:
        return itemgetter(*slots)
    if not slots:
        return lambda values: ()
    (slot,) = slots
    return lambda values: (values[slot],)


class PipelineLayout:
    """The layout of a program for one set of slots whose textures aren't filtered."""

    __slots__ = ("groups", "object", "unfiltered")

    def __init__(self, device: GpuObject, groups: list[GpuObject], unfiltered: tuple[int, ...]) -> None:
        self.groups = groups
        self.unfiltered = unfiltered
        self.object = device.create_pipeline_layout(bind_group_layouts=groups)


class GpuProgram:
    """A program.

    Attributes:
        uniforms, storages, textures, images: the slots of each kind.
        groups: number of bind groups, up to the last one that isn't empty.
        float_textures: the slots of textures of floats that aren't compared.
        written: the storage slots that it may write.
        pipelines: its cached pipelines.
        tests_alpha: whether its fragment stage outputs an alpha for the alpha test.
        pads: the bindings of its pads, by the stages that count them.
        select_offsets: returns the offsets of its uniforms, in order, from those of all slots.
        offset_array: an array for them.
    """

    def __init__(
        self,
        implementation: Implementation,
        device: GpuObject,
        program: Id,
        descriptor: ProgramDescriptor,
        *,
        has_pads: bool,
    ) -> None:
        self.id = program
        self.descriptor = descriptor
        self.modules: dict[Stage, GpuObject] = {}
        self.pipelines: dict[object, Any] = {}
        self._implementation = implementation
        self._device = device
        self._visibility: dict[tuple[int, int], int] = {}
        self._access: dict[tuple[int, int], str] = {}
        self._layouts: dict[tuple[int, ...], PipelineLayout] = {}
        self.tests_alpha = False
        self._fragment = ""
        self._flat: GpuObject | None = None
        for stage in sorted(descriptor.stages, key=lambda stage: stage.value):
            self._compile(stage)
        self._types = {(b.kind, b.slot): b.type for b in descriptor.bindings}
        slots = {
            kind: tuple(sorted(b.slot for b in descriptor.bindings if b.kind is kind)) for kind in BindingKind
        }
        self.uniforms, self.storages = slots[BindingKind.UNIFORM], slots[BindingKind.STORAGE]
        self.select_offsets = _make_selection(self.uniforms)
        self.offset_array = implementation.offset_array(len(self.uniforms))
        self.textures, self.images = slots[BindingKind.TEXTURE], slots[BindingKind.IMAGE]
        self.groups = (
            4 if self.images else 3 if self.textures else 2 if self.storages else 1 if self.uniforms else 0
        )
        self.written = tuple(s for s in self.storages if self._access.get((1, s)) == "read_write")
        self.written_images = tuple(s for s in self.images if self._access.get((3, s)) != "read")
        types = {slot: self.texture_type(slot) for slot in self.textures}
        self.pads = self._assign_pad_slots() if has_pads else {}
        self.float_textures = tuple(
            s for s, type in types.items() if type.scalar is FLOAT and not (type.compare or type.samples)
        )

    def _assign_pad_slots(self) -> dict[int, int]:
        pads: dict[int, int] = {}
        for stage in (_VISIBILITY[stage] for stage in self.modules):
            read = [
                slot for slot in self.uniforms if self._get_visibility(BindingKind.UNIFORM, 2 * slot) & stage
            ]
            if len(read) > _FAULTY:
                binding = 2 * read[_FAULTY] - 1
                pads[binding] = pads.get(binding, 0) | stage
        return pads

    def _compile(self, stage: Stage) -> None:
        descriptor = self.descriptor
        source = descriptor.emit("wgsl", stage)
        try:
            with translate_errors(f"device.program({descriptor.name})"):
                self.modules[stage] = self._implementation.create_module(
                    self._device, descriptor.name, source.text
                )
        except ModuleError as error:
            raise make_driver_error(descriptor, stage, source, iter(error.messages), "WGSL") from None
        for address, access in read_declarations(source.text).items():
            self._visibility[address] = self._visibility.get(address, 0) | _VISIBILITY[stage]
            declared = self._access.get(address, access)
            self._access[address] = access if declared == access else "read_write"
        if stage is Stage.FRAGMENT:
            self.tests_alpha = "override rhi_alpha_test" in source.text
            self._fragment = source.text

    def get_fragment_module(self, *, has_depth: bool) -> GpuObject:
        """Return the module of the fragment stage for passes with depth or without it. WebGPU refuses to
        write depth that isn't there, so it goes to a color that isn't there, which is dropped."""
        if has_depth or _DEPTH not in self._fragment:
            return self.modules[Stage.FRAGMENT]
        if self._flat is None:
            taken = {output.location for output in self.descriptor.outputs}
            free = next(number for number in range(MAX_TARGETS + 1) if number not in taken)
            text = self._fragment.replace(_DEPTH, f"@location({free})")
            with translate_errors(f"device.program({self.descriptor.name})"):
                self._flat = self._device.create_shader_module(label=self.descriptor.name, code=text)
        return self._flat

    def texture_type(self, slot: int) -> TextureType:
        """Return the type of a texture's slot; descriptors that are made by hand may have none."""
        type = self._types.get((BindingKind.TEXTURE, slot))
        return type if isinstance(type, TextureType) else TextureType(TextureKind.D2)

    def image_type(self, slot: int) -> ImageType:
        """Return the type of an image's slot."""
        type = self._types[BindingKind.IMAGE, slot]
        assert isinstance(type, ImageType)
        return type

    def layout(self, unfiltered: tuple[int, ...]) -> PipelineLayout:
        """Return the layout in which the textures of the slots `unfiltered` can't be filtered."""
        pipeline_layout = self._layouts.get(unfiltered)
        if pipeline_layout is None:
            rows = (self._uniforms(), self._storages(), self._textures(unfiltered), self._images())
            with translate_errors(f"device.program({self.descriptor.name})"):
                groups = [self._device.create_bind_group_layout(entries=entries) for entries in rows]
                pipeline_layout = self._layouts[unfiltered] = PipelineLayout(self._device, groups, unfiltered)
        return pipeline_layout

    def _entry(self, kind: BindingKind, binding: int, **layout: object) -> dict[str, Any]:
        return {"binding": binding, "visibility": self._get_visibility(kind, binding), **layout}

    def _get_visibility(self, kind: BindingKind, binding: int) -> int:
        fallback = GpuShaderStage.COMPUTE if Stage.COMPUTE in self.modules else GpuShaderStage.FRAGMENT
        return int(self._visibility.get((SETS[kind], binding), fallback))

    def _uniforms(self) -> list[dict[str, Any]]:
        buffer = {"type": "uniform", "has_dynamic_offset": True}
        read = [self._entry(BindingKind.UNIFORM, 2 * slot, buffer=buffer) for slot in self.uniforms]
        pads = [{"binding": b, "visibility": v, "buffer": {"type": "uniform"}} for b, v in self.pads.items()]
        return read + pads

    def _storages(self) -> list[dict[str, Any]]:
        return [
            self._entry(
                BindingKind.STORAGE,
                slot,
                buffer={"type": "storage" if slot in self.written else "read-only-storage"},
            )
            for slot in self.storages
        ]

    def _textures(self, unfiltered: tuple[int, ...]) -> list[dict[str, Any]]:
        entries = []
        for slot in self.textures:
            type = self.texture_type(slot)
            if type.compare:
                sample, sampler = "depth", "comparison"
            elif type.scalar is not FLOAT:
                sample, sampler = "sint" if type.scalar is INT else "uint", "non-filtering"
            elif slot in unfiltered or type.samples:
                sample, sampler = "unfilterable-float", "non-filtering"
            else:
                sample, sampler = "float", "filtering"
            texture = {
                "sample_type": sample,
                "view_dimension": DIMENSIONS[type.kind],
                "multisampled": type.samples,
            }
            entries.append(self._entry(BindingKind.TEXTURE, 2 * slot, texture=texture))
            entries.append(self._entry(BindingKind.TEXTURE, 2 * slot + 1, sampler={"type": sampler}))
        return entries

    def _images(self) -> list[dict[str, Any]]:
        entries = []
        for slot in self.images:
            type = self.image_type(slot)
            access = _ACCESS[self._access.get((3, slot)) or "read_write"]
            image = {
                "access": access,
                "format": FORMATS[type.format],
                "view_dimension": DIMENSIONS[type.kind],
            }
            entries.append(self._entry(BindingKind.IMAGE, slot, storage_texture=image))
        return entries
