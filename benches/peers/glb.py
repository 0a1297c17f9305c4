"""Flat-coloured triangles and area lights out of the glTF binaries that `hplt gen` writes."""

import json

import numpy as np

COMPONENTS = {5121: "u1", 5123: "u2", 5125: "u4", 5126: "f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


class Refused(Exception):
    """The scene holds what cannot be handed over."""


def read_glb(path):
    """Parts of a scene: (name, triangles of shape (n, 3, 3) in world space, albedo, emitted radiance)."""
    with open(path, "rb") as file:
        data = file.read()
    if data[:4] != b"glTF":
        raise Refused("the scene is no binary glTF file")
    n_json = int.from_bytes(data[12:16], "little")
    tree = json.loads(data[20 : 20 + n_json])
    binary = data[20 + n_json + 8 :]

    def accessor(index):
        a = tree["accessors"][index]
        view = tree["bufferViews"][a["bufferView"]]
        if "byteStride" in view or "sparse" in a:
            raise Refused("interleaved or sparse buffers")
        width = WIDTHS[a["type"]]
        start = view.get("byteOffset", 0) + a.get("byteOffset", 0)
        values = np.frombuffer(binary, COMPONENTS[a["componentType"]], a["count"] * width, start)
        return values.reshape(a["count"], width)

    parts = []

    def visit(index, above):
        node = tree["nodes"][index]
        if "KHR_lights_punctual" in node.get("extensions", {}):
            raise Refused("a light without surface")
        world = above @ matrix(node)
        if "mesh" in node:
            for primitive in tree["meshes"][node["mesh"]]["primitives"]:
                positions = accessor(primitive["attributes"]["POSITION"]).astype(np.float64)
                positions = positions @ world[:3, :3].T + world[:3, 3]
                indices = accessor(primitive["indices"])[:, 0].astype(np.int64)
                name, albedo, radiance = material(tree, primitive)
                parts.append((name, positions[indices].reshape(-1, 3, 3), albedo, radiance))
        for child in node.get("children", []):
            visit(child, world)

    for root in tree["scenes"][tree.get("scene", 0)]["nodes"]:
        visit(root, np.eye(4))
    return parts


def matrix(node):
    if "matrix" in node:
        return np.array(node["matrix"], dtype=np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", [0, 0, 0, 1])
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    world = np.eye(4)
    world[:3, :3] = turn * np.array(node.get("scale", [1, 1, 1]))
    world[:3, 3] = node.get("translation", [0, 0, 0])
    return world


def material(tree, primitive):
    m = tree["materials"][primitive["material"]] if "material" in primitive else {}
    pbr = m.get("pbrMetallicRoughness", {})
    if "baseColorTexture" in pbr or "emissiveTexture" in m or m.get("alphaMode", "OPAQUE") != "OPAQUE":
        raise Refused(f"material {m.get('name', '?')} has a texture or is not opaque; peers get flat albedos alone")
    albedo = pbr.get("baseColorFactor", [1, 1, 1, 1])[:3]
    strength = m.get("extensions", {}).get("KHR_materials_emissive_strength", {}).get("emissiveStrength", 1.0)
    radiance = [strength * c for c in m.get("emissiveFactor", [0, 0, 0])]
    if m.get("doubleSided", False) and any(radiance):
        raise Refused(f"material {m.get('name', '?')} emits from both sides")
    return m.get("name", "?"), albedo, radiance
