"""Programs whose identifiers are one after a careless renaming: `a` and `a_`, `x_x` and `x__x`, words of
other languages, letters that aren't ASCII, and what writers of texts derive from names."""

from __future__ import annotations

import random
from dataclasses import dataclass
from typing import Any, Final

FAMILIES: Final = (
    ("a", "a_", "a__", "a_2", "a_2_", "a_2_2"),
    ("x_x", "x__x", "x___x", "x_x_", "x_x_2"),
    ("input", "input_", "input__", "input_2"),  # words of GLSL
    ("sample", "sample_", "sample__", "sample_2"),
    ("target", "target_", "target__", "target_2"),  # words of WGSL
    ("fn", "fn_", "fn__", "fn_2"),
    ("kernel", "kernel_", "half", "half_"),  # words of OpenCL C
    ("λ", "xu03bb", "xu03bb_", "λ_", "λλ"),
    ("gl_a", "x_gl_a", "gl_a_", "x_gl_a_"),
    ("rhi_item", "x_rhi_item", "rhi_item_", "rhi_result"),
    ("m", "m_", "m_0", "m_1", "in_m", "v_m", "out_m", "in_m_0"),
    ("t", "t_texture", "t_sampler", "t_block", "t_words", "t_count", "t_std140"),
    ("constant", "constant_0", "constant_1", "constant_2", "inputs", "flat"),
    ("value", "hoisted", "first", "selected", "at", "result", "result_", "old"),
    ("RhiOutputs", "main", "main_", "vertex_index", "in_vertex_index", "storageBarrier", "textureLoad"),
)
"""Identifiers that a text may give one name."""


def clashing_names(rng: random.Random, count: int, families: int) -> list[str]:
    """Return distinct identifiers of a few families, in random order."""
    names = [name for family in rng.sample(FAMILIES, families) for name in family]
    assert len(names) >= count, "more families are needed"
    return rng.sample(names, count)


@dataclass(frozen=True)
class ComputeCase:
    """A compute shader that reads one thing of each role after the other.

    Attributes:
        text: the module, whose shader is `Reads`.
        structs: the names of the two structs; the second contains the first.
        fields: the fields of the first struct (float, vec2, mat2, float), and those of the second (float, the
            first struct, float).
        uniforms, storages: the names of the bindings: of the first struct, and of the second.
        expected: what the shader writes to `out`.
        stored: what it writes to the second field of the second storage.
    """

    text: str
    structs: list[str]
    fields: tuple[list[str], list[str]]
    uniforms: list[str]
    storages: list[str]
    expected: list[float]
    stored: float

    def values(self, first: float) -> dict[str, Any]:
        """Return the values of the first struct's fields, numbers from `first` on."""
        n = [first + i for i in range(8)]
        parts = [n[0], (n[1], n[2]), ((n[3], n[4]), (n[5], n[6])), n[7]]
        return dict(zip(self.fields[0], parts, strict=True))


def compute_case(seed: int) -> ComputeCase:
    """Return a random compute shader: structs, bindings, sl.shared memory, constants, functions, methods,
    parameters and locals have clashing names, and each thing has a number of its own."""
    rng = random.Random(seed)
    names = iter(clashing_names(rng, 28, 7))
    first, second, c0, c1, f0, f1, u0, u1, s0, s1, h0, h1, m0, m1, k0 = (next(names) for _ in range(15))
    p0, p1, p2, l0, l1, l2, l3, l4, l5, l6, l7, l8, l9 = names
    a, b = clashing_names(rng, 4, 2), clashing_names(rng, 3, 2)
    reads = [
        (f"self.{u0}.{a[0]}", 10),
        (f"self.{u0}.{a[1]}.y", 12),
        (f"self.{u0}.{a[2]}[1].x", 15),
        (f"self.{u0}.{a[3]}", 17),
        (f"self.{u1}.{b[0]}", 20),
        (f"self.{u1}.{b[1]}.{a[1]}.x", 31),
        (f"self.{u1}.{b[1]}.{a[3]}", 37),
        (f"self.{u1}.{b[2]}", 29),
        (f"self.{s0}[0].{a[0]}", 40),
        (f"self.{s0}[0].{a[2]}[0].y", 44),
        (f"self.{s1}[0].{b[1]}.{a[0]}", 60),
        (f"self.{s1}[0].{b[0]}", 50),
        (f"self.{h0}[1]", 1),
        (f"self.{h1}[1]", 2),
        (f"{c0}[{l0}]", 3),
        (f"{c1}[{l0}]", 5),
        (f"{f0}(7.0, 1.0)", 7),
        (f"{f1}(7.0, 1.0)", 1),
        (f"self.{m0}({l3}, 4.0)", 118 * 100 + 4),
        (f"self.{m1}(2.0, {l3})", 2 * 100 + 111),
        (f"self.{k0}", 9),
        (l1, 6),
        (l2, 8),
        (f"{l3}.{a[0]}", 111),
        (f"{l3}.{a[3]}", 118),
        (f"{l4}.{b[1]}.{a[3]}", 118),
        (f"{l4}.{b[2]} + {l4}.{b[0]}", 7),
        (f"{l5}[0] + {l5}[1]", 13),
        (f"float({l6})", 3),
        (f"{l7}[1].{a[0]}", 0),
        (l8, 19),
    ]
    text = f"""
import rhi.shading as sl

class {first}(sl.Struct):
    {a[0]}: float
    {a[1]}: sl.vec2
    {a[2]}: sl.mat2
    {a[3]}: float

class {second}(sl.Struct):
    {b[0]}: float
    {b[1]}: {first}
    {b[2]}: float

{c0} = (1.0, 2.0, 3.0)
{c1} = (1.0, 2.0, 5.0)

@sl.function
def {f0}({p0}: float, {p1}: float) -> float:
    {p2} = {p0}
    return {p2} * {p1}

@sl.function
def {f1}({p1}: float, {p0}: float) -> float:
    {p2} = {p0}
    return {p2} * {p2}

class Reads(sl.Shader):
    work_group = (1,)
    {u0}: sl.Uniform[{first}]
    {u1}: sl.Uniform[{second}]
    {s0}: sl.Storage[{first}]
    {s1}: sl.StorageRW[{second}]
    out: sl.StorageRW[float]
    {h0} = sl.shared(float, 2)
    {h1} = sl.shared(float, 2)
    {k0} = 9.0

    def {m0}(self, {p0}: {first}, {p1}: float) -> float:
        return {p0}.{a[3]} * 100.0 + {p1}

    def {m1}(self, {p0}: float, {p1}: {first}) -> float:
        return {p0} * 100.0 + {p1}.{a[0]}

    def compute(self) -> None:
        {l0} = len(self.out) - {len(reads) - 2}
        self.{h0}[1] = 1.0
        self.{h1}[1] = 2.0
        {l1} = 6.0
        {l2} = 8.0
        {l3} = {first}({a[0]}=101.0, {a[1]}=sl.vec2(102.0, 103.0), {a[2]}=sl.mat2(1.0), {a[3]}=108.0)
        {l3}.{a[0]} += 10.0
        {l3}.{a[3]} += 10.0
        {l4} = {second}({b[0]}=4.0, {b[1]}={l3}, {b[2]}=3.0)
        {l5} = sl.array(float, 2)
        {l5}[0] = {l1}
        {l5}[1] = {l1} + 1.0
        {l6} = 0
        for {l9} in range(3):
            {l6} += {l9}
        {l7} = sl.array({first}, 2)
        {l7}[0] = {l3}
        {l8} = 19.0
        self.{s1}[0].{b[2]} = {l8} * 2.0
""" + "".join(f"        self.out[{i}] = {read}\n" for i, (read, _) in enumerate(reads))
    expected = [float(value) for _, value in reads]
    return ComputeCase(text, [first, second], (a, b), [u0, u1], [s0, s1], expected, 38.0)


@dataclass(frozen=True)
class DrawCase:
    """A shader with two stages.

    Attributes:
        text: the module, whose shader is `Draws`.
        attributes: the names of the attributes: the position, a float, a vec2, a float.
        uniforms: of the vertex stage, and of the fragment stage.
        textures: both are loaded at texel (0, 0).
        outputs: the names of the targets.
    """

    text: str
    attributes: list[str]
    uniforms: list[str]
    textures: list[str]
    outputs: list[str]

    ATTRIBUTES = (5.0, (6.0, 7.0), 8.0)
    UNIFORMS = (10.0, 20.0)
    TEXELS = (3.0, 4.0)
    EXPECTED = ((6.0, 7.0, 15.0, 18.0), (15.0, 6.0, 7.0, 28.0), (3.0, 4.0, 8.0, 5.0))


def draw_case(seed: int) -> DrawCase:
    """Return a random shader whose attributes, varyings, targets, bindings and parameters have clashing
    names."""
    rng = random.Random(seed)
    names = iter(clashing_names(rng, 15, 6))
    corner, more, passed, colors, u0, u1, x0, x1, p, q, r, l0, l1, f0, f1 = names
    a = clashing_names(rng, 4, 2)
    o = clashing_names(rng, 5, 2)
    t = clashing_names(rng, 3, 1)
    text = f"""
import rhi.shading as sl

class {corner}(sl.Struct):
    {a[0]}: sl.vec4
    {a[1]}: float

class {more}(sl.Struct):
    {a[2]}: sl.vec2
    {a[3]}: float

class {passed}(sl.Struct):
    {o[0]}: sl.vec4
    {o[1]}: sl.vec2
    {o[2]}: sl.mat2
    {o[3]}: sl.Flat[float]
    {o[4]}: float

class {colors}(sl.Struct):
    {t[0]}: sl.vec4
    {t[1]}: sl.vec4
    {t[2]}: sl.vec4

@sl.function
def {f0}({p}: float, {q}: float) -> float:
    return {p}

@sl.function
def {f1}({p}: float, {q}: float) -> float:
    return {q}

class Draws(sl.Shader):
    {u0}: sl.Uniform[float]
    {u1}: sl.Uniform[float]
    {x0}: sl.Texture2D
    {x1}: sl.Texture2D

    def vertex(self, {p}: {corner}, {q}: {more}) -> {passed}:
        {l0} = {p}.{a[1]} + self.{u0} + float(sl.vertex_index()) * 0.0
        {l1} = {q}.{a[3]} + self.{u0}
        {r} = sl.mat2(sl.vec2({l0}, {q}.{a[2]}.x), sl.vec2({q}.{a[2]}.y, {q}.{a[3]}))
        return {passed}(
            {o[0]}={p}.{a[0]},
            {o[1]}={q}.{a[2]},
            {o[2]}={r},
            {o[3]}={f0}({l0}, {l1}),
            {o[4]}={f1}({l0}, {l1}),
        )

    def fragment(self, {r}: {passed}) -> {colors}:
        {l0} = self.{x0}.load(sl.ivec2(0, 0)).x
        {l1} = self.{x1}.load(sl.ivec2(0, 0)).x
        {p} = {r}.{o[2]}
        return {colors}(
            {t[0]}=sl.vec4({r}.{o[1]}, {r}.{o[3]}, {r}.{o[4]}),
            {t[1]}=sl.vec4({p}[0], {p}[1].x, {p}[1].y + self.{u1}),
            {t[2]}=sl.vec4({l0}, {l1}, {r}.{o[2]}[1].y, {p}[0].x - self.{u1} + 10.0),
        )
"""
    return DrawCase(text, a, [u0, u1], [x0, x1], t)
