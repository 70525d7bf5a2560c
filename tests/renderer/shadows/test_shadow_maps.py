"""The shadow maps that a frame draws, keeps and skips, in the commands that the null device records."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from frames import make_boxes

import rhi
from renderer.content import BUILT_IN, load_scene
from renderer.frame import Effect
from renderer.renderer import Renderer
from renderer.scene import (
    AlphaMode,
    Camera,
    Perspective,
    Scene,
    SceneBuilder,
    StereoRig,
    scaling,
    translation,
)
from renderer.shadows import ShadowFilter, ShadowSettings
from renderer.stereo import Stereo
from renderer.techniques import TECHNIQUES
from renderer.techniques.inspection import INSPECTIONS, Inspection
from renderer.techniques.resource_capture import ResourceCapture
from renderer.visibility import make_visibility

EYE = Camera.look_at((0, 4, 12), (0, 0, 0), projection=Perspective(fov=1.0, near=0.1, far=100.0))
SMALL = ShadowSettings(cascades=2, cascade_size=64)


def stage(*, casts: bool = True, casters: bool = True, moves: bool = False) -> SceneBuilder:
    """Make a floor and a box over it, which moves with time or not, and a sun."""
    builder, box, material = make_boxes(name="stage"), 0, 0
    floor = builder.add_node(translation((0, -0.5, 0)) @ scaling((30, 1, 30)))
    builder.add_objects(floor, box, material, casts_shadow=False)
    above = builder.add_node(translation((0, 2, 0)), dynamic=moves)
    builder.add_objects(above, box, material, casts_shadow=casters)
    if moves:
        builder.animate(above, lambda seconds: translation(((seconds, 2.0, 0.0),)))
    builder.lights.add_directional((-0.3, -1, -0.2), casts_shadow=casts)
    return builder


def make_renderer(device: rhi.Device, scene: Scene, technique: str = "forward") -> Renderer:
    visibility = make_visibility("frustum", scene, device)
    renderer = Renderer(
        device, scene, technique=TECHNIQUES[technique](), visibility=visibility, size=(64, 48)
    )
    renderer.shadows.settings = SMALL
    return renderer


def draw(renderer: Renderer, camera: Camera = EYE, seconds: float = 0.0) -> Counter[str]:
    """Draw a frame; return the numbers of maps by what became of them."""
    renderer.render(camera, seconds)
    return Counter(report.state for report in renderer.shadows.reports)


@pytest.mark.parametrize("missing", [{"casts": False}, {"casters": False}], ids=["light", "caster"])
def test_a_scene_without_a_casting_light_or_a_caster_issues_no_command_of_shadows(
    null: rhi.Device, missing: dict[str, bool]
) -> None:
    with make_renderer(null, stage(**missing).build()) as renderer:
        renderer.render(EYE)
        effects, plan = renderer.plan(EYE)
        assert "shadow maps" not in [planned.name for planned in plan.passes]
        assert not any("shadow" in command.labels for command in null.stream)
        assert (
            effects.explain(Effect.DIRECTIONAL_SHADOWS)
            == "the scene has no directional light that casts shadows"
        )


def test_shadow_maps_are_drawn_before_the_objects_and_the_plan_states_the_reason(null: rhi.Device) -> None:
    with make_renderer(null, stage().build()) as renderer:
        _, plan = renderer.plan(EYE)
        assert [planned.name for planned in plan.passes] == ["shadow maps", "forward"]
        assert plan.passes[0].reason == "the scene has 1 directional light that casts shadows"


def test_a_map_is_kept_while_nothing_in_it_moves(null: rhi.Device) -> None:
    with make_renderer(null, stage().build()) as renderer:
        assert draw(renderer) == {"drawn": 2}
        null.stream.clear()
        assert draw(renderer) == {"kept": 2}
        assert not [command for command in null.stream.draws() if "shadow maps" in command.labels]
        assert {report.reason for report in renderer.shadows.reports} == {"nothing in it has moved"}


def test_a_moved_eye_draws_the_maps_again(null: rhi.Device) -> None:
    with make_renderer(null, stage().build()) as renderer:
        draw(renderer)
        moved = replace(EYE, position=EYE.position + np.array((7.0, 0.0, 0.0)))
        assert draw(renderer, moved) == {"drawn": 2}


def test_a_dynamic_caster_is_drawn_over_a_copy_of_the_static_casters(null: rhi.Device) -> None:
    builder = stage(moves=True)
    builder.add_objects(builder.add_node(translation((3, 1, 0))), 0, 0)
    with make_renderer(null, builder.build()) as renderer:
        assert draw(renderer) == {"drawn": 2}
        assert draw(renderer, seconds=1.0) == {"drawn": 2}
        null.stream.clear()
        assert draw(renderer, seconds=2.0) == {"drawn": 2}
        assert renderer.shadows.casters_drawn == 2  # the box alone, in each map
        copies = null.stream.filter(rhi.Op.COPY_TEXTURE)
        assert len(copies) == 2
        assert draw(renderer, seconds=2.0) == {"kept": 2}


def test_a_view_without_anything_in_reach_of_a_map_skips_it(null: rhi.Device) -> None:
    away = Camera.look_at((0, 400, 0), (0, 500, 0))
    builder = stage()
    builder.add_objects(builder.add_node(translation((0, 4000, 0))), 0, 0)  # in view, beyond all maps
    with make_renderer(null, builder.build()) as renderer:
        assert draw(renderer, away) == {"skipped": 2}
        assert renderer.shadows.reports[0].reason == "nothing visible is in it"


def test_a_view_without_objects_asks_for_no_map(null: rhi.Device) -> None:
    with make_renderer(null, stage().build()) as renderer:
        assert draw(renderer, Camera.look_at((0, 400, 0), (0, 500, 0))) == {}
        assert sum(draw(renderer).values()) == 2, "control"


def test_casters_that_shade_nothing_visible_arent_drawn(null: rhi.Device) -> None:
    builder = stage()
    builder.add_objects(builder.add_node(translation((0, -30, 0))), 0, 0)  # below all that is visible
    builder.add_objects(builder.add_node(translation((900, 0, 0))), 0, 0)  # far aside
    with make_renderer(null, builder.build()) as renderer:
        draw(renderer)
        assert max(report.casters for report in renderer.shadows.reports) == 1


def street(lights: int = 64, *, car: bool = True) -> Scene:
    """Make a street of casting spot lights, 12 m apart, with a post each, and a car that passes at 10 m/s, or
    none."""
    builder, box, material = make_boxes(name="street"), 0, 0
    along = 12.0 * np.arange(lights)
    for x in along:
        ground = translation((x, -0.5, 0)) @ scaling((12, 1, 20))
        builder.add_objects(builder.add_node(ground), box, material, casts_shadow=False)
        builder.add_objects(builder.add_node(translation((x, 1, 2)) @ scaling((0.2, 2, 0.2))), box, material)
        builder.lights.add_spot((x, 5, 0), (0, -1, 0), 8.0, 0.4, 0.8, casts_shadow=True)
    if car:
        node = builder.add_node(translation((0, 0.5, 0)), dynamic=True)
        builder.add_objects(node, box, material)
        builder.animate(node, lambda seconds: translation(((10.0 * seconds, 0.5, 0.0),)))
    return builder.build()


ABOVE = Camera.look_at((378, 300, 0), (378, 0, 0), (0, 0, -1), Perspective(fov=1.0, aspect=4 / 3, near=1.0))
ALONG = Camera.look_at((-30, 40, 0), (378, 0, 0), projection=Perspective(fov=1.6, near=0.5))


def test_a_static_street_of_64_lights_draws_no_map_again(null: rhi.Device) -> None:
    with make_renderer(null, street(car=False)) as renderer:
        assert draw(renderer, ALONG) == {"drawn": 64}
        for _ in range(3):
            null.stream.clear()
            assert draw(renderer, ALONG) == {"kept": 64}
            assert len(null.stream.draws()) == 1  # the scene


def test_a_moving_eye_draws_no_map_of_a_local_light_again(null: rhi.Device) -> None:
    with make_renderer(null, street(car=False)) as renderer:
        renderer.shadows.settings = replace(SMALL, min_size=32, max_size=32)
        draw(renderer, ALONG)
        moved = replace(ALONG, position=ALONG.position + np.array((3.0, 1.0, 0.0)))
        assert draw(renderer, moved) == {"kept": 64}


def test_a_car_that_passes_draws_only_the_maps_that_it_touches(null: rhi.Device) -> None:
    with make_renderer(null, street()) as renderer:
        renderer.shadows.settings = replace(SMALL, min_size=32, max_size=32, far_size=16)
        draw(renderer, ALONG)
        for seconds in (1.2, 6.0, 6.3, 30.0):
            states = draw(renderer, ALONG, seconds)
            touched = [r.name for r in renderer.shadows.reports if r.state == "drawn"]
            light_index = round(10 * seconds / 12)
            assert f"spot light {light_index}" in touched
            assert len(touched) <= 4  # where it is, and where it was in the last frame
            assert states["kept"] == 64 - len(touched)
            assert all(abs(int(name.split()[-1]) - light_index) <= 1 or seconds != 6.3 for name in touched)


def test_a_moving_caster_that_shades_nothing_visible_redraws_no_map(null: rhi.Device) -> None:
    along = (0.0, 40.0)  # the second one isn't in view
    builder = make_boxes(*(translation((x, -0.5, 0)) @ scaling((30, 1, 30)) for x in along), name="shelf")
    moves = builder.add_node(translation((26, 1, 0)), dynamic=True)
    builder.add_objects(moves, 0, 0)
    builder.animate(moves, lambda seconds: translation(((26.0 + seconds, 1.0, 0.0),)))
    builder.lights.add_point((20, 2, 0), 24.0, casts_shadow=True)
    down = Camera.look_at((0, 10, 0), (0, 0, 0), (0, 0, -1), Perspective(fov=1.0, aspect=4 / 3, near=1.0))
    with make_renderer(null, builder.build()) as renderer:
        draw(renderer, down)
        drawn = draw(renderer, down, 0.5)
        assert not drawn["drawn"]
        reasons = {report.reason for report in renderer.shadows.reports}
        assert "what moved in it shades nothing visible" in reasons


def test_far_maps_take_turns_when_there_are_more_than_the_budget(null: rhi.Device) -> None:
    builder = make_boxes(name="crowd")
    nodes = builder.add_nodes(translation([(12.0 * i, 1.0, 0.0) for i in range(10)]), dynamic=True)
    builder.add_objects(nodes, 0, 0)
    builder.animate(nodes, lambda s: translation([(12.0 * i + s, 1.0, 0.0) for i in range(10)]))
    builder.lights.add_spots(
        [(12.0 * i, 5, 0) for i in range(10)], (0, -1, 0), 8.0, 0.4, 0.6, casts_shadow=True
    )
    camera = Camera.look_at(
        (54, 200, 0), (54, 0, 0), (0, 0, -1), Perspective(fov=1.0, aspect=4 / 3, near=1.0)
    )
    with make_renderer(null, builder.build()) as renderer:
        renderer.shadows.settings = replace(SMALL, budget=5)
        assert draw(renderer, camera) == {"drawn": 10}
        turns = []
        for number in range(1, 5):
            assert draw(renderer, camera, 0.01 * number) == {"drawn": 5, "kept": 5}
            turns += [report.name for report in renderer.shadows.reports if report.state == "drawn"]
        assert Counter(turns) == dict.fromkeys((f"spot light {i}" for i in range(10)), 2)


def test_a_local_light_without_a_caster_in_range_has_no_map(null: rhi.Device) -> None:
    builder = stage(casts=False)
    builder.lights.add_point((0, 3, 0), 8.0, casts_shadow=True)
    builder.lights.add_point((5, 1, 0), 2.0, casts_shadow=True)  # in reach of the floor alone
    with make_renderer(null, builder.build()) as renderer:
        draw(renderer)
        skipped = {r.name: r.reason for r in renderer.shadows.reports if r.state == "skipped"}
        assert skipped["point light 1"] == "no caster is in its range"
        assert all(
            name == "point light 1" or reason == "no caster is in it" for name, reason in skipped.items()
        )
        assert {key[1] for key in renderer.shadows.tiles} == {0}


@pytest.mark.parametrize(("atlas", "dark"), [(512, 0), (256, 100 - 256 // 6)])
def test_local_lights_have_maps_as_long_as_there_is_room_for_the_smallest(
    null: rhi.Device, atlas: int, dark: int
) -> None:
    builder = stage(casts=False)
    positions = np.random.default_rng(1).uniform((-4, -1, -4), (4, 7, 4), (100, 3))
    builder.lights.add_points(positions, 9.0, casts_shadow=True)
    with make_renderer(null, builder.build()) as renderer:
        renderer.shadows.settings = replace(SMALL, max_size=128, max_atlas_size=atlas)
        draw(renderer)
        reasons = [r.reason for r in renderer.shadows.reports if r.name.count("face") == 0]
        assert reasons.count("no room is left for its shadow maps, so it is disabled") == dark
        assert renderer.shadows.unshadowed_lights == dark
        assert len({key[1] for key in renderer.shadows.tiles}) == 100 - dark


def test_local_lights_that_come_into_view_get_the_room_of_those_that_left(null: rhi.Device) -> None:
    builder = stage(casts=False)
    for x in (0.0, 500.0, 1000.0):
        builder.add_objects(builder.add_node(translation((x, 1.0, 0.0))), 0, 0)
        positions = np.random.default_rng(1).uniform((x - 2, 1, -2), (x + 2, 5, 2), (20, 3))
        builder.lights.add_points(positions, 9.0, casts_shadow=True)
    with make_renderer(null, builder.build()) as renderer:
        renderer.shadows.settings = replace(SMALL, max_size=128, max_atlas_size=256)
        first: dict[int, Counter[int]] = {}
        for step in range(7):
            states = draw(
                renderer, replace(EYE, position=EYE.position + np.array((500.0 * (step % 3), 0.0, 0.0)))
            )
            assert renderer.shadows.unshadowed_lights == 0
            assert states["kept"] == 0
            seen = Counter(
                tile.size for key, tile in renderer.shadows.tiles.items() if key[1] // 20 == step % 3
            )
            first.setdefault(step % 3, seen)
            assert seen == first[step % 3]


def test_local_lights_share_the_room_of_the_atlas(null: rhi.Device) -> None:
    builder = stage()
    builder.lights.add_points(
        np.random.default_rng(1).uniform((-2, 1, -2), (2, 5, 2), (20, 3)), 9.0, casts_shadow=True
    )
    with make_renderer(null, builder.build()) as renderer:
        renderer.shadows.settings = replace(SMALL, max_size=128, max_atlas_size=256)
        draw(renderer)
        assert renderer.shadows.atlas.size == (256, 256)
        sizes = {key: tile.size for key, tile in renderer.shadows.tiles.items() if key[0] == "point"}
        assert set(sizes.values()) == {16, 32}  # only as many are halved as have to be
        for step in range(1, 9):  # and those that are remain the same
            draw(renderer, replace(EYE, position=EYE.position + np.array((0.05 * step, 0.0, 0.0))))
            assert {key: renderer.shadows.tiles[key].size for key in sizes} == sizes
        renderer.scene.lights.point["casts_shadow"][3] = False
        draw(renderer)
        assert 3 not in {
            key[1] for key in renderer.shadows.tiles
        }  # maps of those out of view are kept, not its own


def test_two_eyes_share_maps_that_are_drawn_once(null: rhi.Device) -> None:
    builder = stage()
    builder.lights.add_spot((0, 5, 0), (0, -1, 0), 8.0, 0.4, 0.8, casts_shadow=True)
    with make_renderer(null, builder.build()) as renderer:
        renderer.stereo = Stereo(StereoRig(), "color")
        assert draw(renderer) == {"drawn": 3}
        passes = [c for c in null.stream.draws() if "shadow maps" in c.labels]
        assert len(passes) == 2 * 3  # each map is cleared and drawn once
        assert draw(renderer) == {"kept": 3}


def test_other_settings_draw_the_maps_again(null: rhi.Device) -> None:
    with make_renderer(null, stage().build()) as renderer:
        draw(renderer)
        renderer.shadows.settings = replace(SMALL, cascades=3, filter=ShadowFilter.HARD)
        assert draw(renderer) == {"drawn": 3}


@pytest.mark.parametrize("size", [1, 2, 8])
def test_maps_of_few_texels_are_drawn(null: rhi.Device, size: int) -> None:
    with make_renderer(null, stage().build()) as renderer:
        renderer.shadows.settings = replace(SMALL, cascade_size=size)
        assert draw(renderer) == {"drawn": 2}
        assert all(tile.size == size for tile in renderer.shadows.tiles.values())


@pytest.mark.parametrize("technique", TECHNIQUES)
def test_all_techniques_have_the_bindings_that_shadows_need(null: rhi.Device, technique: str) -> None:
    builder = stage()
    builder.lights.add_point((0, 3, 0), 8.0)
    builder.lights.add_spot((0, 3, 0), (0, -1, 0), 8.0, 0.3, 0.5)
    builder.add_image(np.zeros((4, 4, 4), np.uint8))
    builder.haze = 0.01
    with make_renderer(null, builder.build(), technique) as renderer:
        assert draw(renderer) == {"drawn": 2}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("cascades", 0),
        ("cascade_size", 100),
        ("distance", -1.0),
        ("split", 2.0),
        ("max_atlas_size", 512),
        ("budget", 0),
    ],
)
def test_settings_out_of_their_range_are_refused(name: str, value: float) -> None:
    with pytest.raises(rhi.ValidationError, match=r"^\[shadow-settings\]"):
        ShadowSettings(**{name: value})  # type: ignore[arg-type]


def test_scenes_cast_shadows_on_request(null: rhi.Device) -> None:
    plain, shaded = load_scene("city:blocks=2"), load_scene("city:blocks=2,shadows=1")
    assert not plain.lights.directional["casts_shadow"].any()
    assert shaded.lights.directional["casts_shadow"].all()
    assert shaded.name == plain.name + ",shadows=1"
    assert np.count_nonzero(~shaded.objects.casts_shadow) > 4  # ground


def masked_stage() -> Scene:
    """Make a scene of a floor, a box with an opaque material, and another one whose material is a mask."""
    builder = stage()
    holes = np.full((4, 4, 4), 255, np.uint8)
    holes[:2, :, 3] = 0
    masked = builder.add_material(
        alpha_mode=AlphaMode.MASK, alpha_cutoff=0.5, texture=builder.add_image(holes)
    )
    builder.add_objects(builder.add_node(translation((2, 2, 0))), builder.add_mesh(BUILT_IN["box"]()), masked)
    return builder.build()


def test_only_masks_are_drawn_to_maps_by_a_program_that_reads_materials(null: rhi.Device) -> None:
    with make_renderer(null, masked_stage()) as renderer:
        null.stream.clear()
        assert draw(renderer)["drawn"] == 2
        bound = [command.bindings for command in null.stream.draws() if not command.render_pass.colors]
        drawn = Counter("materials" in names for names in bound if "objects" in names)
        assert drawn == {False: 2, True: 2}  # one draw of the opaque box and one of the mask, in each cascade


@pytest.mark.parametrize("name", ["alpha_mode", "alpha_cutoff", "double_sided"])
def test_maps_are_drawn_again_if_materials_cover_something_else(null: rhi.Device, name: str) -> None:
    scene = masked_stage()
    with make_renderer(null, scene) as renderer:
        assert draw(renderer)["drawn"] == 2
        assert draw(renderer)["drawn"] == 0
        scene.materials[name][-1] = {"alpha_mode": AlphaMode.BLEND, "alpha_cutoff": 0.25, "double_sided": 1}[
            name
        ]
        assert draw(renderer)["drawn"] == 2


@pytest.mark.parametrize("name", ["base_color", "roughness"])
def test_changed_colors_of_materials_redraw_no_map(null: rhi.Device, name: str) -> None:
    scene = masked_stage()
    with make_renderer(null, scene) as renderer:
        draw(renderer)
        scene.materials[name][0] *= 0.5
        assert draw(renderer)["drawn"] == 0


@pytest.mark.parametrize("displayed", INSPECTIONS)
def test_images_of_a_frame_update_maps_only_if_they_show_light(null: rhi.Device, displayed: str) -> None:
    with make_renderer(null, stage(moves=True).build()) as renderer:
        draw(renderer)
        lit, renderer.technique = renderer.technique, Inspection(displayed)
        is_lit = displayed in ("clusters", "tessellation", "tiles", "volumes")
        null.stream.clear()
        renderer.render(EYE, 1.0)
        assert any("shadow maps" in command.labels for command in null.stream) == is_lit
        renderer.technique = lit
        assert draw(renderer, seconds=1.0 if is_lit else 2.0)["drawn"] == (0 if is_lit else 2)


def test_maps_are_up_to_date_when_one_buffer_of_a_lit_frame_is_read(null: rhi.Device) -> None:
    with make_renderer(null, stage(moves=True).build()) as renderer:
        draw(renderer)
        renderer.technique = ResourceCapture(TECHNIQUES["deferred"](), "surface")
        assert draw(renderer, seconds=1.0)["drawn"] == 2
