"""Named tuples whose annotations stay texts."""

from __future__ import annotations

import pickle
import typing
from typing import Any

import pytest

from rhi.errors.named_tuples import NamedTuple


class Light(NamedTuple):
    """A pair."""

    name: str
    power: float = 2.0

    @property
    def doubled(self) -> float:
        """Twice the power."""
        return 2.0 * self.power


class Standard(typing.NamedTuple):
    """A pair."""

    name: str
    power: float = 2.0

    @property
    def doubled(self) -> float:
        """Twice the power."""
        return 2.0 * self.power


@pytest.mark.parametrize(
    "read",
    [
        lambda cls: cls("a"),
        lambda cls: cls("a", power=3.0).doubled,
        lambda cls: cls._fields,
        lambda cls: cls._field_defaults,
        lambda cls: cls.__doc__,
        lambda cls: typing.get_type_hints(cls),
        lambda cls: cls("a")._replace(power=1.0) == ("a", 1.0),
        lambda cls: cls.__module__,
        lambda cls: issubclass(cls, tuple),
    ],
)
def test_a_named_tuple_behaves_as_one_of_typing(read: Any) -> None:
    assert read(Light) == read(Standard)


def test_a_named_tuple_is_pickled_by_its_name() -> None:
    assert pickle.loads(pickle.dumps(Light("a"))) == Light("a")
    assert repr(Light("a")) == "Light(name='a', power=2.0)"
    assert Light.__qualname__ == "Light"


def test_an_unknown_field_is_refused() -> None:
    with pytest.raises(TypeError):
        Light("a", strength=1.0)  # type: ignore[call-arg]
