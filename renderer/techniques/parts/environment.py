"""The pass that brings an environment to the device, before the passes that read it."""

from __future__ import annotations

from functools import partial

from renderer.frame import Effect, EnvironmentMaps, EnvironmentSettings, Frame, FrameEffects, FramePass


def environment_passes(effects: FrameEffects) -> tuple[FramePass[Frame], ...]:
    """The pass that uploads and filters a new environment, and does nothing while it stays the same; none without
    one in view."""
    if effects.enabled.isdisjoint((Effect.ENVIRONMENT, Effect.SKY_BOX)):
        return ()
    effect = Effect.ENVIRONMENT if Effect.ENVIRONMENT in effects.enabled else Effect.SKY_BOX
    run = partial(_update, settings=effects.environment)
    reason = f"filters the environment, if it is new; {effects.explain(effect)}"
    return (FramePass("environment", run, reason, has_side_effects=True),)


def _update(frame: Frame, *, settings: EnvironmentSettings) -> None:
    environment = frame.resources.scene.environment
    assert environment is not None, "only a scene with an environment has its pass"
    frame.resources.workspace(EnvironmentMaps).update(environment, settings)
