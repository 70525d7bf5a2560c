"""The languages that shaders are written in: a table from a language's name to the function that writes a
stage in it.

A language is one function `(ShaderCode, Stage) -> StageText` and its row, made by `register_language`, here
or in the package of a port. It writes from the typed tree of the stage (`ShaderCode.stages`), as GLSL does,
or from lane code (`ShaderCode.lower_compute`), as OpenCL C and NumPy do.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import TYPE_CHECKING, Final

from rhi.contract.descriptors import Stage, StageText, StageVarying
from rhi.errors import ShaderError, refuse
from rhi.errors.call_sites import find_call_site
from rhi.errors.data_classes import dataclass
from rhi.errors.shared_caches import SHARED
from rhi.shading.glsl.glsl_stages import write_stage
from rhi.shading.ir import tree
from rhi.shading.ir.interface import Interface
from rhi.shading.language import rules
from rhi.shading.language.builtins import Precision

# Lane code and most writers are imported when a shader first needs them: they would take a tenth of `import
# rhi`.
if TYPE_CHECKING:
    from rhi.shading.ir.lanes import Code

WIDTHS: Final = (1, 4, 8, 16)
"""The numbers of lanes that compute kernels are written for."""


class ShaderCode:
    """A type-checked shader, from which its stages are written in a language when they are first requested.

    - Texts are cached by language and stage, because several devices may request them. Threads share them, so
      each is written under the lock of what threads share.
    - Lane code is cached until its text is written. A doubtful compute stage is lowered for 16 lanes when it
      is checked, long before a device may request its text.

    Attributes:
        stages: the typed tree of each stage.
        interface: what the trees don't hold: inputs, outputs, varyings, the bindings and their slots, the
            work-group.
        bindings: the bindings, in order.
        varyings: the varyings that the fragment stage reads.
        precision: how exact built-ins must be.
        checked: whether faults are reported on the device.
        unused: an error for each binding that nothing uses.
    """

    def __init__(
        self,
        stages: Mapping[Stage, tree.StageTree],
        interface: Interface,
        varyings: tuple[StageVarying, ...],
        precision: Precision,
        checked: bool,
        unused: tuple[ShaderError, ...] = (),
    ) -> None:
        self.stages = stages
        self.interface = interface
        self.bindings = tuple(interface.bindings.values())
        self.varyings = varyings
        self.precision = precision
        self.checked = checked
        self.unused = unused
        self._texts: dict[tuple[str, Stage], StageText] = {}
        self._lane_code: dict[int, Code] = {}  # of the compute stage, by width
        self._other_precision: ShaderCode | None = None

    def emit(self, language: str, stage: Stage) -> StageText:
        """Return a stage's text in a language, writing it on first use; see `ProgramDescriptor.emit`.

        Raises:
            ShaderError: `shading-native`: the stage can't be written in this language.
        """
        text = self._texts.get((language, stage))
        if text is None:
            with SHARED:
                text = self._emit_once(language, stage)
        return text

    def _emit_once(self, language: str, stage: Stage) -> StageText:
        text = self._texts.get((language, stage))
        if text is None:
            device_language = _LANGUAGES.get(language)
            if device_language is None or stage not in device_language.stages:
                names = ", ".join(name for name, row in _LANGUAGES.items() if stage in row.stages)
                raise ShaderError(
                    rules.NATIVE, f"{self.interface.name}: emit({language!r}, {stage})", language, names
                )
            try:
                text = self._texts[language, stage] = device_language.write(self, stage)
            except RecursionError:
                raise make_depth_error(self.interface.name) from None
        return text

    def with_other_precision(self, precision: Precision) -> ShaderCode:
        """Return the same stages in the other precision, with texts of their own."""
        with SHARED:
            if self._other_precision is None:
                expected = self.interface, self.varyings
                self._other_precision = ShaderCode(
                    self.stages, *expected, precision, self.checked, self.unused
                )
            return self._other_precision

    def list_exact_functions(self) -> list[str]:
        """Return the built-ins in written OpenCL C texts that `Precision.FAST` computes with fewer
        instructions."""
        if self.precision is Precision.FAST:
            return []
        names = set()
        for stage in {stage for language, stage in list(self._texts) if language.startswith("opencl")}:
            names |= {builtin.name for builtin in self.stages[stage].builtins if builtin.fast}
            nodes = (node for function in self.stages[stage].functions for node in tree.walk(function.body))
            if any(isinstance(node, tree.Binary) and node.operator is tree.Operator.DIVIDE for node in nodes):
                names.add("divide")
        return sorted(names)

    def written(self) -> Mapping[tuple[str, Stage], StageText]:
        """Return the texts that were requested, by language and stage."""
        return dict(self._texts)

    def lower_compute(self, width: int) -> Code:
        """Return the lane code of the compute stage for `width` lanes, or for whole arrays with 0.

        Raises:
            ShaderError: a rule that only lane code can check, such as one about barriers.
        """
        code = self._lane_code.get(width)
        if code is None:
            from rhi.shading.lowering.functions import lower_compute

            stage, shared = self.stages[Stage.COMPUTE], self.interface
            code = lower_compute(stage, shared.name, shared.work_group, width, self.checked)
            self._lane_code[width] = code
        return code

    def take_compute(self, width: int) -> Code:
        """Return the lane code of the compute stage, and drop it from the cache."""
        code = self.lower_compute(width)
        del self._lane_code[width]
        return code


Write = Callable[[ShaderCode, Stage], StageText]


@dataclass(frozen=True, slots=True)
class DeviceLanguage:
    """A row of the table: the function that writes a stage, and the stages that it can write."""

    write: Write
    stages: frozenset[Stage]


_LANGUAGES: Final[dict[str, DeviceLanguage]] = {}


def register_language(name: str, write: Write, stages: Collection[Stage] = tuple(Stage)) -> None:
    """Add a language: `ProgramDescriptor.emit(name, stage)` returns the text that `write(code, stage)`
    creates.

    Raises:
        ValidationError `shading-language`: a language has this name.
    """
    if name in _LANGUAGES:
        refuse(
            rules.LANGUAGE,
            f"register_language({name!r}, …)",
            name,
            "a name other than " + ", ".join(_LANGUAGES),
        )
    _LANGUAGES[name] = DeviceLanguage(write, frozenset(stages))


def registered_languages() -> tuple[str, ...]:
    """Return the names of all languages, in the order of their registration."""
    return tuple(_LANGUAGES)


def make_depth_error(name: str) -> ShaderError:
    """Return the error for a shader whose compilation reached Python's recursion limit.

    The shader itself is within the limits of nesting; the stack was deep already."""
    tip = "compile it where fewer functions have been called, or raise sys.setrecursionlimit(…)"
    return ShaderError(
        rules.TOO_DEEP,
        f"class {name}",
        "Python's recursion limit was reached",
        tip=tip,
        site=find_call_site(),
    )


# -- the languages -------------------------------------------------------------------------------------------


def _write_glsl(code: ShaderCode, stage: Stage) -> StageText:
    """Write a stage as GLSL 4.30 for OpenGL."""
    return write_stage(code.stages[stage], code.interface, code.precision is Precision.EXACT)


def _write_vulkan(code: ShaderCode, stage: Stage) -> StageText:
    """Write a stage as GLSL 4.50 for Vulkan."""
    from rhi.shading.glsl.vulkan import write_vulkan_stage

    return write_vulkan_stage(code.stages[stage], code.interface, code.precision is Precision.EXACT)


def _write_spirv(code: ShaderCode, stage: Stage) -> StageText:
    """Write a stage as GLSL for Vulkan, with its SPIR-V."""
    from rhi.shading.glsl.spirv import compile_spirv

    return compile_spirv(code.emit("vulkan", stage), stage, code.interface.name)


def _write_wgsl(code: ShaderCode, stage: Stage) -> StageText:
    """Write a stage as WGSL."""
    from rhi.shading.wgsl.wgsl_stages import write_wgsl_stage

    return write_wgsl_stage(code.stages[stage], code.interface)


def _write_opencl(width: int) -> Write:
    """Return the function that writes OpenCL C for `width` lanes: a kernel, or the function of a draw's
    stage."""

    def write(code: ShaderCode, stage: Stage) -> StageText:
        return _write_kernel(code, width) if stage is Stage.COMPUTE else _write_function(code, stage)

    return write


def _write_kernel(code: ShaderCode, width: int) -> StageText:
    from rhi.shading.ir.lanes import Code
    from rhi.shading.opencl.opencl_writer import write_opencl_kernel

    entry, interface = code.stages[Stage.COMPUTE].entry, code.interface
    if f"opencl{width}" in entry.native:
        empty = Code(interface.name, width, [], (), work_group=interface.work_group)
        return write_opencl_kernel(empty, code.bindings, code.precision, entry)
    return write_opencl_kernel(code.take_compute(width), code.bindings, code.precision)


def _write_function(code: ShaderCode, stage: Stage) -> StageText:
    from rhi.shading.lowering.bounds import bound_positions
    from rhi.shading.lowering.stages import lower_stage
    from rhi.shading.opencl.opencl_stages import write_opencl_stage

    lanes = lower_stage(code.stages[stage], code.interface, code.varyings, checked=code.checked)
    bounds = bound_positions(lanes) if stage is Stage.VERTEX else None
    return write_opencl_stage(code.stages[stage], lanes, bounds, code.bindings, code.precision)


def _write_numpy(code: ShaderCode, stage: Stage) -> StageText:
    """Write a compute stage as a NumPy module."""
    from rhi.shading.numpy.kernel import write_numpy_kernel

    return StageText(write_numpy_kernel(code.take_compute(0)))


register_language("glsl", _write_glsl)
for _width in WIDTHS:
    register_language(
        f"opencl{_width}", _write_opencl(_width), [Stage.COMPUTE] if _width < max(WIDTHS) else list(Stage)
    )
register_language("numpy", _write_numpy, [Stage.COMPUTE])
register_language("vulkan", _write_vulkan)
register_language("spirv", _write_spirv)
register_language("wgsl", _write_wgsl)
