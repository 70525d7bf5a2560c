"""All settings in one value: their file, and the renderer that has them."""

from __future__ import annotations

import json
import random
import re
from contextlib import suppress
from dataclasses import fields
from math import inf, nan
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refused_rule

import rhi
from renderer.content import load_scene
from renderer.frame import Blending, BloomSettings, TextureSettings
from renderer.scene import Compression, Depth, StereoRig
from renderer.settings import RenderSettings
from renderer.shadows import ShadowFilter, ShadowSettings
from renderer.techniques import TECHNIQUES, Clustered, Forward, Inferred, TechniqueSettings
from renderer.techniques.parts.light_list_reader import ClusterSettings
from renderer.tessellation import TessellationSettings
from renderer.visibility import ChcPlusPlus, FrustumCulling, VisibilitySettings
from rhi import Filter, SamplerDescriptor
from rhi.shading import Precision, Shader
from tests.renderer.conftest import open_device

OTHERS = RenderSettings(
    TechniqueSettings(
        "clustered", fxaa=True, clusters=ClusterSettings(32, 7, "hybrid"), scale=0.5, stippled=False
    ),
    "frustum",
    VisibilitySettings(batch=7, threshold=3),
    ShadowSettings(ShadowFilter.HARD, cascades=2, bias=0.5),
    TextureSettings(Filter.NEAREST, None, 4.0, compression=Compression.BC1),
    blending=Blending.WEIGHTED,
    precision=Precision.EXACT,
    depth=Depth.STANDARD,
    animation_step=0.25,
    animation_lag=2.0,
    simulates_hidden=True,
    reprojects=True,
    far_error=0.25,
    scale=0.5,
)


def test_a_file_keeps_all_settings(tmp_path: Path) -> None:
    OTHERS.save(tmp_path / "s.json", ratio=0.5)
    assert RenderSettings.load(tmp_path / "s.json") == OTHERS
    assert (
        VisibilitySettings.load(tmp_path / "s.json") == OTHERS.visibility
    )  # commands that only cull read it, too


def test_settings_that_a_file_lacks_have_their_defaults(tmp_path: Path) -> None:
    VisibilitySettings(batch=9).save(tmp_path / "tuned.json")
    assert RenderSettings.load(tmp_path / "tuned.json") == RenderSettings(
        visibility=VisibilitySettings(batch=9)
    )
    (tmp_path / "s.json").write_text(
        json.dumps({"rendering": {"shadows": {"cascades": 3}, "textures": {"mip": None}}}), encoding="utf-8"
    )
    assert RenderSettings.load(tmp_path / "s.json") == RenderSettings(
        shadows=ShadowSettings(cascades=3), textures=TextureSettings(mip=None)
    )


def test_cells_that_a_file_gives_in_part_are_otherwise_those_of_their_technique(tmp_path: Path) -> None:
    technique_fields = {"tiles": {"sphere_test": "hybrid"}, "clusters": {"slices": 12}}
    (tmp_path / "s.json").write_text(
        json.dumps({"rendering": {"technique": technique_fields}}), encoding="utf-8"
    )
    technique = RenderSettings.load(tmp_path / "s.json").technique
    assert (technique.tiles, technique.clusters) == (
        ClusterSettings(16, 1, "hybrid"),
        ClusterSettings(64, 12, "exact"),
    )


@pytest.mark.parametrize("text", ["[]", "{}"])
def test_a_file_without_settings_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "s.json").write_text(text, encoding="utf-8")
    assert refused_rule(lambda: RenderSettings.load(tmp_path / "s.json")) == "visibility-bad-settings"


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ('{"shadow": {}}', "visibility-bad-settings"),
        ('{"shadows": {"filter": "soft"}}', "visibility-bad-settings"),
        ('{"shadows": {"cascades": "4"}}', "visibility-bad-settings"),
        ('{"precision": 1}', "visibility-bad-settings"),
        ('{"shadows": [4]}', "visibility-bad-settings"),
        ('{"shadows": {"cascades": 9}}', "shadow-settings"),
        ('{"technique": {"name": "forwards"}}', "technique-parameter"),
        ('{"technique": {"name": "deferred", "samples": 4}}', "technique-one-sample"),
        ('{"technique": {"scale": 5.0}}', "technique-parameter"),
        ('{"technique": {"scale": 0.0}}', "technique-parameter"),
        ('{"technique": {"specular_channels": 7}}', "technique-parameter"),
        ('{"technique": {"tiles": {"tile": 0}}}', "technique-parameter"),
        ('{"technique": {"clusters": {"tile": 64, "slices": 0}}}', "technique-parameter"),
        ('{"technique": {"clusters": {"tile": 64, "sphere_test": "nope"}}}', "lights-unknown-test"),
        ('{"shadows": {"far_size": -3}}', "shadow-settings"),
    ],
)
def test_a_setting_that_no_frame_could_have_is_refused_as_its_file_is_read(
    text: str, rule: str, tmp_path: Path
) -> None:
    (tmp_path / "s.json").write_text(f'{{"rendering": {text}}}', encoding="utf-8")
    assert refused_rule(lambda: RenderSettings.load(tmp_path / "s.json")) == rule


PARTS = (
    RenderSettings,
    TechniqueSettings,
    VisibilitySettings,
    ShadowSettings,
    TextureSettings,
    TessellationSettings,
    BloomSettings,
)
FIELDS = [(part, setting.name) for part in PARTS for setting in fields(part)]


@pytest.mark.parametrize(("part", "name"), FIELDS, ids=lambda setting: getattr(setting, "__name__", setting))
def test_a_value_of_another_kind_is_refused_by_name(part: type[Any], name: str) -> None:
    default = getattr(part(), name)
    others: list[Any] = ["text" if not isinstance(default, str) else 3, [], float("nan")]
    others += [1] if isinstance(default, bool) else [True]
    others += [1.5] if type(default) is int else []
    for other in others:
        with pytest.raises(rhi.ValidationError, match=re.escape(f"{part.__name__}({name}=")):
            part(**{name: other})


STRANGE = (
    None,
    True,
    "",
    "forward",
    -1,
    0,
    1,
    3,
    1e-300,
    1e300,
    2**70,
    inf,
    float("nan"),
    [],
    [1, 2],
    {},
    {"a": 1},
)


def mutate(rng: random.Random, value: Any) -> Any:
    """Return plain settings of which one is another, missing or named otherwise."""
    if not isinstance(value, dict) or not value or rng.random() < 0.1:
        return rng.choice(STRANGE)
    name = rng.choice(list(value))
    others = {setting: it for setting, it in value.items() if setting != name}
    way = rng.random()
    return others if way < 0.1 else {**others, f"{name}s" if way < 0.2 else name: mutate(rng, value[name])}


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(10))
def test_a_mutated_file_is_refused_by_a_rule_or_draws_a_frame(
    seed: int, tmp_path: Path, null: rhi.Device
) -> None:
    OTHERS.save(tmp_path / "s.json")
    text, scene = (tmp_path / "s.json").read_text(encoding="utf-8"), load_scene("grid:count=4,lights=2")
    rng, drawn = random.Random(seed), 0
    for _ in range(300):
        mutated = json.dumps(mutate(rng, json.loads(text)))
        cut = rng.randrange(len(mutated)) if rng.random() < 0.1 else len(mutated)
        (tmp_path / "s.json").write_text(mutated[:cut], encoding="utf-8")
        with suppress(rhi.RhiError):
            settings = RenderSettings.load(tmp_path / "s.json")
            with settings.open(null, scene, (32, 24)) as renderer:
                renderer.render(settings.adapt_camera(next(iter(scene.views.values()))))
                drawn += 1
    assert 30 < drawn < 290  # some are as good as others, and most of what isn't is refused


def test_numbers_of_numpy_become_python_s_own() -> None:
    shadows = ShadowSettings(cascades=np.int64(3), bias=np.float32(0.5))
    assert (type(shadows.cascades), type(shadows.bias)) == (int, float)
    assert shadows == ShadowSettings(cascades=3, bias=0.5)
    assert TessellationSettings(edge_pixels=4).edge_pixels == 4


@pytest.mark.parametrize("anisotropy", [0.99, inf])
def test_an_anisotropy_out_of_its_range_is_refused(anisotropy: float) -> None:
    assert refused_rule(lambda: TextureSettings(anisotropy=anisotropy)) == "texture-settings"
    assert TextureSettings(anisotropy=1.0).anisotropy == 1.0


@pytest.mark.parametrize("bias", [-16.01, 16.01, nan])
def test_a_mip_bias_of_more_levels_than_there_are_is_refused(bias: float) -> None:
    assert refused_rule(lambda: TextureSettings(mip_bias=bias)) == "texture-settings"
    assert [TextureSettings(mip_bias=most).mip_bias for most in (-16.0, 16.0)] == [-16.0, 16.0]


@pytest.mark.parametrize("least", [-0.1, inf, nan])
def test_a_cutoff_of_no_light_is_refused(least: float, null: rhi.Device) -> None:
    assert refused_rule(lambda: RenderSettings(light_cutoff=least)) == "light-cutoff"
    with RenderSettings(light_cutoff=0.5).open(null, load_scene("grid:count=1"), (8, 8)) as renderer:
        assert refused_rule(lambda: setattr(renderer, "light_cutoff", least)) == "light-cutoff"
        assert renderer.light_cutoff == 0.5


def test_an_algorithm_that_no_frame_could_have_is_refused() -> None:
    with pytest.raises(rhi.ValidationError, match="frustum"):
        RenderSettings(algorithm="frustrum")
    assert RenderSettings(algorithm="frustum").algorithm == "frustum"


def test_settings_at_the_ends_of_their_ranges_are_taken(tmp_path: Path) -> None:
    technique = (
        '{"scale": 1.0, "specular_channels": 1, "tiles": {"tile": 1}, "clusters": {"tile": 64, "slices": 1}}'
    )
    (tmp_path / "s.json").write_text(
        f'{{"rendering": {{"technique": {technique}, "shadows": {{"far_size": 0}}}}}}', encoding="utf-8"
    )
    read = RenderSettings.load(tmp_path / "s.json")
    assert (read.technique.scale, read.technique.specular_channels, read.shadows.far_size) == (1.0, 1, 0)
    assert (read.technique.tiles.tile, read.technique.clusters.slices) == (1, 1)


@pytest.mark.parametrize(
    ("technique", "way"),
    [
        ("forward", "all_lights"),
        ("deferred", "stencil"),
        ("light_pre_pass", "stencil"),
        ("forward_plus", "tiled_transparency"),
        ("clustered", "depth_first"),
        ("deferred_plus", "multi_pass"),
        ("deferred_plus", "object_rectangles"),
        ("deferred_plus", "binned"),
        ("deferred_plus", "tiled"),
    ],
)
def test_other_ways_of_techniques_can_be_set(technique: str, way: str, null: rhi.Device) -> None:
    scene = load_scene("grid:count=1")
    for is_on in (False, True):
        settings = RenderSettings().change_all({"technique.name": technique, f"technique.{way}": is_on})
        assert getattr(settings.technique.make(scene, null), way) is is_on


def test_settings_change_by_their_paths() -> None:
    changed = RenderSettings().change_all({"shadows.cascades": 2, "technique.clusters.slices": 8})
    assert (changed.get("shadows.cascades"), changed.technique.clusters) == (2, ClusterSettings(64, 8))
    assert changed.change("shadows.cascades", 4).change("technique.clusters.slices", 24) == RenderSettings()


def test_a_renderer_has_the_settings(null: rhi.Device) -> None:
    scene = load_scene("city:blocks=2,shadows=1")
    with OTHERS.open(null, scene, (16, 16), StereoRig()) as renderer:
        camera = OTHERS.adapt_camera(next(iter(scene.views.values())))
        result = renderer.render(camera)
        assert renderer.shadows.settings is OTHERS.shadows
        assert isinstance(renderer.visibility, FrustumCulling)
        assert (renderer.blending, renderer.precision) == (Blending.WEIGHTED, Precision.EXACT)
        assert renderer.stereo is not None
        assert renderer.stereo.is_reprojected
        assert camera.projection.depth is Depth.STANDARD
        assert len(result.eye_images) == 2


def test_techniques_have_the_settings_that_are_theirs(null: rhi.Device) -> None:
    scene = load_scene("grid:count=1")
    settings = TechniqueSettings("clustered", clusters=ClusterSettings(32), scale=0.25, stippled=False)
    clustered, inferred = (
        settings.make(scene, null),
        RenderSettings(settings).change("technique.name", "inferred"),
    )
    technique = inferred.technique.make(scene, null)
    assert isinstance(clustered, Clustered)
    assert clustered.cells == ClusterSettings(32)
    assert isinstance(technique, Inferred)
    assert (technique.scale, technique.stippled) == (0.25, False)
    sampled = TechniqueSettings(samples=4).make(scene, null)
    assert isinstance(sampled, Forward)
    assert sampled.samples == 4


def test_an_algorithm_has_the_settings() -> None:
    settings = RenderSettings(algorithm="chc_plus_plus", visibility=VisibilitySettings(batch=3))
    with open_device("gl") as device, settings.open(device, load_scene("grid:count=1"), (8, 8)) as renderer:
        assert isinstance(renderer.visibility, ChcPlusPlus)


def test_textures_are_read_no_better_than_the_settings_say() -> None:
    plain, best = SamplerDescriptor(), SamplerDescriptor(max_anisotropy=8.0)
    pixels = SamplerDescriptor(Filter.NEAREST, Filter.NEAREST, None)
    assert [TextureSettings().adjust(setting, 16.0) for setting in (plain, best, pixels)] == [
        plain,
        best,
        pixels,
    ]
    flat = TextureSettings(mip=None)
    assert flat.adjust(plain, 16.0) == SamplerDescriptor(mip=None)
    nearest = TextureSettings(Filter.NEAREST, Filter.NEAREST)
    assert nearest.adjust(plain, 16.0) == SamplerDescriptor(Filter.NEAREST, Filter.NEAREST, Filter.NEAREST)
    assert nearest.adjust(pixels, 16.0) == pixels  # without levels it stays
    sharp = TextureSettings(anisotropy=4.0)
    assert sharp.adjust(plain, 16.0).max_anisotropy == 4.0
    assert sharp.adjust(plain, 2.0).max_anisotropy == 2.0  # as the device can
    assert sharp.adjust(best, 16.0).max_anisotropy == 8.0


@pytest.mark.parametrize("precision", Precision)
@pytest.mark.parametrize("name", TECHNIQUES)
def test_all_shaders_of_a_technique_have_the_precision(
    name: str, precision: Precision, null: rhi.Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, used = load_scene("hall"), list[type[Shader]]()
    program = null.program
    monkeypatch.setattr(null, "program", lambda shader: used.append(shader) or program(shader))
    settings = RenderSettings(TechniqueSettings(name), "frustum", precision=precision)
    with settings.open(null, scene, (16, 16)) as renderer:
        renderer.render(next(iter(scene.views.values())))
    fast = [shader.__name__ for shader in used if shader.precision is Precision.FAST]
    assert bool(fast) is (precision is Precision.FAST)
