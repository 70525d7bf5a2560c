"""The cases of the exam by number: the catalogue `cases.toml` joined with the functions that measure them."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from renderer import rules
from renderer.lab.exam import (
    anisotropy_cases,
    area_light_cases,
    contact_cases,
    crack_cases,
    decal_cases,
    deformation_cases,
    detail_cases,
    encoding_cases,
    environment_cases,
    far_object_cases,
    far_position_cases,
    focus_cases,
    image_cases,
    input_cases,
    light_culling_cases,
    light_map_cases,
    lighting_model_cases,
    limit_cases,
    meshlet_cases,
    occlusion_cases,
    particle_cases,
    penumbra_cases,
    plan_cases,
    proxy_cases,
    ray_traced_cases,
    shadow_cases,
    stereo_cases,
    streaming_cases,
    temporal_cases,
    tessellated_mesh_cases,
)
from renderer.lab.exam import visibility_cases as culling
from renderer.lab.exam.case import Case
from rhi import refuse

_CASE_MODULES: Final = (
    culling,
    light_culling_cases,
    encoding_cases,
    far_position_cases,
    stereo_cases,
    shadow_cases,
    plan_cases,
    input_cases,
    limit_cases,
    ray_traced_cases,
    crack_cases,
    decal_cases,
    occlusion_cases,
    penumbra_cases,
    focus_cases,
    deformation_cases,
    temporal_cases,
    environment_cases,
    area_light_cases,
    anisotropy_cases,
    detail_cases,
    image_cases,
    meshlet_cases,
    proxy_cases,
    lighting_model_cases,
    light_map_cases,
    contact_cases,
    tessellated_mesh_cases,
    far_object_cases,
    streaming_cases,
    particle_cases,
)
MEASURES: Final = {
    number: measure for subject in _CASE_MODULES for number, measure in subject.MEASURES.items()
}


def _read_cases() -> Iterator[Case]:
    groups = tomllib.loads(Path(__file__).with_name("cases.toml").read_text(encoding="utf-8"))
    for group in groups.values():
        shared = {name: value for name, value in group.items() if not isinstance(value, dict)}
        for number in group.keys() - shared.keys():
            fields: dict[str, Any] = {"requires": (), **shared, **group[number]}
            fields["requires"] = tuple(fields["requires"])
            yield Case(int(number), measure=MEASURES[int(number)], **fields)


CASES: Final[dict[int, Case]] = {
    case.number: case for case in sorted(_read_cases(), key=lambda case: case.number)
}
"""All cases, in the order of their numbers."""


def select_cases(numbers: Sequence[int], *, are_long: bool = False) -> list[Case]:
    """The cases with these numbers, or all if there is no number; long ones only if they are named, or with
    `are_long`."""
    for number in numbers:
        if number not in CASES:
            refuse(rules.UNKNOWN_CASE, f"select_cases([{number}])", number, f"1 to {max(CASES)}")
    if numbers:
        return [CASES[number] for number in numbers]
    return [case for case in CASES.values() if are_long or not case.is_long]
