"""The generated draw: which bindings it sends again; `refusals` tests what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from null_kit import Camera, Kit, Object, hand_made_program

import rhi

Op = rhi.Op
BINDS = (Op.BIND_PROGRAM, Op.BIND_UNIFORM)


def test_a_second_draw_sends_only_the_binding_that_changed(kit: Kit) -> None:
    with kit.device.render_pass(kit.image):
        kit.device.draw(kit.program, kit.mesh, **kit.bindings)
        before = len(kit.device.stream)
        kit.device.draw(kit.program, kit.mesh, camera=kit.camera, object=kit.objects[1])
    sent = list(kit.device.stream)[before:]
    assert [c.op for c in sent] == [Op.BIND_UNIFORM, Op.DRAW, Op.END_PASS]
    assert (sent[0]["slot"], sent[0]["offset"]) == (1, kit.objects[1].offset)


def test_another_program_in_between_makes_everything_be_sent_again(kit: Kit) -> None:
    other = kit.device.program(hand_made_program("other"))
    arguments = {"camera": kit.camera, "object": kit.objects[0]}
    with kit.device.render_pass(kit.image):
        for program in (kit.program, other, kit.program):
            kit.device.draw(program, kit.mesh, **arguments)
    bound = [c["program"] for c in kit.ops(Op.BIND_PROGRAM)]
    assert bound == [kit.program.id, other.id, kit.program.id]
    assert len(kit.ops(Op.BIND_UNIFORM)) == 6


def test_a_new_pass_makes_everything_be_sent_again(kit: Kit) -> None:
    for _ in range(2):
        with kit.device.render_pass(kit.image):
            kit.device.draw(kit.program, kit.mesh, **kit.bindings)
    assert len(kit.ops(Op.BIND_UNIFORM)) == 4


def test_a_value_of_another_type_is_refused_with_the_call_that_creates_one(kit: Kit) -> None:
    for wrong in (
        np.eye(4),
        Object(offset=(0, 0, 0, 0)),
        1.0,
        "1234",
        b"0123456789abcdef",
        [0, 0, 0, 0],
        Camera,
    ):
        before = len(kit.device.stream)
        with kit.device.render_pass(kit.image):
            with pytest.raises(rhi.ValidationError) as caught:
                kit.device.draw(kit.program, kit.mesh, camera=wrong, object={"offset": (0, 0, 0, 0)})
        assert "Camera(…), or keep it in device.uniform(Camera(…))" in caught.value.tip
        sent = [command.op for command in list(kit.device.stream)[before:]]
        assert Op.WRITE_BUFFER not in sent  # nothing of the value that does fit was uploaded


def test_the_fields_of_a_value_are_checked_by_name(kit: Kit) -> None:
    for wrong, expected in (({"tnt": (0, 0, 0, 0)}, "tint"), ({"tint": (0, 0)}, "shape"), ({}, "no tint")):
        with kit.device.render_pass(kit.image), pytest.raises(rhi.ValidationError, match=expected) as caught:
            kit.device.draw(kit.program, kit.mesh, camera=wrong, object=kit.objects[0])
        assert caught.value.rule.id == "shading-struct-value"
        assert caught.value.site is not None
        assert caught.value.site.file == __file__


def test_a_value_is_one_upload_and_one_binding_of_its_bytes(kit: Kit) -> None:
    tint = Camera(tint=(1, 2, 3, 4))
    with kit.device.render_pass(kit.image):
        kit.device.draw(kit.program, kit.mesh, **kit.bindings)
        before = len(kit.device.stream)
        kit.device.draw(kit.program, kit.mesh, camera=tint, object=kit.objects[0])
        kit.device.draw(kit.program, kit.mesh, camera=tint, object=kit.objects[0])
        kit.device.draw(kit.program, kit.mesh, **kit.bindings)
    sent = [command for command in list(kit.device.stream)[before:] if command.op is not Op.CREATE_BUFFER]
    value_ops = [Op.WRITE_BUFFER, Op.BIND_UNIFORM, Op.DRAW]
    assert [command.op for command in sent] == [*value_ops, *value_ops, Op.BIND_UNIFORM, Op.DRAW, Op.END_PASS]
    assert bytes(sent[0]["data"]) == np.array([1, 2, 3, 4], "f4").tobytes()
    assert (sent[1]["buffer"], sent[1]["offset"]) == (sent[0]["buffer"], sent[0]["offset"])
    assert sent[3]["offset"] != sent[0]["offset"]  # the first draw may not have run yet


def test_a_missing_binding_is_refused_by_both_draws(kit: Kit) -> None:
    with kit.device.render_pass(kit.image):
        with pytest.raises(rhi.ValidationError) as by_device:
            kit.device.draw(kit.program, kit.mesh, camera=kit.camera)
        with pytest.raises(rhi.ValidationError) as by_program:
            kit.program.draw(kit.mesh, camera=kit.camera)
    assert by_device.value.rule.id == by_program.value.rule.id == "binding-missing"


def test_drawing_while_something_else_is_locked_works(kit: Kit) -> None:
    other = kit.device.buffer(16)
    with kit.device.render_pass(kit.image), other.lock(rhi.Access.WRITE):
        kit.device.draw(kit.program, kit.mesh, **kit.bindings)
    assert len(kit.ops(Op.DRAW)) == 1


@pytest.mark.parametrize("instances", [0, 2, np.int64(3), (1 << 31) - 1])
def test_a_number_of_instances_reaches_the_backend(kit: Kit, instances: int) -> None:
    with kit.device.render_pass(kit.image):
        kit.device.draw(kit.program, kit.mesh, instances, **kit.bindings)
    argument = kit.ops(Op.DRAW)[0]["instances"]
    assert argument == instances
    assert type(argument) is int


def test_the_same_class_gives_the_same_program(kit: Kit) -> None:
    descriptor = hand_made_program("once")
    assert kit.device.program(descriptor) is kit.device.program(descriptor)
