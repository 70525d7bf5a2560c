"""The parts of the web backend that need no page: its refusal elsewhere, its tables, its names."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from enum import IntFlag
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

import rhi
from rhi.backends.null.null_capabilities import PROFILES
from rhi.backends.web import find_obstacle
from rhi.backends.web.javascript import FUNCTIONS
from rhi.backends.webgpu.specified_formats import SpecifiedFormats
from rhi.backends.webgpu.webgpu_flags import GpuBufferUsage, GpuShaderStage, GpuTextureUsage
from rhi.contract.descriptors import TextureKind
from rhi.contract.formats import COLOR_FORMATS, Format
from rhi.errors import DeviceError

CORE = PROFILES["webgpu"]
TARGET = GpuTextureUsage.RENDER_ATTACHMENT


def test_outside_of_a_page_the_backend_is_refused_and_names_another() -> None:
    with pytest.raises(DeviceError, match=r"^\[device-driver\]") as caught:
        rhi.create_device("web")
    assert caught.value.given == f"Python on {sys.platform}"
    assert '"wgpu"' in caught.value.tip
    assert find_obstacle() == f"{caught.value.given}; {caught.value.tip}"


def test_pages_are_not_tried_before_drivers() -> None:
    names = rhi.backend_names()
    assert "web" in names
    assert names[0] == "gl"


@pytest.mark.parametrize(
    "flags", [GpuBufferUsage, GpuTextureUsage, GpuShaderStage], ids=lambda flags: flags.__name__
)
def test_flags_have_the_numbers_of_wgpu(flags: type[IntFlag]) -> None:
    theirs = getattr(pytest.importorskip("wgpu"), flags.__name__.removeprefix("Gpu"))
    assert {flag.name: int(flag) for flag in flags} == {
        name: int(getattr(theirs, name)) for name in flags.__members__
    }


# -- formats -----------------------------------------------------------------------------------------------


def test_without_features_formats_have_the_uses_of_the_core_profile() -> None:
    uses = SpecifiedFormats(frozenset())
    supported = {f for f in Format if uses.usage(f, TextureKind.D2, 1)}
    assert set(Format) - supported == CORE.unsupported_formats
    renderable = {f for f in COLOR_FORMATS if uses.usage(f, TextureKind.D2, 1) & TARGET}
    assert set(COLOR_FORMATS) - renderable == CORE.unrenderable_formats
    single = {f for f in supported if not uses.usage(f, TextureKind.D2, 4) & TARGET}
    assert single == CORE.single_sampled_formats
    assert {f for f in COLOR_FORMATS if not uses.is_image(f, "write-only")} == CORE.unstorable_formats
    assert {f for f in COLOR_FORMATS if not uses.is_image(f, "read-write")} == CORE.unloadable_formats
    assert {f for f in renderable if not uses.blends(f)} == CORE.unblendable_formats & renderable


@pytest.mark.parametrize(
    ("feature", "format"),
    [("depth32float-stencil8", Format.D32FS8), ("rg11b10ufloat-renderable", Format.R11G11B10F)],
)
def test_features_add_their_capabilities(feature: str, format: Format) -> None:
    without, with_it = SpecifiedFormats(frozenset()), SpecifiedFormats(frozenset({feature}))
    for samples in (1, 4):
        assert not without.usage(format, TextureKind.D2, samples) & TARGET
        assert with_it.usage(format, TextureKind.D2, samples) & TARGET
    differing = [f for f in Format if f is not format and without.usage(f, TextureKind.D2, 1)
                 != with_it.usage(f, TextureKind.D2, 1)]  # fmt: skip
    assert differing == []
    assert not without.blends(Format.R32F)
    assert SpecifiedFormats(frozenset({"float32-blendable"})).blends(Format.R32F)


@pytest.mark.parametrize("format", [f for f in Format if f.is_depth], ids=lambda f: f.name)
def test_depth_has_no_volumes(format: Format) -> None:
    assert SpecifiedFormats(frozenset()).usage(format, TextureKind.D3, 1) == 0


# -- names and values --------------------------------------------------------------------------------------


@pytest.fixture
def js_objects(monkeypatch: pytest.MonkeyPatch) -> Iterator[ModuleType]:
    """The module of the page's objects, with a Pyodide whose conversions change nothing."""

    class JsProxy:
        pass

    ffi = SimpleNamespace(JsProxy=JsProxy, to_js=lambda value, **_: value)
    for name, module in {
        "js": SimpleNamespace(
            Map=SimpleNamespace(new=lambda: SimpleNamespace(set=None, delete=None)),
            Object=SimpleNamespace(fromEntries=dict),
        ),
        "pyodide": SimpleNamespace(ffi=ffi),
        "pyodide.ffi": ffi,
    }.items():
        monkeypatch.setitem(sys.modules, name, module)  # type: ignore[arg-type]
    monkeypatch.delitem(sys.modules, "rhi.backends.web.js_objects", raising=False)
    import rhi.backends.web.js_objects as module_

    yield module_
    sys.modules.pop("rhi.backends.web.js_objects", None)


@pytest.mark.parametrize(
    ("name", "expected"),
    [("size", "size"), ("mip_level_count", "mipLevelCount"), ("address_mode_u", "addressModeU")],
)
def test_names_are_spelt_as_webgpu_does(js_objects: Any, name: str, expected: str) -> None:
    assert js_objects.to_camel_case(name) == expected


def test_values_keep_their_shape_and_constants_their_names(js_objects: Any) -> None:
    module = js_objects.WebObject("module")
    converted = js_objects.to_javascript(
        {
            "vertex": {"module": module, "entry_point": "main", "constants": {"rhi_reversed": 1.0}},
            "depth_stencil": None,
            "usage": GpuBufferUsage.VERTEX | GpuBufferUsage.COPY_DST,
            "size": (4, 4, 1),
            "has_dynamic_offset": True,
        }
    )
    assert converted == {
        "vertex": {"module": "module", "entryPoint": "main", "constants": {"rhi_reversed": 1.0}},
        "usage": 40,
        "size": [4, 4, 1],
        "hasDynamicOffset": True,
    }
    assert type(converted["usage"]) is int
    assert type(converted["hasDynamicOffset"]) is bool


def test_every_function_that_the_page_uses_is_written() -> None:
    written = set(re.findall(r"^(\w+): ", FUNCTIONS, re.MULTILINE))
    page = Path(rhi.__path__[0], "backends", "web", "page.py").read_text(encoding="utf-8")
    used = set(re.findall(r"functions\.(\w+)", page))
    assert used - written == set()
    assert len(used) > 20
