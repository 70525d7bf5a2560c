"""The core of a device, shared by its resources: backend, ids, timeline, states, counters, current bindings.

Users hold a `Device`. Resources, programs, queries and rings hold its `Core`, so that none of them depends on
the device.
"""

from __future__ import annotations

import itertools
import sys
import threading
import time
import weakref
from collections.abc import Callable, Iterable, Sequence
from threading import get_ident
from typing import Any, ClassVar, Final, NoReturn, Protocol, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from rhi.contract.backend import (
    Backend,
    SupportsClippedDraws,
    SupportsCurrentContext,
    SupportsOrderedWrites,
    SupportsPreparedDraws,
    SupportsRecordedDraws,
    SupportsTextureSharing,
)
from rhi.contract.descriptors import Id, PassDescriptor, Primitive, SamplerDescriptor
from rhi.contract.interrupts import DeferredInterrupts
from rhi.contract.limits import Fault, sampler_faults
from rhi.contract.queries import list_draws
from rhi.contract.states import AlphaTest, Scissor, StateChange
from rhi.device.core.readback_pool import ReadbackPool
from rhi.device.core.refusals import RefusalLog
from rhi.device.core.ring import Ring
from rhi.device.core.scopes import Scope
from rhi.device.core.state_cache import StateCache, StateVector
from rhi.device.core.timeline import Timeline
from rhi.errors import DeviceError, Rule, rules
from rhi.errors.call_sites import find_call_site
from rhi.errors.data_classes import dataclass
from rhi.errors.device_objects import DeviceObject

D = TypeVar("D")
NO_THREAD: Final = 0
"""The `Core.thread` of a device that belongs to no thread."""
FORKED: Final = -1
"""The `Core.thread` of a device in a process that was forked after the device's creation."""
ENDING: Final = -2
"""The `Core.thread` of a daemon thread's device while the process ends: the thread's next call doesn't
return."""
NO_TARGETS: Final[frozenset[Id]] = frozenset()
MAX_SAMPLERS: Final = 4096
"""Largest number of different samplers of a device. They live as long as the device, and platforms have
few."""


@dataclass(slots=True)
class Statistics:
    """Counters since creation or the last reset.

    `draws` counts draw calls (an indirect call or a `draw_many` is one), `creations` resources,
    `recorded_commands` the commands of command buffers, at their first submission. The state counters are
    those of the thesis's tables (7.1).
    """

    draws: int = 0
    dispatches: int = 0
    queries: int = 0
    upload_bytes: int = 0
    creations: int = 0
    software_state_changes: int = 0
    hardware_state_changes: int = 0
    recorded_commands: int = 0


class Owner(Protocol):
    """The resource behind a binding, as the checks see it."""

    @property
    def core(self) -> Core: ...
    @property
    def destroyed(self) -> bool: ...
    @property
    def label(self) -> str: ...


class FrameMemory(Protocol):
    """Memory that frames allocate from."""

    def mark(self, fence: int) -> None:
        """End the frame: its allocations are free once `fence` has passed."""


class Creation:
    """A `with` block that creates resources for the user: all of them, or none.

    If it raises, or an interrupt came meanwhile (`DeferredInterrupts`), everything that it has created is
    destroyed, since the caller never receives it. A block inside another is a part of it.
    """

    __slots__ = ("_core", "_deferred", "_outer")

    def __init__(self, core: Core) -> None:
        self._core = core
        self._deferred = DeferredInterrupts()
        self._outer = True

    def __enter__(self) -> None:
        self._deferred.__enter__()
        if self._core.created is None:
            self._outer = False
            self._core.created = []

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        core = self._core
        created: list[Id] = []
        if not self._outer:
            created, core.created = core.created or [], None
        try:
            if kind is not None:
                core.take_back(created)
        finally:
            try:
                self._deferred.__exit__(kind, error, trace)
            except BaseException:
                if kind is None:
                    core.take_back(created)
                raise


class Core(DeviceObject):
    """The shared part of one device.

    A device belongs to one thread. Whatever reaches the backend is checked by `check_ready`, except for what
    happens thousands of times a frame (draws, states, queries, transient memory): `check_command` checks
    that, as fast as it can, and everything if the device validates.

    Attributes:
        thread: the thread that the device belongs to, or `NO_THREAD`.
        refusals: raises and keeps the errors of refused calls.
        program: the `Program` whose bindings are in place, None when the next draw must check everything.
        render_pass: the open pass, if any.
        scopes: the stack of open scopes.
        open_query: the scope of the open occlusion query, if any.
        condition_open: whether a condition on a query is open.
        condition_count: number of conditions begun so far.
        targets: ids of the open pass's textures.
        readbacks: the memory of asynchronous reads.
        target_kinds: "float", "int" or "uint" per color target of the open pass.
        target_channels: the number of channels of each.
        unblendable_targets: the indices of those that draws can't blend with.
        tests_alpha: whether the alpha test is on, so that prepared draws can't be used.
        draw_counters: by program's id, a function that returns its number of draws since the last call.
        has_drawn: whether a pass has ended since `draw_counters` were added to `draws`.
        locked: resources with an open lock; while there are any, every draw checks everything.
        lock_blocks: weak references to the blocks of those locks.
        created: ids of the resources that the open `creation` block has created so far.
    """

    __slots__ = (
        "_clips",
        "_context",
        "_ids",
        "_notes_sites",
        "_prepares",
        "_samplers",
        "backend",
        "capabilities",
        "closed",
        "condition_count",
        "condition_open",
        "counters",
        "created",
        "dispatches",
        "draw_counters",
        "draws",
        "frame_rings",
        "has_drawn",
        "lock_blocks",
        "locked",
        "open_query",
        "program",
        "readbacks",
        "refusals",
        "render_pass",
        "sampler_descriptors",
        "scopes",
        "states",
        "target_channels",
        "target_kinds",
        "targets",
        "tests_alpha",
        "thread",
        "timeline",
        "unblendable_targets",
        "upload_bytes",
    )

    records: ClassVar[bool] = False
    """Whether this is the core of a command buffer. Nothing else may use its transient memory."""
    validates: ClassVar[bool] = False
    """Whether each command runs all checks, and not only the free ones (`ValidatingCore`)."""

    def __init__(self, backend: Backend, states: StateCache, refusals: RefusalLog) -> None:
        self.backend = backend
        self.capabilities = backend.capabilities
        self.refusals = refusals
        self.timeline = Timeline(backend, refusals)
        self.states = states
        self.scopes = states.scopes
        if self.validates:
            states.validator = self
        self.counters = Statistics()
        self.draws = 0
        self.has_drawn = False
        self.dispatches = 0
        self.upload_bytes = 0
        self.closed = False
        self.created: list[Id] | None = None
        self.thread = get_ident()
        self._context = cast("SupportsCurrentContext | None", find_optional_part(backend, "release_current"))
        self.program: object | None = None
        self.render_pass: PassDescriptor | None = None
        self.open_query: Scope | None = None
        self.condition_open = False
        self.condition_count = 0
        self.targets = NO_TARGETS
        self.target_kinds: tuple[str, ...] = ()
        self.target_channels: tuple[int, ...] = ()
        self.unblendable_targets: tuple[int, ...] = ()
        self.locked: list[Owner] = []
        self.lock_blocks: list[weakref.ref[object]] = []
        self.draw_counters: dict[Id, Callable[[], int]] = {}
        self.frame_rings: list[FrameMemory] = []
        self.readbacks = ReadbackPool(backend, self.timeline, self.new_id)
        self.tests_alpha = False
        self._clips = cast("SupportsClippedDraws", backend) if hasattr(backend, "draw_clipped") else None
        self._prepares: SupportsPreparedDraws | None = None
        if hasattr(backend, "prepare_draw"):
            self._prepares = cast("SupportsPreparedDraws", backend)
            self._prepares.on_interruption(self.forget_program)
        self._notes_sites = self.validates or sys.flags.dev_mode  # lines of creation
        self._ids = itertools.count(1)  # its next() is atomic, also with several threads
        self._samplers: dict[SamplerDescriptor, Id] = {}
        self.sampler_descriptors: dict[Id, SamplerDescriptor] = {}

    def refuse(
        self, rule: Rule, call: str, given: object = "", allowed: object = "", tip: str = ""
    ) -> NoReturn:
        """Raise a `ValidationError` for `rule` at the user's line; a recording device keeps it."""
        self.refusals.refuse(rule, call, given, allowed, tip)

    def require(self, call: str, faults: Iterable[Fault]) -> None:
        """Refuse a call with the first of its faults, if it has any."""
        for fault in faults:
            self.refuse(fault.rule, call, *fault[1:])

    def new_id(self) -> Id:
        """Return the next resource id; ids are never reused."""
        return next(self._ids)

    def create_id(self) -> Id:
        """Return the id of a new resource of the user, and count the creation."""
        self.check_ready()
        self.timeline.make_room()
        self.counters.creations += 1
        return self.new_id()

    def creation(self) -> Creation:
        """Return a block that creates all of its resources or none; see `Creation`."""
        return Creation(self)

    def create(self, make: Callable[[Id, D], object], resource: Id, descriptor: D, size: int = 0) -> None:
        """Create a resource of `size` bytes on the backend, inside a `creation` block or
        `DeferredInterrupts`.

        If memory is exhausted while destroyed resources wait for their fence, they are destroyed first, and
        creation is tried once more.
        """
        try:
            make(resource, descriptor)
        except DeviceError as error:
            if error.rule is not rules.DEVICE_MEMORY or not self.timeline.reclaim():
                raise
            make(resource, descriptor)
        timeline = self.timeline
        timeline.living[resource] = size
        if size:  # a buffer or a texture; as `MemoryLedger.add`, without its call
            memory = timeline.memory
            memory.entries[resource] = descriptor, size
            memory.total = total = memory.total + size
            if total > memory.peak:
                memory.peak = total
        if self._notes_sites and (site := find_call_site()) is not None:
            timeline.sites[resource] = site
        if self.created is not None:
            self.created.append(resource)

    def take_back(self, resources: list[Id]) -> None:
        """Destroy resources that the user never received, the latest first."""
        for resource in reversed(resources):
            if resource in self.timeline.living:
                self.draw_counters.pop(resource, None)
                self.timeline.retire(resource)

    def check_open(self) -> None:
        """Refuse calls of a closed device."""
        if self.closed:
            if self.thread == ENDING:
                block_forever()
            self.refuse(rules.DEVICE_CLOSED, "device", "a closed device")

    check_command = check_open
    """Refuse a command that happens thousands of times a frame. With validation it is `check_ready`."""

    def check_ready(self) -> None:
        """Refuse calls of a closed device and calls on other threads; make the platform's context current.

        Raises:
            DeviceError: `device-context` if it was lost inside a render pass, whose draws went elsewhere.
        """
        if self.closed or get_ident() != self.thread:
            self.check_open()
            self.check_thread()
        context = self._context
        if context is not None and context.resume():
            self.program = None
            if self.render_pass is not None:
                self.refusals.fail(make_lost_pass_error())

    def check_thread(self, call: str = "device") -> None:
        """Refuse calls on any thread but the device's own. A closed device has none."""
        if get_ident() != self.thread and not self.closed:
            if self.thread == FORKED:
                self.refuse(
                    rules.DEVICE_FORKED,
                    call,
                    "a device of the process that was forked",
                    "devices of this process",
                )
            allowed = (
                describe_thread(self.thread) if self.thread != NO_THREAD else "none before make_current()"
            )
            self.refuse(rules.DEVICE_THREAD, call, f"a call on {describe_thread(get_ident())}", allowed)

    def resume(self) -> bool:
        """Make the platform's context current again; return whether another one was current."""
        if self._context is None or not self._context.resume():
            return False
        self.program = None
        return True

    def check_scope(self) -> None:
        """Check the begin of a scope that may surround passes or lie in one, where the pass's own checks are
        enough."""
        if self.render_pass is None:
            self.check_ready()
        else:
            self.check_command()

    def resume_scope(self) -> None:
        """Make the platform's context current for the end of such a scope; in a pass, its end does so."""
        if self.render_pass is None:
            self.resume()

    def make_current(self) -> None:
        """Make the device usable on this thread, which it belongs to from now on."""
        if self.thread != NO_THREAD:
            self.check_thread("device.make_current")
        if self._context is not None:
            self._context.make_current()
        self.thread = get_ident()
        self.program = None

    def release_current(self) -> None:
        """Detach the device from its thread, which is the calling one."""
        if self._context is not None:
            self._context.release_current()
        self.thread = NO_THREAD

    def hand_back(self) -> None:
        """End a frame for the code that shares textures with the platform's context, and make that code's
        context current."""
        if self._context is not None:
            self._context.hand_back()

    def require_texture_sharing(self, call: str) -> SupportsTextureSharing:
        """Return the backend, typed for texture sharing; refuse a backend that doesn't share textures."""
        self.check_ready()
        if not self.capabilities.shares_textures:
            given = f"a {self.capabilities.backend} device that stands alone"
            tip = 'create it beside a context: rhi.create_device("gl", context=…)'
            self.refuse(rules.DEVICE_CAPABILITY, call, given, "needs capabilities.shares_textures", tip)
        return cast("SupportsTextureSharing", find_optional_part(self.backend, "adopting_texture"))

    def check_usable(self, owner: Owner, call: str) -> None:
        """Refuse a resource that is destroyed, locked, or of another device."""
        if owner.core is not self:
            self.refuse(
                rules.RECORD_TRANSIENT if owner.core.records else rules.RESOURCE_FOREIGN,
                call,
                describe_object(owner),
            )
        if owner.destroyed:
            self.refuse(rules.RESOURCE_DESTROYED, call, describe_object(owner))
        if self.locked and self.is_locked(owner):
            self.refuse(rules.LOCK_OPEN, call, f"{describe_object(owner)}, which has an open lock")

    def has_open_pass(self) -> bool:
        """True if a pass is open. First ends a pass whose block was left without its `__exit__`."""
        if self.render_pass is not None:
            self.scopes.end_unreferenced()
        return self.render_pass is not None

    def leave_pass(self) -> None:
        """Note that no pass is open."""
        self.render_pass = None
        self.has_drawn = True
        self.targets = NO_TARGETS
        self.target_kinds = self.target_channels = self.unblendable_targets = ()
        self.program = None

    def lock(self, owner: Owner, block: object) -> None:
        """Note that a resource is locked by a `with` block."""
        with DeferredInterrupts():
            self.lock_blocks.append(weakref.ref(block))
            self.locked.append(owner)

    def unlock(self, block: object = None) -> None:
        """Release a block's resource, and the resources of blocks that were left without their `__exit__`."""
        with DeferredInterrupts():
            for index in reversed(range(len(self.locked))):
                if self.lock_blocks[index]() in (block, None):
                    del self.lock_blocks[index], self.locked[index]

    def is_locked(self, owner: Owner) -> bool:
        """True if a resource has an open lock."""
        if owner in self.locked:
            self.unlock()
        return owner in self.locked

    def prepare_recorded_draws(
        self, commands: Sequence[tuple[str, tuple[Any, ...]]]
    ) -> Sequence[tuple[int, int, Callable[[], bool]]]:
        """Return the parts of recorded commands that the backend executes together; see `SupportsRecordedDraws`."""
        if not hasattr(self.backend, "prepare_recorded_draws"):
            return ()
        return cast("SupportsRecordedDraws", self.backend).prepare_recorded_draws(commands)

    def forget_program(self) -> None:
        """Invalidate the current program: its bindings are no longer in place."""
        self.program = None

    def flush_states(self) -> None:
        """Send changed states to the backend, if any."""
        states = self.states
        if states.requested is states.hardware:
            return
        try:
            self.backend.set_states(states.flush())
        except BaseException:  # the backend has applied an unknown part of them
            self.program = None  # it may lack a variant for these states
            self.tests_alpha = True
            states.lose_hardware()
            raise
        if self._prepares is not None:
            self.tests_alpha = self.states.hardware[AlphaTest] is AlphaTest.ON

    def send_states(self, vector: StateVector) -> None:
        """Send the changes that lead from the hardware's states to a state vector of any cache."""
        try:
            states = self.states
            if vector.values != states.hardware.values and (changes := states.change_to(vector)):
                self.backend.set_states(changes)
        except BaseException:
            self.states.lose_hardware()
            raise

    def draw_clipped(
        self, vertex_array: Id, primitive: Primitive, draws: NDArray[Any], clips: NDArray[np.int64]
    ) -> None:
        """Draw each of `draws` (n,) inside one of the rectangles `clips` (n, 4), with the bindings in place.
        The hardware's states are then as before."""
        states = self.states
        try:
            if self._clips is not None and primitive is not Primitive.QUADS:
                self._clips.draw_clipped(vertex_array, primitive, draws, clips)
            else:
                backend = self.backend
                for clip, arguments in zip(clips.tolist(), list_draws(draws), strict=True):
                    backend.set_states((StateChange(Scissor, Scissor(*clip)),))
                    backend.draw(vertex_array, primitive, *arguments)
                backend.set_states((StateChange(Scissor, states.hardware[Scissor]),))
        except BaseException:
            states.lose_hardware()
            raise
        states.hardware_changes += len(draws) + 1

    def adopt_states(self, values: tuple[object, ...]) -> None:
        """Record state values that were sent to the backend without the cache."""
        if values != self.states.hardware.values:
            self.states.adopt(values)
        if self._prepares is not None:
            self.tests_alpha = self.states.hardware[AlphaTest] is AlphaTest.ON

    def prepare_draw(
        self,
        program: Id,
        vertex_array: Id,
        primitive: Primitive,
        first: int,
        count: int,
        base_vertex: int,
        base_instance: int,
    ) -> Callable[[int], object]:
        """Return a draw as a function of its number of instances, prepared by the backend where it can."""
        if self._prepares is not None:
            return self._prepares.prepare_draw(
                program, vertex_array, primitive, first, count, base_vertex, base_instance
            )
        draw = self.backend.draw
        return lambda instances: draw(
            vertex_array, primitive, first, count, instances, base_vertex, base_instance
        )

    def prepare_uniform(self, buffer: Id) -> Callable[[int, int, int], object]:
        """Return a function of slot, offset and size that binds a range of a buffer."""
        if self._prepares is not None:
            return self._prepares.prepare_uniform(buffer)
        bind = self.backend.bind_uniform
        return lambda slot, offset, size: bind(slot, buffer, offset, size)

    @property
    def orders_writes(self) -> bool:
        """True if the backend is one of `SupportsOrderedWrites`."""
        return hasattr(self.backend, "prepare_uniform_write")

    def prepare_uniform_write(self, buffer: Id) -> Callable[[int, int, bytes], object]:
        """Return a function of slot, offset and data that writes to a STREAM buffer, and binds what it has written."""
        return cast("SupportsOrderedWrites", self.backend).prepare_uniform_write(buffer)

    def sampler(self, descriptor: SamplerDescriptor) -> Id:
        """Return the id of a sampler; equal descriptors share one.

        Raises:
            ValidationError: `device-capability` for more anisotropy than the device supports, for a border
                that it lacks, and for more than `MAX_SAMPLERS` different samplers.
        """
        sampler = self._samplers.get(descriptor)
        if sampler is None:
            self.require("device.sampler", sampler_faults(descriptor, self.capabilities))
            self.check_ready()
            if len(self._samplers) >= MAX_SAMPLERS:
                more = f"one more sampler, {descriptor}"
                self.refuse(
                    rules.DEVICE_CAPABILITY, "device.sampler", more, f"up to {MAX_SAMPLERS} different ones"
                )
            with DeferredInterrupts():  # it belongs to the device, not to whoever asks first
                sampler = self.new_id()
                self.backend.create_sampler(sampler, descriptor)
                self._samplers[descriptor] = sampler
                self.sampler_descriptors[sampler] = descriptor
        return sampler

    def signal(self) -> int:
        """Signal the fence and destroy retired resources that the GPU no longer uses."""
        value = self.timeline.signal()
        self.timeline.collect()
        return value

    def end_frame(self) -> int:
        """Signal the fence; memory that the rings allocated in this frame is free once the GPU has passed
        it."""
        value = self.timeline.signal()
        for ring in self.frame_rings:
            if not isinstance(ring, Ring) or ring._head != ring._tail or ring._outgrown:
                ring.mark(value)
        if self.timeline._retired:
            self.timeline.collect()
        return value

    def statistics(self) -> Statistics:
        """Return a snapshot of the counters."""
        if self.has_drawn or self.render_pass is not None:  # seldom in frames of command buffers alone
            self.has_drawn = False
            for collect in self.draw_counters.values():
                self.draws += collect()
        counters, states = self.counters, self.states
        return Statistics(  # `dataclasses.replace` takes five times as long
            self.draws,
            self.dispatches,
            counters.queries,
            self.upload_bytes,
            counters.creations,
            states.software_changes,
            states.hardware_changes,
            counters.recorded_commands,
        )

    def reset_statistics(self) -> None:
        self.counters = Statistics()
        for collect in self.draw_counters.values():
            collect()
        self.draws = 0
        self.dispatches = 0
        self.upload_bytes = 0
        self.timeline.memory.peak = self.timeline.memory.total
        self.states.reset_counters()


class ValidatingCore(Core):
    """The core of a device with validation: each command checks its thread, and that its context is
    current."""

    __slots__ = ()

    validates = True
    check_command = Core.check_ready


def find_optional_part(backend: Backend, method: str) -> object | None:
    """Find the backend, behind any recorder, that has a method of an optional part of the contract; None if
    it lacks it."""
    inner: object = backend
    while inner is not None and not hasattr(inner, method):
        inner = getattr(inner, "backend", None)
    return inner


def make_lost_pass_error() -> DeviceError:
    """Return the error of a render pass during which other code made another context current."""
    given = "another context, made current by other code inside a render pass; draws since then are lost"
    return DeviceError(rules.DEVICE_CONTEXT, "device.render_pass", given)


def block_forever() -> None:
    """Wait for the end of the process."""
    while True:
        time.sleep(3600.0)


def describe_thread(identity: int) -> str:
    """Return a thread's text for an error message."""
    names = (thread.name for thread in threading.enumerate() if thread.ident == identity)
    name = next(names, None)
    return f"thread {name!r}" if name is not None else "a thread that has ended"


def describe_object(owner: object) -> str:
    """Return an object's text for an error message: its class and, if it has one, its label."""
    label = getattr(owner, "label", "")
    return f"{type(owner).__name__}({label!r})" if label else f"a {type(owner).__name__}"
