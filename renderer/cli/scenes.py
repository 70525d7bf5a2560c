"""`scenes`: what can be rendered."""

from __future__ import annotations

import argparse
from typing import Any

from renderer.cli.arguments import add_command
from renderer.content import GENERATORS

_EXAMPLES = """\
  python -m renderer scenes
  python -m renderer render city:blocks=12,seed=3"""


def add_to(commands: Any) -> None:
    """Add the command."""
    add_command(commands, "scenes", run, "list the scene generators and their options", _EXAMPLES)


def run(given: argparse.Namespace) -> None:
    """List them."""
    for generator in GENERATORS.values():
        print(f"{generator.name}: {generator.summary}")
        for option in generator.options:
            default = f"{option.name}={option.default}"
            allowed = "" if option.allowed == option.meaning else f" ({option.allowed})"
            print(f"  {default:<16}{option.meaning}{allowed}")
    print("or a model file: glTF (.gltf, .glb), OBJ, PLY or STL")
