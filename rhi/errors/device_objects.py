"""Objects that stand for something of a device: a copy would stand for the same, and end its life twice."""

from __future__ import annotations

import copy
import pickle
from typing import Any, ClassVar, SupportsIndex

from rhi.errors import describe_value, refuse
from rhi.errors.call_sites import MARK
from rhi.errors.rules import DEVICE_COPY

for _module in (copy, pickle):  # their frames stand between the user's line and what is copied
    vars(_module)[MARK] = True


class DeviceObject:
    """Base class of objects that can't be copied or pickled; neither can what refers to them, by `deepcopy`
    or `pickle`."""

    __slots__ = ()
    _copy_tip: ClassVar[str] = ""
    """What to do instead; the rule's tip by default."""

    def __reduce_ex__(self, protocol: SupportsIndex) -> Any:
        """Refuse `copy.copy`, `copy.deepcopy` and `pickle`.

        Raises:
            ValidationError: `device-copy`.
        """
        refuse(
            DEVICE_COPY,
            f"a copy or pickle of a {type(self).__name__}",
            describe_value(self),
            "",
            self._copy_tip,
        )
