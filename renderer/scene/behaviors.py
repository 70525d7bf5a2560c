"""Behaviours: functions that move nodes in steps of time, one entity's or a whole group's at once.

An entity is some nodes, a state that its function changes, and a number that no other entity ever has (Russell 2011,
8.5: numbers instead of references, which might outlive what they refer to).

- `Behaviors.update` takes steps of a fixed length up to the scene's time. So a state follows from the number of steps,
  not from how often frames are drawn.
- A function is called once a step, for all nodes of its entity. Many things that behave alike are one entity whose
  state has arrays: the cost in Python doesn't grow with their number.
- A message is read in the step after it was sent. So nobody depends on who is called first.
- Functions are found again by their names when a module is reloaded; states stay.
"""

from __future__ import annotations

import importlib
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import count
from types import ModuleType, SimpleNamespace
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from renderer import rules
from renderer.scene.arrays import Floats, Indices, read_ids
from renderer.scene.finite import check_time
from renderer.scene.scene import Scene
from rhi.errors import describe_value, refuse

MAX_STEPS: Final = 240
"""The most steps that an update takes, by default: after a longer pause, the rest of the time is left out."""

_LOGGER: Final = logging.getLogger("renderer.behaviors")


@dataclass(frozen=True, slots=True)
class Message:
    """A message to an entity.

    Attributes:
        name: of what has happened, or is to be done.
        sender: the number of the entity that sent it, or None.
        values: what else is said.
    """

    name: str
    sender: int | None
    values: dict[str, Any]


@dataclass(eq=False, slots=True)
class Entity:
    """Nodes, and what moves them.

    Attributes:
        number: that of no other entity, also after this one was removed.
        nodes: the indices (k,) of its nodes, which are dynamic.
        transforms: (k, 4, 4) float64, from the nodes to their parents. The function changes them in place.
        state: all else that the function needs, by name.
        messages: those that were sent since the step before.
        seconds: the time at which the present step ends.
    """

    number: int
    nodes: Indices
    transforms: Floats
    state: SimpleNamespace
    _behaviors: Behaviors
    _update: Update
    messages: tuple[Message, ...] = ()
    seconds: float = 0.0
    _inbox: list[Message] = field(default_factory=list)

    def send(self, number: int, name: str, **values: Any) -> None:
        """Send a message to another entity, or to this one.

        Raises:
            ValidationError `scene-unknown-entity`.
        """
        self._behaviors._post(number, Message(name, self.number, values))


Update = Callable[[Entity, float], None]
"""A behaviour: what an entity does in a step of so many seconds."""


class Behaviors:
    """The entities of a scene.

    Attributes:
        interval: the length of a step in seconds.
        max_steps: the most steps of an update.
        steps: the number of steps taken so far.
    """

    def __init__(self, scene: Scene, *, interval: float = 1.0 / 60.0, max_steps: int = MAX_STEPS) -> None:
        if not 0.0 < interval < np.inf:
            refuse(rules.BAD_BEHAVIOR, "Behaviors(interval=...)", interval, "seconds, above 0, finite")
        self.interval = float(interval)
        self.max_steps = rules.check_count(rules.BAD_BEHAVIOR, "Behaviors(max_steps=...)", max_steps)
        self.steps = 0
        self._scene = scene
        self._entities: dict[int, Entity] = {}
        self._numbers = count(1)
        self._reached = 0  # the step of the scene's time
        self._owner = np.zeros(len(scene.nodes), np.int64)  # by node: the number of its entity, 0 for none

    def __len__(self) -> int:
        return len(self._entities)

    def __iter__(self) -> Iterator[Entity]:
        """All entities, in the order of their numbers."""
        return iter(tuple(self._entities.values()))

    def __getitem__(self, number: int) -> Entity:
        """The entity of a number.

        Raises:
            ValidationError `scene-unknown-entity`.
        """
        entity = self._entities.get(number)
        if entity is None:
            refuse(rules.UNKNOWN_ENTITY, "Behaviors[number]", describe_value(number))
        return entity

    def __contains__(self, number: object) -> bool:
        return number in self._entities

    def add(self, update: Update, nodes: ArrayLike, **state: Any) -> int:
        """Add an entity; return its number.

        Args:
            update: called once a step with the entity and the step's length in seconds.
            nodes: the indices of dynamic nodes, of which no other entity has any.
            state: the first state, by name.

        Raises:
            ValidationError: `scene-bad-behavior`, `scene-bad-index`, `scene-static-node`.
        """
        if not callable(update):
            refuse(
                rules.BAD_BEHAVIOR,
                "Behaviors.add(update, …)",
                describe_value(update),
                "a function of an entity and a step",
            )
        scene_nodes, call = self._scene.nodes, "Behaviors.add(…, nodes)"
        indices = np.atleast_1d(read_ids(call, nodes, len(scene_nodes)))
        static = indices[~scene_nodes.dynamic[indices]]
        if len(static):
            refuse(rules.STATIC_NODE, call, f"node {static[0]} {scene_nodes.names[static[0]]!r}")
        if len(np.unique(indices)) < len(indices) or self._owner[indices].any():
            refuse(rules.BAD_BEHAVIOR, call, indices.tolist(), "nodes of one entity alone")
        number = next(self._numbers)
        entity = Entity(
            number, indices, scene_nodes.local[indices].copy(), SimpleNamespace(**state), self, update
        )
        entity.seconds = self._reached * self.interval
        self._entities[number] = entity
        self._owner[indices] = number
        return number

    def remove(self, number: int) -> None:
        """Remove an entity. Its nodes stay where they are; messages to it are refused from now on."""
        entity = self[number]
        del self._entities[number]
        self._owner[entity.nodes] = 0

    def send(self, number: int, name: str, **values: Any) -> None:
        """Send a message to an entity, which reads it in the next step.

        Raises:
            ValidationError `scene-unknown-entity`.
        """
        self._post(number, Message(name, None, values))

    def _post(self, number: int, message: Message) -> None:
        self[number]._inbox.append(message)

    def update(self, seconds: float) -> int:
        """Take the steps up to the scene's time `seconds`, and return their number. If the time goes back, no step is
        taken, and the next ones begin there.

        An error of a function ends the update. The entity's nodes stay as they were before that step; those of entities
        with smaller numbers have taken it, and the others haven't.
        """
        check_time("Behaviors.update", seconds)
        target = int(np.floor(seconds / self.interval + 1e-9))
        first = max(self._reached, target - self.max_steps)
        if first > self._reached:
            _LOGGER.warning(
                "%d steps are left out: an update takes %d", first - self._reached, self.max_steps
            )
        self._reached = min(first, target)
        taken = 0
        moved: dict[int, Entity] = {}
        try:
            while self._reached < target:
                self._reached += 1
                self.steps += 1
                taken += 1
                self._step(self._reached * self.interval, moved)
        finally:
            self._write(moved)
        return taken

    def _step(self, seconds: float, moved: dict[int, Entity]) -> None:
        """Call all functions for the step that ends at `seconds`; note the entities whose transforms have changed."""
        entities = tuple(self)
        for entity in entities:  # all first, so that an answer is read in the next step
            entity.messages, entity._inbox = tuple(entity._inbox), []
        for entity in entities:
            if entity.number not in self:
                continue
            before, entity.seconds = entity.transforms.copy(), seconds
            try:
                entity._update(entity, self.interval)
                entity.transforms = np.asarray(entity.transforms, np.float64)
                if entity.transforms.shape != before.shape or not np.isfinite(entity.transforms).all():
                    refuse(
                        rules.BAD_BEHAVIOR,
                        f"{_name(entity._update)}: transforms",
                        f"shape {entity.transforms.shape}",
                        f"{before.shape}, finite",
                    )
            except BaseException as error:
                entity.transforms = before
                error.add_note(f"in the behaviour of entity {entity.number}, {_name(entity._update)}")
                raise
            if not np.array_equal(before, entity.transforms):
                moved[entity.number] = entity

    def _write(self, moved: dict[int, Entity]) -> None:
        """Set the transforms of entities' nodes, all at once."""
        if moved:
            self._scene.nodes.set_local(
                np.concatenate([entity.nodes for entity in moved.values()]),
                np.concatenate([entity.transforms for entity in moved.values()]),
            )

    def reload(self, module: ModuleType) -> int:
        """Reload a module, and exchange its functions in all entities; return the number of entities. States,
        transforms and messages stay. A module that can't be loaded, or lacks a function that is used, changes nothing.

        Raises:
            ValidationError `scene-bad-behavior`: a function is missing, or it isn't at the top of the module.
        """
        users = [entity for entity in self if getattr(entity._update, "__module__", "") == module.__name__]
        names = [getattr(entity._update, "__qualname__", "") for entity in users]
        before = dict(vars(module))
        try:
            for name in names:  # or a module that lacks one would keep it
                vars(module).pop(name, None)
            reloaded = importlib.reload(module)
            functions = [self._read_function(reloaded, name) for name in names]
        except BaseException:
            vars(module).clear()
            vars(module).update(before)
            raise
        for entity, function in zip(users, functions, strict=True):
            entity._update = function
        return len(users)

    @staticmethod
    def _read_function(module: ModuleType, name: str) -> Update:
        function: Any = vars(module).get(name)
        if not callable(function):
            refuse(rules.BAD_BEHAVIOR, f"reload({module.__name__})", name, "a function at the module's top")
        update: Update = function
        return update


def _name(update: Update) -> str:
    return getattr(update, "__qualname__", repr(update))
