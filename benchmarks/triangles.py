"""How exact triangles are: coverage, depth and varyings of random triangles against float64.

Run `python benchmarks/triangles.py`; `--triangles 1000000` takes some minutes. The families are those of
`rhi.conformance.triangles`, drawn in the whole view and, where they are cut, in the middle of a viewport of 16,384
texels. For each family: the triangles, the texels drawn, the texels that are wrong (farther than 1/256 texel from every
edge and cut), and the worst errors: of depth against float64 and beyond the corners' depths, of weights likewise.
"""

from __future__ import annotations

import argparse

import numpy as np

import rhi
from rhi.conformance.triangles import BATCH, CELL, CUT, WHOLE, Judgement, examine


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--backend", default="cl", help="default: %(default)s")
    parser.add_argument("--triangles", type=int, default=100_000, help="number of triangles (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="first seed (default: %(default)s)")
    given = parser.parse_args()
    cases = [(family, float(CELL)) for family in (*CUT, *WHOLE)] + [(family, 16384.0) for family in CUT]
    batches = -(-given.triangles // (BATCH * len(cases)))
    print(f"{'family':<24} {'viewport':>8} {'triangles':>9} {'texels':>10} {'wrong':>5} "
          f"{'depth':>8} {'beyond':>8} {'weight':>8} {'beyond':>8}")  # fmt: skip
    with rhi.create_device(given.backend) as device:
        for family, wide in cases:
            results: list[Judgement] = [examine(device, family, given.seed + number, wide) for number in range(batches)]
            worst = [
                max(getattr(result, name) for result in results)
                for name in ("depth_error", "depth_beyond", "weight_error", "weight_beyond")
            ]
            wrong = sum(int(np.sum(result.wrong)) for result in results)
            print(f"{family.__name__:<24} {wide:>8.0f} {batches * BATCH:>9} {sum(r.drawn for r in results):>10} "
                  f"{wrong:>5} " + " ".join(f"{error:>8.1e}" for error in worst), flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
