"""The fields of settings as a panel shows them: each with its kind, its choices, its default and what it does.

They follow from the dataclasses of the settings, so a new setting is there by itself. A text that documents a
field is that of the class's `Attributes:`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from functools import cache
from inspect import cleandoc
from typing import Any, Final, get_args, get_type_hints

from renderer.frame import LIGHT_FORMATS
from renderer.lights.culling import SPHERE_TESTS
from renderer.settings import RenderSettings
from renderer.stereo import OUTPUTS
from renderer.techniques import TECHNIQUES, AutoTechnique
from renderer.techniques.parts.geometry_buffer import NORMAL_BITS
from renderer.techniques.parts.resolve import SUM_FORMATS
from renderer.viewer.display_settings import SHADOWS, DisplaySettings
from renderer.viewer.session import ViewerSession
from renderer.visibility import list_algorithms
from renderer.visibility.boxes.polytopes import PLANE_COUNTS

_DEFAULTS: Final = RenderSettings()

_CHOICES: Final[Mapping[str, Callable[[ViewerSession], Iterable[Any]]]] = {
    "technique.name": lambda _: [AutoTechnique.name, *TECHNIQUES],
    "technique.samples": lambda session: session.renderer.device.capabilities.sample_counts,
    "technique.tiles.sphere_test": lambda _: SPHERE_TESTS,
    "technique.clusters.sphere_test": lambda _: SPHERE_TESTS,
    "technique.specular_channels": lambda _: (1, 3),
    "technique.light_bits": lambda _: SUM_FORMATS,
    "technique.normal_bits": lambda _: NORMAL_BITS,
    "bloom.bits": lambda _: LIGHT_FORMATS,
    "visibility.proxy_planes": lambda _: (0, *PLANE_COUNTS),
    "algorithm": lambda session: list_algorithms(session.renderer.device),
    "show": ViewerSession.list_show_choices,
    "shadows": lambda _: SHADOWS,
    "stereo": lambda _: (None, *OUTPUTS),
}
"""The choices of settings that are texts, or numbers of which few are allowed, by their paths."""


@dataclass(frozen=True, slots=True)
class SettingField:
    """A setting of a panel.

    Attributes:
        path: such as `shadows.cascades`.
        kind: the type of its value: bool, int, float, str or an `Enum`.
        choices: all values that it may have; empty if they are too many.
        default: the value that `RenderSettings()` or `DisplaySettings()` has.
        doc: what it does, in sentences of the documentation.
    """

    path: str
    kind: type
    choices: tuple[Any, ...]
    default: Any
    doc: str

    @property
    def name(self) -> str:
        """The last word of the path."""
        return self.path.rpartition(".")[2]

    @property
    def group(self) -> str:
        """The path of the settings that it belongs to, "" for those of the whole."""
        return self.path.rpartition(".")[0]


def list_setting_fields(session: ViewerSession) -> list[SettingField]:
    """All fields of `RenderSettings`, in the order of its paths."""
    return [
        _make_field(session, RenderSettings, path, _DEFAULTS.get(path)) for path in _DEFAULTS.list_paths()
    ]


def list_display_fields(session: ViewerSession) -> list[SettingField]:
    """All fields of `DisplaySettings` but its `settings`."""
    plain = DisplaySettings()
    return [
        _make_field(session, DisplaySettings, field.name, getattr(plain, field.name))
        for field in fields(DisplaySettings)
        if field.name != "settings"
    ]


def _make_field(session: ViewerSession, owner: type, path: str, default: Any) -> SettingField:
    *parts, name = path.split(".")
    for part in parts:
        owner = _type_hints(owner)[part]
    hint = _type_hints(owner)[name]
    kinds = get_args(hint) or (hint,)
    kind = next(kind for kind in kinds if kind is not type(None))
    choices = tuple(_CHOICES[path](session)) if path in _CHOICES else ()
    if issubclass(kind, Enum):
        choices = (*kind, *(() if type(None) not in kinds else (None,)))
    return SettingField(path, kind, choices, default, attribute_docs(owner).get(name, ""))


@cache
def _type_hints(owner: type) -> Mapping[str, Any]:
    """The types of a class's fields; cached, because evaluating the annotations of all settings takes 40 ms."""
    return get_type_hints(owner)


def describe_choice(value: Any) -> str:
    """A choice as a word: the value of an enumeration's member, and `off` for None."""
    if value is None:
        return "off"
    return str(value.value) if isinstance(value, Enum) else str(value)


@cache
def attribute_docs(owner: type) -> Mapping[str, str]:
    """The sentences that a class's docstring has about its attributes, by their names."""
    assert is_dataclass(owner)
    _, _, listed = cleandoc(owner.__doc__ or "").partition("Attributes:\n")
    docs: dict[str, str] = {}
    names: list[str] = []
    for line in listed.splitlines():
        if line and not line.startswith(" "):  # another section
            break
        entry = re.match(r" {4}(\w+(?:, \w+)*): (.*)", line)
        if entry:
            names = entry[1].split(", ")
            docs |= dict.fromkeys(names, entry[2])
        else:
            docs |= {name: f"{docs[name]} {line.strip()}".strip() for name in names if line.strip()}
    return docs
