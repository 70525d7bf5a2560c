"""Compilers that no backend uses here, as a second opinion about the texts of shaders.

| language | at run time | second opinion |
|---|---|---|
| WGSL | naga, in wgpu | Tint, of Dawn: the package `webgpu` of npm |
| GLSL | the OpenGL driver | glslang: `rhi[spirv]` |
| GLSL for Vulkan, SPIR-V | that of a port | glslang, then spirv-val: `rhi[spirv]` |
| OpenCL C | PoCL or another driver | Clang, with all warnings |

Each function takes texts and returns the messages about those that are refused, by the same names. It skips the
test if the compiler isn't there.

`python tests/kits/shader_compilers.py FILE` writes the texts of all shaders of the tree, as `scripts/dump_shaders.py`
collects them, as JSON: language, shader and stage, text.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import pytest
from node_packages import require_package, run_node

from rhi.contract.descriptors import ProgramDescriptor, Stage, VertexAttribute, VertexFormat, VertexStream
from rhi.contract.layout import INT, UINT, VectorType
from rhi.errors import ShaderError
from rhi.shading import compile_shader
from rhi.shading.glsl import spirv
from rhi.shading.language.types import scalar_of

_SUFFIXES: Final = {Stage.VERTEX: "vert", Stage.FRAGMENT: "frag", Stage.COMPUTE: "comp"}
_DRAW_PARAMETERS: Final = re.compile(r"\bgl_(?:BaseInstance|BaseVertex|DrawID)ARB\b")
_CLANGS: Final = ("clang", *(f"clang-{version}" for version in range(30, 13, -1)))
CLANG_OPTIONS: Final = ("-x", "cl", "-cl-std=CL1.2", "-target", "spir64", "-fsyntax-only", "-Wall")
_UNUSED: Final = ("-Wno-unused-variable", "-Wno-unused-function", "-Wno-unused-but-set-variable")
"""Written texts name each value, and declare what their kernels may need; compilers drop what they don't."""
WITHOUT_CAPABILITY: Final = {
    "draw_index": re.compile(r"^enable draw_index;", re.MULTILINE),
    "early_depth": re.compile(r"^@early_depth_test\(force\)", re.MULTILINE),
    "vertex_writes": re.compile(r"var<storage, read_write>(?s:.*)^@vertex ", re.MULTILINE),
}
"""The capabilities that WebGPU lacks, and how their use shows in WGSL: naga extends the language for them."""


def missing_capability(wgsl: str) -> str | None:
    """Return the capability beyond WebGPU's that a text uses, or None."""
    return next((name for name, pattern in WITHOUT_CAPABILITY.items() if pattern.search(wgsl)), None)


def check_with_tint(texts: Mapping[str, str], install: bool = False) -> dict[str, str]:
    """Compile texts in WGSL with Tint.

    Args:
        install: whether to install it if it is missing.
    """
    folder = require_package("webgpu", install)
    refusals: dict[str, str] = json.loads(run_node("tint.mjs", [folder], json.dumps(texts)))
    return refusals


def check_with_glslang(texts: Mapping[str, tuple[Stage, str]]) -> dict[str, str]:
    """Compile texts in GLSL for OpenGL with glslang, all in one process."""
    tool = _require_tool("glslang")
    with tempfile.TemporaryDirectory() as folder:
        names = {}
        for number, (name, (stage, text)) in enumerate(texts.items()):
            path = Path(folder) / f"{number}.{_SUFFIXES[stage]}"
            # glslang knows these variables from 4.40 on; drivers have them in 4.30, with the extension.
            version = "450" if _DRAW_PARAMETERS.search(text) else "430"
            path.write_text(text.replace("#version 430", f"#version {version}", 1), encoding="utf-8")
            names[str(path)] = name
        done = _run([tool, "-C", *names], spirv.environment_of(tool))
        refusals: dict[str, str] = {}
        name = ""
        for line in done.stdout.splitlines():
            if line in names:
                name = names[line]
            elif line.startswith("ERROR"):
                refusals[name] = f"{refusals.get(name, '')}{line}\n"
    return refusals


def check_spirv(texts: Mapping[str, tuple[Stage, str]]) -> dict[str, str]:
    """Compile texts in GLSL for Vulkan with glslang, and validate the SPIR-V."""
    compiler, validator = _require_tool("glslang"), _require_tool("spirv-val")
    environment, refusals = spirv.environment_of(compiler), {}
    with tempfile.TemporaryDirectory() as folder:
        for name, (stage, text) in texts.items():
            path, module = Path(folder) / f"stage.{_SUFFIXES[stage]}", Path(folder) / "stage.spv"
            path.write_text(text, encoding="utf-8")
            target = ("--target-env", spirv.TARGET)
            done = _run([compiler, "-V", *target, str(path), "-o", str(module)], environment)
            if not done.returncode:
                done = _run([validator, *target, str(module)], environment)
            if done.returncode:
                refusals[name] = done.stdout + done.stderr
    return refusals


def check_with_clang(texts: Mapping[str, str]) -> dict[str, str]:
    """Compile texts in OpenCL C with Clang; what it warns of is refused."""
    tool = next(filter(None, map(shutil.which, _CLANGS)), None)
    if tool is None:
        pytest.skip("Clang isn't installed: on Debian, apt install clang")
    refusals = {}
    for name, text in texts.items():
        done = subprocess.run(
            [tool, *CLANG_OPTIONS, *_UNUSED, "-"],
            input=text,
            capture_output=True,
            text=True,
            check=False,
            encoding="utf-8",
        )
        if done.returncode or done.stderr:
            refusals[name] = done.stderr
    return refusals


def write_opencl_sources(descriptor: ProgramDescriptor) -> Iterator[tuple[str, str]]:
    """Yield the kernels that the OpenCL backend builds of a program, each with a name.

    Of draws, these are the vertex kernel for floats and integers in one stream, and the raster kernel that
    serves all formats and states.
    """
    if Stage.COMPUTE in descriptor.stages:
        for width in (1, 16):
            yield f"opencl{width}", descriptor.emit(f"opencl{width}", Stage.COMPUTE).text
        return
    cl_pipelines = pytest.importorskip("rhi.backends.cl.raster.cl_pipelines")
    builds = _SourceList()
    shared = SimpleNamespace(
        calls_stages=False
    )  # so the raster kernel has the stage in it, whose text is checked
    pipeline = cl_pipelines.Pipeline(None, builds, shared, descriptor)
    pipeline.get_vertex_kernels([_make_stream(descriptor)])
    pipeline._general(4 * (1 + max((output.location for output in descriptor.outputs), default=-1)))
    yield from zip(("vertex", "raster"), builds.sources, strict=True)


class _SourceList:
    """In place of `rhi.backends.cl.builds.Builds`: it keeps the sources, and builds nothing."""

    is_quick = True

    def __init__(self) -> None:
        self.sources: list[str] = []

    def request(self, source: str, names: tuple[str, ...], flushes_denormals: bool = False) -> Any:
        self.sources.append(source)
        return SimpleNamespace(source=source, kernels=names)

    def build(self, request: Any, launch: object) -> list[None]:
        return [None] * len(request.kernels)

    def compile(self, request: object, quick: bool) -> None:
        pass


def _make_stream(descriptor: ProgramDescriptor) -> VertexStream:
    """Return a stream that has all attributes of a program, one after the other, as words."""
    attributes, offset = [], 0
    for attribute in descriptor.attributes:
        scalar = scalar_of(attribute.type)  # type: ignore[arg-type]
        kind = {INT: "INT", UINT: "UINT"}.get(scalar, "FLOAT")  # type: ignore[arg-type]
        size = attribute.type.size if isinstance(attribute.type, VectorType) else 1
        name = VertexFormat[f"{kind}{size if size > 1 else ''}"]
        attributes.append(VertexAttribute(attribute.location, name, offset))
        offset += 4 * size
    return VertexStream(1, 0, max(offset, 4), False, tuple(attributes))


def list_texts(name: str, descriptor: ProgramDescriptor) -> Iterator[tuple[str, str, str]]:
    """Yield language, name and text of all texts of a program; of those that can't be written, none."""
    for stage in descriptor.stages:
        for language in ("wgsl", "glsl", "vulkan"):
            with suppress(ShaderError, KeyError):  # a built-in that the table has only while a test runs
                yield language, f"{name} {stage.value}", descriptor.emit(language, stage).text
    if not (descriptor.checked and Stage.COMPUTE not in descriptor.stages):  # it reports faults to an address
        with suppress(ShaderError, KeyError):
            for kernel, text in write_opencl_sources(descriptor):
                yield "opencl", f"{name} {kernel}", text


def write_all_texts(path: Path) -> None:
    """Write the texts of all shaders of the tree as JSON."""
    sys.path.append(str(Path(__file__).parents[2] / "scripts"))
    from dump_shaders import collect_shaders, draw_frames, import_modules

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # shaders of tests that are there to be warned of
        import_modules()
        draw_frames()
        texts = []
        for name, shader in collect_shaders().items():
            with suppress(ShaderError):
                texts += list_texts(name, compile_shader(shader))
    path.write_text(json.dumps(texts), encoding="utf-8")


def _require_tool(name: str) -> str:
    tool = spirv.find_tool(name)
    if tool is None:
        pytest.skip(f'{name} isn\'t installed: pip install "rhi[spirv]"')
    return tool


def _run(command: list[str], environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command, capture_output=True, text=True, env=environment, check=False, encoding="utf-8"
    )


if __name__ == "__main__":
    write_all_texts(Path(sys.argv[1]))
