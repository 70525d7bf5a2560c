"""Scenes, sizes and devices of the arguments that several commands have (`renderer.cli.options`)."""

from __future__ import annotations

import argparse
from dataclasses import replace

import rhi
from renderer import rules
from renderer.cli.options import WAYS
from renderer.cli.output import note
from renderer.content import load_scene
from renderer.frame import Blending
from renderer.scene import Camera, Depth, Scene
from renderer.settings import RenderSettings
from renderer.stereo import Stereo, find_rig
from renderer.techniques import AutoTechnique, Technique, TechniqueSettings
from rhi import refuse


def open_scene(text: str) -> Scene:
    """Load the scene that `SCENE` names; what its file has and the scene hasn't is listed on stderr."""
    scene = load_scene(text)
    for omission in scene.omissions:
        note(f"left out: {omission}")
    return scene


def make_technique(given: argparse.Namespace, scene: Scene, device: rhi.Device) -> Technique:
    """Return the technique that the arguments of `options.technique` describe, for a scene and a device."""
    ways = {name: getattr(given, name) for name in WAYS}
    return TechniqueSettings(given.technique, samples=given.samples, fxaa=given.fxaa, **ways).make(scene, device)


def explain_technique(technique: Technique, given: argparse.Namespace) -> dict[str, str]:
    """Return the technique that draws, as `technique`, and `because`, why it does."""
    if isinstance(technique, AutoTechnique):
        return {"technique": technique.chosen, "because": technique.because}
    if given.technique == AutoTechnique.name:
        because = f"{given.samples} samples per pixel, which others don't have" if given.samples > 1 else "is shown"
        return {"technique": technique.name, "because": because}
    return {"technique": technique.name, "because": "was asked for"}


def make_stereo(given: argparse.Namespace, scene: Scene, camera: Camera) -> Stereo | None:
    """Return the stereo that `options.STEREO` describe, comfortable for a camera where they don't say."""
    if given.stereo is None:
        named = ("eye_distance", "convergence", "swap_eyes", "toe_in", "reproject")
        for name in named:
            if getattr(given, name):
                refuse(rules.NO_STEREO, "render", f"--{name.replace('_', '-')} without --stereo")
        return None
    rig = find_rig(
        scene, camera, eye_distance=given.eye_distance, convergence=given.convergence, is_toed_in=given.toe_in
    )
    return Stereo(rig, given.stereo, is_swapped=given.swap_eyes, is_reprojected=given.reproject)


def load_settings(given: argparse.Namespace, default: RenderSettings | None = None) -> RenderSettings:
    """Return the settings in the file that `--settings` names, or `default`, or the defaults of all."""
    return default or RenderSettings() if given.settings is None else RenderSettings.load(given.settings)


def merge_settings(given: argparse.Namespace) -> RenderSettings:
    """Return the settings in the file that `--settings` names, or the defaults, with what other options say instead:
    those of `options.technique`, `--visibility`, `--queries`, `--depth`, `--blending`, `--edge-pixels`, `--reproject`,
    None where they aren't given. Those of `options.technique` then hold what is merged."""
    settings = load_settings(given)
    ways = {name: getattr(given, name) or None for name in WAYS}
    of_technique = {"name": given.technique, "samples": given.samples, "fxaa": given.fxaa or None, **ways}
    chosen = {name: value for name, value in of_technique.items() if value is not None}
    technique = replace(settings.technique, **chosen)
    given.technique, given.samples, given.fxaa = technique.name, technique.samples, technique.fxaa
    for name in WAYS:
        setattr(given, name, getattr(technique, name))
    changes = {
        "technique": technique,
        "algorithm": given.visibility,
        "visibility.emulated": None if given.queries is None else given.queries == "emulated",
        "depth": None if given.depth is None else Depth(given.depth),
        "blending": None if given.blending is None else Blending(given.blending),
        "reprojects": given.reproject or None,
        "tessellation.edge_pixels": given.edge_pixels,
    }
    return settings.change_all({path: value for path, value in changes.items() if value is not None})
