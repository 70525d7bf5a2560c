"""Fault injection: a backend in front of the null backend that fails like real devices, at selected calls.

- A `Faults` says what fails, and when. `Faults.from_seed` chooses one fault for a program from a clean run of
  it.
- A creation or compilation that fails never reaches the backend behind, as the contract requires. A lost
  device stays lost: every further call except `close` fails.
- Counts start at 0 and follow the order of the calls.
"""

from __future__ import annotations

import random
from collections import Counter
from types import CodeType
from typing import Any

from rhi.commands.ops import CREATIONS, Op
from rhi.commands.recorder import ForwardingBackend, forward
from rhi.commands.stream import CommandStream
from rhi.contract.backend import Backend
from rhi.contract.descriptors import Id, ProgramDescriptor, QueryKind
from rhi.errors import DeviceError, ShaderError
from rhi.errors.data_classes import dataclass
from rhi.errors.rules import DEVICE_LOST, DEVICE_MEMORY, SHADER_DRIVER

FRAME_SECONDS = 1 / 60
"""Seconds that a wait takes for each frame by which a fence is late."""


@dataclass(frozen=True, slots=True)
class Faults:
    """The faults to inject. With None and 0 nothing fails.

    Attributes:
        memory: the number of the creation (of any resource) that runs out of memory: `device-out-of-memory`.
        compilation: the number of the program that the driver rejects: `shader-driver`.
        loss: the number of the command at which the device is lost: `device-lost`.
        late_frames: how many frames (`present` calls) after its signal the fence appears to be reached.
        silent_query: the number of the query, in order of creation, that never answers.
    """

    memory: int | None = None
    compilation: int | None = None
    loss: int | None = None
    late_frames: int = 0
    silent_query: int | None = None

    @classmethod
    def from_seed(cls, seed: int, stream: CommandStream) -> Faults:
        """Choose one fault in the program whose clean run is `stream`. Equal seeds give equal faults."""
        ops = Counter(command.op for command in stream)
        creations = sum(ops[op] for op in CREATIONS)
        generator = random.Random(seed)
        counts = {
            "memory": creations,
            "compilation": ops[Op.CREATE_PROGRAM],
            "loss": len(stream),
            "silent_query": ops[Op.CREATE_QUERY],
        }
        kinds = [kind for kind, count in counts.items() if count] + ["late_frames"] * bool(ops[Op.PRESENT])
        if not kinds:
            return cls()
        kind = generator.choice(kinds)
        if kind == "late_frames":
            return cls(late_frames=generator.randint(1, 4))
        return cls(**{kind: generator.randrange(counts[kind])})


class FaultInjector(ForwardingBackend):
    """A backend that forwards calls to another, and injects its `faults`."""

    METHOD = """\
    self._enter({op})
    return self.backend.{method}({arguments})
"""

    def __init__(self, backend: Backend, faults: Faults) -> None:
        super().__init__(backend)
        self.faults = faults
        self._commands = 0
        self._creations = 0
        self._programs = 0
        self._queries = 0
        self._lost = False
        self._presented = 0
        self._signalled: dict[
            int, int
        ] = {}  # by fence value not yet seen, the number of frames presented before
        self._observed = 0
        self._silent: Id = 0

    def forward(self, op: Op, arguments: tuple[Any, ...], code: CodeType | None, offset: int) -> None:
        """Forward a command of a command buffer with its call site. It is none of the commands that this
        class defines."""
        self._enter(op)
        forward(self.backend, op, arguments, code, offset)

    # -- faults ------------------------------------------------------------------------------------------

    def _enter(self, op: int) -> None:
        """Count a command, and fail if a fault is due."""
        name = Op(op).method
        number, self._commands = self._commands, self._commands + 1
        self._lost = self._lost or number == self.faults.loss
        self._check_lost(name)
        if op in CREATIONS:
            creation, self._creations = self._creations, self._creations + 1
            if creation == self.faults.memory:
                raise DeviceError(DEVICE_MEMORY, name, f"creation {creation}, an injected fault")

    def _check_lost(self, call: str) -> None:
        if self._lost:
            raise DeviceError(DEVICE_LOST, call, f"lost at command {self.faults.loss}, an injected fault")

    def create_program(self, program: Id, descriptor: ProgramDescriptor) -> None:
        self._enter(Op.CREATE_PROGRAM)
        number, self._programs = self._programs, self._programs + 1
        if number == self.faults.compilation:
            given = f"program {number} ({descriptor.name}), an injected fault"
            raise ShaderError(SHADER_DRIVER, f"device.program({descriptor.name})", given)
        self.backend.create_program(program, descriptor)

    def create_query(self, query: Id, kind: QueryKind) -> None:
        self._enter(Op.CREATE_QUERY)
        number, self._queries = self._queries, self._queries + 1
        if number == self.faults.silent_query:
            self._silent = query
        self.backend.create_query(query, kind)

    def read_query(self, query: Id) -> int | None:
        self._check_lost("read_query")
        answer = self.backend.read_query(query)
        return None if query == self._silent else answer

    def present(self, texture: Id) -> None:
        self._enter(Op.PRESENT)
        self.backend.present(texture)
        self._presented += 1

    def signal(self, value: int) -> None:
        self._enter(Op.SIGNAL)
        self.backend.signal(value)
        self._signalled[value] = self._presented

    def completed(self) -> int:
        self._check_lost("completed")
        reached = self.backend.completed()
        for value in sorted(self._signalled):
            if value > reached or self._signalled[value] + self.faults.late_frames > self._presented:
                break
            self._observe(value)
        return self._observed

    def wait(self, value: int, seconds: float) -> bool:
        self._enter(Op.WAIT)
        missing = self._signalled.get(value, 0) + self.faults.late_frames - self._presented
        if value > self._observed and missing * FRAME_SECONDS > seconds:
            return False
        reached = self.backend.wait(value, seconds)
        if reached:
            self._observe(value)
        return reached

    def _observe(self, value: int) -> None:
        self._observed = max(self._observed, value)
        for signal in [signal for signal in self._signalled if signal <= value]:
            del self._signalled[signal]
