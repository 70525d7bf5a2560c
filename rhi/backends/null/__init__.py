"""The null backend: real memory and real execution order, but no GPU. Draws are counted, not rasterised.

`create_backend()` returns the backend itself. A device created with `rhi.create_device("null")` always has a
`rhi.commands.recorder.Recorder` in front of it. With `simulation=Simulation(…)` it has a GPU on a simulated
clock.
"""

from rhi.backends.null.answers import AnswerLog, RecordedAnswers
from rhi.backends.null.faults import FaultInjector, Faults
from rhi.backends.null.null_backend import ExecutionStatistics, NullBackend
from rhi.backends.null.null_capabilities import PROFILES, get_profile
from rhi.backends.null.null_draws import Draw, ExecutedIndirectDraws
from rhi.backends.null.shaders import StandIn
from rhi.backends.null.simulation.activity import Activity, ActivityTimeline, FrameActivity, Lane, Span
from rhi.backends.null.simulation.cost import CommandWork, CostModel
from rhi.backends.null.simulation.hazards import Hazard, HazardKind
from rhi.backends.null.simulation.simulated_backend import SimulatedBackend, Simulation
from rhi.contract.backend import Backend, Capabilities
from rhi.errors import refuse
from rhi.errors.rules import DEVICE_ARGUMENT

__all__ = [
    "PROFILES",
    "Activity",
    "ActivityTimeline",
    "AnswerLog",
    "CommandWork",
    "CostModel",
    "Draw",
    "ExecutedIndirectDraws",
    "ExecutionStatistics",
    "FaultInjector",
    "Faults",
    "FrameActivity",
    "Hazard",
    "HazardKind",
    "Lane",
    "NullBackend",
    "RecordedAnswers",
    "SimulatedBackend",
    "Simulation",
    "Span",
    "StandIn",
    "create_backend",
]


def create_backend(
    *,
    validation: bool = False,
    profile: str | Capabilities = "everything",
    simulation: Simulation | None = None,
    faults: Faults | None = None,
) -> Backend:
    """Create a null backend. `validation` has no effect, since there is no driver whose messages it could
    enable.

    Args:
        profile: the capabilities to present: a name of `PROFILES`, or a `Capabilities`.
        simulation: execute commands on a simulated clock (in a `SimulatedBackend`). None: execute them when
            something depends on them.
        faults: the faults to inject (by a `FaultInjector` in front of the backend).

    Raises:
        ValidationError: `device-argument` for an unknown profile, or an option of the wrong type.
    """
    for name, value, kind in (("simulation", simulation, Simulation), ("faults", faults, Faults)):
        if not isinstance(value, (kind, type(None))):  # `rhi.create_device` forwards any value
            refuse(DEVICE_ARGUMENT, f"{name}=", repr(value), f"a {kind.__name__}, or None")
    capabilities = get_profile(profile)
    backend = NullBackend(capabilities) if simulation is None else SimulatedBackend(simulation, capabilities)
    return backend if faults is None else FaultInjector(backend, faults)
