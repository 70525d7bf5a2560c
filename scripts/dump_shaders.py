"""Hash the text of every shader: `python scripts/dump_shaders.py [-o FILE] [--compare FILE] [--show NAME]
[--origins]`.

The shaders are those of the renderer, of the conformance kit, and of examples, benchmarks and tests: the ones
that their modules define, and the ones that the renderer composes for a frame of each technique on the null
backend. Each is written in all languages, or refused; a refusal is a text, too. A dump has a line for each
shader:

    MODULE.CLASS  SAID  interface:HASH  vertex-glsl:HASH  vertex-opencl16:HASH  …

SAID is the hash of what the shader says in Python: its bindings, numbers and functions, the functions that
these call, and the constants that they name; no comments, and no line numbers. Where it is equal in two dumps
and a text differs, the language itself has changed. That is what `--compare` prints; a shader that says
something else may have another text, and with `--all` its texts are compared as well.

With `--naga`, the compiler of wgpu reads all texts in WGSL, instead.

With `--origins` a hash includes the Python line of each line of the text, so that only dumps of one tree can
be compared: this is the proof that work on the compiler changed nothing.

`tests/shader_texts.txt` is a dump that a nightly test compares. Where the language is meant to write other
texts:

    python scripts/dump_shaders.py -o tests/shader_texts.txt
"""

from __future__ import annotations

import argparse
import ast
import hashlib
import importlib
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import fields
from pathlib import Path, PurePosixPath
from types import FunctionType, ModuleType
from typing import Any, Final

ROOT: Final = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "scripts")]

from count_lines import list_programs  # noqa: E402

import rhi  # noqa: E402
from rhi.contract.descriptors import ProgramDescriptor, Stage  # noqa: E402
from rhi.errors import ShaderError  # noqa: E402
from rhi.shading import Shader, Struct, compile_shader  # noqa: E402
from rhi.shading.language.function import NATIVE, ShadingFunction  # noqa: E402
from rhi.shading.language.source import MISSING, source_of  # noqa: E402

RECORDED_TEXTS: Final = ROOT / "tests" / "shader_texts.txt"
_GRAPHICS: Final = ("glsl", "vulkan", "wgsl", "opencl16")
_COMPUTE: Final = (*_GRAPHICS, "opencl1", "numpy")
_SCENE: Final = "hall:columns=4,rows=2,flags=2,fountains=2,cloths=1,lights=16,shadows=1,fog=0.02,bloom=0.1"
_DIGITS: Final = 8


# -- the shaders -------------------------------------------------------------------------------------------


def import_modules() -> None:
    """Import every module of the tree that may define shaders, tests as pytest does."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["pytest"][
        "ini_options"
    ]
    sys.path += [str(ROOT / folder) for folder in settings["pythonpath"]]
    for path in list_programs(".py"):
        text = (ROOT / path).read_text(encoding="utf-8")
        mentions = "Shader" in text or "conformance.shaders" in text  # whose shaders are bases of others
        if path.parts[0] == "scripts" or path.stem == "__main__" or not mentions:
            continue
        module = ".".join(path.with_suffix("").parts)
        if path.parts[0] in ("tests", "benchmarks") or path.parent == PurePosixPath("examples/programs"):
            module = path.stem
            sys.path.insert(0, str(ROOT / path.parent))
        importlib.import_module(module)


def draw_frames() -> None:
    """Draw a frame with each technique, for which the renderer composes shaders, and compose those of
    standard depth."""
    from renderer.content import load_scene
    from renderer.renderer import Renderer
    from renderer.scene import Depth
    from renderer.techniques import TECHNIQUES
    from renderer.visibility import FrustumCulling
    from renderer.visibility.gpu.farthest_depth import depth_variant

    scene = load_scene(_SCENE)
    camera = next(iter(scene.paths.values())).camera(0)
    for technique in TECHNIQUES.values():
        with rhi.create_device("null") as device:
            culling = FrustumCulling(scene)
            with Renderer(
                device, scene, technique=technique(), size=(64, 36), visibility=culling
            ) as renderer:
                renderer.render(camera)
    for shader in list(collect_shaders().values()):
        is_whole = hasattr(shader, "compute") or hasattr(shader, "fragment")
        if (
            is_whole
            and hasattr(shader, "is_reversed")
            and shader.__module__.startswith("renderer.visibility")
        ):
            depth_variant(shader, Depth.STANDARD)


def collect_shaders() -> dict[str, type[Shader]]:
    """Return the shaders that exist by name; those of one name also have their bases and numbers in it."""
    shaders: dict[type[Shader], None] = {}
    left = [Shader]
    while left:
        subclasses = left.pop().__subclasses__()
        shaders |= dict.fromkeys(subclasses)
        left += subclasses
    count = Counter(map(_name, shaders))
    names: dict[str, type[Shader]] = {}
    for shader in shaders:
        name = _name(shader)
        if count[name] > 1:
            bases = ",".join(base.__qualname__ for base in shader.__bases__)
            numbers = ",".join(f"{key}={value}" for key, value in sorted(_numbers(shader).items()))
            name = f"{name}({bases}|{numbers})".replace(" ", "")
        number = sum(other_name.partition("#")[0] == name for other_name in names)
        names[f"{name}#{number + 1}" if number else name] = shader
    return dict(sorted(names.items()))


def _name(shader: type[Shader]) -> str:
    return f"{shader.__module__}.{shader.__qualname__}".replace(".<locals>", "")


def _numbers(shader: type[Shader]) -> dict[str, Any]:
    return {
        name: value
        for base in reversed(shader.__mro__)
        for name, value in vars(base).items()
        if isinstance(value, bool | int | float | tuple) and not name.startswith("__") and base is not Shader
    }


# -- their texts -------------------------------------------------------------------------------------------


def texts_of(shader: type[Shader], origins: bool) -> dict[str, str]:
    """Return the text of each stage in each language, the interface, and the refusal of what can't be had."""
    try:
        program = compile_shader(shader)
    except ShaderError as error:
        return {"refused": _refusal(error, origins)}
    names = [field.name for field in fields(ProgramDescriptor) if field.name != "emit"]
    texts = {"interface": "\n".join(f"{name}: {_ordered(getattr(program, name))}" for name in names)}
    for stage in sorted(program.stages, key=lambda stage: stage.value):
        for language in _COMPUTE if stage is Stage.COMPUTE else _GRAPHICS:
            try:
                written = program.emit(language, stage)
            except ShaderError as error:
                text = _refusal(error, origins)
            except KeyError as error:  # a built-in that the table has only while a test runs
                text = f"no {error}"
            else:
                text = _local(written.text)  # a checked shader names its file
                if origins:
                    text += "".join(f"\n{_local(file)}:{line}" for file, line in written.origins)
            texts[f"{stage.value}-{language}"] = text
    return texts


def _ordered(value: object) -> str:
    return str(sorted(map(str, value))) if isinstance(value, frozenset) else str(value)


def _refusal(error: ShaderError, origins: bool) -> str:
    text = str(error) if origins else "\n".join([error.rule.id, error.given, error.allowed, error.tip])
    return _local(text)


def _local(text: str) -> str:
    return text.replace(f"{ROOT}/", "")


# -- what shaders say --------------------------------------------------------------------------------------


def definition_of(shader: type[Shader]) -> str:
    """The shader's Python source: all that its texts may depend on but for the language."""
    definition = [f"{name} = {value!r}" for name, value in _numbers(shader).items()]
    definition += [str(declaration) for declaration in shader._declared.values()]
    members = [
        getattr(member, "__func__", member)
        for base in shader.__mro__
        if issubclass(base, Shader) and base is not Shader
        for member in vars(base).values()
    ]
    left = [member for member in members if isinstance(member, FunctionType)]
    done: set[FunctionType] = set()
    while left:
        function = left.pop()
        if function not in done:
            done.add(function)
            definition += [f"{function.__qualname__}{function.__defaults__}{getattr(function, NATIVE, '')}"]
            for value in _named_by(function):
                if isinstance(value, ShadingFunction):
                    left.append(value.python)
                else:
                    definition.append(str(value))
    return "\n".join(definition)


def _named_by(function: FunctionType) -> Iterator[Any]:
    """Yield the text of a function, and the functions, structs and constants that it names."""
    source = source_of(function)
    try:
        node = source.node
    except ShaderError as error:
        yield error.given
        return
    yield ast.unparse(node)
    for part in ast.walk(node):
        value: Any = MISSING
        if isinstance(part, ast.Name):
            value = source.scope.find(part.id)
        elif isinstance(part, ast.Attribute) and isinstance(part.value, ast.Name):
            owner = source.scope.find(part.value.id)
            if isinstance(owner, ModuleType | type):
                value = getattr(owner, part.attr, MISSING)
        if isinstance(value, bool | int | float | tuple | ShadingFunction):
            yield value
        elif isinstance(value, type) and issubclass(value, Struct):
            with suppress(AttributeError):  # `Struct` itself has none
                yield value.shading_type


# -- dumps -------------------------------------------------------------------------------------------------


def dump(origins: bool = False) -> dict[str, dict[str, str]]:
    """Return the hashes of each shader: of what it "said", and of each of its texts."""
    hashes = {}
    for name, shader in collect_shaders().items():
        texts = {"definition": definition_of(shader), **texts_of(shader, origins)}
        hashes[name] = {
            key: hashlib.sha256(text.encode()).hexdigest()[:_DIGITS] for key, text in texts.items()
        }
    return hashes


def write_dump(hashes: Mapping[str, Mapping[str, str]]) -> str:
    """Return a dump as text."""
    lines = []
    for name, row in hashes.items():
        texts = "  ".join(f"{key}:{value}" for key, value in row.items() if key != "definition")
        lines.append(f"{name}  {row['definition']}  {texts}\n")
    return "".join(lines)


def read_dump(text: str) -> dict[str, dict[str, str]]:
    """Return the hashes that `write_dump` has written."""
    hashes = {}
    for line in text.splitlines():
        name, definition, *texts = line.split("  ")
        hashes[name] = {"definition": definition, **dict(entry.split(":") for entry in texts)}
    return hashes


def compare(
    before: Mapping[str, Mapping[str, str]], now: Mapping[str, Mapping[str, str]], everything: bool = False
) -> tuple[list[str], int]:
    """Return the names of the texts that differ, and the number of texts that were compared.

    Only shaders that say the same in both dumps are compared, or with `everything` all, also those that are
    missing.
    """
    differ, compared = [], 0
    for name in sorted({*before, *now}):
        old, new = before.get(name, {}), now.get(name, {})
        if not everything and old.get("definition") != new.get("definition"):
            continue
        for key in dict.fromkeys((*old, *new)):
            compared += 1
            if old.get(key) != new.get(key):
                differ.append(f"{name} {key}")
    return differ, compared


def check_wgsl() -> int:
    """Parse each text in WGSL with naga, the compiler of wgpu; print what it refuses. Return 1 if it refuses
    any."""
    import wgpu

    adapter = next(a for a in wgpu.gpu.enumerate_adapters_sync() if a.info["backend_type"] != "OpenGL")
    features = sorted(name for name in adapter.features if name != "pipeline-cache")
    naga = adapter.request_device_sync(required_features=features, required_limits=dict(adapter.limits))
    count: Counter[str] = Counter()
    for name, shader in collect_shaders().items():
        try:
            program = compile_shader(shader)
        except ShaderError:
            continue
        for stage in program.stages:
            try:
                naga.create_shader_module(code=program.emit("wgsl", stage).text)
            except ShaderError:
                count["refused"] += 1
            except wgpu.GPUError as error:
                count["wrong"] += 1
                print(f"{name}, {stage}: {error}")
            else:
                count["accepted"] += 1
    print(", ".join(f"{count[key]} {key}" for key in ("accepted", "refused", "wrong")), file=sys.stderr)
    return min(1, count["wrong"])


def main() -> int:
    """Write, compare or show; return 1 if texts differ."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, help="the file to write")
    parser.add_argument(
        "--compare", type=Path, metavar="FILE", help="print the texts that differ from those of a dump"
    )
    parser.add_argument("--all", action="store_true", help="compare shaders that say something else, too")
    parser.add_argument(
        "--show", metavar="NAME", help="print the texts of the shaders whose name ends with this"
    )
    parser.add_argument(
        "--origins", action="store_true", help="let hashes include the Python line of each line"
    )
    parser.add_argument("--naga", action="store_true", help="let the compiler of wgpu read all texts in WGSL")
    arguments = parser.parse_args()
    import_modules()
    draw_frames()
    if arguments.naga:
        return check_wgsl()
    if arguments.show is not None:
        for name, shader in collect_shaders().items():
            if name.endswith(arguments.show):
                for key, text in texts_of(shader, arguments.origins).items():
                    print(f"==== {name} {key}\n{text}")
        return 0
    hashes = dump(arguments.origins)
    print(f"{len(hashes)} shaders, {sum(len(row) - 1 for row in hashes.values())} texts", file=sys.stderr)
    if arguments.output is not None:
        arguments.output.write_text(write_dump(hashes), encoding="utf-8")
    if arguments.compare is None:
        return 0
    differ, compared = compare(
        read_dump(arguments.compare.read_text(encoding="utf-8")), hashes, arguments.all
    )
    print(f"{compared} compared, {len(differ)} differ", file=sys.stderr)
    print("\n".join(differ), end="\n" if differ else "")
    return 1 if differ else 0


if __name__ == "__main__":
    sys.exit(main())
