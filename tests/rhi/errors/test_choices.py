"""Misspelt members of enums name the closest ones."""

from __future__ import annotations

import copy
import enum
import pickle
from typing import Any

import pytest

import renderer.frame.effects
import renderer.scene.materials
import renderer.shadows.shadow_settings
import rhi
import rhi.testing
from rhi.errors import rules
from rhi.errors.choices import Choice, ChoiceType, suggest_members

ENUMS = sorted(
    {
        value
        for module in (
            rhi,
            rhi.testing,
            renderer.frame.effects,
            renderer.scene.materials,
            renderer.shadows.shadow_settings,
        )
        for value in (getattr(module, name) for name in dir(module))
        if isinstance(value, type) and issubclass(value, enum.Enum) and list(value)
    },
    key=lambda kind: kind.__name__,
)


def test_all_public_enums_are_looked_at() -> None:
    assert {rhi.Format, rhi.CullMode, rhi.Access, rhi.Filter, renderer.frame.effects.Blending} <= set(ENUMS)
    assert len(ENUMS) >= 25


@pytest.mark.parametrize("kind", ENUMS, ids=lambda kind: kind.__name__)
def test_a_misspelt_member_of_each_public_enum_names_the_right_one(kind: Any) -> None:
    for name in kind.__members__:
        for misspelt in (f"{name}S", name.lower()):
            if misspelt in kind.__members__:
                continue
            with pytest.raises(AttributeError, match="has no member") as raised:
                getattr(kind, misspelt)
            assert f"{kind.__name__} has no member {misspelt}" in str(raised.value)
            assert f"{kind.__name__}.{name}" in str(raised.value)


@pytest.mark.parametrize("kind", ENUMS, ids=lambda kind: kind.__name__)
def test_members_are_copied_and_pickled_as_themselves(kind: Any) -> None:
    for member in kind:
        assert copy.deepcopy(member) is pickle.loads(pickle.dumps(member)) is member
        assert kind[member.name] is kind(member.value) is getattr(kind, member.name) is member


def test_a_name_that_resembles_no_member_shows_the_members() -> None:
    with pytest.raises(AttributeError, match=r"it has Filter\.NEAREST, Filter\.LINEAR$"):
        _ = rhi.Filter.anything  # type: ignore[attr-defined]
    with pytest.raises(AttributeError, match=r"Format\.RGBA8, .*… \(\d+ in all\)$"):
        _ = rhi.Format.anything  # type: ignore[attr-defined]


def test_probes_for_private_names_get_no_suggestion() -> None:
    with pytest.raises(AttributeError, match=r"^_ipython_display_$"):
        _ = rhi.Format._ipython_display_  # type: ignore[attr-defined]
    assert not hasattr(rhi.Format, "anything")


@pytest.mark.parametrize(
    ("text", "hint"),
    [
        ("rgba8", "did you mean Format.RGBA8?"),
        ("Format.RGBA8", "did you mean Format.RGBA8?"),
        ("rgba9", "did you mean Format.RGBA8"),
        ("zzz", ""),
        ("", ""),
    ],
)
def test_a_text_in_the_place_of_a_member_names_the_member(text: str, hint: str) -> None:
    device = rhi.create_device("null")
    with pytest.raises(rhi.ValidationError) as raised:
        device.texture((4, 4), text)  # type: ignore[arg-type]
    assert raised.value.rule is rules.DEVICE_ARGUMENT
    assert (hint in str(raised.value)) if hint else ("did you mean" not in str(raised.value))
    device.close()


def test_the_value_of_a_member_suggests_it_too() -> None:
    class Sort(Choice):
        FAST = "quick"
        SLOW = 3

    assert suggest_members("quick", Sort) == "did you mean Sort.FAST?"
    assert suggest_members("quack", Sort) == "did you mean Sort.FAST?"
    assert suggest_members("xyz", Sort) == ""


def test_whole_numbers_can_be_members_too() -> None:
    class Level(enum.IntEnum, metaclass=ChoiceType):
        LOW = 0
        HIGH = 1

    with pytest.raises(AttributeError, match=r"did you mean Level\.HIGH\?"):
        _ = Level.HIGHER  # type: ignore[attr-defined]
    assert Level(1) is Level.HIGH
