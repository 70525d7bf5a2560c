"""Tiles of the atlas."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from renderer.shadows.tiles import Tile, TileTree


def overlap(a: Tile, b: Tile) -> bool:
    return abs(2 * a.x + a.size - 2 * b.x - b.size) < a.size + b.size > abs(2 * a.y + a.size - 2 * b.y - b.size)


def test_tiles_from_large_to_small_fill_the_square_without_a_gap() -> None:
    tree = TileTree(16)
    sizes = [8, 8, 8, 4, 4, 4, *[2] * 3, *[1] * 4]
    assert None not in [tree.take(size) for size in sizes]
    assert tree.take(1) is None


def test_a_tile_that_is_larger_than_the_square_isnt_there() -> None:
    assert TileTree(4).take(8) is None


def test_a_square_of_one_texel_has_one_tile() -> None:
    tree = TileTree(1)
    assert tree.take(1) == Tile(0, 0, 1)
    assert tree.take(1) is None


@given(st.lists(st.tuples(st.sampled_from([1, 2, 4, 8]), st.booleans()), max_size=40))
def test_tiles_dont_overlap_and_what_is_given_back_is_there_again(steps: list[tuple[int, bool]]) -> None:
    tree, held = TileTree(16), list[Tile]()
    for size, gives_back in steps:
        if gives_back and held:
            tree.give_back(held.pop(0))
        else:
            tile = tree.take(size)
            if tile is not None:
                assert not any(overlap(tile, other) for other in held)
                assert 0 <= tile.x <= 16 - size >= tile.y >= 0
                held.append(tile)
    for tile in held:
        tree.give_back(tile)
    assert tree.take(16) == Tile(0, 0, 16)
