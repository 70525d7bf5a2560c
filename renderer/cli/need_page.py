"""The text of `docs/need.md`, around the tables that `need` measures."""

from __future__ import annotations

from typing import Final

PAGE: Final = """\
# What effects need

An effect costs something where a scene calls for it, and nothing where it doesn't. This page shows both on a ladder
of scenes, each of which has one effect more than the one before. It is made by one command:

```bash
{command}
```

![The ladder of scenes](images/need.png)

## What each effect adds

Each row is the difference to the row before: {size} pixels, forward shading, objects found by the frustum, an eye
that moves by 1 cm and a clock that goes on by 1/60 s in each frame. Except for times, all numbers are counted on a
null device. So they are exact, and the same on every backend.

{added}

- *passes* are the events of the frame that are new, *draws*, *dispatches* and *bindings* are commands of a frame,
  *programs* those that run in it. *Bytes a frame* are written to the device in a frame, *bytes at first* before it.
- *Image bytes* and *buffer bytes* are held on the device; most of the former are shadow maps, which are kept.
- *Steps* are those of simulations, *calls* those of Python functions on the null device, a measure of the CPU's
  work that no other program on the machine disturbs.
- *ms* are milliseconds of the processor in all threads, medians over rounds in which all scenes were drawn in turn,
  with 95 % intervals. In the first row they are those of the whole frame, in the others what is added.

## What is left once it is removed

The effect is switched off in a renderer that has drawn frames with it; where it is a part of the scene, such as a
box, the renderer is destroyed, and another one of the scene without it made on the same device. A later frame is
compared with one of a renderer on a new device that never had the effect:

{removed}

- *Commands that differ*: none. Both streams are the same operation by operation, number by number, byte by byte,
  and in the text of all programs. Only ids may differ where they stand for equal resources, and places in rings
  that go on from frame to frame.
- *Calls that differ*: calls of the renderer's Python functions that only one of the frames makes. With equal
  commands and equal calls, both frames are the same work. *Calls of the device that differ*: a device counts the
  draws of each program that it has compiled, with two calls for each, twice a frame; programs stay compiled for the
  case that they are needed again.
- *Bytes still held*: rings of the device (`draw arguments`, `transient constants`, `readback`), which whatever
  comes next uses, and constants of less than 1 KB.
- *Time* is that of a frame after the removal as a multiple of one that never had the effect, processor time with 95
  % intervals. The two alternate in one process. They are the same renderer in the same state, so what isn't 1 is
  the machine.

## What a frame without effects pays for the question

A renderer without effects would not even ask whether a frame needs them. This one does: `find_needs` counts what
the scene has, in each frame. That takes {asking}, for all effects together, so for each of them it is less than a
hundredth of the frame.

## How a new effect declares its need

1. **Need.** Add a member to `Effect` in `renderer/frame/needs.py`, count its causes in `find_needs`, and say them
   in a noun. `python -m renderer plan` then names it, with the reason why it is in a frame or not.
2. **Passes and programs.** A technique declares passes of the effect only if it is in `needs.effects`, and adds the
   class with the effect's binding to its shader only then. What it keeps between frames is made on first use
   (`SceneResources.workspace`). What is large and can be made again is given back by a method `release`.
3. **A rung.** Add a `Rung` to `LADDER` in `renderer/lab/need/ladder.py`: what it places in the scene, how it is
   switched on and off in a renderer that runs, the modules of which nothing may run without it, and its footprint:

   ```text
   Rung(
       "haze",
       "haze in the air",
       Footprint("haze", words=("through_haze",), bindings=("haze",), resources=("Haze",)),
       switch=switch_haze,
   )
   ```

   From then on the tests of the ladder (`tests/renderer/lab/need`) assert that a scene without it has no command of it
   ([`assert_free`](testing.md#6-effects-that-cost-nothing-when-they-are-absent), with the scene that has it as
   control), and that a frame after its removal is the frame of a scene that never had it. This page and its picture
   have it as well.
"""
