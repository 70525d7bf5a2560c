"""`scenes`: list the scenes that can be rendered.

  python -m renderer scenes
  python -m renderer render city:blocks=12,seed=3

Options of a scene that aren't named have their defaults.
"""

from __future__ import annotations

import argparse
from typing import Final

from renderer.cli.subcommand import Subcommand
from renderer.content import GENERATORS


def _run(arguments: argparse.Namespace) -> None:
    for generator in GENERATORS.values():
        print(f"{generator.name}: {generator.summary}")
        for option in generator.options:
            default = f"{option.name}={option.default}"
            allowed = "" if option.allowed == option.meaning else f" ({option.allowed})"
            print(f"  {default:<16}{option.meaning}{allowed}")
    print("or a model file: glTF (.gltf, .glb), OBJ, PLY or STL")


COMMAND: Final = Subcommand("scenes", "list the scene generators and their options", (), _run, __doc__)
