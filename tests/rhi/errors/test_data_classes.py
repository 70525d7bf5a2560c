"""Data classes whose methods are generated on first use behave as those of the standard library."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import pickle
import sys
import threading
from collections.abc import Callable
from dataclasses import FrozenInstanceError, field
from typing import Any, ClassVar

import pytest

from rhi.errors import data_classes


def define(decorate: Callable[..., Any]) -> dict[str, Any]:
    """Return data classes of several kinds, decorated by a function."""

    @decorate(frozen=True, slots=True)
    class Point:
        """A point."""

        dimensions: ClassVar[int] = 2
        x: int
        y: int = 3

        def __post_init__(self) -> None:
            if self.y < 0:
                raise ValueError("y")

    @decorate(frozen=True, slots=True)
    class Labelled(Point):
        labels: list[str] = field(default_factory=list, compare=False)

    @decorate(frozen=True, slots=True, eq=False)
    class Same:
        value: float = 0.5

    @decorate(slots=True)
    class Changing:
        value: int = 0

        def __repr__(self) -> str:
            return f"changing {self.value}"

    for cls in (Point, Labelled, Same, Changing):
        cls.__qualname__ = cls.__name__
    return {"Point": Point, "Labelled": Labelled, "Same": Same, "Changing": Changing}


def attempt(action: Callable[[], object]) -> object:
    """Return the result of an action, or its error as text."""
    try:
        return action()
    except Exception as error:
        return type(error), str(error)


USES: dict[str, Callable[[dict[str, Any]], object]] = {
    "repr": lambda classes: repr(classes["Labelled"](1, labels=["a"])),
    "own repr": lambda classes: repr(classes["Changing"](4)),
    "equality": lambda classes: (
        classes["Point"](1) == classes["Point"](1, 3),
        classes["Point"](1) == classes["Point"](2),
    ),
    "equality by identity": lambda classes: classes["Same"]() == classes["Same"](),
    "hash": lambda classes: hash(classes["Point"](1)) == hash((1, 3)),
    "no hash": lambda classes: attempt(lambda: hash(classes["Changing"]())),
    "too few arguments": lambda classes: attempt(classes["Point"])[0],  # type: ignore[index]
    "post init": lambda classes: attempt(lambda: classes["Point"](1, -1)),
    "assignment": lambda classes: attempt(lambda: setattr(classes["Point"](1), "x", 2)),
    "deletion": lambda classes: attempt(lambda: delattr(classes["Point"](1), "x")),
    "assignment of what changes": lambda classes: attempt(
        lambda: setattr(classes["Changing"](1), "value", 2)
    ),
    "another attribute": lambda classes: attempt(lambda: setattr(classes["Changing"](1), "other", 2))[0],  # type: ignore[index]
    "fields": lambda classes: [f.name for f in dataclasses.fields(classes["Labelled"])],
    "is_dataclass": lambda classes: dataclasses.is_dataclass(classes["Same"]),
    "replace": lambda classes: repr(dataclasses.replace(classes["Point"](1), x=7)),
    "asdict": lambda classes: dataclasses.asdict(classes["Labelled"](1)),
    "match": lambda classes: classes["Labelled"].__match_args__,
    "signature": lambda classes: str(inspect.signature(classes["Labelled"])),
    "slots": lambda classes: classes["Labelled"].__slots__,
    "class variable": lambda classes: classes["Point"].dimensions,
    "docstring": lambda classes: classes["Point"].__doc__,
    "copy": lambda classes: copy.deepcopy(classes["Labelled"](2, labels=["b"])).labels,
    "match statement": lambda classes: match_point(classes["Point"], classes["Point"](5, 6)),
}


def match_point(cls: Any, value: object) -> object:
    match value:
        case cls(x, y):
            return x, y
    return None


@pytest.mark.parametrize("name", USES)
def test_each_use_agrees_with_the_standard_library(name: str) -> None:
    expected = USES[name](define(dataclasses.dataclass))
    assert USES[name](define(data_classes.dataclass)) == expected


@pytest.mark.parametrize(
    "use", [hash, repr, lambda point: point == point, lambda point: point.__getstate__()]
)
def test_an_instance_made_without_init_has_all_methods(use: Callable[[Any], object]) -> None:
    points = [define(decorate)["Point"] for decorate in (dataclasses.dataclass, data_classes.dataclass)]
    results = []
    for cls in points:
        point = cls.__new__(cls)
        object.__setattr__(point, "x", 1)
        object.__setattr__(point, "y", 2)
        results.append(use(point))
    assert results[0] == results[1]


def test_a_frozen_instance_is_pickled(monkeypatch: pytest.MonkeyPatch) -> None:
    point = define(data_classes.dataclass)["Point"]
    monkeypatch.setattr(sys.modules[__name__], "Point", point, raising=False)
    copied = pickle.loads(pickle.dumps(point(3, 4)))
    assert (copied.x, copied.y) == (3, 4)
    with pytest.raises(FrozenInstanceError):
        copied.x = 5


def test_methods_are_generated_on_first_use_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    generated: list[str] = []
    real = dataclasses.dataclass

    def note(cls: type, **options: Any) -> type:
        generated.append(cls.__name__)
        processed: type = real(cls, **options)
        return processed

    monkeypatch.setattr(dataclasses, "dataclass", note)
    classes = define(data_classes.dataclass)
    assert generated == []
    classes["Labelled"](1)
    assert sorted(generated) == ["Labelled", "Point"]
    classes["Labelled"](2)
    assert len(generated) == 2


def test_an_interrupted_generation_is_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    real = dataclasses.dataclass

    def interrupt(cls: type, **options: Any) -> type:
        real(cls, **options)
        raise KeyboardInterrupt

    labelled = define(data_classes.dataclass)["Labelled"]
    with monkeypatch.context() as patch:
        patch.setattr(dataclasses, "dataclass", interrupt)
        with pytest.raises(KeyboardInterrupt):
            labelled(1)
    first, second = labelled(1), labelled(2)
    assert (first.x, second.x, first.labels) == (1, 2, [])
    assert first.labels is not second.labels


def test_threads_may_use_a_class_first_at_the_same_time() -> None:
    for _ in range(20):
        point = define(data_classes.dataclass)["Point"]
        barrier = threading.Barrier(4)
        results: list[bool] = []

        def make(
            point: Any = point, barrier: threading.Barrier = barrier, results: list[Any] = results
        ) -> None:
            barrier.wait()
            results.append(point(1) == point(1))

        threads = [threading.Thread(target=make) for _ in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert results == [True] * 4
