"""The textures of a frame: created as plans ask for them, kept, exchanged and given back."""

from __future__ import annotations

import pytest

import rhi
from renderer.frame import SharedTexture, Targets
from rhi import Format, Op

IMAGE = SharedTexture(Format.RGBA8_SRGB, 1.0, 1, ("image",))
DEPTH = SharedTexture(Format.D32F, 1.0, 1, ("depth",))
HALF = SharedTexture(Format.RGBA16F, 0.5, 1, ("light", "blurred"))
KEPT = SharedTexture(Format.RGBA16F, 1.0, 1, ("history",), has_history=True)


def created(device: rhi.Device) -> int:
    return len(device.stream.filter(Op.CREATE_TEXTURE))


def test_the_image_is_created_with_its_targets(null: rhi.Device) -> None:
    targets = Targets(null, (64, 36))
    assert created(null) == 1
    targets.provide((IMAGE, DEPTH))
    assert created(null) == 2
    assert targets.image.size == targets.depth.size == (64, 36)


def test_names_that_share_a_texture_get_the_same_one(null: rhi.Device) -> None:
    targets = Targets(null, (65, 36))
    targets.provide((IMAGE, DEPTH, HALF))
    assert targets["light"] is targets["blurred"]
    assert targets["light"].size == (33, 18)


def test_the_same_plan_creates_nothing(null: rhi.Device) -> None:
    targets = Targets(null, (64, 36))
    for _ in range(3):
        targets.provide((IMAGE, DEPTH, HALF))
    assert created(null) == 3


def test_another_plan_reuses_matching_textures_and_destroys_the_rest(null: rhi.Device) -> None:
    targets = Targets(null, (64, 36))
    targets.provide((IMAGE, DEPTH, HALF))
    image, light = targets.image, targets["light"]
    targets.provide((DEPTH, IMAGE))
    assert targets.image is image
    assert not image.destroyed
    assert light.destroyed
    assert created(null) == 3


def test_a_target_with_history_alternates_between_two_textures(null: rhi.Device) -> None:
    targets = Targets(null, (64, 36))
    seen = []
    for _ in range(4):
        targets.provide((IMAGE, DEPTH, KEPT))
        seen.append((targets["history"], targets.previous("history")))
    first, second = seen[0][0], seen[1][0]
    assert first is not second
    assert seen == [(first, None), (second, first), (first, second), (second, first)]
    assert targets.previous("image") is None


def test_a_new_size_replaces_all_textures(null: rhi.Device) -> None:
    targets = Targets(null, (64, 36))
    targets.provide((IMAGE, DEPTH))
    before = targets.image, targets.depth
    targets.resize((32, 18))
    targets.provide((IMAGE, DEPTH))
    assert all(texture.destroyed for texture in before)
    assert targets.image.size == targets.depth.size == (32, 18)


def test_a_texture_that_cannot_be_created_leaves_the_targets_as_they_were(null: rhi.Device) -> None:
    targets = Targets(null, (64, 36))
    targets.provide((IMAGE, DEPTH))
    huge = SharedTexture(Format.RGBA16F, 1e6, 1, ("huge",))
    before = created(null)
    with pytest.raises(rhi.ValidationError):
        targets.provide((IMAGE, HALF, huge))
    assert not targets.image.destroyed
    assert not targets.depth.destroyed
    null.finish()
    assert created(null) - before == len(null.stream.filter(Op.DESTROY)) == 1  # the texture of HALF


def test_everything_is_destroyed(null: rhi.Device) -> None:
    targets = Targets(null, (64, 36))
    targets.provide((IMAGE, DEPTH, KEPT))
    targets.destroy()
    null.finish()
    assert created(null) == len(null.stream.filter(Op.DESTROY)) == 4
