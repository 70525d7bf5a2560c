"""A refusal for a missing capability says what to use instead."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest

import rhi
from rhi import Capabilities, Format
from rhi.backends.null.null_capabilities import get_profile
from rhi.contract import limits
from rhi.contract.alternatives import ALTERNATIVES
from rhi.contract.descriptors import Attachment, PassDescriptor, QueryKind, TextureDescriptor
from rhi.contract.limits import Fault
from rhi.errors.rules import DEVICE_CAPABILITY, STATE_CAPABILITY
from rhi.testing.portability import check_portability

CORE = get_profile("webgpu")
TEXTURE = TextureDescriptor((4, 4), Format.RGBA8)


def lacking(**missing: Any) -> Capabilities:
    """A device that has what most have, without some of it."""
    return replace(CORE, max_point_size=64.0, border_colors=True, **missing)


def cases() -> dict[str, Iterable[Fault]]:
    """Faults by the capability that is missing."""
    border = rhi.SamplerDescriptor(wrap_u=rhi.Wrap.BORDER)
    multisampled = replace(TEXTURE, samples=4)
    layered = replace(TEXTURE, kind=rhi.TextureKind.D2_ARRAY, layers=9)
    return {
        "border_colors": limits.sampler_faults(border, replace(CORE, border_colors=False)),
        "max_anisotropy": limits.sampler_faults(rhi.SamplerDescriptor(max_anisotropy=64.0), CORE),
        "unsupported_formats": limits.texture_faults(
            TEXTURE, lacking(unsupported_formats=frozenset({Format.RGBA8}))
        ),
        "max_texture_layers": limits.texture_faults(layered, lacking(max_texture_layers=8)),
        "single_sampled_formats": limits.texture_faults(
            multisampled, lacking(single_sampled_formats=frozenset({Format.RGBA8}))
        ),
        "unresolvable_formats": limits.resolve_faults(
            multisampled, TEXTURE, lacking(unresolvable_formats=frozenset({Format.RGBA8}))
        ),
        "indirect_count": limits.count_faults(0, 4, lacking(indirect_count=False)),
        "occlusion_queries": limits.query_faults(QueryKind.OCCLUSION, lacking(occlusion_queries=False)),
        "sample_counter": limits.query_faults(QueryKind.COUNTER, lacking(sample_counter=False)),
        "timestamps": limits.query_faults(QueryKind.TIMESTAMP, lacking(timestamps=False)),
        "conditional_rendering": limits.condition_faults(lacking(conditional_rendering=False)),
        "wireframe": limits.state_faults(rhi.PolygonMode.LINE, lacking(wireframe=False)),
        "alpha_test": limits.state_faults(rhi.AlphaTest.ON, lacking(alpha_test=False)),
        "layered_rendering": limits.pass_faults(
            PassDescriptor((4, 4), (Attachment(1, layer=-1),)), {1: layered}, CORE
        ),
        "max_line_width": limits.state_faults(rhi.LineWidth(3.0), lacking(max_line_width=1.0)),
    }


@pytest.mark.parametrize("capability", cases())
def test_the_refusal_of_a_missing_capability_names_an_alternative(capability: str) -> None:
    fault = next(
        fault for fault in cases()[capability] if fault.rule in (DEVICE_CAPABILITY, STATE_CAPABILITY)
    )
    assert fault.tip == ALTERNATIVES[capability]
    assert len(fault.tip) > 20


def test_each_alternative_belongs_to_a_capability() -> None:
    assert ALTERNATIVES.keys() <= {field.name for field in fields(Capabilities)}


def test_each_feature_that_a_device_may_lack_has_an_alternative() -> None:
    always = {
        "shading",
        "precise_triangles",
        "precise_clipping",
        "precise_lines",
        "list_restart",
    }  # none needs it
    flags = {field.name for field in fields(Capabilities) if isinstance(field.default, bool)}
    formats = {field.name for field in fields(Capabilities) if field.name.endswith("_formats")}
    assert (flags | formats) - always - {"shares_textures"} <= ALTERNATIVES.keys()


def test_limits_state_no_missing_capability_without_an_alternative() -> None:
    text = Path(limits.__file__).read_text("utf-8")
    faults = re.findall(r"Fault\(\s*rules\.(?:DEVICE|STATE)_CAPABILITY[^)]*", text)
    assert faults == []


def draw_border(device: rhi.Device) -> None:
    device.sampler(rhi.SamplerDescriptor(wrap_u=rhi.Wrap.BORDER))


def test_portability_says_it_before_anyone_has_the_device() -> None:
    report = check_portability(draw_border, {"webgpu": CORE})
    assert ALTERNATIVES["border_colors"] in str(report.obstacles["webgpu"][0])


def test_a_refused_call_says_it_to_the_user() -> None:
    with rhi.create_device("null", profile=CORE) as device, pytest.raises(rhi.ValidationError) as refused:
        draw_border(device)
    assert f"tip:     {ALTERNATIVES['border_colors']}" in str(refused.value)
