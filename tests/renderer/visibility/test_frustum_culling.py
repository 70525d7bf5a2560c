"""The visibility algorithms: one method, interchangeable, on scenes with static and moving objects."""

import numpy as np
import pytest

from renderer import visibility
from renderer.content import load_scene
from renderer.scene import Camera
from renderer.visibility import (
    CallbackDrawer,
    FrustumCulling,
    NoCulling,
    frustum,
    list_visible_objects,
    select_visible,
)
from renderer.visibility.boxes.culling import BruteForceCuller
from rhi.errors import ValidationError


@pytest.fixture(scope="module")
def hall():
    return load_scene("hall:columns=8,rows=2,flags=12")


@pytest.fixture(scope="module")
def city():
    return load_scene("city:blocks=10")


@pytest.mark.parametrize("path", ["ground", "sky"])
def test_frustum_culling_draws_along_a_path_exactly_the_objects_that_brute_force_selects(hall, path):
    algorithm = FrustumCulling(hall)
    assert len(hall.objects.dynamic_indices)
    assert len(hall.objects.static_indices)
    seen = set()
    for frame in range(0, 1800, 90):
        hall.update(frame / 60.0)
        camera = hall.paths[path].camera(frame)
        expected = np.flatnonzero(
            select_visible(camera.frustum.planes, hall.objects.lower, hall.objects.upper)
        )
        assert (list_visible_objects(algorithm, camera) == expected).all()
        seen.update(np.intersect1d(expected, hall.objects.dynamic_indices).tolist())
    assert seen


def test_no_culling_draws_every_object_once(hall):
    batches = []
    statistics = NoCulling(hall).render(hall.paths["sky"].camera(0), CallbackDrawer(batches.append))
    assert [batch.tolist() for batch in batches] == [list(range(len(hall.objects)))]
    assert statistics.visible == statistics.objects == len(hall.objects)


def test_batches_are_ascending_and_statistics_count_them(hall):
    batches = []
    statistics = FrustumCulling(hall).render(hall.views["overview"], CallbackDrawer(batches.append))
    assert statistics.batches == len(batches) == 1
    assert statistics.visible == len(batches[0])
    assert (np.diff(batches[0]) > 0).all()
    assert 0 < statistics.objects_tested <= len(hall.objects)
    assert statistics.plane_tests > 0


def test_an_object_that_is_alone_in_view_is_a_batch():
    scene = load_scene("grid:count=1")
    statistics = FrustumCulling(scene).render(
        next(iter(scene.views.values())), CallbackDrawer(lambda rows: None)
    )
    assert (statistics.visible, statistics.batches) == (1, 1)


def test_nothing_in_view_draws_nothing(hall):
    batches = []
    away = Camera.look_at((0.0, 1000.0, 0.0), (0.0, 2000.0, 0.0))
    statistics = FrustumCulling(hall).render(away, CallbackDrawer(batches.append))
    assert batches == []
    assert statistics.visible == statistics.batches == 0


def test_many_objects_are_in_a_hierarchy_which_needs_fewer_tests_and_few_are_not(monkeypatch):
    city = load_scene("city:blocks=24,detail=2")
    count, camera = len(city.objects.fixed_indices), city.paths["ground"].camera(900)
    visible = []
    for few in (count, count - 1):
        monkeypatch.setattr(frustum, "_MAX_BRUTE_FORCE", few)
        statistics = FrustumCulling(city).render(camera, CallbackDrawer(visible.append))
        if few == count:
            assert (statistics.nodes_tested, statistics.plane_tests) == (0, 5 * count)
    assert np.array_equal(*visible)
    assert 0 < len(visible[0]) < count
    assert 0 < statistics.plane_tests < 5 * count / 3
    assert statistics.objects_tested < count / 3


@pytest.mark.parametrize("name", ["none", "frustum"])
def test_a_name_makes_its_algorithm(city, null, name):
    assert len(list_visible_objects(visibility.make_visibility(name, city, null), city.views["street"])) > 0


def test_an_unknown_name_is_refused_with_the_nearest(city, null):
    with pytest.raises(ValidationError, match="did you mean 'frustum'") as error:
        visibility.make_visibility("frustrum", city, null)
    assert error.value.rule.id == "visibility-unknown-name"


@pytest.mark.parametrize("seed", range(3))
def test_boxes_that_touch_a_plane_are_selected_by_a_product_of_matrices_as_one_by_one(seed: int) -> None:
    random = np.random.default_rng(seed)
    planes = random.normal(size=(6, 4))
    planes[:, :3] /= np.linalg.norm(planes[:, :3], axis=1, keepdims=True)
    lower = 10.0 * random.normal(size=(300, 3))
    upper = lower + random.random((300, 3))
    for row in range(0, 300, 3):  # its p-vertex is on a plane, but for rounding
        normal, distance = planes[row % 6, :3], planes[row % 6, 3]
        corner = np.where(normal > 0.0, upper[row], lower[row])
        moved = (corner @ normal + distance) * normal
        lower[row], upper[row] = lower[row] - moved, upper[row] - moved
    far = np.array([[np.inf, 0.0, 0.0], [-np.inf, 0.0, 0.0]])
    for boxes in ((lower, upper), (np.vstack([lower, -np.abs(far)]), np.vstack([upper, np.abs(far)]))):
        culler = BruteForceCuller(*boxes)
        for subset in (planes, planes[:1], planes - [0.0, 0.0, 0.0, 3.0]):
            with np.errstate(invalid="ignore"):
                expected = select_visible(subset, *boxes).nonzero()[0]
                assert culler.select_visible(subset)[0].tolist() == expected.tolist()
