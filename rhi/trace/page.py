"""`make_page`: a page that replays a trace in a browser, with a slider over its commands.

The trace is replayed here on a recorder (`rhi.backends.webgpu.call_recorder`), which writes down the calls of
WebGPU. The page makes the same calls on its own device: it needs neither Python nor anything from elsewhere.
After each command it shows the target of the latest pass, or what was presented.
"""

from __future__ import annotations

import base64
import html
import json
from pathlib import Path
from typing import Any, Final

import numpy as np

from rhi.backends.webgpu.call_recorder import FEATURES, RecordingBackend
from rhi.commands.context import StreamContext
from rhi.commands.ops import Op
from rhi.commands.stream import CommandStream
from rhi.contract.descriptors import (
    Attachment,
    DepthAttachment,
    PassDescriptor,
    TextureDescriptor,
    TextureKind,
)
from rhi.device.device import Device
from rhi.errors import DeviceError, refuse
from rhi.trace.file import Trace, as_trace
from rhi.trace.replay import Player
from rhi.trace.rules import TRACE_PAGE, TRACE_TRUST
from rhi.trace.validation import check_capabilities

_TEMPLATE: Final = Path(__file__).with_name("replay_page.html")


def make_page(source: Trace | Device | CommandStream, title: str = "trace") -> str:
    """Return a page, as HTML, that replays a trace in a browser.

    The page runs nothing before its reader presses Replay.

    Raises:
        ValidationError: `trace-capability` if the trace needs a capability that not every WebGPU has,
            `trace-incomplete` for a stream without its beginning, `trace-trust` for a file with shaders that
            isn't trusted.
        DeviceError: `trace-page` for commands that depend on what a device must read back first, such as
            indirect draws of fans.
    """
    trace = as_trace(source)
    if not trace.trusted and trace.stream.filter(Op.CREATE_PROGRAM):
        call = "rhi.trace.page.make_page"
        refuse(TRACE_TRUST, call, f"{trace.file!r}, loaded without trusted=True")
    backend = _TraceRecorder()
    check_capabilities(trace.stream, backend.capabilities)
    device = Device(backend)
    steps: list[_Step] = []
    player = Player(
        trace.stream,
        device,
        checks_indirect=False,
        after_command=lambda index, context: steps.append(
            _Step(backend, index, context, player.result.ids, trace.stream)
        ),
    )
    try:
        player.play()
    except DeviceError as error:
        text = str(error.given or error).splitlines()[0]
        call, index = "rhi.trace.page.make_page", len(steps)
        command = str(trace.stream[index]) if index < len(trace.stream) else ""
        raise DeviceError(TRACE_PAGE, call, f"command {index}, {command}: {text}") from error
    recorder = backend.recorder
    visible: dict[str, Any] | None = None
    commands = []
    for step in steps:
        visible = step.visible or visible
        commands.append([step.text, step.line, step.calls, visible])
    data = {
        "calls": recorder.calls,
        "blobs": [base64.b64encode(blob).decode("ascii") for blob in recorder.blobs],
        "commands": commands,
        "backend": trace.backend,
        "features": sorted(FEATURES),
    }
    text = json.dumps(data, separators=(",", ":")).replace("<", "\\u003c")  # no data ends the script
    template = _TEMPLATE.read_text(encoding="utf-8")
    return template.replace("TITLE", html.escape(title)).replace("DATA", text)


class _TraceRecorder(RecordingBackend):
    """A recorder for which reads of a trace return nothing, since a replay doesn't use them."""

    def __init__(self) -> None:
        super().__init__()
        self.read_buffer = lambda *_: b""
        self.read_texture = lambda *_: np.zeros((1, 1, 1, 1), np.uint8)
        self.read_query = lambda *_: None

    def wait(self, value: int, seconds: float) -> bool:
        """Return True: a page waits for nothing."""
        return True


class _Step:
    """The state after a command.

    Attributes:
        text, line: the command, and the line that sent it.
        calls: the number of calls of WebGPU up to here.
        visible: the texture to show and the members of its view, if the command has changed it.
    """

    def __init__(
        self,
        backend: _TraceRecorder,
        index: int,
        context: StreamContext,
        ids: dict[int, int],
        stream: CommandStream,
    ) -> None:
        command = stream[index]
        site = command.site
        self.line = str(site) if site is not None else ""
        self.text = str(command).removesuffix(f"  {site}")
        if command.op is Op.BEGIN_PASS:
            backend.settle()
        self.visible = self._select_view(backend, command.op, command.arguments, context, ids)
        self.calls = len(backend.recorder.calls)

    def _select_view(
        self,
        backend: _TraceRecorder,
        op: Op,
        arguments: dict[str, Any],
        context: StreamContext,
        ids: dict[int, int],
    ) -> dict[str, Any] | None:
        if op is Op.PRESENT and arguments["texture"]:
            return _describe_view(backend, context, ids, arguments["texture"], 0, 0)
        render_pass = context.render_pass
        if op is not Op.BEGIN_PASS or not isinstance(render_pass, PassDescriptor):
            return None
        targets: list[Attachment | DepthAttachment] = [*render_pass.colors]
        if render_pass.depth is not None:
            targets.append(render_pass.depth)
        if not targets:
            return None
        target = targets[0]
        return _describe_view(backend, context, ids, target.texture, target.level, target.layer)


def _describe_view(
    backend: _TraceRecorder, context: StreamContext, ids: dict[int, int], texture: int, level: int, layer: int
) -> dict[str, Any] | None:
    descriptor = context.resources.get(texture)
    if not isinstance(descriptor, TextureDescriptor) or descriptor.kind is TextureKind.D3:
        return None
    number, members = backend.locate_view(ids[texture], level, max(layer, 0))
    return {"texture": number, "view": members}


__all__ = ["make_page"]
