"""Arrays as NumPy makes them: repacked structs, volumes without an axis of channels, texels of float64."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from testing_kit import backend_works

import rhi
import rhi.shading as sl
from rhi import BufferUsage, Device, Format, TextureKind
from rhi.contract.descriptors import DRAW_UNINDEXED


class Inner(sl.Struct):
    direction: sl.vec3
    weights: sl.Array[sl.vec2] = sl.array(sl.vec2, 2)


class Padded(sl.Struct):
    a: sl.vec3
    b: sl.vec2
    m: sl.mat3
    inner: Inner
    last: int


def fill(dtype: np.dtype[Any], count: int, seed: int) -> np.ndarray[Any, Any]:
    """Return elements whose fields, at any depth, have random numbers; padding is 0."""
    random = np.random.default_rng(seed)
    array = np.zeros(count, dtype)

    def fill_fields(part: np.ndarray[Any, Any]) -> None:
        for name in part.dtype.names or ():
            if part[name].dtype.names:
                fill_fields(part[name])
            else:
                part[name] = random.integers(0, 1000, part[name].shape)

    fill_fields(array)
    return array


def rebuild(array: np.ndarray[Any, Any], names: list[str] | None = None) -> np.ndarray[Any, Any]:
    """Return the array with packed fields, in another order of names."""
    base = array.dtype
    fields = [(name, base[name]) for name in names or base.names or ()]
    packed = np.zeros(len(array), fields)
    for name, _ in fields:
        packed[name] = array[name]
    return packed


REPACKED: dict[str, Callable[[np.ndarray[Any, Any]], np.ndarray[Any, Any]]] = {
    "concatenate": lambda a: np.concatenate([a[:1], a[1:]]),
    "append": lambda a: np.append(a[:2], a[2:]),
    "hstack": lambda a: np.hstack([a[:1], a[1:]]),
    "stack": lambda a: np.stack([a[:2], a[2:]]).reshape(-1),
    "packed": rebuild,
    "another order": lambda a: rebuild(a, list(a.dtype.names or ())[::-1]),
    "byte order": lambda a: np.concatenate([a]).astype(np.concatenate([a]).dtype.newbyteorder(">")),
    "as it was": lambda a: a,
}


@pytest.fixture
def array() -> np.ndarray[Any, Any]:
    return fill(Padded.dtype, 4, 3)


class Corner(sl.Struct):
    position: sl.vec2


class Flat(sl.Shader):
    def vertex(self, v: Corner) -> sl.vec4:
        return sl.vec4(v.position, 0.5, 1.0)

    def fragment(self) -> sl.vec4:
        return sl.vec4(1.0)


class Summing(sl.Shader):
    work_group = (4,)
    elements: sl.Storage[Padded]
    sums: sl.StorageRW[float]

    def compute(self) -> None:
        index = sl.global_id().x
        element = self.elements[index]
        self.sums[index] = element.b.y + element.inner.weights[1].x + float(element.last)


def use_storage(device: Device, array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    return device.storage(Padded, array).read()


def use_storage_write(device: Device, array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    storage = device.storage(Padded, 4)
    storage.write(array)
    return storage.read()


def use_buffer_write(device: Device, array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    buffer = device.buffer(4, Padded.dtype)
    buffer.write(array)
    return buffer.read()


def use_stream_buffer(device: Device, array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    buffer = device.buffer(4, Padded.dtype, usage=BufferUsage.STREAM)
    buffer.write(array[:2])
    buffer.write(array[2:], 2)
    return buffer.read()


def use_buffer(device: Device, array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    return device.buffer(array, Padded.dtype).read()


def use_transient(device: Device, array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    part = device.transient.storage(Padded, array)
    data = device.stream.filter(rhi.Op.WRITE_BUFFER)[-1]["data"]
    assert part.count == 4
    return np.frombuffer(data, Padded.dtype)


USES = [use_storage, use_storage_write, use_buffer_write, use_stream_buffer, use_buffer, use_transient]


@pytest.mark.parametrize("repacked", REPACKED)
@pytest.mark.parametrize("use", USES)
def test_structs_are_taken_as_numpy_repacks_them(
    null_device: Device,
    array: np.ndarray[Any, Any],
    use: Callable[[Device, np.ndarray[Any, Any]], np.ndarray[Any, Any]],
    repacked: str,
) -> None:
    result = use(null_device, REPACKED[repacked](array))
    assert result.dtype == Padded.dtype
    assert result.tobytes() == array.tobytes()


@pytest.mark.parametrize("repacked", REPACKED)
@pytest.mark.parametrize("backend", ["null", "gl", "cl", "wgpu"])
def test_shaders_read_repacked_structs(backend: str, repacked: str, array: np.ndarray[Any, Any]) -> None:
    expected = array["b"][:, 1] + array["inner"]["weights"][:, 1, 0] + array["last"]
    values = REPACKED[repacked](array)
    if backend == "null":  # NumPy runs the shader, with arrays of the program
        sums = sl.run_compute(Summing, 1, elements=values, sums=4)["sums"]
    else:
        device = open_device(backend)
        storage = device.storage(float, 4)
        device.dispatch(device.program(Summing), 1, elements=device.storage(Padded, values), sums=storage)
        sums = storage.read()
    assert sums.tolist() == expected.tolist()


@cache
def open_device(backend: str) -> Device:
    if not backend_works(backend):
        pytest.skip(f"no device of {backend} here")
    return rhi.create_device(backend)


@pytest.mark.parametrize("repacked", REPACKED)
def test_uniforms_are_taken_as_numpy_repacks_them(null_device: Device, repacked: str) -> None:
    values = fill(Padded.uniform_dtype, 4, 5)
    uniforms = null_device.uniform_array(Padded, 4)
    uniforms.write(REPACKED[repacked](values))
    written = null_device.stream.filter(rhi.Op.WRITE_BUFFER)[-1]["data"]
    stride = len(written) // 4
    for i, value in enumerate(values):
        assert written[i * stride :][: Padded.uniform_dtype.itemsize] == value.tobytes()


def test_draws_are_taken_in_another_order_of_fields(null_device: Device) -> None:
    mesh = null_device.mesh({"position": np.zeros((3, 2), np.float32)})
    draws = mesh.draws(np.zeros(2, int), 3)
    assert draws.dtype == DRAW_UNINDEXED

    image = null_device.texture((4, 4), Format.RGBA8)
    with null_device.render_pass(image):
        null_device.draw_many(
            null_device.program(Flat), mesh, rebuild(draws, list(draws.dtype.names or ())[::-1])
        )
    assert null_device.stream.draws()[-1].draw_arguments["count"].tolist() == [3, 3]


WRONG: dict[str, Callable[[np.ndarray[Any, Any]], np.ndarray[Any, Any]]] = {
    "a name less": lambda a: rebuild(a, list(a.dtype.names or ())[:-1]),
    "another name": lambda a: rebuild(a).astype(
        [(name if name != "b" else "c", rebuild(a).dtype[name]) for name in a.dtype.names or ()]
    ),
    "another type": lambda a: rebuild(a).astype(
        [(name, rebuild(a).dtype[name] if name != "last" else np.float32) for name in a.dtype.names or ()]
    ),
    "another shape": lambda a: np.zeros(
        4, [(name, a.dtype[name] if name != "b" else ("f4", 3)) for name in a.dtype.names or ()]
    ),
    "a field more": lambda a: np.zeros(
        4, [*((name, a.dtype[name]) for name in a.dtype.names or ()), ("z", "f4")]
    ),
    "bytes": lambda a: a.view(np.uint8),
}


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("use", USES)
def test_other_names_and_types_are_refused(
    null_device: Device,
    array: np.ndarray[Any, Any],
    use: Callable[[Device, np.ndarray[Any, Any]], np.ndarray[Any, Any]],
    wrong: str,
) -> None:
    with pytest.raises(rhi.ValidationError, match=r"layout-mismatch|buffer-dtype"):
        use(null_device, WRONG[wrong](array))


FIELDS = st.lists(
    st.sampled_from([float, int, sl.vec2, sl.vec3, sl.vec4, sl.mat2, sl.mat3, sl.mat4]),
    min_size=1,
    max_size=6,
)


@settings(max_examples=40)
@given(FIELDS, st.integers(1, 5), st.integers(0, 99))
def test_random_structs_survive_concatenate(types: list[Any], count: int, seed: int) -> None:
    struct = type("S", (sl.Struct,), {"__annotations__": {f"f{i}": kind for i, kind in enumerate(types)}})
    array = fill(struct.dtype, count, seed)
    with rhi.create_device("null") as device:
        assert device.storage(struct, np.concatenate([array])).read().tobytes() == array.tobytes()


# -- texels ----------------------------------------------------------------------------------------------

LAYERED = [TextureKind.D3, TextureKind.D2_ARRAY]
ONE_CHANNEL = [format for format in Format if format.components == 1 and not format.is_depth]


@pytest.mark.parametrize("kind", LAYERED)
@pytest.mark.parametrize("format", ONE_CHANNEL)
@pytest.mark.parametrize("shape", [(4, 5, 6), (2, 3, 4), (5, 4, 3), (3, 2, 2)])
def test_layers_of_one_channel_need_no_axis_for_it(
    null_device: Device, kind: TextureKind, format: Format, shape: tuple[int, ...]
) -> None:
    texels = np.arange(np.prod(shape)).reshape(shape).astype(format.dtype)
    texture = null_device.texture(texels, format, kind=kind)
    assert (texture.layers, *texture.size[::-1]) == shape
    for layer in range(shape[0]):
        assert np.array_equal(texture.read(layer=layer), texels[layer])
    texture.write(texels[::-1])
    assert np.array_equal(texture.read(layer=0), texels[-1])


@pytest.mark.parametrize("dtype", ["u1", "u2", "f2", "f4", "f8", "i4", "u4"])
def test_the_format_of_a_volume_follows_from_its_dtype(null_device: Device, dtype: str) -> None:
    texels = np.arange(4 * 5 * 6).reshape(4, 5, 6).astype(dtype)
    volume = null_device.texture(texels, kind=TextureKind.D3)
    assert volume.format.components == 1
    assert (volume.layers, *volume.size[::-1]) == (4, 5, 6)
    assert np.array_equal(volume.read(layer=2), texels[2])


def test_an_axis_for_channels_is_one_as_before(null_device: Device) -> None:
    for shape, expected in (((4, 5, 6, 1), (4, 5, 6)), ((5, 6, 2), (1, 5, 6)), ((5, 6, 1), (1, 5, 6))):
        texture = null_device.texture(np.zeros(shape, np.uint8), kind=TextureKind.D3)
        assert (texture.layers, *texture.size[::-1]) == expected


def test_textures_of_the_host_take_the_same_arrays() -> None:
    volume = np.arange(4 * 5 * 6.0).reshape(4, 5, 6)
    texture = sl.HostTexture(volume, Format.R32F, TextureKind.D3)
    assert texture.levels[0].shape == (4, 5, 6, 1)
    assert texture.levels[0].dtype == np.float32
    volume[:] = 0  # it has copied them
    assert texture.levels[0].max() == 119
    with pytest.raises(rhi.RhiError, match="shading-arguments"):
        sl.HostTexture(volume, Format.R32F)


def test_a_plain_texture_takes_no_volume(null_device: Device) -> None:
    with pytest.raises(rhi.ValidationError, match=r"texture-data(.|\n)*kind=TextureKind\.D3"):
        null_device.texture(np.zeros((4, 5, 6), np.uint8))
    with pytest.raises(rhi.ValidationError, match="texture-data"):
        null_device.texture((5, 4), Format.R8).write(np.zeros((4, 5, 6), np.uint8))


FLOATS = [format for format in Format if format.dtype.kind == "f" and not format.is_depth]


@pytest.mark.parametrize("format", FLOATS)
def test_float64_becomes_the_floats_of_the_format(null_device: Device, format: Format) -> None:
    texels = np.linspace(-3, 3, 4 * 5 * format.components).reshape(4, 5, format.components)
    texture = null_device.texture(texels, format)
    assert np.array_equal(texture.read().reshape(texels.shape), texels.astype(format.dtype))
    texture.write(2 * texels)
    assert np.array_equal(texture.read().reshape(texels.shape), (2 * texels).astype(format.dtype))
    with pytest.raises(rhi.ValidationError, match=r"texture-data(.|\n)*1e\+300 of float64"):
        texture.write(np.full_like(texels, 1e300))


def test_float64_without_a_format_is_float32(null_device: Device) -> None:
    assert null_device.texture(np.zeros((4, 5, 3))).format is Format.RGBA32F
    assert null_device.texture(np.full((4, 5), np.nan)).format is Format.R32F


@pytest.mark.parametrize(
    ("texels", "format", "tip"),
    [
        (np.zeros((4, 5), bool), None, r"mask\.astype\(np\.uint8\) \* 255"),
        (np.zeros((4, 5), bool), Format.R8, r"mask\.astype\(np\.uint8\) \* 255"),
        (np.zeros((4, 5, 4)), Format.RGBA8, r"\(array \* 255\)\.astype\(np\.uint8\)"),
        (np.zeros((4, 5, 4), int), Format.RGBA8, r"array\.astype\(np\.uint8\) converts it"),
        (np.zeros((4, 5, 4), np.uint8), Format.RGBA32F, r"array\.astype\(np\.float32\) converts it"),
        (np.zeros((4, 5, 4), int), None, r"array\.astype\(np\.int32\)"),
        (np.zeros((4, 5, 6), np.uint8), None, r"kind=TextureKind\.D3"),
    ],
)
def test_a_tip_names_the_mend(
    null_device: Device, texels: np.ndarray[Any, Any], format: Format | None, tip: str
) -> None:
    with pytest.raises(rhi.ValidationError, match=rf"texture-data(.|\n)*tip: +.*{tip}"):
        null_device.texture(texels, format)


def test_a_tip_names_the_mend_of_buffers(null_device: Device) -> None:
    with pytest.raises(
        rhi.ValidationError, match=r"buffer-dtype(.|\n)*array\.astype\(np\.float32\) converts it"
    ):
        null_device.buffer(4, np.float32).write(np.zeros(4))
    with pytest.raises(
        rhi.ValidationError, match=r"buffer-dtype(.|\n)*array\.astype\(np\.float32\) converts it"
    ):
        null_device.buffer(np.zeros(4), np.float32)
