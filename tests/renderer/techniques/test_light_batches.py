"""Forward shading in passes of several lights: the same image by fewer draws (Thatcher 2014, algorithm 3)."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest
from frames import open_renderer
from hypothesis import given
from hypothesis import strategies as st
from nightly_reasons import ONLY_KERNELS
from numpy.typing import NDArray

import rhi
from renderer.content import load_scene
from renderer.scene import Scene
from renderer.techniques import ForwardMultipass
from renderer.techniques.forward_multipass import batch_lights
from renderer.techniques.technique_settings import TechniqueSettings
from rhi import Op

SIZE = (96, 54)


@pytest.fixture(scope="module")
def hall() -> Scene:
    return load_scene("hall:columns=4,rows=2,flags=2,lights=24")


def draw(device: rhi.Device, scene: Scene, lights_per_draw: int) -> NDArray[np.int64]:
    technique = ForwardMultipass(lights_per_draw=lights_per_draw)
    with open_renderer(device, scene, technique, visibility="frustum", size=SIZE) as renderer:
        image = renderer.render(scene.paths["ground"].camera(600), 10.0).image
        return np.asarray(image.read(), np.int64)


@given(
    pairs=st.sets(st.tuples(st.integers(0, 5), st.integers(0, 30)), max_size=80),
    most=st.integers(1, 9),
    seed=st.integers(0, 9),
)
def test_batches_have_each_pair_once_and_as_many_entries_as_they_may(
    pairs: set[tuple[int, int]], most: int, seed: int
) -> None:
    shuffled = np.random.default_rng(seed).permutation(np.array(sorted(pairs), np.int64).reshape(-1, 2))
    objects, begins, ends = batch_lights(shuffled[:, 0], shuffled[:, 1], most)
    batched = [
        (number, entry)
        for number, begin, end in zip(objects.tolist(), begins.tolist(), ends.tolist(), strict=True)
        for entry in range(begin, end)
    ]
    assert sorted(batched) == sorted(pairs)
    assert len(batched) == len(pairs)
    assert all(1 <= size <= most for size in (ends - begins).tolist())
    # By brute force: runs of entries that follow each other take as few batches as they can.
    entries_by_object = defaultdict[int, list[int]](list)
    for number, entry in sorted(pairs):
        entries_by_object[number].append(entry)
    expected = 0
    for entries in entries_by_object.values():
        length = 0
        for entry, following in zip(entries, [*entries[1:], None], strict=True):
            length += 1
            if following != entry + 1:
                expected += -(-length // most)
                length = 0
    assert len(objects) == expected


@pytest.mark.nightly_cases("cl", "wgpu", reason=ONLY_KERNELS)
def test_the_image_is_that_of_a_light_at_a_time(drawing_device: rhi.Device, hall: Scene) -> None:
    """But for rounding: lights are added up in another order."""
    single, batches, all_at_once = (draw(drawing_device, hall, number) for number in (1, 4, 1000))
    assert single.std() > 20.0
    assert np.abs(single - batches).max() <= 1
    assert np.abs(single - all_at_once).max() <= 1


def test_as_many_draws_are_saved_as_batches_have_lights(null: rhi.Device, hall: Scene) -> None:
    counts = {}
    for lights_per_draw in (1, 4, 1000):
        technique = ForwardMultipass(lights_per_draw=lights_per_draw)
        with open_renderer(null, hall, technique, visibility="frustum", size=SIZE) as renderer:
            renderer.render(hall.paths["ground"].camera(600), 10.0)
            null.stream.clear()
            renderer.render(hall.paths["ground"].camera(600), 10.0)
            counts[lights_per_draw] = sum(
                command["draws"] for command in null.stream.draws() if command.op is Op.DRAW_INDIRECT
            )
    # The base pass draws each object once; the others a batch of each kind at most, or one for each light.
    assert 10 < counts[1000] < 0.7 * counts[4]
    assert counts[4] < 0.5 * counts[1]


def test_a_number_of_lights_below_1_is_refused() -> None:
    for make in (ForwardMultipass, TechniqueSettings):
        assert make(lights_per_draw=1).lights_per_draw == 1
        with pytest.raises(rhi.ValidationError) as error:
            make(lights_per_draw=0)
        assert error.value.rule.id == "technique-parameter"


def test_settings_choose_the_number_of_lights() -> None:
    technique = TechniqueSettings(name="forward_multipass", lights_per_draw=8).make_technique(
        "forward_multipass"
    )
    assert isinstance(technique, ForwardMultipass)
    assert technique.lights_per_draw == 8
