"""The memory of a process that drops thousands of resources of each kind (nightly)."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytestmark = [
    pytest.mark.nightly,
    pytest.mark.skipif(sys.platform != "linux", reason="reads resident memory from /proc"),
]

PROGRAM = """
import sys
import numpy as np
import rhi
from rhi.shading import Struct, vec4

class Tint(Struct):
    color: vec4

VERTICES = np.zeros(3000, np.dtype([("position", "f4", 3)]))

def record(device):
    with device.record() as commands:
        commands.clear(device.storage(float, 64))
    device.submit(commands)

MADE = {
    "texture": lambda device: device.texture((128, 128), rhi.Format.RGBA8),
    "buffer": lambda device: device.buffer(np.zeros(16384)),
    "uniform": lambda device: device.uniform(Tint(color=vec4(1.0))),
    "storage": lambda device: device.storage(float, 16384),
    "uniform array": lambda device: device.uniform_array(Tint, 256),
    "mesh": lambda device: device.mesh(VERTICES),
    "query": lambda device: device.occlusion_query(),
    "query set": lambda device: device.query_set(8),
    "read": lambda device: device.storage(float, 1024).read_async(),
    "command buffer": record,
}

def measure():
    return int(open("/proc/self/statm").read().split()[1]) * 4096 / 2**20

backend, keeps = sys.argv[1], sys.argv[2] == "keeps"
with rhi.create_device(backend, record=False) as device:
    for kind, make in MADE.items():
        if kind.startswith("query") and not device.capabilities.occlusion_queries:
            continue
        kept = []
        for _ in range(500):
            make(device)
        device.finish()
        before = measure()
        for _ in range(10_000):
            made = make(device)
            if keeps:
                kept.append(made)
        device.finish()
        print(f"{measure() - before:.1f} {kind}", flush=True)
        if keeps:
            break
"""


def measure_growth(backend: str, how: str) -> dict[str, float]:
    """Return how many MiB more a process has after 10,000 resources, by kind."""
    done = subprocess.run([sys.executable, "-c", PROGRAM, backend, how], capture_output=True, text=True, check=True)
    return {kind: float(growth) for growth, kind in (line.split(maxsplit=1) for line in done.stdout.splitlines())}


@pytest.mark.parametrize("backend", ["gl", "cl", "null"])
def test_ten_thousand_dropped_resources_of_a_kind_keep_less_than_20_mib(backend: str) -> None:
    grown = measure_growth(backend, "drops")
    assert len(grown) >= 8
    assert {kind: growth for kind, growth in grown.items() if growth > 20.0} == {}


def test_resources_that_are_held_are_seen_in_the_same_measure() -> None:
    assert measure_growth("null", "keeps")["texture"] > 20.0
