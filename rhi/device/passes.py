"""Render passes: their targets, clears, and resolves.

A pass is a `with` block. Its targets are checked when it is created. It begins on entry and always ends on
exit, also after an exception.
"""

from __future__ import annotations

from collections.abc import Sequence
from sys import is_finalizing
from typing import Any, Final, TypeAlias, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from rhi.contract.descriptors import Attachment, DepthAttachment, PassDescriptor, Vec4
from rhi.contract.limits import pass_faults
from rhi.contract.texels import nearest
from rhi.device.core.core import NO_TARGETS, Core, describe_object, make_lost_pass_error
from rhi.device.core.scopes import Scope
from rhi.device.resources.programs import shader_kind
from rhi.device.resources.textures import Texture, TextureTarget
from rhi.errors import DeviceError, rules
from rhi.errors.arguments import ArgumentChecker

T = TypeVar("T")
RenderTarget: TypeAlias = Texture | TextureTarget
Color: TypeAlias = Sequence[float] | NDArray[Any]
Clear: TypeAlias = Color | Sequence[Color | None] | None

_CLEAR: Final = "4 finite numbers: red, green, blue, alpha"


class RenderPass(Scope):
    """A `with device.render_pass(...)` block."""

    __slots__ = (
        "_channels",
        "_core",
        "_descriptor",
        "_kinds",
        "_lost",
        "_resolves",
        "_textures",
        "_unblendable",
    )

    def __init__(
        self,
        core: Core,
        color: RenderTarget | Sequence[RenderTarget] | None,
        depth: RenderTarget | None,
        clear: Clear,
        clear_depth: float | None,
        clear_stencil: int | None,
        resolve: Texture | Sequence[Texture | None] | None,
        label: str,
    ) -> None:
        self._core = core
        self._lost = False  # whether another context was current at the end of the pass
        check = ArgumentChecker("device.render_pass", core.refuse)
        check.text("label", label)
        if clear_depth is not None:
            clear_depth = ArgumentChecker(check.call, core.refuse, rules.PASS_CLEAR).number(
                "clear_depth", clear_depth
            )
        if clear_stencil is not None:
            clear_stencil = ArgumentChecker(check.call, core.refuse, rules.PASS_CLEAR).integer(
                "clear_stencil", clear_stencil
            )
        colors = [_as_render_target(core, t) for t in _as_list(color)]
        resolves: list[Texture | None] = list(_as_list(resolve)) or [None] * len(colors)
        for texture in resolves:
            if texture is not None:
                check.instance("resolve", texture, Texture, "a Texture for each color target, or None")
        depth_target = None if depth is None else _as_render_target(core, depth)
        self._textures = [t.texture for t in colors] + ([depth_target.texture] if depth_target else [])
        self._resolves = [texture for texture in resolves if texture is not None]
        clears = _clear_values(core, clear, len(colors))
        core.check_open()
        first = colors[0] if colors else depth_target
        if first is None:
            core.refuse(rules.PASS_EMPTY, check.call, "no color and no depth", "a texture, or several")
        for texture in (*self._textures, *self._resolves):
            core.check_usable(texture, check.call)
        if len(resolves) != len(colors):
            given, allowed = f"{len(resolves)} resolve textures", f"{len(colors)}, one per color target"
            core.refuse(rules.PASS_TARGET, check.call, given, allowed)
        if depth_target is None:
            for name, value in (("clear_depth", clear_depth), ("clear_stencil", clear_stencil)):
                if value is not None:
                    core.refuse(
                        rules.PASS_CLEAR, check.call, f"{name}={value}", "None without a depth target"
                    )
        if clear_depth and clear_depth != 1.0 and depth_target is not None:  # every format holds 0 and 1
            form = depth_target.texture.format
            clear_depth = nearest(form, (clear_depth,))[0] if form.is_depth else clear_depth
        formats = [target.texture.format for target in colors]
        self._kinds = tuple(shader_kind(format) for format in formats)
        self._channels = tuple(format.channels for format in formats)
        unblendable = core.capabilities.unblendable_formats
        self._unblendable = tuple(i for i, f in enumerate(formats) if f in unblendable) if unblendable else ()
        self._descriptor = PassDescriptor(
            first.size,
            tuple(
                Attachment(
                    t.texture.id,
                    t.level,
                    t.attached_layer,
                    None if value is None else cast("Vec4", nearest(t.texture.format, value)),
                    r.id if r is not None else 0,
                )
                for t, value, r in zip(colors, clears, resolves, strict=True)
            ),
            None
            if depth_target is None
            else DepthAttachment(
                depth_target.texture.id,
                depth_target.level,
                depth_target.attached_layer,
                clear_depth,
                clear_stencil,
            ),
            first.texture.samples,
            label,
        )
        described = {texture.id: texture.requested for texture in (*self._textures, *self._resolves)}
        core.require(check.call, pass_faults(self._descriptor, described, core.capabilities))

    def __enter__(self) -> None:
        core = self._core
        core.check_ready()
        core.scopes.end_unreferenced()
        if core.render_pass is not None:
            core.refuse(rules.PASS_NESTED, "device.render_pass", "a second pass")
        for texture in (*self._textures, *self._resolves):
            core.check_usable(texture, "device.render_pass")
        core.program = None
        core.targets = frozenset(texture.id for texture in self._textures)
        core.target_kinds = self._kinds
        core.target_channels = self._channels
        core.unblendable_targets = self._unblendable
        core.render_pass = self._descriptor
        try:
            core.scopes.push(self)
            core.backend.begin_pass(self._descriptor)
        except BaseException:
            core.leave_pass()
            core.scopes.withdraw(self)
            raise

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        core = self._core
        core.check_thread("the end of a render pass")
        if core.closed or is_finalizing():  # Python ends and closes generators: drivers may be gone
            core.leave_pass()
            return
        try:
            self._lost = core.resume()
        except DeviceError:  # nothing can end it any more, and the device may be made current later
            core.leave_pass()
            core.open_query = None
            core.scopes.withdraw(self)
            raise
        query = core.open_query
        abandoned = query is not None and core.scopes.top is query
        if query is not None and abandoned:
            query.cut_off()
        core.scopes.leave(self, error)
        if abandoned and error is None:
            given, allowed = "an open occlusion query", "a query that ends in its pass"
            core.refuse(rules.QUERY_STATE, "the end of a render pass", given, allowed)

    def describe(self) -> str:
        """Return the scope's text in messages."""
        label = self._descriptor.label
        return f"render pass {label!r}" if label else "a render pass"

    def finish(self, failed: bool) -> None:
        """Pop the scope, the innermost one, and end the pass."""
        core = self._core
        scopes = core.scopes
        index = (
            scopes._index - 1
        )  # from here on nothing may be interrupted before `end_pass`, so it calls nothing
        scopes._data[index] = None
        scopes._index = index
        core.render_pass = None
        core.has_drawn = True
        core.targets = NO_TARGETS
        core.target_kinds = core.target_channels = core.unblendable_targets = ()
        core.program = None
        core.backend.end_pass()
        if self._lost and not failed:
            core.refusals.fail(make_lost_pass_error())


def _as_list(value: T | Sequence[T] | Sequence[T | None] | None) -> list[T | None]:
    if value is None:
        return []
    return list(value) if isinstance(value, (list, tuple)) else [cast("T", value)]


def _as_render_target(core: Core, value: object) -> TextureTarget:
    if isinstance(value, TextureTarget) and isinstance(value.texture, Texture):
        level, layer = value.texture._check(
            "device.render_pass", value.level, 0 if value.layer is None else value.layer, core
        )
        return TextureTarget(value.texture, level, None if value.layer is None else layer)
    if isinstance(value, Texture):
        layers = value.requested.layers
        if layers > 1:  # silently drawing to layer 0 would look like a lost draw in all others
            core.refuse(
                rules.PASS_TARGET,
                "device.render_pass",
                f"{describe_object(value)} with {layers} layers as target",
                "a texture with one layer, or one layer of it",
                "texture.at(layer=…) is one layer, texture.at(layer=None) all of them",
            )
        return TextureTarget(value)
    core.refuse(
        rules.PASS_TARGET,
        "device.render_pass",
        f"{describe_object(value)} as target",
        "a Texture or texture.at(level, layer)",
    )


def _clear_values(core: Core, clear: Clear, count: int) -> list[Vec4 | None]:
    """Return one clear value per target; `clear` is one value for all targets, one for each, or None."""
    if clear is None:
        return [None] * count
    call = "device.render_pass"
    check = ArgumentChecker(call, core.refuse, rules.PASS_CLEAR)
    if not (isinstance(clear, (list, tuple)) or (isinstance(clear, np.ndarray) and clear.ndim)):
        check.fail("clear", clear, _CLEAR)
    parts: list[Any] = list(clear)
    several = any(part is None or isinstance(part, (list, tuple, np.ndarray)) for part in parts)
    values = parts if several else [parts] * count
    if len(values) != count:
        core.refuse(
            rules.PASS_CLEAR, call, f"{len(values)} clear values", f"one, or {count}: one per color target"
        )
    return [None if part is None else check.color("clear", part) for part in values]
