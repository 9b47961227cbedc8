"""The nodes of a glTF file: their tree and their transforms (glTF 2.0, section 3.5)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from drape.errors import MeshError
from drape.files.gltf import GltfFile
from drape.files.gltf_json import EXPORT, Node

MOST_DEPTH = 256  # A node has at most so many nodes above it.


def tree_of(file: GltfFile) -> tuple[list[int], tuple[int, ...]]:
    """Returns the indices of the file's nodes, parents before children, and for each the place of its parent in that
    order, -1 for none. Raises ``MeshError`` for nodes that are no tree, or too deep."""
    nodes = file.document.nodes
    parent, depth = np.full(len(nodes), -1), np.zeros(len(nodes), dtype=np.int64)
    for number, node in enumerate(nodes):
        for child in node.children:
            file.item("nodes", child, f"nodes[{number}].children")
            if parent[child] >= 0:
                raise _no_tree(file, f"node {child} under two")
            parent[child] = number
    order, waiting = [], [node for node in range(len(nodes)) if parent[node] < 0][::-1]
    while waiting:
        node = waiting.pop()
        order.append(node)
        depth[nodes[node].children] = depth[node] + 1
        waiting.extend(reversed(nodes[node].children))
    if len(order) < len(nodes):
        raise _no_tree(file, f"{len(nodes) - len(order)} nodes in a ring")
    if depth.max(initial=0) > MOST_DEPTH:
        raise _no_tree(file, f"{depth.max()} nodes above one, more than {MOST_DEPTH}")
    place = {node: number for number, node in enumerate(order)}
    return order, tuple(place[int(parent[node])] if parent[node] >= 0 else -1 for node in order)


def _no_tree(file: GltfFile, got: str) -> MeshError:
    return MeshError(f"{file.label}: nodes", expected="a tree", got=got, cure=EXPORT)


def node_matrix(node: Node) -> np.ndarray:
    """Returns the transform (4, 4) of a glTF ``node`` relative to its parent. A quaternion without length turns
    nothing."""
    placed = np.eye(4)
    if node.matrix is not None:
        return np.array(node.matrix).reshape(4, 4).T
    if np.linalg.norm(node.rotation) > 1e-6:
        placed[:3, :3] = Rotation.from_quat(node.rotation).as_matrix()
    placed[:3, :3] *= node.scale
    placed[:3, 3] = node.translation
    return placed


def world_matrices(local: np.ndarray, parents: Sequence[int]) -> np.ndarray:
    """Returns the world transforms (..., N, 4, 4) of nodes whose transforms relative to their parents are ``local``
    (..., N, 4, 4). ``parents`` (N,) are indices below the node's own, or -1."""
    world = np.array(local)
    for node, parent in enumerate(parents):
        if parent >= 0:
            world[..., node, :, :] = world[..., parent, :, :] @ world[..., node, :, :]
    return world
