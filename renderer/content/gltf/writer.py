"""Scenes as glTF 2.0 files.

The scene's arrays are written as they are: its vertices are one interleaved buffer view, and the accessors of
a mesh begin at its first vertex; so are its indices. Transforms are JSON numbers, which hold float64 exactly.
Reading the file gives the same arrays. What glTF can't say is kept in extras
(`renderer.content.gltf.extras`), or listed.
"""

from __future__ import annotations

import json
import struct
from io import BytesIO
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from renderer import rules
from renderer.content.gltf.animations import KINDS
from renderer.content.gltf.container import BINARY_CHUNK, JSON_CHUNK, MAGIC
from renderer.content.gltf.extras import FARTHEST, HOLDER, INFINITE, KEY, SPECULAR, write_scene_extras
from renderer.content.gltf.materials import ALPHA_MODES, MAGNIFY, MINIFY, WRAPS
from renderer.content.gltf.nodes import CANDELA
from renderer.content.gltf.primitives import ATTRIBUTES
from renderer.content.gltf.tracks import LINEAR, NodeMotion, Track
from renderer.content.material_shaders import Brushed
from renderer.content.thread_maps import map_in_threads
from renderer.light_kinds.kind import LightKind
from renderer.light_kinds.table import LIGHT_KINDS
from renderer.scene.arrays import Floats
from renderer.scene.images import ImagePixels, has_high_range, make_likeness
from renderer.scene.materials import AlphaMode, ShadingModel
from renderer.scene.omissions import Omission, Omissions
from renderer.scene.scene import Scene
from rhi import SamplerDescriptor
from rhi.errors import refuse
from rhi.math import Camera, Depth, Orthographic, Perspective

FORMATS: Final = (".glb", ".gltf")
"""The extensions of the files that can be written."""

_PATHS: Final = ("translation", "rotation", "scale")
_KINDS: Final = {kind: name for name, kind in KINDS.items()}
_MODES: Final = {mode: name for name, mode in ALPHA_MODES.items()}
_VERTICES, _INDICES = 34962, 34963  # targets of buffer views
_MAGNIFY: Final = {value: code for code, value in MAGNIFY.items()}
_MINIFY: Final = {value: code for code, value in MINIFY.items()}
_WRAPS: Final = {value: code for code, value in WRAPS.items()}
_SLOTS: Final = {
    "normal_texture": ("normalTexture", "normal_scale", "scale", 1.0),
    "occlusion_texture": ("occlusionTexture", "occlusion_strength", "strength", 1.0),
}


def write_gltf(scene: Scene, path: str | Path) -> tuple[Omission, ...]:
    """Write a scene to a file, and return what the file can't hold; see `renderer.content.save_scene`."""
    file = Path(path)
    check_model_name(file)
    writer = _GltfWriter(scene)
    writer.write_all()
    writer.save(file)
    return tuple(writer.omissions)


def check_model_name(file: Path) -> None:
    """Refuse a file whose name names no format that scenes are written in: `scene-unknown-format`."""
    if file.suffix.lower() not in FORMATS:
        call = f"save_scene({str(file)!r})"
        refuse(rules.UNKNOWN_FORMAT, call, file.suffix or file.name, ", ".join(FORMATS))


class _GltfWriter:
    """A file under construction."""

    def __init__(self, scene: Scene) -> None:
        self.omissions = Omissions()
        self._scene = scene
        self._chunks: list[bytes] = []
        self._size = 0
        self._lists: dict[str, list[Any]] = {}
        self._extensions: set[str] = set()
        self._lights: list[dict[str, Any]] = []
        self._textures: dict[tuple[int, int], int] = {}

    def write_all(self) -> None:
        """Collect everything in the scene."""
        self._write_images()
        self._lists["materials"] = [
            self._material(row, index) for index, row in enumerate(self._scene.materials)
        ]
        primitives = self._write_meshes()
        motions = self._write_nodes(primitives)
        self._write_animations(motions)
        self._write_lights()
        self._write_views()
        for attribute in ("fog", "bloom", "ambient_occlusion", "depth_of_field", "environment"):
            if getattr(self._scene, attribute) is not None:
                self.omissions.add(attribute.replace("_", " "), "scene")
        if len(self._scene.decals):
            self.omissions.add("decals", "scene", len(self._scene.decals))
        for custom in self._scene.shaders:
            if custom.shader is not Brushed:
                self.omissions.add("shaders of materials", custom.shader.__name__)

    def save(self, file: Path) -> None:
        """Write the file, and its buffer beside it unless it is a `.glb`."""
        data = b"".join(self._chunks)
        values: dict[str, Any] = {"asset": {"version": "2.0", "generator": "rhi renderer"}, "scene": 0}
        values |= {name: elements for name, elements in self._lists.items() if elements}
        if self._lights:
            self._extensions.add("KHR_lights_punctual")
            values["extensions"] = {"KHR_lights_punctual": {"lights": self._lights}}
        if self._extensions:
            values["extensionsUsed"] = sorted(self._extensions)
        buffer: dict[str, Any] = {"byteLength": len(data)}
        values["buffers"] = [buffer]
        if file.suffix.lower() == ".gltf":
            binary = file.with_suffix(".bin")
            buffer["uri"] = binary.name
            binary.write_bytes(data)
            file.write_text(json.dumps(values, allow_nan=False), encoding="utf-8")
            return
        text = json.dumps(values, allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        total = 28 + len(text) + len(data)
        with file.open("wb") as out:
            out.write(struct.pack("<4sII", MAGIC, 2, total))
            out.write(struct.pack("<II", len(text), JSON_CHUNK) + text)
            out.write(struct.pack("<II", len(data), BINARY_CHUNK) + data)

    def _add(self, name: str, values: dict[str, Any]) -> int:
        elements = self._lists.setdefault(name, [])
        elements.append(values)
        return len(elements) - 1

    def _view(self, data: bytes, **more: Any) -> int:
        number = self._add(
            "bufferViews", {"buffer": 0, "byteOffset": self._size, "byteLength": len(data), **more}
        )
        padded = data + bytes(-len(data) % 4)
        self._chunks.append(padded)
        self._size += len(padded)
        return number

    def _write_images(self) -> None:
        colors = set(self._scene.textures["image"][self._scene.textures["is_color"] == 1].tolist())
        likenesses = [
            make_likeness(image, is_color=index in colors) for index, image in enumerate(self._scene.images)
        ]
        with map_in_threads(_encode, likenesses) as encoded_images:
            for image, encoded in zip(self._scene.images, encoded_images, strict=True):
                fields: dict[str, Any] = {"bufferView": self._view(encoded), "mimeType": "image/png"}
                if has_high_range(image):
                    texels = image.astype("<f2").tobytes()
                    fields["extras"] = {KEY: {"texels": self._view(texels), "size": image.shape[:2]}}
                self._add("images", fields)
        for number, sampler in enumerate(self._scene.samplers):
            self._add("samplers", self._sampler(sampler, number))

    def _sampler(self, sampler: SamplerDescriptor, number: int) -> dict[str, Any]:
        wraps = [_WRAPS.get(wrap) for wrap in (sampler.wrap_u, sampler.wrap_v)]
        if None in wraps or sampler.max_anisotropy != 1.0:
            self.omissions.add("borders and anisotropy of a sampler", f"samplers[{number}]")
        return {
            "magFilter": _MAGNIFY[sampler.magnify],
            "minFilter": _MINIFY[sampler.minify, sampler.mip],
            "wrapS": wraps[0] or 33071,
            "wrapT": wraps[1] or 33071,
        }

    def _texture(self, row: Any) -> dict[str, Any]:
        """Return the reference of a material to a row of the scene's textures."""
        texture = self._scene.textures[row]
        image, sampler = int(texture["image"]), int(texture["sampler"])
        if (image, sampler) not in self._textures:
            default = self._scene.samplers[sampler] == SamplerDescriptor()
            fields = {"source": image, **({} if default else {"sampler": sampler})}
            self._textures[image, sampler] = self._add("textures", fields)
        use: dict[str, Any] = {"index": self._textures[image, sampler]}
        if texture["uv_set"]:
            use["texCoord"] = int(texture["uv_set"])
        (xx, xy, u), (yx, yy, v) = texture["transform"].astype(np.float64).tolist()
        if (xx, xy, u, yx, yy, v) != (1.0, 0.0, 0.0, 0.0, 1.0, 0.0):
            self._extensions.add("KHR_texture_transform")
            turned = float(np.arctan2(-yx, xx)) if xy or yx else 0.0
            scale = [float(np.hypot(xx, yx)), float(np.hypot(xy, yy))] if turned else [xx, yy]
            if turned and xx * yy - xy * yx < 0.0:
                scale[1] = -scale[1]
            use["extensions"] = {
                "KHR_texture_transform": {"offset": [u, v], "rotation": turned, "scale": scale}
            }
        return use

    def _material(self, row: NDArray[Any], index: int) -> dict[str, Any]:
        """Return a material; one of the specular model is a likeness, with its parameters in extras."""
        color = [float(value) for value in row["base_color"]]
        pbr: dict[str, Any] = {"baseColorFactor": color}
        fields: dict[str, Any] = {"pbrMetallicRoughness": pbr}
        tint = row["light_map_color"].tolist()
        extras: dict[str, Any] = {} if len(set(tint)) == 1 else {"light_map_color": tint}
        if row["texture"] >= 0:
            pbr["baseColorTexture"] = self._texture(row["texture"])
        if row["model"] == ShadingModel.METALLIC_ROUGHNESS:
            pbr |= {"metallicFactor": float(row["metallic"]), "roughnessFactor": float(row["roughness"])}
            if row["metallic_roughness_texture"] >= 0:
                pbr["metallicRoughnessTexture"] = self._texture(row["metallic_roughness_texture"])
        else:
            extras |= {name: row[name].tolist() for name in SPECULAR}
            alpha = np.sqrt(2.0 / (float(row["shininess"]) + 2.0))  # the exponent of about the same highlight
            pbr |= {"metallicFactor": 0.0, "roughnessFactor": float(np.sqrt(alpha))}
        for field, (name, factor, written, default) in _SLOTS.items():
            if row[field] >= 0:
                fields[name] = self._texture(row[field])
                if row[factor] != default:
                    fields[name][written] = float(row[factor])
        emissive, image = [float(value) for value in row["emissive"]], int(row["emissive_texture"])
        if row["emission"]:
            extras |= {"emission": float(row["emission"]), "emissive": emissive}
            if not any(emissive):
                emissive = [float(value) * float(row["emission"]) for value in color[:3]]
                extras["has_emissive_texture"] = image >= 0
                image = image if image >= 0 else int(row["texture"])
        if any(emissive):
            strength = 2.0 ** np.ceil(
                np.log2(max(*emissive, 1.0))
            )  # a power of two, so that nothing is rounded
            fields["emissiveFactor"] = [value / strength for value in emissive]
            if strength > 1.0:
                self._extensions.add("KHR_materials_emissive_strength")
                strength_fields = {"emissiveStrength": float(strength)}
                fields["extensions"] = {"KHR_materials_emissive_strength": strength_fields}
        if row["shader"] and self._scene.shaders[row["shader"] - 1].shader is Brushed:
            brushed = self._scene.parameters[row["shader"] - 1][index]
            fields.setdefault("extensions", {})["KHR_materials_anisotropy"] = self._anisotropy(brushed)
        if row["light_map_texture"] >= 0:
            fields.setdefault("extensions", {})["MOZ_lightmap"] = self._light_map(row)
        if image >= 0:
            fields["emissiveTexture"] = self._texture(image)
        if row["alpha_mode"] != AlphaMode.OPAQUE:
            fields["alphaMode"] = _MODES[AlphaMode(int(row["alpha_mode"]))]
        if row["alpha_cutoff"] != 0.5:
            fields["alphaCutoff"] = float(row["alpha_cutoff"])
        if row["double_sided"]:
            fields["doubleSided"] = True
        if extras:
            fields["extras"] = {KEY: extras}
        return fields

    def _anisotropy(self, brushed: Any) -> dict[str, Any]:
        """Return the parameters of `Brushed` as KHR_materials_anisotropy has them."""
        self._extensions.add("KHR_materials_anisotropy")
        anisotropy: dict[str, Any] = {
            "anisotropyStrength": float(brushed["anisotropy"]),
            "anisotropyRotation": float(brushed["anisotropy_rotation"]),
        }
        if brushed["anisotropy_texture"] >= 0:
            anisotropy["anisotropyTexture"] = self._texture(brushed["anisotropy_texture"])
        return anisotropy

    def _light_map(self, row: NDArray[Any]) -> dict[str, Any]:
        """Return the light map of a material as MOZ_lightmap has it, as bright as its brightest channel."""
        self._extensions.add("MOZ_lightmap")
        intensity = float(row["light_map_color"].max()) / CANDELA
        return {"texCoord": 0} | self._texture(row["light_map_texture"]) | {"intensity": intensity}

    def _write_meshes(self) -> list[dict[str, Any]]:
        """Write the vertices and indices of all meshes; return for each the attributes and indices of a
        primitive."""
        meshes = self._scene.meshes
        stride = meshes.vertices.dtype.itemsize
        rows = meshes.vertices
        if "tangent" in (rows.dtype.names or ()):
            rows = rows.copy()
            rows["tangent"][:, 3] = np.where(rows["tangent"][:, 3] < 0.0, -1.0, 1.0)  # without a stretch
        vertices = self._view(rows.tobytes(), byteStride=stride, target=_VERTICES)
        indices = self._view(meshes.indices.tobytes(), target=_INDICES)
        offsets = {name: description[1] for name, description in (meshes.vertices.dtype.fields or {}).items()}
        fields = {name: (field, types[0]) for name, (field, types) in ATTRIBUTES.items()}
        written = []
        for mesh, count in enumerate(meshes.vertex_counts.tolist()):
            first_index, index_count, base = (int(value) for value in meshes.ranges[mesh])
            position = meshes.vertices["position"][base : base + count]
            attributes = {}
            for name, (field, kind) in fields.items():
                if field not in offsets:
                    continue
                offset = offsets[field]
                accessor: dict[str, Any] = {
                    "bufferView": vertices,
                    "byteOffset": base * stride + offset,
                    "componentType": 5126,
                    "count": count,
                    "type": kind,
                }
                if name == "POSITION":
                    accessor |= {"min": position.min(0).tolist(), "max": position.max(0).tolist()}
                attributes[name] = self._add("accessors", accessor)
            order = self._add(
                "accessors",
                {
                    "bufferView": indices,
                    "byteOffset": 4 * first_index,
                    "componentType": 5125,
                    "count": index_count,
                    "type": "SCALAR",
                },
            )
            written.append({"attributes": attributes, "indices": order})
        return written

    def _write_nodes(self, primitives: list[dict[str, Any]]) -> list[tuple[NDArray[np.int64], NodeMotion]]:
        """Write nodes, and for each set of objects at a node a mesh; return the motions that can be
        written."""
        scene = self._scene
        nodes = scene.nodes
        objects = scene.objects
        order = np.argsort(objects.node, kind="stable")
        starts = np.searchsorted(objects.node[order], np.arange(len(nodes) + 1))
        written: list[dict[str, Any]] = []
        combined: dict[tuple[tuple[int, int], ...], int] = {}
        children: list[list[int]] = [[] for _ in range(len(nodes))]
        for row, parent in enumerate(nodes.parents.tolist()):
            if parent >= 0:
                children[parent].append(row)
        for row in range(len(nodes)):
            fields: dict[str, Any] = {"name": nodes.names[row]} if nodes.names[row] else {}
            fields |= {"children": children[row]} if children[row] else {}
            if (local := nodes.local[row]).tolist() != _IDENTITY:
                moved = local.copy()
                moved[:3, 3] = 0.0
                if moved.tolist() == _IDENTITY:
                    fields["translation"] = local[:3, 3].tolist()
                else:
                    fields["matrix"] = local.T.ravel().tolist()
            rows = order[starts[row] : starts[row + 1]]
            if len(rows):
                pairs = tuple(zip(objects.mesh[rows].tolist(), objects.material[rows].tolist(), strict=True))
                if pairs not in combined:
                    combined[pairs] = self._add("meshes", self._mesh(pairs, primitives))
                fields["mesh"] = combined[pairs]
            written.append(fields)
        unused = np.setdiff1d(np.arange(len(primitives)), objects.mesh)
        for mesh in unused.tolist():
            self._add("meshes", self._mesh(((mesh, -1),), primitives))
        motions = self._collect_motions(written)
        self._lists["nodes"] = written
        lists = {
            "dynamic": np.flatnonzero(nodes.dynamic),
            "hidden": np.flatnonzero(nodes.hidden_itself),
            "objects": order if (np.diff(order) < 0).any() else order[:0],
            "shadowless": np.flatnonzero(~objects.casts_shadow),
        }
        private = write_scene_extras(scene) | {
            name: rows.tolist() for name, rows in lists.items() if len(rows)
        }
        roots = np.flatnonzero(nodes.parents < 0).tolist()
        self._lists["scenes"] = [{"name": scene.name, "nodes": roots, "extras": {KEY: private}}]
        return motions

    def _mesh(self, pairs: tuple[tuple[int, int], ...], primitives: list[dict[str, Any]]) -> dict[str, Any]:
        names = [self._scene.meshes.names[mesh] for mesh, _ in pairs]
        parts = [
            primitives[mesh] | ({"material": material} if material >= 0 else {}) for mesh, material in pairs
        ]
        if len(set(names)) == 1:
            return {**({"name": names[0]} if names[0] else {}), "primitives": parts}
        named = [part | {"extras": {"name": name}} for part, name in zip(parts, names, strict=True)]
        return {"primitives": named}

    def _collect_motions(self, nodes: list[dict[str, Any]]) -> list[tuple[NDArray[np.int64], NodeMotion]]:
        """Return the motions of glTF with the rows of their nodes, which get their parts in place of a
        matrix."""
        motions = []
        for number, simulated in enumerate(self._scene.simulated):
            motion = simulated.simulation
            if not isinstance(motion, NodeMotion):
                what = "simulations of nodes" if len(simulated.nodes) else "simulations of vertices"
                self.omissions.add(what, f"simulated[{number}]", len(simulated))
                continue
            for member, row in enumerate(simulated.nodes.tolist()):
                for name in ("matrix", *_PATHS):
                    nodes[row].pop(name, None)
                nodes[row] |= {
                    name: part[member].tolist() for name, part in zip(_PATHS, motion.rest, strict=True)
                }
            motions.append((simulated.nodes, motion))
        return motions

    def _write_animations(self, motions: list[tuple[NDArray[np.int64], NodeMotion]]) -> None:
        """Write tracks; the tracks of a clip become an animation."""
        names = list(self._scene.clips)
        for rows, motion in motions:
            animations: dict[int, dict[str, Any]] = {}
            for track, owner in zip(motion.tracks, motion.owners.tolist(), strict=True):
                begun = {"name": names[track.clip], "samplers": [], "channels": []}
                animation = animations.setdefault(track.clip, begun)
                animation["samplers"].append(self._track(track))
                target = {"node": int(rows[owner]), "path": _PATHS[track.target]}
                animation["channels"].append({"sampler": len(animation["samplers"]) - 1, "target": target})
            for _, animation in sorted(animations.items()):
                self._add("animations", animation)

    def _track(self, track: Track) -> dict[str, Any]:
        times = track.times.astype("<f4")
        size = track.values.shape[-1]
        values = track.values.astype("<f4").reshape(-1, size)
        fields = {
            "input": self._accessor(times, "SCALAR", min=[float(times.min())], max=[float(times.max())]),
            "output": self._accessor(values, f"VEC{size}"),
        }
        return fields if track.kind == LINEAR else fields | {"interpolation": _KINDS[track.kind]}

    def _accessor(self, values: NDArray[Any], kind: str, **more: Any) -> int:
        view = self._view(values.tobytes())
        accessor = {"bufferView": view, "componentType": 5126, "count": len(values), "type": kind}
        return self._add("accessors", accessor | more)

    def _add_light_or_camera_node(
        self, name: str, position: Floats, axes: Floats, followed: int = -1, **more: Any
    ) -> None:
        """Add a node that only holds a light or a camera; `axes` (3, 3) has the rows right, up and back.

        It is in the space of the row `followed` of the scene's nodes, or in the world if that is -1.
        """
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = axes.T, position
        fields = {"name": name, "matrix": matrix.T.ravel().tolist(), "extras": {KEY: {HOLDER: True}}, **more}
        number = self._add("nodes", fields)
        above = self._lists["scenes"][0] if followed < 0 else self._lists["nodes"][followed]
        above.setdefault("nodes" if followed < 0 else "children", []).append(number)

    def _write_lights(self) -> None:
        for kind in LIGHT_KINDS:
            lights = self._scene.lights.of_kind(kind)
            if kind.gltf is None:
                if len(lights):
                    self.omissions.add(
                        f"{kind.noun}s, which glTF doesn't have", f"lights[{len(self._lights)}]"
                    )
                continue
            lights, followed = self._anchor_lights(kind)
            for light, node in zip(lights, followed, strict=True):
                number = len(self._lights)
                fields: dict[str, Any] = {
                    "type": kind.gltf.type,
                    "color": light["color"].tolist(),
                    "intensity": float(light["intensity"]) / CANDELA,
                }
                if kind.has_range:
                    fields["range"] = float(light["range"])
                if not kind.gltf.is_allowed(light):
                    self.omissions.add(kind.gltf.omission, f"lights[{number}]")
                fields |= kind.gltf.write(light)
                extras: dict[str, Any] = {"casts_shadow": True} if light["casts_shadow"] else {}
                if kind.has_range and light["source_radius"] > 0.0:
                    extras["source_radius"] = float(light["source_radius"])
                if kind.has_shapes:
                    for side in ("source_right", "source_up"):
                        if light[side].any():
                            extras[side] = light[side].tolist()
                if not kind.has_range and light["angular_diameter"] > 0.0:
                    extras["angular_diameter"] = float(light["angular_diameter"])
                if extras:
                    fields["extras"] = {KEY: extras}
                self._lights.append(fields)
                position = light["position"].astype(np.float64) if kind.has_range else np.zeros(3)
                axes = _look_along(light["direction"].astype(np.float64)) if kind.has_direction else np.eye(3)
                extension = {"KHR_lights_punctual": {"light": number}}
                name = f"{kind.gltf.type} {number}"
                self._add_light_or_camera_node(name, position, axes, node, extensions=extension)

    def _anchor_lights(self, kind: LightKind) -> tuple[NDArray[Any], list[int]]:
        """Return the lights of a kind, each in the space of the node that it follows, and these nodes; -1 is the
        world."""
        lights = self._scene.lights.of_kind(kind).copy()
        followed = np.full(len(lights), -1)
        for attached in self._scene.attachments.lights:
            if attached.kind_name == kind.name:
                followed[attached.indices] = attached.nodes
                for field, values in (("position", attached.positions), ("direction", attached.directions)):
                    if field in (lights.dtype.names or ()):
                        lights[field][attached.indices] = values
                if kind.has_shapes:
                    for number, field in enumerate(("source_right", "source_up")):
                        lights[field][attached.indices] = attached.sides[:, number]
        return lights, followed.tolist()

    def _write_views(self) -> None:
        attached = self._scene.attachments.views
        for name, view in self._scene.views.items():
            node, camera = (attached[name].node, attached[name].camera) if name in attached else (-1, view)
            number = self._add("cameras", self._camera(view, name))
            self._add_light_or_camera_node(name, camera.position, camera.rotation, node, camera=number)

    def _camera(self, view: Camera, name: str) -> dict[str, Any]:
        projection = view.projection
        assert isinstance(projection, Perspective | Orthographic)
        if projection.depth is not Depth.REVERSED:
            self.omissions.add("the direction of a camera's depth", name)
        if isinstance(projection, Perspective):
            # glTF lets an infinite zfar be left out, but loaders of other engines fail without it.
            far = FARTHEST * projection.near if np.isinf(projection.far) else projection.far
            fields = {
                "yfov": projection.fov,
                "aspectRatio": projection.aspect,
                "znear": projection.near,
                "zfar": far,
            }
            stands = {} if far == projection.far else {"extras": {KEY: {INFINITE: far}}}
            return {"type": "perspective", "perspective": fields, **stands}
        height = 0.5 * projection.height
        fields = {
            "xmag": height * projection.aspect,
            "ymag": height,
            "znear": projection.near,
            "zfar": projection.far,
        }
        return {"type": "orthographic", "orthographic": fields}


_IDENTITY: Final = np.eye(4).tolist()


def _look_along(direction: Floats) -> Floats:
    """Return axes (3, 3) whose last row is exactly the opposite of a unit vector."""
    up = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    up /= np.linalg.norm(up)
    return np.stack([np.cross(up, -direction), up, -direction])


def _encode(image: ImagePixels) -> bytes:
    from PIL import Image

    file = BytesIO()
    Image.fromarray(image).save(file, "PNG", compress_level=1)
    return file.getvalue()
