"""Draws that are to be finished before llvmpipe itself reads textures.

llvmpipe draws on threads of its own. What is not a fragment runs elsewhere, at once: reads and copies of textures,
work groups, vertex stages. Before these, llvmpipe asks whether a texture is in use by a pass that isn't finished.
It takes the first pass that uses it: if that one samples the texture, and a later one draws it, the draw isn't waited
for, and the old texels are read (Mesa 22.3, `docs/backends-gl.md`). So the backend waits for all draws there. Other
drivers keep the order that GL asks for, so nothing is waited for.
"""

from __future__ import annotations

from rhi.backends.gl.entry_points import EntryPoints

__rhi_internal__ = True


class UnfinishedDraws:
    """Whether passes, resolves or mip levels have been drawn since all draws were last waited for."""

    __slots__ = ("_draws", "_gl", "_keeps_order")

    def __init__(self, gl: EntryPoints, keeps_order: bool) -> None:
        """`keeps_order`: whether the driver itself waits for the draws of a texture that it reads."""
        self._gl = gl
        self._keeps_order = keeps_order
        self._draws = False

    def add(self) -> None:
        """Note that textures have been drawn."""
        self._draws = not self._keeps_order

    def finish(self) -> None:
        """Wait until all textures are drawn, if the driver may not."""
        if self._draws:
            self._gl.Finish()
            self._draws = False
