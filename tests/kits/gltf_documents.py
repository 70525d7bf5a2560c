"""glTF documents made of arrays, for tests."""

import json
import struct

import numpy as np

COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
TRIANGLE = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float32)

STRIP = np.array([[x, y, 0] for y in range(5) for x in (0, 1)], np.float32)
CORNERS = np.array(
    [[2 * r + a, 2 * r + b, 2 * r + c] for r in range(4) for a, b, c in ((0, 1, 2), (1, 3, 2))], np.uint16
)
UP = np.tile(np.float32([[0, 0, 1]]), (len(STRIP), 1))


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
        elements = np.asarray(array)
        size = 1 if elements.ndim == 1 else elements.shape[1]
        properties = {
            "bufferView": self.view(elements.tobytes()),
            "componentType": COMPONENTS[elements.dtype.str[1:]],
            "count": len(elements),
            "type": TYPES[size],
        }
        return self.add("accessors", **{**properties, **more})

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
        document_animation = self.values["animations"][animation]
        document_animation["samplers"].append(
            {
                "input": self.accessor(np.asarray(times, np.float32)),
                "output": self.accessor(np.asarray(values, np.float32)),
                "interpolation": interpolation,
            }
        )
        number = len(document_animation["samplers"]) - 1
        document_animation["channels"].append({"sampler": number, "target": {"node": node, "path": path}})
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
            path.write_text(json.dumps(values), encoding="utf-8")
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


def rotation_quaternion(degrees, axis=2):
    """The quaternion of a rotation about an axis."""
    quaternion = np.zeros(4)
    quaternion[axis], quaternion[3] = np.sin(np.radians(degrees) / 2), np.cos(np.radians(degrees) / 2)
    return quaternion


def make_skinned(moves=True, root=None):
    """A strip along y, bent by its second joint at y = 2, in a file whose mesh's own node is to be
    ignored."""
    document = GltfDocument(
        nodes=[
            {"name": "body", "children": [1, 3], **(root or {})},
            {"name": "hip", "children": [2]},
            {"name": "knee", "translation": [0, 2, 0]},
            {"name": "mesh", "mesh": 0, "skin": 0, "translation": [50, 0, 0]},
        ]
    )
    share = np.clip(STRIP[:, 1] / 4, 0, 1)
    weights = np.stack([1 - share, share, 0 * share, 0 * share], 1).astype(np.float32)
    joints = np.tile(np.array([[0, 1, 0, 0]], np.uint8), (len(STRIP), 1))
    document.mesh(STRIP, CORNERS.ravel(), NORMAL=UP, JOINTS_0=joints, WEIGHTS_0=weights)
    binds = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))
    binds[1, 3, 1] = -2  # column-major: moves by -2 along y
    document.add("skins", joints=[1, 2], inverseBindMatrices=document.accessor(binds.reshape(2, 16)))
    if moves:
        document.animate(
            2,
            "rotation",
            [0, 1, 2],
            [rotation_quaternion(0), rotation_quaternion(90), rotation_quaternion(0)],
        )
    return document


def make_morphing(track=True, weights=(0.25, 0.0), normals=False):
    """A triangle with two targets: along x, and along y."""
    document = GltfDocument(nodes=[{"mesh": 0, "translation": [0, 0, 5]}])
    document.mesh(NORMAL=UP[:3])
    shifts = [
        {"POSITION": document.accessor(np.tile(np.float32([shift]), (3, 1)))}
        for shift in ((4, 0, 0), (0, 8, 0))
    ]
    if normals:
        shifts[0]["NORMAL"] = document.accessor(np.tile(np.float32([[1, 0, -1]]), (3, 1)))
    mesh = document.values["meshes"][0]
    mesh["primitives"][0]["targets"] = shifts
    mesh["weights"] = list(weights)
    if track:
        document.animate(0, "weights", [0, 1, 2], [0, 0, 1, 0.5, 0, 1])
    return document
