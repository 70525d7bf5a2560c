"""Refusals of textures on the null device; the conformance kit tests their texels."""

from __future__ import annotations

import pytest
from null_kit import Kit

import rhi
from rhi import Format


@pytest.mark.parametrize("form", [Format.R32UI, Format.RGBA32I])
def test_integers_have_no_average_to_resolve_to(kit: Kit, form: Format) -> None:
    several, one = kit.device.texture((4, 4), form, samples=4), kit.device.texture((4, 4), form)
    with pytest.raises(rhi.ValidationError) as by_texture:
        several.resolve_to(one)
    with pytest.raises(rhi.ValidationError) as by_pass:
        kit.device.render_pass(several, resolve=one)
    assert (by_texture.value.rule.id, by_pass.value.rule.id) == ("texture-format", "pass-target")


def test_colors_resolve(kit: Kit) -> None:
    several, one = kit.device.texture((4, 4), Format.RGBA8, samples=4), kit.device.texture((4, 4), Format.RGBA8)
    several.resolve_to(one)
    with kit.device.render_pass(several, resolve=one):
        pass
    assert len(kit.ops(rhi.Op.RESOLVE_TEXTURE)) == 1
