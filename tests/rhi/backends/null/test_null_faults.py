"""After every fault the library's state is consistent, and the error names its cause."""

import numpy as np
import pytest
from null_kit import Camera, Object, hand_made_program

import rhi
from rhi import DeviceError, Format, Op, Primitive, ShaderError
from rhi.backends.null import FaultInjector, Faults, NullBackend, SimulatedBackend, Simulation, create_backend
from rhi.backends.null.faults import FRAME_SECONDS

POSITIONS = np.array([[-1, -1], [1, -1], [0, 1]], np.float32)


def live(device):
    """Return the ids of resources that were created and not destroyed."""
    resources = set()
    for command in device.stream:
        if command.op.method.startswith("create_") and command.failure is None:
            resources.add(command.values[0])
        elif command.op is Op.DESTROY:
            resources.discard(command["resource"])
    return resources


def render(device, frames=3):
    """Create and use resources of every kind. Return an image and the samples counted."""
    null = device.backend_as(NullBackend)
    null.count_samples(lambda draw: 10)
    device.timing = True
    seen = []
    with (
        device.mesh({"position": POSITIONS}, np.array([0, 1, 2])) as mesh,
        device.texture((8, 8), Format.RGBA8) as image,
        device.uniform(Camera(tint=(1, 1, 1, 1))).owner as owner,
    ):
        program = device.program(hand_made_program())
        camera = device.transient.uniform(Camera(tint=(1, 1, 1, 1)))
        objects = device.uniform_array(Object, 4)
        queries = [device.occlusion_query(emulated=emulated) for emulated in (False, True)]
        for number in range(frames):
            camera = device.transient.uniform(Camera(tint=(1, 1, 1, 1)))
            with device.event("frame"), device.render_pass(image, clear=(0, 0, number / 4, 1)):
                for query in queries:
                    with query, device.states(rhi.CullMode.NONE):
                        device.draw(program, mesh, camera=camera, object=objects[number])
                with device.immediate(program, Primitive.QUADS, camera=camera, object=objects[0]) as quads:
                    for corner in range(4):
                        quads.vertex(position=(corner, 0))
            device.present(image)
            seen += [query.wait() for query in queries]
        pixels = image.read()
        for query in queries:
            query.destroy()
        objects.buffer.destroy()
        program.destroy()
        owner.destroy()
    device.timing = False
    return pixels.tolist(), seen


@pytest.fixture(scope="module")
def clean():
    with rhi.create_device("null") as device:
        result = render(device)
        ops = [command.op for command in device.stream]
        yield result, ops, device.stream


def check_whole(device):
    """Check that no pass, scope, lock, label or query is left open: each can begin and end again."""
    with device.event("again"), device.states(rhi.CullMode.BACK):
        pass
    labels = [command.op for command in device.stream if command.op in (Op.PUSH_LABEL, Op.POP_LABEL)]
    assert labels.count(Op.PUSH_LABEL) == labels.count(Op.POP_LABEL)
    begun = [command.op for command in device.stream if command.failure is None]
    assert begun.count(Op.BEGIN_PASS) == begun.count(Op.END_PASS)
    assert not device._core.locked
    assert device._core.render_pass is None


# -- out of memory -------------------------------------------------------------------------------------------


def test_after_running_out_of_memory_anywhere_the_same_device_renders_the_same(clean):
    expected, ops, _ = clean
    creations = sum(op.method.startswith("create_") for op in ops)
    assert creations > 15
    for number in range(creations):
        with rhi.create_device("null", faults=Faults(memory=number)) as device:
            with pytest.raises(DeviceError, match=r"^\[device-out-of-memory\]") as caught:
                render(device)
            assert f"creation {number}, an injected fault" in str(caught.value)
            assert caught.value.site.file == __file__
            device.timing = False
            check_whole(device)
            assert render(device) == expected


CREATORS = {
    "mesh": lambda d: d.mesh({"position": POSITIONS}, np.array([0, 1, 2]), instances={"a": POSITIONS}),
    "buffer": lambda d: d.buffer(POSITIONS),
    "texture": lambda d: d.texture(np.zeros((4, 4, 4), np.uint8), Format.RGBA8, levels=None),
    "query": lambda d: d.occlusion_query(),
    "emulated": lambda d: d.occlusion_query(emulated=True),
    "uniform": lambda d: d.uniform(Camera(tint=(1, 1, 1, 1))),
    "storage": lambda d: d.storage(rhi.shading.vec4, np.zeros((4, 4), np.float32)),
    "program": lambda d: d.program(hand_made_program()),
}


@pytest.mark.parametrize("name", CREATORS)
def test_a_creation_that_fails_leaves_nothing_behind(name):
    create = CREATORS[name]
    with rhi.create_device("null") as device:
        create(device)
        creations = sum(command.op.method.startswith("create_") for command in device.stream)
    for number in range(creations):
        with rhi.create_device("null", faults=Faults(memory=number)) as device:
            with pytest.raises(DeviceError):
                create(device)
            device.finish()
            samplers = {c.values[0] for c in device.stream.filter(Op.CREATE_SAMPLER)}
            assert live(device) <= samplers  # which are shared and kept
            create(device)


def test_an_event_without_memory_for_its_end_reuses_the_query_of_its_beginning():
    with rhi.create_device("null", timing=True, faults=Faults(memory=1)) as device:
        with pytest.raises(DeviceError):
            device.event("a").__enter__()
        with device.event("b"):
            pass
        queries = [command for command in device.stream.filter(Op.CREATE_QUERY) if command.failure is None]
        assert len(queries) == 2
        check_whole(device)


# -- compilation ---------------------------------------------------------------------------------------------


def test_a_program_that_the_driver_refuses_can_be_made_again():
    with rhi.create_device("null", faults=Faults(compilation=1)) as device:
        first, second = hand_made_program("first"), hand_made_program("second")
        device.program(first)
        with pytest.raises(ShaderError, match=r"^\[shader-driver\]") as caught:
            device.program(second)
        assert "program 1 (second), an injected fault" in str(caught.value)
        assert device.program(second).name == "second"


# -- loss ----------------------------------------------------------------------------------------------------


def test_a_device_lost_anywhere_says_so_from_then_on_and_can_be_closed(clean):
    _, ops, _ = clean
    for number in range(len(ops)):
        device = rhi.create_device("null", faults=Faults(loss=number))
        with pytest.raises(DeviceError, match=r"^\[device-lost\]") as caught:
            render(device)
        assert f"lost at command {number}, an injected fault" in str(caught.value)
        assert caught.value.site.file == __file__
        with pytest.raises(DeviceError, match=r"^\[device-lost\]"):
            device.buffer(4)
        device.close()
        assert device.closed


def test_a_lost_device_answers_no_question():
    backend = create_backend(faults=Faults(loss=1))
    backend.signal(1)
    assert backend.completed() == 1
    for call in (lambda: backend.signal(2), backend.completed, lambda: backend.read_query(1)):
        with pytest.raises(DeviceError, match=r"^\[device-lost\]"):
            call()
    backend.close()


# -- late fences ---------------------------------------------------------------------------------------------


def test_a_late_fence_is_seen_so_many_frames_later():
    backend = create_backend(faults=Faults(late_frames=2))
    backend.signal(1)
    seen = [backend.completed()]
    for value in range(2, 5):
        backend.present(0)
        backend.signal(value)
        seen.append(backend.completed())
    assert seen == [0, 0, 1, 2]


def test_a_late_fence_can_be_waited_for_and_takes_its_time():
    backend = create_backend(faults=Faults(late_frames=2))
    backend.signal(1)
    assert not backend.wait(1, 1.9 * FRAME_SECONDS)
    assert backend.completed() == 0
    assert backend.wait(1, 2.1 * FRAME_SECONDS)
    assert backend.completed() == 1


@pytest.mark.parametrize("late", [1, 2, 5])
def test_late_fences_change_nothing_but_when(clean, late):
    with rhi.create_device("null", faults=Faults(late_frames=late), simulation=Simulation()) as device:
        assert render(device, frames=3) == clean[0]
        assert not device.backend_as(SimulatedBackend).hazards


def test_a_destroyed_buffer_is_alive_until_a_late_fence_is_signalled():
    with rhi.create_device("null", faults=Faults(late_frames=3), frames_in_flight=8) as device:
        buffer = device.buffer(16)
        buffer.destroy()
        for _ in range(3):
            device.present()
            assert buffer.id in live(device)
        device.present()
        device.signal()
        assert buffer.id not in live(device)


# -- silent queries ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("emulated", [False, True])
def test_a_query_that_never_answers_is_never_finished_and_no_wait_is_forever(monkeypatch, emulated):
    monkeypatch.setattr("rhi.device.queries.occlusion.RESULT_SECONDS", 0.02)
    with rhi.create_device("null", faults=Faults(silent_query=0)) as device:
        device.backend_as(NullBackend).count_samples(lambda draw: 10)
        silent, other = (device.occlusion_query(emulated=emulated) for _ in range(2))
        image = device.texture((8, 8), Format.RGBA8)
        for query in (silent, other):
            with device.render_pass(image), query:
                pass
        assert not silent.is_finished
        with pytest.raises(DeviceError, match=r"^\[device-no-answer\]") as caught:
            silent.wait()
        assert f"query {silent.id}" in str(caught.value)
        assert other.wait() == 0
        silent.destroy()
        device.finish()
        assert silent.id not in live(device)


def test_timers_go_on_when_a_timestamp_never_comes():
    with rhi.create_device("null", timing=True, faults=Faults(silent_query=0)) as device:
        for _ in range(20):
            with device.event("frame"):
                pass
            device.present()
        assert [node.name for node in device.timers] == ["frame"]


# -- by seed -------------------------------------------------------------------------------------------------


def test_a_seed_draws_one_fault_that_the_program_meets(clean):
    _, _, stream = clean
    drawn = [Faults.from_seed(seed, stream) for seed in range(60)]
    assert drawn == [Faults.from_seed(seed, stream) for seed in range(60)]
    names = [[name for name in Faults.__slots__ if getattr(fault, name) not in (None, 0)] for fault in drawn]
    assert {name for drawn_names in names for name in drawn_names} == set(Faults.__slots__) - {
        "compilation"
    }  # of place 0 only
    assert any(fault.compilation == 0 for fault in drawn)
    assert len({fault.loss for fault in drawn}) > 5


def test_a_program_that_does_nothing_has_no_faults():
    with rhi.create_device("null") as device:
        assert Faults.from_seed(1, device.stream) == Faults()


def test_no_faults_are_no_difference(clean):
    with rhi.create_device("null", faults=Faults()) as device:
        assert render(device) == clean[0]
        assert device.backend_as(FaultInjector).faults == Faults()
