"""A process whose address space ends (`ulimit -v`): creations are refused, nothing aborts, and the device
goes on."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(sys.platform != "linux", reason="the limit is set and measured as on Linux"),
]

PROGRAM = """
import itertools, logging, resource, sys
import numpy as np
import rhi
from rhi.conformance.shaders import Count, FlatColored
from rhi.conformance.shapes import rectangle
logging.getLogger("rhi.kernels").setLevel(logging.ERROR)  # else a slow machine says that it builds kernels

backend, kind, room = sys.argv[1:]
device = rhi.create_device(backend)
image, mesh, program = device.texture((16, 16), rhi.Format.RGBA8), device.mesh(rectangle()), device.program(FlatColored)

sizes = itertools.count(1)

def draw():
    with device.render_pass(image, clear=(0, 0, 0, 0)):
        device.draw(program, mesh)
    return image.read()

def make():
    if kind == "buffers":
        return device.buffer(64 << 20)
    if kind == "textures":
        return device.texture((4096, 4096), rhi.Format.RGBA8)
    if kind == "writes":
        programs = device.texture((2048, 2048), rhi.Format.RGBA8)
        programs.write(np.zeros((2048, 2048, 4), np.uint8))
        return programs
    if kind == "records":
        with device.record() as commands, commands.render_pass(image):
            for _ in range(20000):
                commands.draw(program, mesh)
        device.submit(commands)
        return device.buffer(4), commands
    if kind == "shaders":
        size = {"work_group": (next(sizes),)}
        with device.storage(rhi.shading.uint, 1) as total:
            device.dispatch(device.program(type("Counts", (Count,), size)), 1, total=total)
            return device.buffer(total.read().nbytes + (16 << 20))
    programs = device.texture((1024, 1024), rhi.Format.RGBA32F)
    return programs, programs.read()

wanted = draw()
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + (int(room) << 20),) * 2)
programs = []
try:
    while True:
        programs.append(make())
        assert len(programs) < 400
except (rhi.RhiError, MemoryError) as error:
    told = error.rule.id if isinstance(error, rhi.RhiError) else "MemoryError"
for each in programs:
    (each[0] if isinstance(each, tuple) else each).destroy()
programs.clear()
device.finish()
assert (draw() == wanted).all()
device.close()
print(told)
"""


KINDS = {"buffers": 400, "textures": 400, "writes": 400, "reads": 400, "records": 200, "shaders": 100}


@pytest.mark.parametrize("kind", KINDS)
def test_where_the_address_space_ends_a_creation_is_refused_and_the_device_goes_on(
    kind: str, tmp_path: Path
) -> None:
    command, cache = (
        [sys.executable, "-c", PROGRAM, "cl", kind, str(KINDS[kind])],
        {"RHI_CACHE": str(tmp_path)},
    )
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=300, env=os.environ | cache, encoding="utf-8"
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.strip() in ("device-out-of-memory", "MemoryError")
