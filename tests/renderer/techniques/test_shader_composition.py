"""The declared shaders of techniques: `shaders` names all that a technique draws with, and each name leads to
a class.

A technique's file names its parts: a class that it imports or has, or a table of a part (`*FINISH_SHADERS`)
that names them in turn. Shadow filters and the shaders of materials are mixed in by `shader_variant`, for
every technique alike.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from frames import EYE, open_renderer

import rhi
from renderer.content import BUILT_IN
from renderer.frame import Blending
from renderer.scene import (
    AlphaMode,
    AmbientOcclusion,
    Bloom,
    DepthOfField,
    Environment,
    Fog,
    Scene,
    SceneBuilder,
    TextureMap,
    make_geometry,
    translation,
)
from renderer.shaders.materials import MaterialShader
from renderer.techniques import TECHNIQUES
from rhi.shading import Shader

SIZE = (16, 16)
OPTIONS: dict[str, list[dict[str, Any]]] = {
    "forward": [{}, {"samples": 4}, {"all_lights": True}],
    "forward_multipass": [{}, {"lights_per_draw": 4}, {"light_volumes": True}],
    "light_indexed": [{}, {"samples": 4}],
    "light_pre_pass": [{}, {"specular_channels": 1}],
    "forward_plus": [{}, {"tiled_transparency": True}],
    "clustered": [{}, {"depth_first": True}],
    "tiled_deferred": [{}, {"samples": 4}],
    "clustered_deferred": [{}, {"samples": 4}],
    "deferred_plus": [{}, {"samples": 4}, {"multi_pass": True}, {"binned": True}, {"tiled": True}],
}
"""The parameters by which a technique draws with other shaders."""


class PlainMaterial(MaterialShader):
    """A shader of a material that changes nothing."""


class BrushedMaterial(MaterialShader):
    """A shader of a material that is anisotropic, which not all buffers can store."""

    reads_tangents = True
    has_anisotropy = True


def build_scene(
    *,
    has_lights: bool = True,
    has_details: bool = False,
    has_colors: bool = False,
    mixes_coordinates: bool = False,
    shader: type[MaterialShader] | None = None,
    has_bloom: bool = True,
    has_occlusion: bool = False,
    has_focus: bool = False,
    has_environment: bool = False,
) -> Scene:
    """Build an opaque, a masked and a transparent box, with or without a light of each kind, in fog and with
    bloom."""
    builder = SceneBuilder("boxes")
    box = BUILT_IN["box"]()
    vertices = box.vertices
    colors = np.ones((len(vertices), 4)) * (0.9, 0.9, 0.9, 1.0) if has_colors else None
    geometry = make_geometry(
        vertices["position"], box.indices, vertices["normal"], vertices["uv"], color=colors
    )
    mesh = builder.add_mesh(geometry)
    texels = np.full((4, 4, 4), 255, np.uint8)
    texels[:2, :, 3] = 0  # what the mask cuts
    image = builder.add_image(texels)
    opaque: dict[str, Any] = {"emission": 2.0} if shader is None else {"emission": 2.0, "shader": shader}
    if has_details:
        opaque = {"texture": image, "emissive_texture": image, "emissive": (2.0, 2.0, 2.0), "metallic": 1.0}
        opaque |= {} if shader is None else {"shader": shader}
    if mixes_coordinates:
        opaque |= {"texture": image, "normal_texture": TextureMap(image, scale=(2.0, 2.0))}
    materials: list[dict[str, Any]] = [
        opaque,
        {"alpha_mode": AlphaMode.BLEND, "base_color": (1.0, 1.0, 1.0, 0.5)},
    ]
    if has_details:
        materials.append({"texture": image, "alpha_mode": AlphaMode.MASK})
    for number, material in enumerate(materials):
        node = builder.add_node(translation((1.5 * number - 1.5, 0, 0)))
        builder.add_objects(node, mesh, builder.add_material(**material))
    if has_lights:
        builder.lights.add_directional((0, -1, 0))
        builder.lights.add_point((0, 2, 0), 4.0)
        builder.lights.add_spot((0, 2, 0), (0, -1, 0), 4.0, 0.3, 0.5)
    builder.fog = Fog(0.1)
    if has_bloom:
        builder.bloom = Bloom()
    if has_occlusion:
        builder.ambient_occlusion = AmbientOcclusion()
    if has_focus:
        builder.depth_of_field = DepthOfField()
    if has_environment:
        builder.environment = Environment(np.ones((4, 8, 3), np.float32))
    builder.views["eye"] = EYE
    return builder.build()


@cache
def build_scenes() -> tuple[Scene, ...]:
    """Scenes that need all shaders between them."""
    return (
        build_scene(),
        build_scene(has_details=True),
        build_scene(has_details=True, has_colors=True),
        build_scene(has_lights=False, mixes_coordinates=True),
        build_scene(mixes_coordinates=True),
        build_scene(shader=PlainMaterial),
        build_scene(shader=BrushedMaterial),
        build_scene(shader=BrushedMaterial, has_occlusion=True),
        build_scene(shader=BrushedMaterial, has_details=True, has_occlusion=True),
        build_scene(has_occlusion=True),
        build_scene(has_details=True, has_occlusion=True),
        build_scene(has_focus=True),
        build_scene(has_environment=True),
        build_scene(has_details=True, has_environment=True),
        build_scene(has_bloom=False),  # whose layers of transparency need less than single floats
    )


def collect_parts(shader: type[Any]) -> Iterator[type[Any]]:
    """Yield the classes with a name in a module that a program's shader is combined of."""
    if getattr(sys.modules[shader.__module__], shader.__name__, None) is shader:
        yield shader
        return
    for base in shader.__bases__:
        yield from collect_parts(base)


def draw_all(device: rhi.Device, name: str) -> None:
    """Draw each scene with each set of the technique's parameters, and with each setting that chooses
    shaders."""
    for scene in build_scenes():
        with open_renderer(device, scene, size=SIZE) as renderer:
            for options in OPTIONS.get(name, [{}]):
                renderer.technique = TECHNIQUES[name](**options)
                renderer.render(EYE)
            renderer.blending, renderer.bloom = Blending.WEIGHTED, replace(renderer.bloom, karis_average=True)
            renderer.render(EYE)


FAINT_LAYER_SHADERS = {"LayersShader", "WideBlendShader"}
"""Drawn where faint layers are many, on devices that blend single floats: test_faint_layers.py does so."""
ADDED_BY_RENDERER = ("renderer.techniques.parts.scaling", "renderer.techniques.parts.ambient_occlusion")
"""The modules of the passes that the renderer adds to those of any technique."""


@pytest.mark.parametrize("name", TECHNIQUES)
def test_a_technique_declares_the_shaders_that_it_draws_with_and_no_others(
    null: rhi.Device, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    programs: set[type[Any]] = set()
    create = rhi.Device.program

    def note(device: rhi.Device, shader: type[Shader], *rest: Any, **options: Any) -> Any:
        programs.add(shader)
        return create(device, shader, *rest, **options)

    monkeypatch.setattr(rhi.Device, "program", note)
    draw_all(null, name)
    parts = {part for shader in programs for part in collect_parts(shader)}
    declared: tuple[type[Any], ...] = vars(TECHNIQUES[name])["shaders"]
    drawn = {part for part in parts if part.__module__.startswith("renderer.techniques") or part in declared}
    drawn = {part for part in drawn if not part.__module__.startswith(ADDED_BY_RENDERER)}
    expected = {part.__name__ for part in declared} - FAINT_LAYER_SHADERS
    assert {part.__name__ for part in drawn} - FAINT_LAYER_SHADERS == expected
    assert len(set(declared)) == len(declared)


def parse(module: ModuleType) -> ast.Module:
    """The syntax tree of a module."""
    assert module.__file__ is not None
    return ast.parse(Path(module.__file__).read_text(encoding="utf-8"))


def find_definition(module: ModuleType, name: str) -> tuple[ModuleType, ast.stmt] | None:
    """Return where a name of a module is defined by a statement, followed through its imports; None if
    nowhere."""
    statements = parse(module).body
    # A shader that is generated for all kinds of lights is declared for type checkers.
    declared = [inner for outer in statements if isinstance(outer, ast.If) for inner in outer.body]
    for statement in [*statements, *declared]:
        match statement:
            case ast.ImportFrom(module=str(source), names=aliases):
                if name in [alias.asname or alias.name for alias in aliases]:
                    return find_definition(sys.modules[source], name)
            case ast.ClassDef() if statement.name == name:
                return module, statement
            case ast.AnnAssign(target=ast.Name(id=target)) if target == name:
                return module, statement
    return None


def list_named(module: ModuleType, elements: list[ast.expr]) -> Iterator[str]:
    """Yield the names of the classes that a declaration names, itself or by the tables of parts."""
    for element in elements:
        starred = isinstance(element, ast.Starred)
        name = element.value if isinstance(element, ast.Starred) else element
        assert isinstance(name, ast.Name), ast.unparse(element)
        result = find_definition(module, name.id)
        assert result is not None, f"{name.id} is not imported or defined by name in {module.__name__}"
        owner, statement = result
        if not starred:
            is_generated = isinstance(statement, ast.AnnAssign) and isinstance(statement.value, ast.Call)
            assert is_generated or isinstance(statement, ast.ClassDef), name.id
            yield name.id
            continue
        assert isinstance(statement, ast.AnnAssign), name.id
        assert isinstance(statement.value, ast.Tuple), name.id
        yield from list_named(owner, statement.value.elts)


@pytest.mark.parametrize("name", TECHNIQUES)
def test_the_file_of_a_technique_names_each_part_of_its_shaders(name: str) -> None:
    technique: Any = TECHNIQUES[name]
    module = sys.modules[technique.__module__]
    classes = [statement for statement in parse(module).body if isinstance(statement, ast.ClassDef)]
    (owner,) = [statement for statement in classes if statement.name == technique.__name__]
    (declaration,) = [
        statement
        for statement in owner.body
        if isinstance(statement, ast.AnnAssign) and ast.unparse(statement.target) == "shaders"
    ]
    assert isinstance(declaration.value, ast.Tuple)
    named = list(list_named(module, declaration.value.elts))
    assert named == [shader.__name__ for shader in technique.shaders]
    for shader in technique.shaders:
        for base in shader.__mro__[:-1]:
            source = Path(str(sys.modules[base.__module__].__file__)).read_text(encoding="utf-8")
            assert f"class {base.__name__}(" in source or f"class {base.__name__}:" in source, base
