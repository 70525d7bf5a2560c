"""Uploads over many frames: their budget, their order, what is shown meanwhile, and the final image."""

import numpy as np
import pytest
from nightly_reasons import ONLY_KERNELS

from renderer.content import BUILT_IN, load_scene
from renderer.frame import UploadSettings
from renderer.renderer import Renderer
from renderer.scene import AlphaMode, Camera, SceneBuilder, TextureMap, translation
from tests.renderer.refusals import refused_rule

SIZE = (64, 48)
BUDGET = UploadSettings(1 << 18)


def make_image(seed, width, height):
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 255, (height, width, 4), np.uint8)
    image[..., 3] = 255
    return image


def make_shelf(sizes=((256, 256), (256, 256), (128, 128)), far=30.0):
    """Boxes in a row from near to far with an image each, one of them masked and one with all maps, and a plane."""
    builder = SceneBuilder("shelf")
    box, sphere = builder.add_mesh(BUILT_IN["box"](), "box"), builder.add_mesh(BUILT_IN["sphere"](), "sphere")
    images = [builder.add_image(make_image(seed, *size)) for seed, size in enumerate(sizes)]
    mask = make_image(9, *sizes[0])
    mask[::2, :, 3] = 0
    materials = [builder.add_material(texture=image, roughness=0.5) for image in images]
    materials.append(
        builder.add_material(
            texture=builder.add_image(mask), alpha_mode=AlphaMode.MASK, double_sided=True, roughness=0.7
        )
    )
    materials.append(
        builder.add_material(
            texture=TextureMap(images[0], scale=(2.0, 2.0)),
            emissive=(0.5, 0.5, 0.5),
            emissive_texture=images[1],
            metallic_roughness_texture=builder.add_image(make_image(7, *sizes[0])),
            normal_texture=builder.add_image(make_image(8, *sizes[0])),
        )
    )
    for number, material in enumerate(materials):
        node = builder.add_node(translation((1.6 * number - 1.2, 0.0, -far / 15 * number)), name=f"{number}")
        builder.add_objects(node, sphere if number % 2 else box, material)
    builder.lights.add_directional((-0.3, -1.0, -0.5), (1.0, 1.0, 1.0), 3.0, casts_shadow=True)
    builder.lights.sky = builder.lights.ground = (0.5, 0.5, 0.5)
    return builder.build()


CAMERA = Camera.look_at((0.0, 0.7, 2.0), (0.4, 0.0, -1.0))


def make_many_sizes():
    """More images of other sizes than arrays can be bound for, so that they are in texture tables."""
    return make_shelf(tuple((200 + 8 * number, 250 + 16 * number) for number in range(10)))


@pytest.mark.nightly_cases("cl-*", reason=ONLY_KERNELS)
@pytest.mark.parametrize("make_scene", [make_shelf, make_many_sizes])
def test_the_final_image_is_that_of_a_scene_uploaded_at_once(drawing_device, make_scene):
    with Renderer(drawing_device, make_scene(), size=SIZE) as renderer:
        expected = renderer.render(CAMERA).image.read()
    with Renderer(drawing_device, make_scene(), size=SIZE, uploads=BUDGET) as renderer:
        images = [renderer.render(CAMERA).image.read()]
        while not renderer.uploads.is_done:
            images.append(renderer.render(CAMERA).image.read())
        images.append(renderer.render(CAMERA).image.read())
    assert len(images) > 2
    assert not np.array_equal(images[0], expected)
    assert np.array_equal(images[-1], expected)
    assert expected[..., :3].std() > 20


@pytest.mark.parametrize("make_scene", [make_shelf, make_many_sizes])
def test_no_frame_uploads_more_than_its_budget(null, make_scene):
    scene = make_scene()
    with Renderer(null, scene, size=SIZE) as whole:
        whole.render(CAMERA)
        steady = whole.render(CAMERA).statistics.upload_bytes
    with Renderer(null, scene, size=SIZE, uploads=BUDGET) as renderer:
        written, fractions = [], []
        while not renderer.uploads.is_done:
            before = null.statistics.upload_bytes
            renderer.render(CAMERA)
            written.append(null.statistics.upload_bytes - before)
            fractions.append(renderer.uploads.progress.fraction)
        tables = 20_000  # of 5 objects, their materials and lights, and the constants of a frame
        assert max(written) <= BUDGET.bytes_per_frame + steady + tables
        expected = sum(image.nbytes for image in scene.images)
        assert sum(written) >= expected
        assert len(written) >= expected / BUDGET.bytes_per_frame
        assert fractions == sorted(fractions)
        assert fractions[-1] == 1.0
        assert renderer.uploads.progress.item == ""
        renderer.render(CAMERA)
        before = null.statistics.upload_bytes
        renderer.render(CAMERA)
        assert null.statistics.upload_bytes - before <= steady


def test_objects_are_hidden_until_their_meshes_are_there_the_large_ones_first(null):
    builder = SceneBuilder("spheres")
    meshes = [
        builder.add_mesh(BUILT_IN["sphere"]().transformed(np.diag([s, s, s, 1])))
        for s in (1.0, 1.1, 1.2, 1.3)
    ]
    material = builder.add_material()
    for mesh, position in zip(meshes, ((0, 0, -90), (0, 0, -10), (0, 0, 90), (0, 0, -40)), strict=True):
        builder.add_objects(builder.add_node(translation(position)), mesh, material)
    scene = builder.build()
    each = len(scene.meshes.vertices) // 4 * 32 + len(scene.meshes.indices)
    settings = UploadSettings(1 << 18)
    with Renderer(null, scene, size=SIZE, uploads=settings, visibility="none") as renderer:
        order = []
        object.__setattr__(settings, "bytes_per_frame", each)  # below what users may ask for
        while not renderer.uploads.is_done:
            renderer.render(Camera.look_at((0, 0, 0), (0, 0, -1)))
            for row in np.flatnonzero(scene.objects.is_shown).tolist():
                if row not in order:
                    order.append(row)
        assert order == [1, 3, 0, 2]  # the last one is behind the camera


def test_surfaces_have_the_mean_colour_of_images_that_are_not_there(gl):
    builder = SceneBuilder("wall")
    image = np.zeros((512, 512, 4), np.uint8)
    image[:, ::2] = (0, 255, 0, 255)
    image[:, 1::2] = (0, 0, 0, 255)
    material = builder.add_material(texture=builder.add_image(image), roughness=1.0, metallic=0.0)
    builder.add_objects(builder.add_node(), builder.add_mesh(BUILT_IN["box"]()), material)
    builder.lights.sky = builder.lights.ground = (0.8, 0.8, 0.8)
    scene = builder.build()
    camera = Camera.look_at((0.0, 0.0, 3.0), (0.0, 0.0, 0.0))
    with Renderer(gl, scene, size=SIZE, uploads=UploadSettings(1 << 18)) as renderer:
        first = renderer.render(camera).image.read()[24, 32].astype(int)
        assert not renderer.uploads.is_done
        while not renderer.uploads.is_done:
            last = renderer.render(camera)
        last = renderer.render(camera).image.read()[20:28, 28:36, 1].mean()
    assert first[1] > 60
    assert first[0] < 30
    assert abs(first[1] - last) < 12


def test_destroying_a_renderer_while_it_uploads_shows_all_objects_again(null):
    scene = make_shelf()
    with Renderer(null, scene, size=SIZE, uploads=BUDGET) as renderer:
        renderer.render(CAMERA)
        assert not renderer.uploads.is_done
    scene.refresh()
    assert scene.objects.is_shown.all()
    with Renderer(null, scene, size=SIZE) as renderer:
        assert len(renderer.render(CAMERA).visible) == len(scene.objects)


def test_finish_uploads_all_that_is_left(null):
    with Renderer(null, make_shelf(), size=SIZE, uploads=BUDGET) as renderer:
        renderer.render(CAMERA)
        renderer.uploads.finish()
        assert renderer.uploads.is_done
        assert len(renderer.render(CAMERA).visible) == 5


def test_a_hidden_node_stays_hidden_while_and_after_its_mesh_is_uploaded(null):
    scene = load_scene("grid:count=4")
    scene.nodes.hide(scene.objects.node[:1])
    with Renderer(null, scene, size=SIZE, uploads=BUDGET) as renderer:
        while not renderer.uploads.is_done:
            renderer.render(next(iter(scene.views.values())))
        renderer.render(next(iter(scene.views.values())))
    assert not scene.objects.is_shown[0]
    assert scene.objects.is_shown[1:].all()


@pytest.mark.parametrize("count", [0, -1, (1 << 18) - 1, 1.5e6, "8", None, True, 1 << 40])
def test_budgets_that_are_no_number_of_bytes_are_refused(count):
    assert refused_rule(lambda: UploadSettings(count)) == "upload-settings"
    assert UploadSettings(np.int64(1 << 20)).bytes_per_frame == 1 << 20


def test_other_settings_than_those_of_uploads_are_refused(null):
    scene = load_scene("grid:count=1")
    assert refused_rule(lambda: Renderer(null, scene, uploads=1 << 20)) == "upload-settings"
    Renderer(null, scene, uploads=UploadSettings()).destroy()
