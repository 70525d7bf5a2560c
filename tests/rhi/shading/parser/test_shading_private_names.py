"""Private names (`__x`) mean in shaders what they mean in Python. Stages of other languages are refused by
name."""

import itertools

import numpy as np
import pytest

import rhi
import rhi.shading as sl
from rhi.errors import ShaderError
from rhi.shading.language.source import mangle_name
from rhi.shading.parser.foreign_stages import FOREIGN_STAGES, foreign_stage_tip

_Uses__offset = 5.0
"""What `__offset` means in the class `Uses`."""


class Base(sl.Shader):
    work_group = (1,)
    out: sl.StorageRW[float]
    __scale = 3.0
    __table = (10.0, 20.0)

    def __twice(self, x: float) -> float:
        return x * 2.0

    @staticmethod
    def __half(__x: float) -> float:
        return __x / 2.0

    def base_value(self) -> float:
        __local = self.__twice(2.0) * self.__scale
        return __local + self.__half(8.0) + self.__table[1]


class Uses(Base):
    __values: sl.Storage[float]
    __scale = 7.0  # another name than the base's
    __memory = sl.shared(float, 2)

    def __twice(self, x: float) -> float:
        return x * 200.0

    def compute(self) -> None:
        self.__memory[0] = self.__values[0]
        self.out[0] = self.base_value()
        self.out[1] = self.__twice(1.0) + self.__scale
        self.out[2] = self._Base__scale + self._Base__twice(1.0)
        self.out[3] = self.__memory[0] + __offset  # noqa: F821


EXPECTED = [4.0 * 3.0 + 4.0 + 20.0, 207.0, 5.0, 11.0]


def test_private_names_are_those_of_the_class_that_writes_them():
    run = sl.run_compute(Uses, out=4, _Uses__values=np.array([6.0], np.float32))
    assert run["out"].tolist() == EXPECTED


@pytest.mark.parametrize("backend", ["gl", "cl", "wgpu"])
def test_private_names_are_legal_on_devices(backend):
    with rhi.create_device(backend) as device:
        out = device.storage(float, 4)
        device.dispatch(device.program(Uses), 1, out=out, _Uses__values=device.storage(float, [6.0]))
        assert out.read().tolist() == EXPECTED


NAMES = ("__x", "__x_", "__x__", "_x", "x__", "__", "___", "__x1", "___x")
CLASSES = ("A", "_A", "__A", "_", "__", "A_", "_A_b")


@pytest.mark.parametrize(("name", "cls"), list(itertools.product(NAMES, CLASSES)))
def test_names_are_mangled_as_python_mangles_them(name, cls):
    space = {}
    exec(f"class {cls}:\n    def f(self):\n        return self.{name}\n", space)
    assert space[cls].f.__code__.co_names == (mangle_name(name, cls),)


class Outside(sl.Shader):
    out: sl.StorageRW[float]

    def compute(self) -> None:
        self.out[0] = self.__missing


class Hidden(Base):
    def compute(self) -> None:
        self.out[0] = self.__scale  # the base's is `_Base__scale`


@pytest.mark.parametrize(("shader", "name"), [(Outside, "_Outside__missing"), (Hidden, "_Hidden__scale")])
def test_a_private_name_that_the_class_lacks_is_refused_by_its_full_name(shader, name):
    with pytest.raises(ShaderError, match=name) as error:
        sl.compile_shader(shader)
    assert error.value.rule.id == "shading-unknown-member"


# -- stages of others


def with_method(name, call=""):
    """Return a shader with a method, which its stage calls if `call` says so."""
    return sl.from_source(
        f"""
import rhi.shading as sl

class Staged(sl.Shader):
    out: sl.StorageRW[float]

    def {name}(self) -> float:
        return 1.0

    def compute(self) -> None:
        self.out[0] = {call or "2.0"}
"""
    )


FOREIGN = (
    "geometry", "geometry_shader", "tess_control", "tess_evaluation", "tessellation_control", "hull", "domain",
    "mesh", "task", "ray_generation", "closest_hit", "any_hit", "miss", "pixel", "PixelShader", "vs_main",
    "vertex_main", "fragmentMain", "kernel", "main", "vert", "frag", "Vertex",
)  # fmt: skip


@pytest.mark.parametrize("name", FOREIGN)
def test_a_method_that_looks_like_a_stage_is_refused_with_a_tip(name):
    with pytest.raises(ShaderError, match=name) as error:
        sl.compile_shader(with_method(name))
    assert error.value.rule.id == "shading-stages"
    assert error.value.tip == foreign_stage_tip(name) != ""
    sl.compile_shader(with_method(name, f"self.{name}()"))  # a helper may have any name


@pytest.mark.parametrize(
    "name", ["shade", "geometry_term", "meshes", "missing", "compute_light", "domain_size", "kernels"]
)
def test_other_methods_are_helpers(name):
    sl.compile_shader(with_method(name))


def test_each_name_of_the_table_is_found():
    assert all(foreign_stage_tip(name) for name in FOREIGN_STAGES)
