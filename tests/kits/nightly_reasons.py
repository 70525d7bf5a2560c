"""Why a case runs in the nightly job only: reasons for the mark `nightly_cases`.

    @pytest.mark.nightly_cases("cl*", reason=ONLY_KERNELS)

The patterns are those of `fnmatch`, and are compared with a test's parameters as its id shows them; without a
pattern all cases of the test are nightly. A test that never runs by default is marked `nightly` instead.
`tests/conftest.py` reads both marks.
"""

from __future__ import annotations

from typing import Final

ONLY_KERNELS: Final = """Compiles OpenCL kernels that no other test needs.

The default run shows on gl what the renderer asks of a device. What cl makes of it is shown by the conformance
kit, by tests/rhi/backends/cl, and by the images that every technique draws on cl (test_technique_pixels.py,
test_shadow_pixels.py, test_fog_and_bloom.py, test_scenes_agree.py, test_float64.py).
"""

COVERED_ON_GL: Final = """Draws walks with all visibility algorithms, or compiles kernels no other test needs.

The default run has these cases on gl. On cl it draws shorter walks (test_device_culling.py,
test_software_depth.py), random scenes (test_hard_cases.py) and images of odd sizes (test_culled_images.py).
"""

FEWER_CASES: Final = (
    """Repeats for another scene, size, material or projection what the default run shows with fewer."""
)

SAME_ON_EACH_BACKEND: Final = """Python's end is the same for all backends, and a recorder passes calls on: the
default run tries one of them."""

CHEAPER_TEST: Final = (
    """Starts processes, or runs the whole kit. A test beside it runs the same code with less."""
)
