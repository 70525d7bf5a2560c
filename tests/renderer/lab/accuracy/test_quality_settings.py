"""The registry of quality settings: it has every setting that trades accuracy for time, and each is read."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from typing import Any

import pytest

import rhi
from renderer.content import GENERATORS, load_scene
from renderer.lab.accuracy import NOT_QUALITY_SETTINGS, QUALITY_SETTINGS, QualitySetting
from renderer.lab.accuracy.quality_settings import Requirement
from renderer.lab.accuracy.sweep import list_unsupported_values
from renderer.lab.measure.encoding_errors import ENCODINGS
from renderer.scene import Bloom, StereoRig
from renderer.settings import RenderSettings
from renderer.techniques import TECHNIQUES, TechniqueSettings
from renderer.techniques.parts.light_list_reader import CLUSTERS, TILES
from tests.renderer.conftest import open_device

SETTABLE = [setting for setting in QUALITY_SETTINGS.values() if setting.path]
DEFAULTS = {field.name: field.default for field in fields(TechniqueSettings)}


def covers(path: str, leaf: str) -> bool:
    return leaf == path or leaf.startswith(f"{path}.")


def test_each_setting_is_a_quality_setting_or_has_a_reason_not_to_be_one() -> None:
    leaves = RenderSettings().list_paths()
    quality_settings = [setting.path for setting in SETTABLE]
    assert [
        leaf
        for leaf in leaves
        if leaf not in NOT_QUALITY_SETTINGS and not any(covers(path, leaf) for path in quality_settings)
    ] == []
    assert [path for path in quality_settings if not any(covers(path, leaf) for leaf in leaves)] == []
    assert [path for path in NOT_QUALITY_SETTINGS if path not in leaves or path in quality_settings] == []


@pytest.mark.parametrize("name", TECHNIQUES)
def test_no_technique_has_a_choice_that_settings_lack(name: str) -> None:
    parameters = inspect.signature(TECHNIQUES[name]).parameters
    assert set(parameters) <= set(DEFAULTS)
    assert {field: parameter.default for field, parameter in parameters.items()} == {
        field: DEFAULTS[field] for field in parameters
    }


@pytest.mark.parametrize("name", TECHNIQUES)
def test_a_technique_has_the_settings_that_its_parameters_name(name: str) -> None:
    others = {
        "samples": 4,
        "tiles": CLUSTERS,
        "clusters": TILES,
        "scale": 0.25,
        "stippled": False,
        "specular_channels": 1,
        "all_lights": True,
        "lights_per_draw": 4,
        "light_volumes": True,
        "stencil": True,
        "depth_first": True,
        "multi_pass": False,
        "object_rectangles": False,
        # Those of several samples: neither of the two.
        "light_bits": 16,
        "normal_bits": 8,
        "binned": False,
        "tiled": True,
        "tiled_transparency": True,
    }
    arguments = {field: others[field] for field in inspect.signature(TECHNIQUES[name]).parameters}
    technique = TechniqueSettings(**{"name": name, **arguments}).make_technique(name)
    assert vars(technique) == vars(TECHNIQUES[name](**arguments))
    assert not arguments or vars(technique) != vars(TECHNIQUES[name]())


@pytest.mark.parametrize("setting", SETTABLE, ids=lambda setting: setting.name)
def test_values_are_settings_of_their_own_and_the_default_is_among_them(setting: QualitySetting) -> None:
    settings = [setting.set(RenderSettings(), value) for value in setting.values]
    assert len({repr(changed.get(setting.path)) for changed in settings}) == len(setting.values) >= 2
    assert [changed.get(setting.path) for changed in settings] == list(setting.values.values())
    assert setting.default is not None


def test_encodings_are_those_that_are_compared() -> None:
    names = {encoding.name for encoding in ENCODINGS}
    encodings = [setting for setting in QUALITY_SETTINGS.values() if setting.is_encoding]
    assert encodings == [
        setting for setting in QUALITY_SETTINGS.values() if not setting.path and not setting.option
    ]
    for setting in encodings:
        assert set(setting.values.values()) <= names
        assert setting.default is not None


@pytest.mark.parametrize(
    "setting",
    [setting for setting in QUALITY_SETTINGS.values() if setting.option],
    ids=lambda setting: setting.name,
)
def test_values_of_a_scene_option_are_allowed_and_include_the_default_of_the_hall(
    setting: QualitySetting,
) -> None:
    (option,) = (candidate for candidate in GENERATORS["hall"].options if candidate.name == setting.option)
    parsed = [option.parse("test", value) for value in setting.values]
    assert parsed == list(setting.values.values())
    assert setting.values[str(setting.default)] == (option.default or 8 // 2)  # half of `detail`
    assert len({repr(setting.set(RenderSettings(), value)) for value in setting.values}) == 1


@contextmanager
def watch_reads(settings: RenderSettings, path: str) -> Iterator[list[str]]:
    """Yield a list of the reads of the last name of a path, by whatever has that class."""
    owner, _, name = path.rpartition(".")
    kind = type(settings.get(owner) if owner else settings)
    has_own, before, reads = "__getattribute__" in vars(kind), kind.__getattribute__, []

    def read(self: Any, asked: str) -> Any:
        if asked == name:
            reads.append(asked)
        return before(self, asked)

    kind.__getattribute__ = read  # type: ignore[method-assign, assignment]
    try:
        yield reads
    finally:
        if has_own:
            kind.__getattribute__ = before  # type: ignore[method-assign]
        else:
            del kind.__getattribute__


@pytest.mark.parametrize("setting", SETTABLE, ids=lambda setting: setting.name)
def test_a_frame_reads_the_setting_that_a_quality_setting_changes(setting: QualitySetting) -> None:
    settings = setting.set(RenderSettings(), next(iter(setting.values)))
    null = settings.algorithm in ("none", "frustum")
    ground = (
        "terrain:cells=8,trees=0"
        if setting.requirement in (Requirement.TESSELLATION, Requirement.SHADOW_CASTING_TESSELLATION)
        else "hall"
    )
    scene = load_scene("city:blocks=2,shadows=1" if "shadow" in setting.name else ground)
    scene.bloom = Bloom() if setting.requirement is Requirement.BLOOM else None
    with (
        open_device("null" if null else "gl") as device,
        watch_reads(settings, setting.path) as reads,
        settings.open(device, scene, (16, 16), StereoRig()) as renderer,
    ):
        renderer.render(settings.adapt_camera(next(iter(scene.views.values()))))
    assert reads


def test_a_setting_that_no_frame_reads_is_found() -> None:
    settings = QUALITY_SETTINGS["inferred_scale"].set(RenderSettings(), "0.6")
    scene = load_scene("hall")
    with (
        rhi.create_device("null") as device,
        watch_reads(settings, "technique.samples") as samples,
        watch_reads(settings, "technique.specular_channels") as channels,
        settings.open(device, scene, (16, 16)),
    ):
        pass
    assert samples
    assert not channels  # inferred lighting has no such choice


def test_an_unknown_quality_setting_is_refused_with_the_nearest_name() -> None:
    from renderer.lab.accuracy import lookup_quality_setting

    with pytest.raises(rhi.ValidationError, match="shadow_bias"):
        lookup_quality_setting("shadow_biass", "test")


def test_compression_is_left_out_by_name_where_its_package_is_missing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    setting = QUALITY_SETTINGS["compression"]
    with rhi.create_device("null") as null:
        lacks = list_unsupported_values(null, RenderSettings(), setting)
    assert {name: lack for name, lack in lacks.items() if "compressed" in lack} == dict.fromkeys(
        ("bc1", "bc7"), "the device stores no compressed images"
    )
    with open_device("gl") as device:
        monkeypatch.setattr("renderer.lab.accuracy.sweep.find_spec", lambda _: None)
        assert list_unsupported_values(device, RenderSettings(), setting) == dict.fromkeys(
            ("bc1", "bc7"), "the package etcpak is missing"
        )
