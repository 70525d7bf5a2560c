"""Compares encodings: the error of each on random values, and the time to encode and decode one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from renderer import rules
from renderer.lab.comparison import Record, Subject, compare, time
from renderer.lab.measure.encoding_errors import ROUND_TRIPS, Encoding, run_round_trip, time_round_trip
from rhi import Device, refuse


def compare_encodings(
    devices: Sequence[Device],
    encodings: Sequence[Encoding],
    *,
    count: int = 1 << 14,
    rounds: int = 5,
    progress: Callable[[range], Iterable[int]] = lambda rounds: rounds,
) -> list[Record]:
    """Measure each encoding with `count` random values of the kind that it stores, and return a row for each.

    A row has the encoding's `name`, what it `stores`, its `bits` and the `unit` of errors; `mean_error` and
    `max_error`, the larger ones of the devices'; and `nanoseconds` by backend: the median time to encode and
    decode a value, all lanes and cores taken together.

    Raises:
        ValidationError `measure-no-shaders`: a device runs no shaders.
    """
    for device in devices:
        if not device.capabilities.shading:
            refuse(rules.NO_SHADERS, "compare_encodings", device.backend_name)
    rows: dict[str, Record] = {}
    for device in devices:
        subjects = []
        for encoding in encodings:
            values = encoding.sample(np.random.default_rng(0), count)
            errors = encoding.measure(
                values, run_round_trip(device, encoding.shader, values, **encoding.uniforms)
            )
            row = rows.setdefault(
                encoding.name, {name: getattr(encoding, name) for name in ("name", "stores", "bits", "unit")}
            )
            row["mean_error"] = max(row.get("mean_error", 0.0), float(errors.mean()))
            row["max_error"] = max(row.get("max_error", 0.0), float(errors.max()))
            work = time_round_trip(device, encoding.shader, values, **encoding.uniforms)
            subjects.append(Subject({"name": encoding.name}, work, device=device))
        for timed_row in compare(
            subjects, {"time": time(1e9 / count / ROUND_TRIPS, 2)}, progress(range(rounds))
        ):
            rows[timed_row["name"]].setdefault("nanoseconds", {})[device.backend_name] = timed_row["time"]
    return list(rows.values())
