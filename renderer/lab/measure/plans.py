"""Costs of a frame's plan, pass by pass: the textures that it uses, and the commands that it issues.

Commands are counted on a null device, which records the same ones that another device executes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import rhi
from renderer.frame import Effect, Frame, Pass, Plan
from renderer.frame.plan import list_names
from renderer.frame.resources import SIMULATION_EVENT
from renderer.lab.measure.draw_order import Changes, OrderRow, compare_orders, count_changes
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
        because: why the frame has the pass.
        reads, writes: names of contents; what is drawn over is in both lists.
        bytes: size of the textures that are written. draws, dispatches: numbers of commands.
        changes: what changes between the draws.
    """

    name: str
    because: str
    reads: list[str]
    writes: list[str]
    bytes: int
    draws: int
    dispatches: int
    changes: Changes


@dataclass(frozen=True, slots=True)
class LeftOut:
    """A pass or an effect that the frame doesn't have, and why."""

    name: str
    because: str


@dataclass(frozen=True, slots=True)
class SimulationReport:
    """The work of simulations in the frame after the planned one, a 60th of a second later.

    Attributes:
        run, skipped: the numbers of simulated and animated objects that are drawn, and that aren't.
        steps: those that their members take. dispatches: those that the device takes steps in.
    """

    run: int
    skipped: int
    steps: int
    dispatches: int


@dataclass(frozen=True, slots=True)
class PlanReport:
    """The plan of one frame.

    Attributes:
        passes: in their order. effects: those that are needed, with the reasons.
        left_out: effects that aren't needed, passes that were dropped, and what the scene's file has and the scene
            hasn't. texture_bytes: the size of all textures that passes write.
        textures: the contents that each texture holds in turn. shadow_maps: what became of each shadow map.
        memory: what the renderer holds on the device, the scene included.
        orders: what changes between the objects of the first pass over the scene's geometry, drawn in several orders.
        simulations: what simulations do; None in a scene without any.
    """

    passes: list[PassRow]
    effects: dict[str, str]
    left_out: list[LeftOut]
    textures: list[list[str]]
    texture_bytes: int
    shadow_maps: list[MapReport]
    memory: MemoryReport
    orders: list[OrderRow]
    simulations: SimulationReport | None = None


def describe_plan(scene: Scene, technique: Technique, camera: Camera, size: tuple[int, int]) -> PlanReport:
    """Plan a frame, draw it on a null device and count what each pass does.

    Args:
        size: (width, height) of the image in pixels.
    """
    with (
        rhi.create_device("null") as device,
        Renderer(device, scene, technique=technique, visibility="frustum", size=size) as renderer,
    ):
        drawn = renderer.render(camera).frames[0].drawn.opaque
        needs, plan = renderer.plan(camera)
        commands = _divide_by_pass(device, plan)
        orders = compare_orders(scene, camera, drawn, _find_geometry(commands))
        maps = renderer.shadows.reports
        simulations = _describe_simulations(renderer, camera) if len(renderer.simulator) else None
        memory = describe_memory(device.stream, renderer.images)
    by_name = {name: texture for texture in plan.textures for name in texture.names}

    def describe(one: Pass[Frame]) -> PassRow:
        written = [*list_names(one.writes), *one.changes.values()]
        return PassRow(
            name=one.name,
            because=one.because,
            reads=[*one.reads, *one.changes, *(f"{name} of the last frame" for name in one.reads_last)],
            writes=written,
            bytes=sum(by_name[name].count_bytes(size) for name in written if name in by_name),
            draws=len(commands[one.name].draws()),
            dispatches=len(commands[one.name].filter((Op.DISPATCH, Op.DISPATCH_INDIRECT))),
            changes=count_changes(commands[one.name]),
        )

    return PlanReport(
        passes=[describe(one) for one in plan.passes],
        effects={effect.value: needs.explain(effect) for effect in Effect if effect in needs.effects},
        left_out=[
            *(LeftOut(e.value, needs.explain(e)) for e in Effect if e not in needs.effects),
            *(LeftOut(one.name, one.because) for one in plan.dropped),
            *(LeftOut(one.what, f"the file has it, the scene hasn't: {one}") for one in scene.omissions),
        ],
        textures=[list(texture.names) for texture in plan.textures],
        texture_bytes=plan.count_bytes(size),
        shadow_maps=maps,
        memory=memory,
        orders=orders,
        simulations=simulations,
    )


def _describe_simulations(renderer: Renderer, camera: Camera) -> SimulationReport:
    """Draw the next frame, and return what simulations have done in it."""
    stream = renderer.device.stream
    before = len(stream)
    counted = renderer.render(camera, 1.0 / 60.0).statistics
    issued = stream[before:].filter(Op.DISPATCH, label=SIMULATION_EVENT)
    skipped = counted.skipped_simulations
    return SimulationReport(len(renderer.simulator) - skipped, skipped, counted.simulation_steps, len(issued))


def _divide_by_pass(device: rhi.Device, plan: Plan[Frame]) -> dict[str, Commands]:
    """Return the commands of each pass by its name."""
    return {one.name: _filter_pass(device.stream, one.name) for one in plan.passes}


def _filter_pass(commands: Commands, name: str) -> Commands:
    return commands.filter(where=lambda command: command.labels[:1] == (name,))


def _find_geometry(commands: Mapping[str, Commands]) -> Commands:
    """Return the draws of the scene's objects in the first pass that draws them."""
    found = (some.draws().filter(where=lambda draw: "places" in draw.bindings) for some in commands.values())
    return next((draws for draws in found if len(draws)), next(iter(commands.values()))[:0])
