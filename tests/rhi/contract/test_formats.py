"""The properties of formats."""

import pickle
import re

import numpy as np
import pytest

from rhi.contract.formats import COLOR_FORMATS, DEPTH_FORMATS, ChannelKind, Format, IndexFormat


def test_formats_with_equal_parts_are_still_different():
    assert Format.D24 is not Format.D32F
    assert len(set(Format)) == len(Format.__members__) == len(list(Format))


UNPACKED = [f for f in COLOR_FORMATS if not f.is_packed]


@pytest.mark.parametrize("format", [f for f in COLOR_FORMATS if f.is_packed], ids=lambda f: f.name)
def test_a_packed_texel_is_one_number_for_all_channels(format):
    letters = re.fullmatch(r"(RGB)(\d+)(A)(\d+)(UI|)|(R)(\d+)(G)(\d+)(B)(\d+)(F)", format.name).groups()
    bits = [int(n) for n in letters if n and n.isdigit()]
    assert format.channel_bits == (tuple(bits) if len(bits) == 3 else (bits[0],) * 3 + (bits[1],))
    assert sum(format.channel_bits) == 32
    assert (format.components, format.dtype, format.transfer_bytes, format.texel_bytes) == (
        1,
        np.uint32,
        4,
        4,
    )
    assert format.channels == len(format.channel_bits)


@pytest.mark.parametrize("format", UNPACKED, ids=lambda f: f.name)
def test_a_color_texel_is_as_large_as_its_channels(format):
    assert format.components == format.channels
    assert format.texel_bytes == format.channels * format.dtype.itemsize
    assert not format.is_depth
    assert not format.has_stencil


@pytest.mark.parametrize("format", DEPTH_FORMATS, ids=lambda f: f.name)
def test_a_depth_format_reads_as_one_float(format):
    assert format.is_depth
    assert (format.channels, format.dtype) == (1, np.float32)
    assert format.has_stencil == format.name.endswith("S8")


@pytest.mark.parametrize("format", UNPACKED, ids=lambda f: f.name)
def test_a_formats_name_tells_its_channels_and_bits(format):
    letters, bits, suffix = re.fullmatch(r"(RGBA|RG|R)(\d+)(F|UI|I|_SNORM|_SRGB|)", format.name).groups()
    kinds = {"": "UNORM", "_SNORM": "SNORM", "_SRGB": "SRGB", "F": "FLOAT", "UI": "UINT", "I": "INT"}
    assert (format.channels, format.dtype.itemsize * 8) == (len(letters), int(bits))
    assert format.kind.name == kinds[suffix]


def test_integer_formats_are_those_that_shaders_read_as_integers():
    integers = {f for f in Format if f.is_integer}
    assert integers == {f for f in Format if f.kind in (ChannelKind.UINT, ChannelKind.INT)}
    assert all(f.name.endswith("I") for f in integers)


@pytest.mark.parametrize("format", list(Format), ids=lambda f: f.name)
def test_a_format_survives_pickling_as_itself(format):
    assert pickle.loads(pickle.dumps(format)) is format


@pytest.mark.parametrize(("format", "size"), [(IndexFormat.UINT16, 2), (IndexFormat.UINT32, 4)])
def test_an_index_format_knows_its_size(format, size):
    assert format.size == format.dtype.itemsize == size
    assert format.dtype.kind == "u"
