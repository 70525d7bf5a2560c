"""Kernels that programs share until their own are optimised: the raster kernel, and functions that sample.

- The raster kernel reads formats and states as data (`merger.general_defines`), and calls the program's fragment
  stage by its address. So a new program builds its stage alone (kernels/stage.cl), in a tenth of the time.
- The stage in turn calls a function that samples textures of any kind, by an address in their words
  (`rhi.shading.opencl.opencl_textures`). Until a stage needs that, those that only sample 2D textures share a
  function with half of the code.
- Programs that flush denormals have one of their own, since that is an option of a kernel.
- The addresses of functions are known on x86-64 under Linux only. Elsewhere, and if the compiler has removed the
  function, each program builds a general kernel with its stage in it (`cl_pipelines.Pipeline`).
- PoCL never unloads a kernel's code (`rhi.backends.cl.pocl.memory_maps`), so an address stays valid.
"""

from __future__ import annotations

import platform
import sys
from contextlib import nullcontext
from typing import Final

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from rhi.backends.cl.builds import Arguments, Builds, Kernel, Launch
from rhi.backends.cl.cl_context import ClContext
from rhi.backends.cl.cl_errors import translate_errors
from rhi.backends.cl.pocl.kernel_cache import Request
from rhi.backends.cl.pocl.program_residency import EvictableProgram
from rhi.backends.cl.raster import kernel_structs, merger
from rhi.backends.cl.raster.kernel_text import read_kernels
from rhi.contract.states import MAX_TARGETS
from rhi.shading.language.builtins import Precision
from rhi.shading.opencl.opencl_textures import TextureFunction, texture_function_text

RASTER: Final = "raster"
STAGE: Final = "stage"
_TEXTURES: Final = "textures"
_DRAW: Final[Arguments] = (kernel_structs.EMPTY_TABLE,)
_CALL: Final[Arguments] = ((bytes(16), ()),)
POLYGONS: Final = "common", "triangles", "polygon"
RASTER_FILES: Final = "varyings", "records", "edges", "depth_tile", "shade", "raster"
STAGE_FILES: Final = "varyings", "stage"
_MACROS: Final = """
#define VARYING_WORDS batch->varying_words
#define FRAGMENT 1
#define CACHES_DEPTH 0
#define BOUNDS_DEPTH 0
#define CALLS_STAGE
"""


class GeneralRaster:
    """The shared raster kernels of one device.

    Attributes:
        calls_stages: whether kernels can call stages by their addresses.
        texture_functions: the addresses of the functions that sample, by `TextureFunction.slot`; 0 before their
            first use.
    """

    def __init__(self, context: ClContext, builds: Builds, texture_functions: NDArray[np.uint64]) -> None:
        self.texture_functions = texture_functions
        self._queue = context.queue
        self._builds = builds
        self._programs: dict[bool, EvictableProgram] = {}
        self.calls_stages = (
            builds.is_quick
            and sys.platform == "linux"
            and platform.machine() == "x86_64"
            and bool(context.device.type & cl.device_type.CPU)
        )

    def list_requests(self) -> list[tuple[Request, Launch]]:
        """Return the requests for all kernels that don't depend on programs, each with a launch."""
        draws = [(self.request(flushes), Launch((RASTER,), _DRAW)) for flushes in (False, True)]
        functions = [TextureFunction(precision, is_plain=False) for precision in Precision]
        calls = [(self.request_textures(function), Launch((_TEXTURES,), _CALL)) for function in functions]
        return draws + calls

    def _compile(self, request: Request, arguments: Arguments) -> EvictableProgram:
        """Compile a kernel quickly, or take the optimised one from the cache."""
        is_cached = self._builds.is_cached(request, Launch(request.kernels, arguments))
        return self._builds.compile(request, quick=not is_cached)

    def request(self, flushes_denormals: bool) -> Request:
        """Return the request for the kernel."""
        before = *map(read_kernels, POLYGONS), merger.general_defines(4 * MAX_TARGETS), read_kernels("merger")
        source = "\n".join(
            (kernel_structs.common_structs(), *before, _MACROS, *map(read_kernels, RASTER_FILES))
        )
        return self._builds.request(source, (RASTER,), flushes_denormals)

    def get_program(self, flushes_denormals: bool) -> EvictableProgram:
        """Return the program of the kernel, building it on first use."""
        if flushes_denormals not in self._programs:
            request = self.request(flushes_denormals)
            self._programs[flushes_denormals] = self._compile(request, _DRAW)
        return self._programs[flushes_denormals]

    def load_function(self, request: Request) -> int:
        """Build a kernel that writes the address of a function (kernels/common.cl); return the address, 0 if the
        compiler has removed the function.

        Raises:
            pyopencl.Error: the driver rejects the source code.
        """
        (name,) = request.kernels
        built = self._builds.built
        program = self._compile(request, _CALL)
        words = np.zeros(2, np.uint64)
        waiting = self._builds.progress.waiting(name) if self._builds.built > built else nullcontext()
        with translate_errors("a draw"), waiting:
            Kernel(program, name).launch(self._queue, words.ctypes.data, 1).wait()
        return int(words[0])

    def load_texture_function(self, function: TextureFunction) -> bool:
        """Make a function that samples callable by stages; return whether it is.

        One for plain samples is the whole function, if that is loaded or compiled already."""
        addresses, index, whole = self.texture_functions, function.slot, function._replace(is_plain=False)
        if not addresses[index]:
            request = self.request_textures(whole)
            if function.is_plain and not addresses[whole.slot] and not self._is_compiled(request):
                addresses[index] = self.load_function(self.request_textures(function))
            else:
                addresses[whole.slot] = addresses[whole.slot] or self.load_function(request)
                addresses[index] = addresses[whole.slot]
        return bool(addresses[index])

    def _is_compiled(self, request: Request) -> bool:
        """Return whether a kernel is in the cache, optimised or not."""
        return self._builds.is_cached(request, Launch(request.kernels, ())) or self._builds.is_stored(request)

    def request_textures(self, function: TextureFunction) -> Request:
        """Return the request for the kernel of a function that samples."""
        text = texture_function_text("rhi_run_texture", function)
        kernel = "ADDRESS_KERNEL(textures, rhi_run_texture, RhiTextureCall)"
        source = "\n".join((kernel_structs.common_structs(), read_kernels("common"), text, kernel, ""))
        return self._builds.request(source, (_TEXTURES,))
