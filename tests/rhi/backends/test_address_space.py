"""A process whose address space ends (`ulimit -v`): creations are refused, nothing aborts, and the device goes on."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(sys.platform != "linux", reason="the limit is set and measured as on Linux"),
]

PROGRAM = """
import resource, sys
import numpy as np
import rhi
from rhi.conformance.shaders import FlatColored
from rhi.conformance.shapes import rectangle

backend, kind = sys.argv[1:]
device = rhi.create_device(backend)
image, mesh, program = device.texture((16, 16), rhi.Format.RGBA8), device.mesh(rectangle()), device.program(FlatColored)

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
        made = device.texture((2048, 2048), rhi.Format.RGBA8)
        made.write(np.zeros((2048, 2048, 4), np.uint8))
        return made
    made = device.texture((1024, 1024), rhi.Format.RGBA32F)
    return made, made.read()

wanted = draw()
used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + (400 << 20),) * 2)
made = []
try:
    while True:
        made.append(make())
        assert len(made) < 400
except (rhi.RhiError, MemoryError) as error:
    told = error.rule.id if isinstance(error, rhi.RhiError) else "MemoryError"
for each in made:
    (each[0] if isinstance(each, tuple) else each).destroy()
made.clear()
device.finish()
assert (draw() == wanted).all()
device.close()
print(told)
"""


@pytest.mark.parametrize("kind", ["buffers", "textures", "writes", "reads"])
def test_where_the_address_space_ends_a_creation_is_refused_and_the_device_goes_on(kind: str) -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM, "cl", kind], capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.strip() in ("device-out-of-memory", "MemoryError")
