"""Allocation of square tiles in a square atlas: a quadtree whose free squares are listed by their size."""

from __future__ import annotations

from typing import NamedTuple


class Tile(NamedTuple):
    """A square of texels; `x` and `y` are those of its first texel."""

    x: int
    y: int
    size: int


class TileAllocator:
    """Allocates tiles whose sizes are powers of two.

    Tiles that are taken from the largest to the smallest fill the square without a gap. A tile that is given
    back is joined with its three neighbours if these are free, too.
    """

    def __init__(self, size: int) -> None:
        self.size = size
        self._free: dict[int, set[Tile]] = {size: {Tile(0, 0, size)}}

    def allocate(self, size: int) -> Tile | None:
        """Return a tile of `size`, or None if there is none left."""
        larger = size
        while not self._free.get(larger):
            larger *= 2
            if larger > self.size:
                return None
        tile = min(self._free[larger])
        self._free[larger].remove(tile)
        while tile.size > size:
            x, y, half = tile.x, tile.y, tile.size // 2
            self._free.setdefault(half, set()).update(
                {Tile(x + half, y, half), Tile(x, y + half, half), Tile(x + half, y + half, half)}
            )
            tile = Tile(x, y, half)
        return tile

    def free(self, tile: Tile) -> None:
        """Free a tile that was taken."""
        free = self._free.setdefault(tile.size, set())
        double = 2 * tile.size
        x, y = tile.x // double * double, tile.y // double * double
        four = {Tile(x + i * tile.size, y + j * tile.size, tile.size) for i in (0, 1) for j in (0, 1)}
        if tile.size < self.size and four - {tile} <= free:
            free -= four
            self.free(Tile(x, y, double))
        else:
            free.add(tile)
