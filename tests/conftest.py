"""For all tests: property tests take the same examples each time, and no clock judges them.

`pytest --hypothesis-profile exploring` takes new examples.
"""

from __future__ import annotations

from hypothesis import HealthCheck, settings

settings.register_profile(
    "repeatable",
    derandomize=True,
    deadline=None,
    # A busy machine is slow; devices are shared between examples, which leave them as they found them.
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)
settings.register_profile("exploring", settings.get_profile("repeatable"), derandomize=False)
settings.load_profile("repeatable")
