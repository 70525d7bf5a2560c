"""The registry of knobs: it has every setting that trades accuracy for time, and each of its knobs is read."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from typing import Any

import pytest

import rhi
from renderer.content import GENERATORS, load_scene
from renderer.lab.accuracy import KNOBS, NEUTRAL, Knob
from renderer.lab.accuracy.knobs import Demand
from renderer.lab.measure.encodings import ENCODINGS
from renderer.scene import Glow, StereoRig
from renderer.settings import RenderSettings
from renderer.techniques import TECHNIQUES, TechniqueSettings
from renderer.techniques.parts.cell_lists import CLUSTERS, TILES
from tests.renderer.conftest import open_device

SETTABLE = [knob for knob in KNOBS.values() if knob.path]
DEFAULTS = {one.name: one.default for one in fields(TechniqueSettings)}


def covers(path: str, leaf: str) -> bool:
    return leaf == path or leaf.startswith(f"{path}.")


def test_each_setting_is_a_knob_or_has_a_reason_not_to_be_one() -> None:
    leaves = RenderSettings().list_paths()
    knobs = [knob.path for knob in SETTABLE]
    assert [leaf for leaf in leaves if leaf not in NEUTRAL and not any(covers(path, leaf) for path in knobs)] == []
    assert [path for path in knobs if not any(covers(path, leaf) for leaf in leaves)] == []
    assert [path for path in NEUTRAL if path not in leaves or path in knobs] == []


@pytest.mark.parametrize("name", TECHNIQUES)
def test_no_technique_has_a_choice_that_settings_lack(name: str) -> None:
    chosen = inspect.signature(TECHNIQUES[name]).parameters
    assert set(chosen) <= set(DEFAULTS)
    assert {one: parameter.default for one, parameter in chosen.items()} == {one: DEFAULTS[one] for one in chosen}


@pytest.mark.parametrize("name", TECHNIQUES)
def test_a_technique_has_the_settings_that_its_parameters_name(name: str) -> None:
    others = {"samples": 4, "tiles": CLUSTERS, "clusters": TILES, "scale": 0.25, "stippled": False,
              "specular_channels": 1, "all_lights": True, "stencil": True, "depth_first": True, "multi_pass": False,
              # Those of several samples: neither of the two.
              "light_bits": 16, "normal_bits": 8, "binned": False}  # fmt: skip
    chosen = {one: others[one] for one in inspect.signature(TECHNIQUES[name]).parameters}
    made = TechniqueSettings(**{"name": name, **chosen}).make_one(name)
    assert vars(made) == vars(TECHNIQUES[name](**chosen))
    assert not chosen or vars(made) != vars(TECHNIQUES[name]())


@pytest.mark.parametrize("knob", SETTABLE, ids=lambda knob: knob.name)
def test_values_are_settings_of_their_own_and_the_default_is_among_them(knob: Knob) -> None:
    made = [knob.set(RenderSettings(), value) for value in knob.values]
    assert len({repr(one.get(knob.path)) for one in made}) == len(knob.values) >= 2
    assert [one.get(knob.path) for one in made] == list(knob.values.values())
    assert knob.default is not None


def test_encodings_are_those_that_are_compared() -> None:
    known = {one.name for one in ENCODINGS}
    encodings = [knob for knob in KNOBS.values() if knob.is_encoding]
    assert encodings == [knob for knob in KNOBS.values() if not knob.path and not knob.option]
    for knob in encodings:
        assert set(knob.values.values()) <= known
        assert knob.default is not None


@pytest.mark.parametrize("knob", [knob for knob in KNOBS.values() if knob.option], ids=lambda knob: knob.name)
def test_values_of_a_scene_s_option_are_allowed_and_what_the_hall_has_is_among_them(knob: Knob) -> None:
    (option,) = (one for one in GENERATORS["hall"].options if one.name == knob.option)
    parsed = [option.parse("test", value) for value in knob.values]
    assert parsed == list(knob.values.values())
    assert knob.values[str(knob.default)] == (option.default or 8 // 2)  # half of `detail`
    assert len({repr(knob.set(RenderSettings(), value)) for value in knob.values}) == 1


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


@pytest.mark.parametrize("knob", SETTABLE, ids=lambda knob: knob.name)
def test_a_frame_reads_what_a_knob_sets(knob: Knob) -> None:
    settings = knob.set(RenderSettings(), next(iter(knob.values)))
    null = settings.algorithm in ("none", "frustum")
    ground = "terrain:cells=8,trees=0" if knob.demand in (Demand.HEIGHT_FIELDS, Demand.RIDGES) else "hall"
    scene = load_scene("city:blocks=2,shadows=1" if "shadow" in knob.name else ground)
    scene.glow = Glow() if knob.demand is Demand.GLOW else None
    with (
        open_device("null" if null else "gl") as device,
        watch_reads(settings, knob.path) as reads,
        settings.open(device, scene, (16, 16), StereoRig()) as renderer,
    ):
        renderer.render(settings.aim(next(iter(scene.views.values()))))
    assert reads


def test_a_setting_that_no_frame_reads_is_found() -> None:
    settings = KNOBS["inferred_scale"].set(RenderSettings(), "0.6")
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


def test_an_unknown_knob_is_refused_with_the_nearest_name() -> None:
    from renderer.lab.accuracy import find_knob

    with pytest.raises(rhi.ValidationError, match="shadow_bias"):
        find_knob("shadow_biass", "test")
