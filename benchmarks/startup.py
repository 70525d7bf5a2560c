"""The time that `import rhi` takes in a new process.

Each run is a new interpreter, and the interpreter's own start isn't counted. `import numpy` is timed for comparison,
because `import rhi` includes it.

    python benchmarks/startup.py [--json] [--runs 15]
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys

IMPORTS = {
    "numpy": "import numpy",
    "rhi": "import rhi",
    "rhi.shading": "from rhi.shading import Shader, vec4",
}


def time_import(statement: str) -> float:
    """Return the seconds that a statement takes in a new interpreter, without the interpreter's start."""
    code = f"import time; start = time.perf_counter(); {statement}; print(time.perf_counter() - start)"
    return float(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print the figures as JSON")
    parser.add_argument("--runs", type=int, default=15, help="runs of each import (default: %(default)s)")
    options = parser.parse_args()
    times: dict[str, list[float]] = {name: [] for name in IMPORTS}
    for _ in range(options.runs):
        for name, statement in IMPORTS.items():
            times[name].append(time_import(statement))
    medians = {name: {"milliseconds": statistics.median(values) * 1e3} for name, values in times.items()}
    if options.json:
        print(json.dumps(medians, indent=2))
    else:
        for name, row in medians.items():
            print(f"import {name:<12} {row['milliseconds']:7.1f} ms")


if __name__ == "__main__":
    main()
