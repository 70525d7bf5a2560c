"""`plan`: show the passes of a frame, and why each of them is there.

  python -m renderer plan city
  python -m renderer plan hall --technique forward --camera ground --frame 600 --json
  python -m renderer plan city --plot plan.svg
  python -m renderer plan night --backend gl

A pass is in the plan because an effect of the scene calls for it, or because another pass reads what it writes. The
commands are counted on the null device, so no GPU is needed. With --technique auto, the device that --backend names
says which technique is the fastest; the null device doesn't know. In the plot a column is a pass and a row a texture,
with the contents that it holds in turn: dark where they are written, light where they are read.
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
from renderer.lab.measure import format_table, settle
from renderer.lab.measure.memory import MemoryReport
from renderer.lab.measure.plans import PlanReport, SimulationReport, describe_plan
from renderer.renderer import Renderer
from renderer.scene import Camera, Scene
from renderer.techniques import AutoTechnique, Technique

_OPTIONS: Final = (
    options.SCENE,
    *options.technique(),
    options.camera(),
    options.frame("frame of the path"),
    options.size(),
    option("--backend", "with --technique auto, the device that measures which is the fastest", "null",
           "null, which measures nothing", metavar="NAME"),
    options.file("--plot", "chart of passes and textures to write", "F.svg"),
    options.switch("--json", "print the plan as JSON"),
)  # fmt: skip


def _run(given: argparse.Namespace) -> None:
    if given.plot is not None:
        prepare_chart(given.plot)
    scene = open_scene(given.scene)
    camera = parse_camera(given.camera or next(iter(scene.views)), scene, given.frame)
    technique, chosen = choose_technique(given, scene, camera)
    report = describe_plan(scene, technique, camera, given.size)
    if given.plot is not None:
        plot_plan(report, given.plot, f"{technique.name}: {scene.name}")
        note(f"wrote {given.plot}")
    if given.json:
        print(json.dumps(chosen | asdict(report)))
    else:
        print(f"technique: {chosen['technique']}, {chosen['because']}\n\n{show_plan(report)}")


def choose_technique(given: argparse.Namespace, scene: Scene, camera: Camera) -> tuple[Technique, dict[str, str]]:
    """Return the technique that the arguments ask for, and why it is this one; `auto` measures a few."""
    with rhi.create_device(given.backend) as device:
        technique = make_technique(given, scene, device)
        if isinstance(technique, AutoTechnique):
            with Renderer(device, scene, technique=technique, visibility="frustum", size=given.size) as renderer:
                settle(renderer, camera)
        chosen = explain_technique(technique, given)
        return technique.current if isinstance(technique, AutoTechnique) else technique, chosen


def show_plan(report: PlanReport) -> str:
    """Format the plan as text."""
    header = ("pass", "reads", "writes", "bytes", "draws", "dispatches", "because")
    changed = ("pass", "programs", "bindings", "meshes", "states", "draws")
    changes = [(one.name, *astuple(one.changes), one.draws) for one in report.passes]
    orders = [astuple(one) for one in report.orders]
    rows = [
        (one.name, ", ".join(one.reads), ", ".join(one.writes), one.bytes, one.draws, one.dispatches, one.because)
        for one in report.passes
    ]
    needed = "\n".join(f"  {name}: {because}" for name, because in report.effects.items())
    left = "\n".join(f"  {one.name}: {one.because}" for one in report.left_out)
    maps = [(one.name, one.size, one.casters, one.state, one.because) for one in report.shadow_maps]
    shared = f"{len(report.textures)} textures, {report.texture_bytes:,} bytes"
    return "\n\n".join(
        part
        for part in (
            format_table(header, rows),
            shared,
            format_table(changed, changes),
            format_table(("objects of a pass", "programs", "materials", "meshes", "draws"), orders),
            format_table(("shadow map", "texels", "casters", "is", "because"), maps) if maps else "",
            show_memory(report.memory),
            show_simulations(report.simulations),
            f"needed:\n{needed}" if needed else "",
            f"left out:\n{left}" if left else "",
        )
        if part
    )


def show_simulations(found: SimulationReport | None) -> str:
    """Format what simulations do in the next frame as text; nothing in a scene without any."""
    if found is None:
        return ""
    number = f"{found.run} of {found.run + found.skipped} objects"
    return f"simulated a 60th of a second later: {number}, steps: {found.steps}, dispatches: {found.dispatches}"


def show_memory(memory: MemoryReport) -> str:
    """Format what a renderer holds on a device as text."""
    rows = [(one.name, one.shape, one.count, one.bytes) for one in memory.rows]
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
        for row, contents in enumerate(report.textures):
            for name in contents:
                writes = [i for i, one in enumerate(report.passes) if name in one.writes]
                reads = [i for i, one in enumerate(report.passes) if name in one.reads]
                last = max([*reads, *writes])
                axes.barh(row, last - writes[0] + 0.9, left=writes[0] - 0.45, height=0.3, color="#d0d7de")
                axes.barh([row] * len(reads), 0.9, left=[i - 0.45 for i in reads], height=0.7, color="#9ecae1")
                axes.barh([row] * len(writes), 0.9, left=[i - 0.45 for i in writes], height=0.7, color="#2b6ca3")
                axes.text(writes[0], row, name, ha="center", va="center", color="white", fontsize=8)
        axes.set_xticks(range(len(report.passes)), [one.name for one in report.passes])
        axes.set_yticks(range(len(report.textures)), [f"texture {i + 1}" for i in range(len(report.textures))])
        axes.invert_yaxis()
        axes.set_xlim(-0.5, max(len(report.passes), 4) - 0.5)


COMMAND: Final = Subcommand(
    "plan", "show the passes of a frame, and why each of them is there", _OPTIONS, _run, __doc__
)
