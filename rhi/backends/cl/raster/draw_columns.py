"""The row of a gathered draw: 64-bit words in columns.

- The first `FIXED_COLUMNS` columns describe the draw itself.
- In the list that rows are picked from (`bindings.Bindings.columns`), two columns for each binding slot
  follow: `SLOT_COLUMNS`. A program's rows hold only the columns of its own bindings
  (`pipelines.Pipeline.pick`).
"""

from __future__ import annotations

from typing import Final

from rhi.backends.cl.cl_capabilities import MAX_STORAGE_SLOTS
from rhi.contract.descriptors import BindingKind

PREPARED, INSTANCES, VIEW, SAMPLES, CONDITION, INVERTED = range(6)
"""Columns: the prepared draw's number; the number of instances, and in the upper half the draw's number in
its array; the view's number; the addresses of the samples counter and of the condition's counter; whether the
condition is inverted."""
FIXED_COLUMNS: Final = 6
COUNTER_BYTES: Final = 8

SLOT_COUNTS: Final = {
    BindingKind.UNIFORM: 12,
    BindingKind.STORAGE: MAX_STORAGE_SLOTS,
    BindingKind.TEXTURE: 16,
    BindingKind.IMAGE: 8,
}
_SLOTS: Final = [(kind, slot) for kind, count in SLOT_COUNTS.items() for slot in range(count)]
SLOT_COLUMNS: Final = {slot: FIXED_COLUMNS + 2 * index for index, slot in enumerate(_SLOTS)}
"""Column of each slot's first word, an address. The second is the size in bytes, or the address of the
description of a texture or image."""
COLUMN_COUNT: Final = FIXED_COLUMNS + 2 * len(_SLOTS)
