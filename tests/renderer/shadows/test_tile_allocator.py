"""Tiles of the atlas."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from renderer.shadows.tile_allocator import Tile, TileAllocator


def overlap(a: Tile, b: Tile) -> bool:
    return (
        abs(2 * a.x + a.size - 2 * b.x - b.size) < a.size + b.size > abs(2 * a.y + a.size - 2 * b.y - b.size)
    )


def test_tiles_from_large_to_small_fill_the_square_without_a_gap() -> None:
    tree = TileAllocator(16)
    sizes = [8, 8, 8, 4, 4, 4, *[2] * 3, *[1] * 4]
    assert None not in [tree.allocate(size) for size in sizes]
    assert tree.allocate(1) is None


def test_a_tile_that_is_larger_than_the_square_isnt_there() -> None:
    assert TileAllocator(4).allocate(8) is None


def test_a_square_of_one_texel_has_one_tile() -> None:
    tree = TileAllocator(1)
    assert tree.allocate(1) == Tile(0, 0, 1)
    assert tree.allocate(1) is None


@given(st.lists(st.tuples(st.sampled_from([1, 2, 4, 8]), st.booleans()), max_size=40))
def test_tiles_do_not_overlap_and_freed_tiles_are_allocated_again(steps: list[tuple[int, bool]]) -> None:
    tree, taken = TileAllocator(16), list[Tile]()
    for size, gives_back in steps:
        if gives_back and taken:
            tree.free(taken.pop(0))
        else:
            tile = tree.allocate(size)
            if tile is not None:
                assert not any(overlap(tile, other) for other in taken)
                assert 0 <= tile.x <= 16 - size >= tile.y >= 0
                taken.append(tile)
    for tile in taken:
        tree.free(tile)
    assert tree.allocate(16) == Tile(0, 0, 16)
