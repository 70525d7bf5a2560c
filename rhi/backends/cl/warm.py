"""The kernels that every program needs, built before any program does (`python -m rhi warm`).

They are the kernels that don't depend on a program: set-up and binning of primitives, and what programs share until
their own kernels are optimised (`raster.general_raster`). Other processes build them optimised, one a core.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, wait

from rhi.backends.cl.builds import Builds, Optimisation
from rhi.backends.cl.cl_context import ClContext, open_context
from rhi.backends.cl.memory.cl_samplers import Samplers
from rhi.backends.cl.raster.cl_pipelines import request_geometry
from rhi.backends.cl.raster.general_raster import GeneralRaster


def warm(report: Callable[[int, int], None] = lambda done, count: None) -> int:
    """Build the kernels that every program needs into the cache of compiled kernels; return how many were missing.

    Args:
        report: is called with the numbers of programs that are built and that are to be built.

    Raises:
        DeviceError: `device-driver` if there is no OpenCL device.
    """
    context = open_context()
    builds = Builds(context, optimises=True)
    try:
        missing = [
            optimisation
            for optimisation in list_fixed_kernels(context, builds)
            if not builds.is_cached(optimisation.request, optimisation.launch)
        ]
        pending = {optimisation.begin() for optimisation in missing}
        while pending:
            report(len(missing) - len(pending), len(missing))
            pending = wait(pending, return_when=FIRST_COMPLETED).not_done
        report(len(missing), len(missing))
        return len(missing)
    finally:
        builds.close()


def list_fixed_kernels(context: ClContext, builds: Builds) -> list[Optimisation]:
    """Return builds of all kernels that don't depend on programs, none of which has begun."""
    jobs = [request_geometry(builds)]
    general = GeneralRaster(context, builds, Samplers(context.context).texture_functions)
    if general.calls_stages:
        jobs += general.list_requests()
    return [Optimisation(request, launch, builds) for request, launch in jobs]
