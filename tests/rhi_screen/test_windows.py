"""Windows in a virtual X server. What is checked in them runs in a process of its own, which has that
display."""

from __future__ import annotations

import logging
import multiprocessing
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, nullcontext
from typing import Any

import numpy as np
import pytest
from nightly_reasons import CHEAPER_TEST
from screens_kit import Display, WindowManager
from testing_kit import backend_works

import rhi
from rhi import Format
from rhi.backends.wgpu import find_obstacle

pytest.importorskip("rendercanvas", reason="no rendercanvas: pip install rhi[viewer]")

from rhi_screen import Screen, SimulatedGamepads, open_screen

Check = Callable[..., None]
requires_xdotool = pytest.mark.skipif(
    shutil.which("xdotool") is None, reason="nothing that moves a pointer: apt install xdotool"
)
SIZE = (64, 48)


def enter(environment: dict[str, str]) -> None:
    """Begin the process with the display: from now on its windows open there."""
    os.environ.update(environment)


@contextmanager
def begin_process(display: Display) -> Iterator[Check]:
    """Begin a process that has the display, and yield what runs a check there."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context, enter, (display.environment,)) as pool:
        yield lambda check, *arguments: pool.submit(check, display, *arguments).result(120)


@pytest.fixture(scope="module")
def windows(display: Display) -> Iterator[Check]:
    """Runs a check in a process that has the display."""
    with begin_process(display) as run:
        yield run


@pytest.fixture(autouse=True)
def can_run(request: pytest.FixtureRequest) -> None:
    """Skip tests on wgpu where nothing draws by it."""
    if "wgpu" in request.node.nodeid and (obstacle := find_obstacle()) is not None:
        pytest.skip(obstacle)


def play(screen: Screen, steps: Iterator[None]) -> None:
    """Run the screen's loop; each draw is a step, and the last one closes the window."""

    def draw() -> None:
        if next(steps, steps) is steps:
            screen.canvas.close()

    screen.run(draw)


def make_image(screen: Screen, seed: int = 1, format: Format = Format.RGBA8) -> rhi.Texture:
    """Return an image of noise, as large as the screen."""
    width, height = screen.size
    texels = np.random.default_rng(seed).integers(0, 256, (height, width, 4), np.uint8)
    return screen.device.texture(texels, format)


def window_position(screen: Screen) -> tuple[int, int]:
    import glfw

    x, y = glfw.get_window_pos(screen.canvas._window)
    return x, y


def shows(display: Display, screen: Screen, image: rhi.Texture) -> bool:
    """True if the window's pixels on the screen are, or become without another frame, the image's."""
    expected = image.read()[..., :3]
    for _ in range(100):
        seen = display.look(*window_position(screen), *screen.size)
        if seen.shape == expected.shape and (seen == expected).all():
            return True
        time.sleep(0.02)
    return False


def x_window(screen: Screen) -> int:
    import glfw

    return int(glfw.get_x11_window(screen.canvas._window))


def check_errors(display: Display) -> None:
    with open_screen("gl", size=SIZE, update_mode="fastest") as screen:
        draws = []

        def draw() -> None:
            draws.append(screen.size)
            if len(draws) == 2:
                raise KeyError("second")

        with pytest.raises(KeyError, match="second"):
            screen.run(draw)
        assert len(draws) == 2


def check_logged_errors(display: Display) -> None:
    logging.getLogger("rendercanvas").setLevel(logging.CRITICAL)
    with open_screen("gl", size=SIZE, update_mode="fastest") as screen:
        draws = []

        def draw() -> None:
            draws.append(screen.size)
            if len(draws) == 4:
                screen.canvas.close()
            raise KeyError(len(draws))

        screen.run(draw, on_error="log")
        assert len(draws) == 4


def check_full_screen(display: Display, backend: str) -> None:
    with open_screen(backend, size=SIZE, update_mode="fastest") as screen:

        def steps() -> Iterator[None]:
            for full, size in ((True, (640, 480)), (True, (640, 480)), (False, SIZE)):
                screen.device.present()  # the window's context is current, and may have the old size from then on
                screen.is_full_screen = full
                yield
                assert (screen.is_full_screen, screen.size) == (full, size)
                image = make_image(screen)
                screen.show(image)
                yield
                assert shows(display, screen, image)

        play(screen, steps())


def check_old_rectangle(display: Display) -> None:
    import glfw

    with open_screen("gl", size=SIZE, update_mode="fastest") as screen:
        window = screen.canvas._window

        def steps() -> Iterator[None]:
            glfw.set_window_pos(window, 77, 55)
            yield
            assert [monitor.width for monitor in screen.monitors] == [640]
            for _ in range(2):
                screen.fill_monitor(0)
                yield
                assert (screen.canvas.full_screen_monitor, screen.size) == (0, (640, 480))
                screen.is_full_screen = False
                yield
                assert (*glfw.get_window_pos(window), *glfw.get_window_size(window)) == (77, 55, *SIZE)
            with pytest.raises(rhi.ValidationError, match="device-argument"):
                screen.fill_monitor(1)

        play(screen, steps())


def test_a_window_comes_back_to_its_rectangle_from_full_screen(windows: Check) -> None:
    windows(check_old_rectangle)


def check_gamepads(display: Display) -> None:
    """Nothing requests a draw but the controller, which is connected after some time."""
    with open_screen("gl", size=SIZE) as screen:
        source = screen.gamepads.source = SimulatedGamepads()
        buttons: list[str] = []

        def note(event: dict[str, Any]) -> None:
            buttons.append(event["button"])
            screen.canvas.request_draw()

        screen.gamepads.add_handler(note, "gamepad_button_down")
        poll = screen.canvas.on_poll
        polls: list[None] = []

        def press_later() -> None:
            polls.append(None)
            if len(polls) == 5:
                source.set(0, buttons=("start",))
            poll()

        screen.canvas.on_poll = press_later

        def draw() -> None:
            screen.show(make_image(screen))
            if buttons:
                screen.canvas.close()

        screen.run(draw)
        assert buttons == ["start"]


def test_a_controller_wakes_a_window_that_draws_nothing(windows: Check) -> None:
    windows(check_gamepads)


@pytest.mark.parametrize("backend", ["gl", "wgpu"])
def test_a_window_fills_its_display_and_comes_back(windows: Check, backend: str) -> None:
    windows(check_full_screen, backend)


def test_an_error_in_a_draw_ends_the_loop_and_is_raised(windows: Check) -> None:
    windows(check_errors)


def test_an_error_in_a_draw_is_only_logged_if_asked(windows: Check) -> None:
    windows(check_logged_errors)


def check_pixels(display: Display, backend: str) -> None:
    with open_screen(backend, size=SIZE, update_mode="fastest") as screen:
        assert screen.size == SIZE

        def steps() -> Iterator[None]:
            for seed, format in enumerate((Format.RGBA8, Format.RGBA8_SRGB, Format.RGBA8)):
                image = make_image(screen, seed, format)
                screen.show(image)
                yield
                assert shows(display, screen, image), f"frame {seed}"
                image.destroy()

        play(screen, steps())


def check_resize(display: Display, backend: str) -> None:
    with open_screen(backend, size=SIZE, update_mode="fastest") as screen:
        sizes = []
        screen.canvas.add_event_handler(
            lambda event: sizes.append((event["width"], event["height"])), "resize"
        )

        def steps() -> Iterator[None]:
            for size in ((101, 67), (40, 90), SIZE):
                screen.canvas.set_logical_size(*size)
                yield
                assert screen.size == size, "the next frame has the new size"
                assert sizes[-1] == size
                image = make_image(screen)
                screen.show(image)
                yield
                assert shows(display, screen, image), f"the first image of {size}"

        play(screen, steps())


def check_resize_wakes(_display: Display) -> None:
    with open_screen("null", size=SIZE) as screen:
        sizes = []

        def draw() -> None:
            sizes.append(screen.size)
            screen.show(make_image(screen))
            if len(sizes) == 1:
                screen.canvas.set_logical_size(80, 60)  # nobody requests another draw
            else:
                screen.canvas.close()

        screen.run(draw)
    assert sizes == [SIZE, (80, 60)]


def check_events(_display: Display) -> None:
    with open_screen("null", size=SIZE, update_mode="fastest") as screen:
        events: list[dict[str, Any]] = []
        kinds = (
            "pointer_down",
            "pointer_up",
            "pointer_move",
            "double_click",
            "wheel",
            "key_down",
            "key_up",
            "char",
        )
        screen.canvas.add_event_handler(events.append, *kinds)
        window = str(x_window(screen))

        def tell(*words: str) -> None:
            subprocess.run(["xdotool", *words], check=True)

        def wait(kind: str) -> Iterator[None]:
            for _ in range(2000):
                if any(event["event_type"] == kind for event in events):
                    return
                time.sleep(0.002)
                yield
            raise AssertionError(f"no {kind}: {events}")

        def find(kind: str) -> dict[str, Any]:
            return next(event for event in events if event["event_type"] == kind)

        def steps() -> Iterator[None]:
            yield
            tell("windowfocus", window)
            tell("mousemove", "--window", window, "20", "11")
            yield from wait("pointer_move")
            assert (events[-1]["x"], events[-1]["y"]) == (20, 11)
            tell("mousedown", "1")
            yield from wait("pointer_down")
            assert (find("pointer_down")["button"], find("pointer_down")["buttons"]) == (1, (1,))
            tell("mouseup", "1", "click", "1")
            yield from wait("double_click")
            yield from wait("pointer_up")
            assert find("pointer_up")["buttons"] == ()
            tell("click", "5")
            yield from wait("wheel")
            assert (find("wheel")["dy"], find("wheel")["dx"], find("wheel")["x"]) == (100, 0, 20)
            tell("key", "shift+w")
            yield from wait("char")
            yield from wait("key_up")
            keys = [event["key"] for event in events if event["event_type"] == "key_down"]
            assert keys == ["Shift", "W"]
            assert find("char")["data"] == "W"
            assert find("char")["modifiers"] == ("Shift",)
            events.clear()
            tell("key", "Up", "F1", "space")
            yield from wait("char")
            assert [e["key"] for e in events if e["event_type"] == "key_down"] == ["ArrowUp", "F1", " "]

        play(screen, steps())


def check_density(_display: Display, density: int, ratio: float) -> None:
    WindowManager().set_density(density)  # GLFW reads it when its first window opens
    with open_screen("null", size=(60, 40), update_mode="fastest") as screen:
        assert screen.canvas.get_pixel_ratio() == ratio
        assert screen.canvas.get_logical_size() == (60, 40)
        assert screen.size == (60 * ratio, 40 * ratio)
        moves: list[dict[str, Any]] = []
        screen.canvas.add_event_handler(moves.append, "pointer_move")

        def steps() -> Iterator[None]:
            yield
            for _ in range(1000):
                coordinates = [str(round(length * ratio)) for length in (30, 12)]
                subprocess.run(
                    ["xdotool", "mousemove", "--window", str(x_window(screen)), *coordinates], check=True
                )
                yield
                if moves:
                    break
            assert (moves[-1]["x"], moves[-1]["y"]) == (30, 12)

        play(screen, steps())


def check_minimised(_display: Display) -> None:
    from rhi_screen.window import loop

    manager = WindowManager()
    with open_screen("null", size=SIZE, update_mode="fastest") as screen:
        frames, counts = [], []

        def draw() -> None:
            frames.append(time.perf_counter())
            screen.show(make_image(screen))
            if len(frames) == 2:
                manager.minimise(x_window(screen), True)
                loop.call_later(0.3, lambda: counts.append(len(frames)))
                loop.call_later(0.6, restore)
            if counts and len(frames) > counts[-1] + 1:
                screen.canvas.close()

        def restore() -> None:
            counts.append(len(frames))
            manager.minimise(x_window(screen), False)

        screen.run(draw)
    assert counts[0] == counts[1], "nothing was drawn"
    assert len(frames) > counts[1], "it draws again"


def check_closing(_display: Display, backend: str) -> None:
    manager, events = WindowManager(), []
    with open_screen(backend, size=SIZE, update_mode="fastest") as screen:
        screen.canvas.add_event_handler(lambda event: events.append(event["event_type"]), "close")
        image = make_image(screen)

        def steps() -> Iterator[None]:
            screen.show(image)
            yield
            manager.ask_to_close(x_window(screen))
            for _ in range(1000):
                screen.show(image)
                yield
            raise AssertionError("it stays open")

        play(screen, steps())
        assert screen.canvas.get_closed()
        assert events == ["close"]
        screen.show(image)  # nowhere
        assert image.read().shape == (48, 64, 4), "the device lives on"


def check_two(display: Display, backend: str, shares_device: bool = False) -> None:
    with (
        rhi.create_device(backend) if shares_device else nullcontext(backend) as device,
        open_screen(device, size=SIZE, update_mode="fastest") as first,
        open_screen(device, size=(30, 20)) as second,
    ):
        import glfw

        glfw.set_window_pos(second.canvas._window, 200, 100)
        second.canvas.set_update_mode("fastest")
        images = {screen: make_image(screen, seed) for seed, screen in enumerate((first, second))}
        second.canvas.request_draw(lambda: second.show(images[second]))

        def steps() -> Iterator[None]:
            for _ in range(5):
                first.show(images[first])
                yield
            for screen, image in images.items():
                assert shows(display, screen, image), screen.size
            second.canvas.close()

        play(first, steps())


def check_pace(_display: Display, options: dict[str, Any], min_rate: int, max_rate: int) -> None:
    with open_screen("null", size=SIZE, vsync=False, **options) as screen:
        times: list[float] = []

        def draw() -> None:
            times.append(time.perf_counter())
            if times[-1] - times[0] > 0.5:
                screen.canvas.close()
            screen.canvas.request_draw()

        screen.run(draw)
    assert min_rate <= len(times) - 1 <= max_rate, len(times)


def check_many(_display: Display, count: int) -> None:
    import psutil

    def open_one() -> None:
        for backend in ("gl", "null"):
            with open_screen(backend, size=SIZE, update_mode="fastest") as screen:
                play(screen, iter([screen.show(make_image(screen))]))

    memory = psutil.Process().memory_info
    for _ in range(5):
        open_one()
    before = memory().rss
    for _ in range(count):
        open_one()
    assert (memory().rss - before) / count < 200_000


@pytest.mark.parametrize("backend", ["gl", "null", "wgpu"])
def test_the_windows_pixels_are_the_frames(windows: Check, backend: str) -> None:
    windows(check_pixels, backend)


@pytest.mark.parametrize("backend", ["gl", "null", "wgpu"])
def test_the_first_frame_after_a_resize_has_the_new_size(windows: Check, backend: str) -> None:
    windows(check_resize, backend)


def test_a_resize_draws_also_if_nobody_asks(windows: Check) -> None:
    windows(check_resize_wakes)


@requires_xdotool
def test_events_arrive(windows: Check) -> None:
    windows(check_events)


@requires_xdotool
@pytest.mark.parametrize(
    ("density", "ratio"), [(192, 2.0), pytest.param(144, 1.5, marks=pytest.mark.nightly)]
)
def test_a_dense_display_has_more_pixels_than_the_logical_size(
    display: Display, density: int, ratio: float
) -> None:
    with begin_process(display) as run:
        run(check_density, density, ratio)


def test_a_minimised_window_draws_nothing(windows: Check) -> None:
    windows(check_minimised)


@pytest.mark.parametrize("backend", ["gl", "null", "wgpu"])
def test_a_window_that_is_closed_ends_the_loop(windows: Check, backend: str) -> None:
    windows(check_closing, backend)


@pytest.mark.parametrize("backend", ["gl", "wgpu"])
def test_two_windows_show_the_images_of_their_own_devices(windows: Check, backend: str) -> None:
    windows(check_two, backend)


@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu"])
def test_two_windows_show_the_images_of_their_one_device(windows: Check, backend: str) -> None:
    if not backend_works(backend):
        pytest.skip(f"no device of {backend} here")
    windows(check_two, backend, True)


def check_surface(display: Display) -> None:
    with open_screen("wgpu", size=SIZE, update_mode="fastest") as screen:
        image = screen.device.texture((SIZE[0] // 2, SIZE[1] // 2), Format.RGBA8)

        def steps() -> Iterator[None]:
            for shade in (0.2, 1.0):
                with screen.device.render_pass(image, clear=(shade, 0.4, 0.6, 0.0)):
                    pass
                with pytest.MonkeyPatch.context() as patch:
                    patch.setattr(rhi.Texture, "read", lambda *_: pytest.fail("the CPU copies the image"))
                    screen.show(image)
                yield
            texels = np.broadcast_to(np.uint8([255, 102, 153]), (*SIZE[::-1], 3))
            assert (display.look(*window_position(screen), *SIZE) == texels).all(), "scaled, and opaque"

        play(screen, steps())


def test_wgpu_shows_on_the_window_s_surface(windows: Check) -> None:
    windows(check_surface)


@pytest.mark.nightly_cases("options2-30-1000000", reason=CHEAPER_TEST)
@pytest.mark.parametrize(
    ("options", "min_rate", "max_rate"),
    [
        ({"update_mode": "continuous", "max_fps": 20}, 3, 11),
        ({"update_mode": "ondemand", "max_fps": 20}, 3, 11),
        ({"update_mode": "fastest"}, 30, 1_000_000),
    ],
)
def test_frames_come_at_the_rate_that_was_asked_for(
    windows: Check, options: dict[str, Any], min_rate: int, max_rate: int
) -> None:
    windows(check_pace, options, min_rate, max_rate)


@pytest.mark.nightly
def test_windows_opened_and_closed_leave_memory_where_it_was(windows: Check) -> None:
    windows(check_many, 100)
