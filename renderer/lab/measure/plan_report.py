"""The cost of a frame's plan, pass by pass: the textures that it uses, and the commands that it records.

Commands are counted on a null device, which records the same ones that another device executes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import rhi
from renderer.frame import Effect, Frame, FramePass, Plan
from renderer.frame.plan import resource_names
from renderer.frame.resources import SIMULATION_EVENT
from renderer.lab.measure.draw_order import DrawOrderRow, StateChanges, compare_orders, count_changes
from renderer.lab.measure.memory import MemoryReport, describe_memory
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene
from renderer.shadows import MapReport
from renderer.techniques import Technique
from rhi import Commands, Op


@dataclass(frozen=True, slots=True)
class PassRow:
    """A pass of a plan.

    Attributes:
        reason: why the frame has the pass.
        reads, writes: names of resources; those that are drawn over are in both lists.
        bytes: size of the textures that are written.
        draws, dispatches: numbers of commands.
        changes: state changes between the draws.
    """

    name: str
    reason: str
    reads: list[str]
    writes: list[str]
    bytes: int
    draws: int
    dispatches: int
    changes: StateChanges


@dataclass(frozen=True, slots=True)
class OmittedEffect:
    """A pass or an effect that the frame doesn't have, and why."""

    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class SimulationReport:
    """The work of simulations in the frame after the planned one, 1/60 s later.

    Attributes:
        run, skipped: the numbers of simulated and animated objects that are drawn, and that aren't.
        steps: steps of all members.
        dispatches: the dispatches that run these steps.
    """

    run: int
    skipped: int
    steps: int
    dispatches: int


@dataclass(frozen=True, slots=True)
class PlanReport:
    """The plan of one frame.

    Attributes:
        passes: in their order.
        effects: the frame's effects, with the reasons.
        left_out: effects that the frame lacks, passes that were dropped, and what the scene's file has and
            the scene hasn't.
        texture_bytes: the size of all textures that passes write.
        textures: the resources that share each texture.
        shadow_maps: the state of each shadow map.
        memory: what the renderer holds on the device, the scene included.
        orders: state changes between the objects of the first pass over the scene, drawn in several orders.
        simulations: the work of simulations; None in a scene without any.
    """

    passes: list[PassRow]
    effects: dict[str, str]
    left_out: list[OmittedEffect]
    textures: list[list[str]]
    texture_bytes: int
    shadow_maps: list[MapReport]
    memory: MemoryReport
    orders: list[DrawOrderRow]
    simulations: SimulationReport | None = None


def describe_plan(scene: Scene, technique: Technique, camera: Camera, size: tuple[int, int]) -> PlanReport:
    """Plan a frame, draw it on a null device, and count the commands of each pass.

    Args:
        size: (width, height) of the image in pixels.
    """
    with (
        rhi.create_device("null") as device,
        Renderer(device, scene, technique=technique, visibility="frustum", size=size) as renderer,
    ):
        draw_result = renderer.render(camera).frames[0].draw_result.opaque
        effects, plan = renderer.plan(camera)
        commands = _divide_by_pass(device, plan)
        orders = compare_orders(scene, camera, draw_result, _select_geometry_draws(commands))
        maps = renderer.shadows.reports
        simulations = _describe_simulations(renderer, camera) if len(renderer.simulator) else None
        memory = describe_memory(device.stream, renderer.images)
    by_name = {name: texture for texture in plan.textures for name in texture.names}

    def describe(frame_pass: FramePass[Frame]) -> PassRow:
        written = [*resource_names(frame_pass.writes), *frame_pass.changes.values()]
        return PassRow(
            name=frame_pass.name,
            reason=frame_pass.reason,
            reads=[
                *frame_pass.reads,
                *frame_pass.changes,
                *(f"{name} of the last frame" for name in frame_pass.reads_previous),
            ],
            writes=written,
            bytes=sum(by_name[name].count_bytes(size) for name in written if name in by_name),
            draws=len(commands[frame_pass.name].draws()),
            dispatches=len(commands[frame_pass.name].filter((Op.DISPATCH, Op.DISPATCH_INDIRECT))),
            changes=count_changes(commands[frame_pass.name]),
        )

    return PlanReport(
        passes=[describe(part) for part in plan.passes],
        effects={effect.value: effects.explain(effect) for effect in Effect if effect in effects.enabled},
        left_out=[
            *(OmittedEffect(e.value, effects.explain(e)) for e in Effect if e not in effects.enabled),
            *(OmittedEffect(dropped.name, dropped.reason) for dropped in plan.dropped),
            *(
                OmittedEffect(omission.what, f"the file has it, the scene hasn't: {omission}")
                for omission in scene.omissions
            ),
        ],
        textures=[list(texture.names) for texture in plan.textures],
        texture_bytes=plan.count_bytes(size),
        shadow_maps=maps,
        memory=memory,
        orders=orders,
        simulations=simulations,
    )


def _describe_simulations(renderer: Renderer, camera: Camera) -> SimulationReport:
    """Draw the next frame, and count the work of simulations in it."""
    stream = renderer.device.stream
    before = len(stream)
    counted = renderer.render(camera, 1.0 / 60.0).statistics
    issued = stream[before:].filter(Op.DISPATCH, label=SIMULATION_EVENT)
    skipped = counted.skipped_simulations
    return SimulationReport(len(renderer.simulator) - skipped, skipped, counted.simulation_steps, len(issued))


def _divide_by_pass(device: rhi.Device, plan: Plan[Frame]) -> dict[str, Commands]:
    """The commands of each pass by its name."""
    return {frame_pass.name: _filter_pass(device.stream, frame_pass.name) for frame_pass in plan.passes}


def _filter_pass(commands: Commands, name: str) -> Commands:
    return commands.filter(where=lambda command: command.labels[:1] == (name,))


def _select_geometry_draws(commands: Mapping[str, Commands]) -> Commands:
    """The draws of the scene's objects in the first pass that draws them."""
    draws_by_pass = (
        pass_commands.draws().filter(where=lambda draw: "object_positions" in draw.bindings)
        for pass_commands in commands.values()
    )
    return next((draws for draws in draws_by_pass if len(draws)), next(iter(commands.values()))[:0])
