"""`plan`: show the passes of a frame, and why each of them is there.

  python -m renderer plan city
  python -m renderer plan hall --technique forward --camera ground --frame 600 --json
  python -m renderer plan city --plot plan.svg
  python -m renderer plan night --backend gl

A pass is in the plan because an effect of the scene calls for it, or because another pass reads what it
writes. The commands are counted on the null device, so no GPU is needed. With --technique auto, the device
that --backend names says which technique is the fastest; the null device doesn't know. In the plot a column
is a pass and a row a texture, with the resources that share it: dark where they are written, light where they
are read.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import asdict, astuple
from pathlib import Path
from typing import Final

import rhi
from renderer.cli import options
from renderer.cli.arguments import explain_technique, make_technique, open_scene
from renderer.cli.options import option
from renderer.cli.output import draw_chart, note, prepare_chart
from renderer.cli.subcommand import Subcommand
from renderer.content import parse_camera
from renderer.inspection import settle
from renderer.lab.measure import format_table
from renderer.lab.measure.memory import MemoryReport
from renderer.lab.measure.plan_report import PlanReport, SimulationReport, describe_plan
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene
from renderer.techniques import AutoTechnique, Technique

_OPTIONS: Final = (
    options.SCENE,
    *options.technique(),
    options.camera(),
    options.frame("frame of the path"),
    options.size(),
    option(
        "--backend",
        "with --technique auto, the device that measures which is the fastest",
        "null",
        "null, which measures nothing",
        metavar="NAME",
    ),
    options.output_file("--plot", "chart of passes and textures to write", "F.svg"),
    options.switch("--json", "print the plan as JSON"),
)


def _run(arguments: argparse.Namespace) -> None:
    if arguments.plot is not None:
        prepare_chart(arguments.plot)
    scene = open_scene(arguments.scene)
    camera = parse_camera(arguments.camera or next(iter(scene.views)), scene, arguments.frame)
    technique, explanation = choose_technique(arguments, scene, camera)
    report = describe_plan(scene, technique, camera, arguments.size)
    if arguments.plot is not None:
        plot_plan(report, arguments.plot, f"{technique.name}: {scene.name}")
        note(f"wrote {arguments.plot}")
    if arguments.json:
        print(json.dumps(explanation | asdict(report)))
    else:
        print(f"technique: {explanation['technique']}, {explanation['reason']}\n\n{format_plan(report)}")


def choose_technique(
    arguments: argparse.Namespace, scene: Scene, camera: Camera
) -> tuple[Technique, dict[str, str]]:
    """The technique that the arguments name, and the reason for it; `auto` measures a few."""
    with rhi.create_device(arguments.backend) as device:
        technique = make_technique(arguments, scene, device)
        if isinstance(technique, AutoTechnique):
            with Renderer(
                device, scene, technique=technique, visibility="frustum", size=arguments.size
            ) as renderer:
                settle(renderer, camera)
        explanation = explain_technique(technique, arguments)
        return technique.current if isinstance(technique, AutoTechnique) else technique, explanation


def format_plan(report: PlanReport) -> str:
    """Format the plan as text."""
    header = ("pass", "reads", "writes", "bytes", "draws", "dispatches", "reason")
    changed = ("pass", "programs", "bindings", "meshes", "states", "draws")
    changes = [(pass_row.name, *astuple(pass_row.changes), pass_row.draws) for pass_row in report.passes]
    orders = [astuple(order) for order in report.orders]
    rows = [
        (
            pass_row.name,
            ", ".join(pass_row.reads),
            ", ".join(pass_row.writes),
            pass_row.bytes,
            pass_row.draws,
            pass_row.dispatches,
            pass_row.reason,
        )
        for pass_row in report.passes
    ]
    needed = "\n".join(f"  {name}: {reason}" for name, reason in report.effects.items())
    left = "\n".join(f"  {omission.name}: {omission.reason}" for omission in report.left_out)
    maps = [
        (shadow_map.name, shadow_map.size, shadow_map.casters, shadow_map.state, shadow_map.reason)
        for shadow_map in report.shadow_maps
    ]
    shared = f"{len(report.textures)} textures, {report.texture_bytes:,} bytes"
    return "\n\n".join(
        part
        for part in (
            format_table(header, rows),
            shared,
            format_table(changed, changes),
            format_table(("objects of a pass", "programs", "materials", "meshes", "draws"), orders),
            format_table(("shadow map", "texels", "casters", "is", "reason"), maps) if maps else "",
            format_memory(report.memory),
            format_simulations(report.simulations),
            f"needed:\n{needed}" if needed else "",
            f"left out:\n{left}" if left else "",
        )
        if part
    )


def format_simulations(report: SimulationReport | None) -> str:
    """Format the work of simulations in the next frame as text; empty if there are none."""
    if report is None:
        return ""
    number = f"{report.run} of {report.run + report.skipped} objects"
    costs = f"steps: {report.steps}, dispatches: {report.dispatches}"
    return f"simulated a 60th of a second later: {number}, {costs}"


def format_memory(memory: MemoryReport) -> str:
    """Format the memory that a renderer uses on a device as text."""
    rows = [
        (memory_row.name, memory_row.shape, memory_row.count, memory_row.bytes) for memory_row in memory.rows
    ]
    table = format_table(("in memory", "is", "count", "bytes"), rows)
    total = f"{memory.bytes:,} bytes"
    if memory.image_bytes:
        ratio = memory.image_bytes / memory.single_image_bytes
        total += f"; of images {memory.image_bytes:,}, {ratio:.3f} times those of single images"
    return f"{table}\n{total}"


def plot_plan(report: PlanReport, path: Path, title: str) -> None:
    """Draw passes as columns and textures as rows."""
    with draw_chart(path, title) as figure:
        axes = figure.add_subplot()
        for row, resource in enumerate(report.textures):
            for name in resource:
                writes = [i for i, pass_row in enumerate(report.passes) if name in pass_row.writes]
                reads = [i for i, pass_row in enumerate(report.passes) if name in pass_row.reads]
                last = max([*reads, *writes])
                axes.barh(row, last - writes[0] + 0.9, left=writes[0] - 0.45, height=0.3, color="#d0d7de")
                axes.barh(
                    [row] * len(reads), 0.9, left=[i - 0.45 for i in reads], height=0.7, color="#9ecae1"
                )
                axes.barh(
                    [row] * len(writes), 0.9, left=[i - 0.45 for i in writes], height=0.7, color="#2b6ca3"
                )
                axes.text(writes[0], row, name, ha="center", va="center", color="white", fontsize=8)
        axes.set_xticks(range(len(report.passes)), [pass_row.name for pass_row in report.passes])
        axes.set_yticks(
            range(len(report.textures)), [f"texture {i + 1}" for i in range(len(report.textures))]
        )
        axes.invert_yaxis()
        axes.set_xlim(-0.5, max(len(report.passes), 4) - 0.5)


COMMAND: Final = Subcommand(
    "plan", "show the passes of a frame, and why each of them is there", _OPTIONS, _run, __doc__
)
