"""`compare techniques`: what a frame costs with each technique, for several numbers of objects and lights.

  python -m renderer compare techniques grid --objects 1,4,16,64,256 --lights 1,8,32,128 --backend gl
  python -m renderer compare techniques night --lights 64,1024,4096 --techniques forward,clustered --json
  python -m renderer compare techniques city --camera ground --frame 600
  python -m renderer compare techniques grid --objects 1,256 --lights 1,2,4,8,16,32,64,128 --plot wilks.png

--objects and --lights set the options of the scene's generator that say how many there are: `count` and
`lights` (`grid` has both, `hall` and `night` have lights). Without them the scene is compared as it is; a
scene without such an option, as the city or a model file, can only be compared so.

All techniques draw the same frame in turn in one process, without occlusion culling. Times are medians, from
the scene's update until the GPU is finished; `processor ms` is the time of the processor in all threads.
`light evaluations` counts how often a light is looked at for a surface: the entries of the lists that
fragments walk, or the fragments of lights' volumes; on the null device nothing is counted. `bytes per pixel`
are those of all textures of the plan. `draws` are draw commands; one may draw many objects or lights. Under
OpenCL set RHI_KERNELS=optimised, or the first frames are drawn by kernels that were built in a hurry;
`kernels` says which ones cl ran in the rounds.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from inspect import signature
from itertools import chain
from typing import Any, Final

import rhi
from renderer.cli import options
from renderer.cli.arguments import load_settings, open_scene
from renderer.cli.comparison import ComparisonProgram, Report, describe, repeat
from renderer.cli.output import show_progress
from renderer.content import load_scene
from renderer.lab.comparison import Record
from renderer.lab.comparisons.technique_comparison import compare_techniques, vary_scene
from renderer.techniques import TECHNIQUES

COMPARED_TECHNIQUES: Final[dict[str, tuple[str, dict[str, Any]]]] = {
    name: (name, {}) for name in TECHNIQUES
} | {
    f"{name}_{way}": (name, {way: True})
    for name in TECHNIQUES
    for way in options.TECHNIQUE_VARIANTS
    if way in signature(TECHNIQUES[name]).parameters
}
"""The techniques to compare, also with variants, and their settings."""

_OPTIONS: Final = (
    options.SCENE,
    *(
        options.values(
            f"--{kind}",
            f"numbers of {kind}",
            options.parse_count,
            [None],
            "those of the scene as it is",
            "N,N,…",
        )
        for kind in ("objects", "lights")
    ),
    options.names(
        "--techniques",
        COMPARED_TECHNIQUES,
        "is not a technique",
        list(TECHNIQUES),
        "all, each in its first way",
    ),
    options.camera(),
    options.frame("frame of a path"),
    options.rounds("times each technique is timed"),
    options.size(),
    options.settings(
        "file with settings, written by `accuracy`; all but the technique and the algorithm count"
    ),
    options.BACKEND,
    options.chart(),
    *options.form(),
)


def _measure(arguments: argparse.Namespace) -> Report:
    settings = load_settings(arguments)
    first, *others = [
        vary_scene(arguments.scene, objects, lights)
        for objects in arguments.objects
        for lights in arguments.lights
    ]
    scene = open_scene(first)  # a file is the only scene; generators leave nothing out
    with rhi.create_device(arguments.backend) as device:
        rows = compare_techniques(
            device,
            chain([scene], map(load_scene, others)),
            {
                label: replace(settings.technique, **way).make_technique(name)
                for label in arguments.techniques
                for name, way in [COMPARED_TECHNIQUES[label]]
            },
            arguments.size,
            camera=arguments.camera,
            frame=arguments.frame,
            rounds=arguments.rounds,
            settings=settings,
            progress=partial(show_progress, task="compare"),
        )
        metadata = describe(device) | repeat(arguments, "scene", "camera", "frame", "size", "rounds")
        return Report(metadata, list(rows), f"{arguments.scene}, {metadata['device']}", scene)


def plot_techniques(figure: Any, rows: Sequence[Record]) -> None:
    """Draw the times over the number of lights: a chart for each number of objects, a line for each
    technique."""
    counts = list(dict.fromkeys(row["objects"] for row in rows))
    charts = figure.subplots(1, len(counts), sharey=True, squeeze=False)[0]
    for axes, objects in zip(charts, counts, strict=True):
        for number, name in enumerate(dict.fromkeys(row["technique"] for row in rows)):
            mine = [row for row in rows if (row["technique"], row["objects"]) == (name, objects)]
            axes.plot(
                [row["lights"] for row in mine],
                [row["milliseconds"] for row in mine],
                label=name,
                marker=".",
                linestyle="-" if number < 10 else "--",
            )
        axes.set_title(f"{objects:,} objects" if objects > 1 else "1 object", fontsize="medium")
        axes.set_xlabel("lights")
        axes.set_yscale("log")
    charts[0].set_ylabel("milliseconds")
    figure.legend(*charts[0].get_legend_handles_labels(), loc="outside right upper", fontsize="x-small")


COMMAND: Final = ComparisonProgram(
    "techniques",
    "compare what a frame costs with each technique",
    __doc__,
    _OPTIONS,
    _measure,
    plot=plot_techniques,
).command
