"""Lists of what was left out: equal things are counted, and the first place is told."""

from __future__ import annotations

from renderer.scene import Omissions


def test_equal_omissions_are_counted_and_have_the_location_of_the_first() -> None:
    omissions = Omissions()
    omissions.add("a camera", "nodes[3]")
    omissions.add("a texture", "images[0]", 4)
    omissions.add("a camera", "nodes[7]")
    omissions.add("a texture", "images[9]", 2)
    assert [(omission.what, omission.count, omission.where) for omission in omissions] == [
        ("a camera", 2, "nodes[3]"),
        ("a texture", 6, "images[0]"),
    ]
    assert len(omissions) == 2
    assert list(map(str, omissions)) == ["a camera (nodes[3], 2 times)", "a texture (images[0], 6 times)"]


def test_an_omission_that_occurs_once_is_printed_without_a_count() -> None:
    omissions = Omissions()
    omissions.add("a camera", "nodes[3]")
    assert list(map(str, omissions)) == ["a camera (nodes[3])"]
