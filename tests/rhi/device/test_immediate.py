"""Immediate mode and transient memory, as the backend sees them."""

from __future__ import annotations

import numpy as np
import pytest
from null_kit import Kit, Object, hand_made_program

import rhi
from rhi import Op, Primitive
from rhi.backends.null import NullBackend
from rhi.errors.rules import DEVICE_MEMORY


def test_immediate_vertices_become_one_upload_and_one_draw(kit: Kit) -> None:
    with kit.device.render_pass(kit.image):
        before = len(kit.device.stream)
        with kit.device.immediate(kit.program, Primitive.TRIANGLES, **kit.bindings) as triangles:
            for x, y in ((0, 0), (1, 0), (0, 1)):
                triangles.vertex(position=(x, y))
        sent = list(kit.device.stream)[before:]
    assert sum(c.op is Op.WRITE_BUFFER for c in sent) == 1
    (draw,) = (c for c in sent if c.op is Op.DRAW)
    assert (draw["count"], draw["primitive"]) == (3, Primitive.TRIANGLES)


def test_arrays_and_single_vertices_keep_their_order(kit: Kit) -> None:
    rows = np.array([((1, 1),), ((2, 2),)], [("position", "<f4", (2,))])
    with kit.device.render_pass(kit.image):
        with kit.device.immediate(kit.program, Primitive.POINTS, **kit.bindings) as points:
            points.vertex(position=(0, 0))
            points.vertices(rows)
            points.vertex(position=(3, 3))
    written = kit.ops(Op.WRITE_BUFFER)[-1]["data"]
    assert np.frombuffer(written, "<f4").reshape(-1, 2)[:, 0].tolist() == [0, 1, 2, 3]


def test_an_array_is_drawn_as_it_was_at_the_call(kit: Kit) -> None:
    rows = np.array([((1, 1),)], [("position", "<f4", (2,))])
    with kit.device.render_pass(kit.image):
        with kit.device.immediate(kit.program, Primitive.POINTS, **kit.bindings) as points:
            points.vertices(rows)
            rows["position"] = 7
            points.vertices(rows)
    written = kit.ops(Op.WRITE_BUFFER)[-1]["data"]
    assert np.frombuffer(written, "<f4").reshape(-1, 2)[:, 0].tolist() == [1, 7]


@pytest.mark.parametrize("bad", [np.nan, "left"], ids=["not a number", "text"])
def test_a_vertex_that_was_refused_with_an_array_is_refused_at_the_end_too(kit: Kit, bad: object) -> None:
    """The array after it is refused and the vertex is kept, so that nothing is drawn without it."""
    rows = np.zeros(1, [("position", "<f4", (2,))])
    with (
        kit.device.render_pass(kit.image),
        pytest.raises(rhi.ValidationError, match=r"^\[immediate-vertex\]"),
    ):
        with kit.device.immediate(kit.program, Primitive.POINTS, **kit.bindings) as points:
            points.vertex(position=(bad, 0))
            with pytest.raises(rhi.ValidationError):
                points.vertices(rows)
    assert not kit.ops(Op.DRAW)


def test_an_array_that_is_refused_leaves_the_vertices_before_it(kit: Kit) -> None:
    rows = np.full(1, np.nan, [("position", "<f4", (2,))])
    with kit.device.render_pass(kit.image):
        with kit.device.immediate(kit.program, Primitive.POINTS, **kit.bindings) as points:
            points.vertex(position=(5, 0))
            with pytest.raises(rhi.ValidationError):
                points.vertices(rows)
    (draw,) = kit.ops(Op.DRAW)
    assert draw["count"] == 1


def test_a_vertex_array_that_could_not_be_made_is_made_at_the_next_try(
    kit: Kit, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = np.zeros(3, [("position", "f4", 2)])

    def fail(*arguments: object) -> None:
        raise rhi.DeviceError(DEVICE_MEMORY, "create_vertex_array")

    with monkeypatch.context() as patch:
        patch.setattr(kit.device.backend_as(NullBackend), "create_vertex_array", fail)
        with pytest.raises(rhi.DeviceError):
            kit.device.transient.mesh(kit.program, rows)
    mesh = kit.device.transient.mesh(kit.program, rows)
    with kit.device.render_pass(kit.image):
        kit.device.draw(kit.program, mesh, **kit.bindings)
    (draw,) = kit.ops(Op.DRAW)
    assert draw.resource(draw["vertex_array"]) is not None


def test_blocks_share_one_vertex_array_until_the_ring_grows(kit: Kit) -> None:
    def draw(count: int) -> None:
        with kit.device.immediate(kit.program, Primitive.POINTS, **kit.bindings) as points:
            points.vertices(np.zeros(count, [("position", "<f4", (2,))]))

    with kit.device.render_pass(kit.image):
        draw(10)
        draw(10)
        assert len({c["vertex_array"] for c in kit.ops(Op.DRAW)}) == 1
        draw(100_000)
    draws = kit.ops(Op.DRAW)
    assert len({c["vertex_array"] for c in draws}) == 2
    assert [c["first"] for c in draws[:2]] == [0, 10]


def test_vertex_arrays_of_instances_live_for_a_frame(kit: Kit) -> None:
    """Each begins where its instances lie; those of meshes without instances are shared by all frames."""
    rows, shifts = np.zeros(3, [("position", "<f4", 2)]), np.zeros(4, [("position", "<f4", 2)])
    for _ in range(5):
        kit.device.transient.mesh(kit.program, rows)
        for _ in range(3):
            kit.device.transient.mesh(kit.program, 3, instances=shifts)
        kit.device.present()
    kit.device.finish()
    created = [c["vertex_array"] for c in kit.ops(Op.CREATE_VERTEX_ARRAY)]
    gone = [c["resource"] for c in kit.ops(Op.DESTROY)]
    assert len(created) == 1 + 5 * 3
    assert set(created) - set(gone) == {created[0]}


def test_vertex_arrays_of_programs_that_are_gone_do_not_stay(
    kit: Kit, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rhi.device.transient.MAX_LAYOUTS", 10)
    rows = np.zeros(3, [("position", "<f4", (2,))])
    for number in range(50):
        program = kit.device.program(hand_made_program(f"program {number}"))
        kit.device.transient.mesh(program, rows)
        program.destroy()
        kit.device.present()
    kit.device.finish()
    assert len(kit.ops(Op.CREATE_VERTEX_ARRAY)) == 50
    gone = {c["resource"] for c in kit.ops(Op.DESTROY)}
    assert sum(c["vertex_array"] not in gone for c in kit.ops(Op.CREATE_VERTEX_ARRAY)) <= 11


def test_transient_constants_are_bound_anew_when_their_ring_has_grown(kit: Kit) -> None:
    memory = kit.device.transient
    with kit.device.render_pass(kit.image):
        for _ in range(600):
            kit.device.draw(
                kit.program, kit.mesh, camera=kit.camera, object=memory.uniform(Object(offset=(0, 0, 0, 0)))
            )
    slots = [(c["buffer"], c["offset"]) for c in kit.ops(Op.BIND_UNIFORM) if c["slot"] == 1]
    assert len(slots) == len(set(slots)) == 600


def test_draw_many_sends_its_array_as_one_indirect_draw(kit: Kit) -> None:
    with kit.device.render_pass(kit.image):
        kit.device.draw_many(kit.program, kit.mesh, kit.mesh.draws(np.zeros(5, int), 3), **kit.bindings)
    (draw,) = kit.ops(Op.DRAW_INDIRECT)
    assert (draw["draws"], draw["stride"]) == (5, 20)


def test_draw_many_again_sends_its_arguments_alone(kit: Kit) -> None:
    with kit.device.render_pass(kit.image):
        for _ in range(2):
            before = len(kit.device.stream)
            kit.device.draw_many(kit.program, kit.mesh, kit.mesh.draws([0], 3), **kit.bindings)
    sent = list(kit.device.stream)[before:]
    assert [c.op for c in sent if c.op is not rhi.Op.WRITE_BUFFER] == [rhi.Op.DRAW_INDIRECT, rhi.Op.END_PASS]


@pytest.mark.parametrize("name", ["objects", "camera", "mesh", "program"])
def test_a_repeated_draw_many_refuses_resources_destroyed_since(kit: Kit, name: str) -> None:
    draws, arguments = kit.mesh.draws([0], 3), kit.bindings
    with kit.device.render_pass(kit.image):
        kit.device.draw_many(kit.program, kit.mesh, draws, **arguments)
        getattr(kit, name).destroy()
        with pytest.raises(rhi.ValidationError, match=r"^\[resource-destroyed\]"):
            kit.device.draw_many(kit.program, kit.mesh, draws, **arguments)


def test_a_transient_mesh_serves_the_program_it_was_made_for(kit: Kit) -> None:
    rows = np.zeros(3, [("position", "f4", 2)])
    other = kit.device.program(hand_made_program("other"))
    mesh = kit.device.transient.mesh(kit.program, rows)
    with kit.device.render_pass(kit.image):
        with pytest.raises(rhi.ValidationError, match=r"^\[mesh-attribute\]"):
            kit.device.draw(other, mesh, **kit.bindings)
        kit.device.draw(kit.program, mesh, **kit.bindings)
