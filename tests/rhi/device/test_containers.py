"""FixedStack and FixedQueue against lists."""

import tracemalloc

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from rhi.device.core.containers import FixedQueue, FixedStack
from rhi.errors import ValidationError

CAPACITIES = st.integers(1, 9)
# A number is pushed, None pops, "clear" clears.
STEPS = st.lists(st.one_of(st.integers(0, 9), st.none(), st.just("clear")), max_size=60)


@pytest.mark.parametrize("container", [FixedStack, FixedQueue])
@pytest.mark.parametrize("capacity", [0, -1])
def test_a_container_without_room_is_refused(container, capacity):
    with pytest.raises(ValidationError, match=r"^\[container-capacity\]"):
        container(capacity)


@pytest.mark.parametrize(("container", "name"), [(FixedStack, "top"), (FixedQueue, "front")])
def test_an_empty_container_has_no_first_element(container, name):
    with pytest.raises(ValidationError, match=r"^\[container-empty\]"):
        getattr(container(1), name)


@pytest.mark.parametrize(("container", "peek", "end"), [(FixedStack, "top", -1), (FixedQueue, "front", 0)])
@example(8, range(9))
@example(9, range(10))
@given(CAPACITIES, STEPS)
@settings(max_examples=200)
def test_a_fixed_container_behaves_as_a_list(container, peek, end, capacity, steps):
    room, model = container(capacity), []
    for step in steps:
        if step == "clear":
            room.clear()
            model.clear()
        elif step is None and model:
            assert getattr(room, peek) == model[end]
            assert room.pop() == model.pop(end)
        elif step is not None and len(model) < capacity:
            room.push(step)
            model.append(step)
        else:
            with pytest.raises(
                ValidationError, match="container-empty" if step is None else "container-full"
            ):
                room.pop() if step is None else room.push(step)
        assert list(room) == model
        assert len(room) == len(model)
        if container is FixedQueue:
            assert room.is_full == (len(model) == capacity)


@pytest.mark.parametrize("container", [FixedStack, FixedQueue])
def test_a_container_releases_removed_elements(container):
    import weakref

    class Thing:
        pass

    room, thing = container(2), Thing()
    alive = weakref.ref(thing)
    room.push(thing)
    room.pop()
    del thing
    assert alive() is None


@pytest.mark.parametrize("container", [FixedStack, FixedQueue])
def test_a_container_allocates_nothing_but_its_positions(container):
    room, things = container(4096), [object() for _ in range(4096)]

    def use():
        for thing in things:
            room.push(thing)
        for _ in range(1000):
            room.pop()
        room.clear()

    def measure():
        tracemalloc.start()
        try:
            use()
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    use()
    assert min(measure() for _ in range(5)) < 1000  # other threads of the process may allocate meanwhile
