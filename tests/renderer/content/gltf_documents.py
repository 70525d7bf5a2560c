"""glTF documents made of arrays, for tests."""

import json
import struct

import numpy as np

COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)


class GltfDocument:
    """A document under construction, and the bytes of its only buffer."""

    def __init__(self, **values):
        self.values = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], **values}
        self.data = bytearray()

    def view(self, data, **more):
        """Add a buffer view with these bytes; return its number."""
        self.data += bytes(-len(self.data) % 4)
        views = self.values["bufferViews"]
        views.append({"buffer": 0, "byteOffset": len(self.data), "byteLength": len(data), **more})
        self.data += data
        return len(views) - 1

    def accessor(self, array, **more):
        """Add an accessor of an array (n,) or (n, size); return its number."""
        held = np.asarray(array)
        size = 1 if held.ndim == 1 else held.shape[1]
        given = {
            "bufferView": self.view(held.tobytes()),
            "componentType": COMPONENTS[held.dtype.str[1:]],
            "count": len(held),
            "type": TYPES[size],
        }
        return self.add("accessors", **{**given, **more})

    def add(self, name, **fields):
        """Append to a list of the document; return the number of what was added."""
        self.values.setdefault(name, []).append(fields)
        return len(self.values[name]) - 1

    def mesh(self, positions=TRIANGLE, indices=None, **more):
        """Add a mesh of one primitive; return its number. Arrays in `more` are attributes."""
        arrays = {name: value for name, value in more.items() if isinstance(value, np.ndarray)}
        attributes = {"POSITION": self.accessor(np.asarray(positions, np.float32))}
        attributes |= {name: self.accessor(array) for name, array in arrays.items()}
        primitive = {"attributes": attributes}
        primitive |= {name: value for name, value in more.items() if name not in arrays}
        if indices is not None:
            primitive["indices"] = self.accessor(np.asarray(indices))
        return self.add("meshes", primitives=[primitive])

    def animate(self, node, path, times, values, interpolation="LINEAR", animation=None):
        """Add a channel to a new animation, or to the one of that number; return the animation's number."""
        if animation is None:
            animation = self.add("animations", samplers=[], channels=[])
        held = self.values["animations"][animation]
        held["samplers"].append(
            {
                "input": self.accessor(np.asarray(times, np.float32)),
                "output": self.accessor(np.asarray(values, np.float32)),
                "interpolation": interpolation,
            }
        )
        number = len(held["samplers"]) - 1
        held["channels"].append({"sampler": number, "target": {"node": node, "path": path}})
        return animation

    def write(self, path):
        """Write a `.glb`, or a `.gltf` with its buffer beside it; return the path as text."""
        values = {name: value for name, value in self.values.items() if value != []}
        if self.data:
            values["buffers"] = [{"byteLength": len(self.data)}]
        if path.suffix == ".glb":
            path.write_bytes(pack_glb(values, bytes(self.data)))
        else:
            if self.data:
                (path.parent / "data.bin").write_bytes(self.data)
                values["buffers"][0]["uri"] = "data.bin"
            path.write_text(json.dumps(values))
        return str(path)


def pack_glb(values, data):
    """Return the bytes of a `.glb`."""
    text = json.dumps(values).encode()
    text += b" " * (-len(text) % 4)
    data += bytes(-len(data) % 4)
    chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
    if data:
        chunks += struct.pack("<II", len(data), 0x004E4942) + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks
