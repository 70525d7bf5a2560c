"""Opens the scenes, techniques and settings that arguments of several commands name
(`renderer.cli.options`)."""

from __future__ import annotations

import argparse
from dataclasses import replace

import rhi
from renderer import rules
from renderer.cli.options import TECHNIQUE_VARIANTS
from renderer.cli.output import note
from renderer.content import load_scene
from renderer.frame import Blending
from renderer.scene import Camera, Depth, Scene
from renderer.settings import RenderSettings
from renderer.stereo import Stereo, compute_rig
from renderer.techniques import AutoTechnique, Technique, TechniqueSettings
from rhi import refuse


def open_scene(text: str) -> Scene:
    """Load the scene that `SCENE` names; list on stderr what was left out of its file."""
    scene = load_scene(text)
    note_omissions(scene)
    return scene


def note_omissions(scene: Scene) -> None:
    """List on stderr what was left out of a scene's file."""
    for omission in scene.omissions:
        note(f"left out: {omission}")


def make_technique(arguments: argparse.Namespace, scene: Scene, device: rhi.Device) -> Technique:
    """Make the technique that the arguments of `options.technique` describe, for a scene and a device."""
    variants = {name: getattr(arguments, name) for name in TECHNIQUE_VARIANTS}
    return TechniqueSettings(
        arguments.technique, samples=arguments.samples, fxaa=arguments.fxaa, **variants
    ).make(scene, device)


def explain_technique(technique: Technique, arguments: argparse.Namespace) -> dict[str, str]:
    """The technique that draws, as `technique`, and the `reason` for it."""
    if isinstance(technique, AutoTechnique):
        return {"technique": technique.current_name, "reason": technique.reason}
    if arguments.technique == AutoTechnique.name:
        reason = (
            f"{arguments.samples} samples per pixel, which other candidates don't have"
            if arguments.samples > 1
            else "is shown"
        )
        return {"technique": technique.name, "reason": reason}
    return {"technique": technique.name, "reason": "was asked for"}


def make_stereo(arguments: argparse.Namespace, scene: Scene, camera: Camera) -> Stereo | None:
    """The stereo settings of `options.STEREO`; the rest is chosen to be comfortable for a camera."""
    if arguments.stereo is None:
        named = ("eye_distance", "convergence", "swap_eyes", "toe_in", "reproject", "far_error")
        for name in named:
            if getattr(arguments, name):
                refuse(rules.NO_STEREO, "render", f"--{name.replace('_', '-')} without --stereo")
        return None
    rig = compute_rig(
        scene,
        camera,
        eye_distance=arguments.eye_distance,
        convergence=arguments.convergence,
        is_toed_in=arguments.toe_in,
    )
    return Stereo(
        rig,
        arguments.stereo,
        is_swapped=arguments.swap_eyes,
        is_reprojected=arguments.reproject,
        far_error=arguments.far_error or 0.0,
    )


def load_settings(arguments: argparse.Namespace, default: RenderSettings | None = None) -> RenderSettings:
    """Load the settings file that `--settings` names; otherwise `default`, or all defaults."""
    return (
        default or RenderSettings() if arguments.settings is None else RenderSettings.load(arguments.settings)
    )


def merge_settings(arguments: argparse.Namespace) -> RenderSettings:
    """The settings of `--settings`, or the defaults, overridden by other options: those of
    `options.technique`, `--visibility`, `--queries`, `--depth`, `--blending`, `--temporal`, `--edge-pixels`,
    `--reproject`, `--far-error`, `--texture-memory`, if they aren't None. The arguments of `options.technique` are
    then set to the merged values."""
    settings = load_settings(arguments)
    variants = {name: getattr(arguments, name) or None for name in TECHNIQUE_VARIANTS}
    of_technique = {
        "name": arguments.technique,
        "samples": arguments.samples,
        "fxaa": arguments.fxaa or None,
        **variants,
    }
    overrides = {name: value for name, value in of_technique.items() if value is not None}
    technique = replace(settings.technique, **overrides)
    arguments.technique, arguments.samples, arguments.fxaa = technique.name, technique.samples, technique.fxaa
    for name in TECHNIQUE_VARIANTS:
        setattr(arguments, name, getattr(technique, name))
    changes = {
        "technique": technique,
        "algorithm": arguments.visibility,
        "visibility.emulated": None if arguments.queries is None else arguments.queries == "emulated",
        "depth": None if arguments.depth is None else Depth(arguments.depth),
        "blending": None if arguments.blending is None else Blending(arguments.blending),
        "temporal.is_on": arguments.temporal or None,
        "reprojects": arguments.reproject or None,
        "far_error": arguments.far_error,
        "tessellation.edge_pixels": arguments.edge_pixels,
        "textures.memory": arguments.texture_memory,
        "textures.memory_per_frame": 0.0,  # each frame has what it reads
    }
    return settings.change_all({path: value for path, value in changes.items() if value is not None})
