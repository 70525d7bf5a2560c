"""Values that are no numbers, or not finite, for each parameter of a call in turn.

`list_accepted` calls a function with each of them in place of a right number or array, and names those that
it takes. Whatever it raises but a rule's error is raised by `list_accepted`, too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from rhi import RhiError

NO_NUMBERS: Final[Mapping[str, Any]] = {
    "NaN": float("nan"),
    "NaN of NumPy": np.float32("nan"),
    "NaN without dimensions": np.array(np.nan),
    "an integer beyond floats": 10**400,
    "an integer beyond floats, negative": -(10**400),
    "a text": "1",
    "a complex number": 1j,
    "a list": [0.5],
    "an array": np.array([0.5]),
    "a masked element": np.ma.masked,
    "a date": np.datetime64("2020"),
    "a time span": np.timedelta64(1, "s"),
    "an object": object(),
    "bytes": b"1",
    "a set": {1.0},
    "a class": float,
}
"""What no parameter of a number takes."""
NO_WHOLE_NUMBERS: Final[Mapping[str, Any]] = {
    **NO_NUMBERS,
    "infinity": float("inf"),
    "a fraction": 1.5,
    "a whole float": 1.0,
    "2**31": 2**31,
    "-2**70": -(2**70),
    "True": True,
    "a flag of NumPy": np.bool_(True),
}


def hostile_arrays(good: Any) -> dict[str, Any]:
    """Return values that no parameter takes if it takes the array `good`, with its shape."""
    array = np.asarray(good, np.float64)
    first, last = array.copy(), array.copy()
    first.flat[0], last.flat[-1] = np.nan, np.inf
    return {
        "NaN": first,
        "NaN in lists": first.tolist(),
        "infinity": last,
        "too short": array[..., :-1],
        "too long": np.concatenate([array, array[..., :1]], -1),
        "texts": array.astype(str),
        "a text": "1",
        "None in an array": np.full(array.shape, None),
        "complex numbers": array + 1j,
        "masked elements": np.ma.masked_array(array, mask=True),
        "dates": np.full(array.shape, np.datetime64("2020-01-01")),
        "an axis more": array[None],
        "a set": set(array.ravel().tolist()),
        "a dict": dict.fromkeys(array.ravel().tolist()),
        "a generator": (number for number in array.ravel()),
        "nothing": [],
        "an object": object(),
    }


def list_accepted(call: Callable[..., object], good: Mapping[str, Any]) -> list[str]:
    """Return the hostile values that a call takes, as "parameter: value".

    Args:
        good: arguments of the call, each of them a float, an int, or an array or sequence of floats.
    """
    call(**good)
    accepted = []
    for parameter, value in good.items():
        if np.ndim(value):
            hostile: Mapping[str, Any] = hostile_arrays(value)
        else:
            hostile = NO_WHOLE_NUMBERS if isinstance(value, int) else NO_NUMBERS
        for name, wrong in hostile.items():
            try:
                call(**{**good, parameter: wrong})
            except RhiError:
                continue
            except Exception as error:
                error.add_note(f"{parameter}: {name}")
                raise
            accepted.append(f"{parameter}: {name}")
    return accepted
