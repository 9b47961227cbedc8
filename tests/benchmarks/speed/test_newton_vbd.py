import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.judge.physics import Held
from benchmarks.speed.newton_vbd import bending_n, take_rest_state
from benchmarks.speed.rivals import NewtonClip, newton_cloth, newton_runs
from drape.cloth.energies import ClothMesh, bending, membrane
from drape.cloth.fabric_table import fabric
from drape.cloth.material import Material, material


def test_a_hinge_of_newton_bends_like_ours():
    rest = np.array([(0.2, 0.9, 0.0), (0.1, -0.7, 0.0), (-0.3, 0.0, 0.0), (0.8, 0.1, 0.0)])
    faces = np.array([(2, 3, 0), (3, 2, 1)])
    cloth = Material(bending_j=2.5e-4)
    edges = np.array([(0, 1, 2, 3), (-1, 0, 3, 2)])
    stiffness = bending_n(rest, edges, cloth.bending_j)
    assert stiffness[1] == 0.0  # a border does not bend

    # Fold the second triangle about the shared edge by a small angle: k l theta^2 / 2 there, our energy here.
    theta = 0.03  # small, and large beside what guards the hinge
    axis = (rest[3] - rest[2]) / np.linalg.norm(rest[3] - rest[2])
    arm = rest[1] - rest[2]
    folded = rest.copy()
    along = axis * (arm @ axis)
    folded[1] = rest[2] + along + np.cos(theta) * (arm - along) + np.sin(theta) * np.cross(axis, arm)
    theirs = 0.5 * stiffness[0] * np.linalg.norm(rest[3] - rest[2]) * theta**2
    ours = float(bending(folded[None], ClothMesh.from_rest(rest, faces), cloth)[0])
    assert theirs == pytest.approx(ours, rel=3e-4)


def sheet(side: int = 3) -> tuple[np.ndarray, np.ndarray]:
    x, y = (axis.reshape(-1) for axis in np.meshgrid(np.arange(side), np.arange(side)))
    rest = 0.1 * np.stack([x, y, 0 * x], axis=-1).astype(float)
    corners = np.arange(side * side).reshape(side, side)
    a, b, c, d = (part.reshape(-1) for part in (corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]))
    return rest, np.concatenate([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)])


def test_the_membrane_is_the_mean_over_the_directions_of_the_warp():
    own = newton_cloth(material())
    assert (own["membrane"], own["area"]) == pytest.approx((0.25 * material().shear_n_per_m, material().cross_n_per_m))

    cloth = Material.of(fabric("denim"))
    theirs = newton_cloth(cloth)
    strain = np.array([(3e-3, -2e-3), (-2e-3, 1e-3)])

    def energy(angle: float) -> float:
        turn = np.array([(np.cos(angle), -np.sin(angle)), (np.sin(angle), np.cos(angle))])
        e = turn @ strain @ turn.T
        warp, weft, cross, shear = cloth.membrane
        stretch = warp * e[0, 0] ** 2 + weft * e[1, 1] ** 2 + 2.0 * cross * e[0, 0] * e[1, 1]
        return 0.5 * (stretch + shear * e[0, 1] ** 2)

    mean = np.mean([energy(angle) for angle in np.linspace(0.0, np.pi, 64, endpoint=False)])
    isotropic = theirs["membrane"] * np.sum(strain**2) + 0.5 * theirs["area"] * np.trace(strain) ** 2
    assert isotropic == pytest.approx(mean)


def test_the_energy_above_is_the_membrane_that_we_have():
    rest, _ = sheet()
    cloth, mesh = Material.of(fabric("denim")), ClothMesh.from_rest(*sheet())
    sheared = rest.copy()
    sheared[:, 0] += 1e-3 * rest[:, 1]
    area = mesh.face_area.sum()
    assert float(membrane(sheared[None], mesh, cloth)[0]) == pytest.approx(
        0.5 * area * cloth.shear_n_per_m * 0.5e-3**2, rel=1e-3
    )


def clip(held: Held | None = None) -> NewtonClip:
    rest, faces = sheet()
    body = np.stack([rest, rest + np.array([0.0, 0.0, 0.1])])
    mesh = ClothMesh.from_rest(rest, faces)
    return NewtonClip(mesh, rest, rest + 1.0, Material.of(fabric("jersey")), 0.35, faces, body, 30.0, held)


def test_a_scene_has_our_sheets_and_hinges_and_holds_a_waist():
    scene = clip().scene([(1, 10), (8, 10)])
    assert scene["paces"].tolist() == [[1, 10], [8, 10]] and scene["friction"] == 0.35
    assert scene["radius"] == Material().contact_gap_m
    assert scene["face_area"] == pytest.approx(np.full(8, 0.005)) and scene["vertex_kg"].sum() == pytest.approx(
        0.04 * Material.of(fabric("jersey")).density_kg_m2
    )
    assert scene["hinge_edge"].shape == (8, 2) and (scene["hinge_angle"] == 0.0).all()
    assert (scene["hinge_j"] > 0.0).all() and scene["hinge_j"].max() > 1.2 * scene["hinge_j"].min()
    assert scene["pinned"].shape == (0,) and scene["anchor"].shape == (2, 0, 3)
    held = clip(Held(np.array([3, 5]), np.ones(2), np.ones((2, 2, 3)))).scene([(1, 10)])
    assert held["pinned"].tolist() == [3, 5] and (held["anchor"] == 1.0).all()


def test_a_scene_goes_to_an_interpreter_and_what_it_finds_comes_back(tmp_path: Path):
    stand_in = tmp_path / "python"
    stand_in.write_text(
        f"""#!{sys.executable}
import sys
import numpy as np
with np.load(sys.argv[2]) as scene:
    shape = len(scene["paces"]), *scene["body_vertices"].shape[:1]
    still = np.broadcast_to(scene["start"], (*shape, *scene["start"].shape))
np.savez(sys.argv[3], vertices=still, wall_ms=np.full(shape, 2.0), cpu_ms=np.ones(shape))
"""
    )
    stand_in.chmod(0o755)
    found = clip().run(str(stand_in), [(1, 10), (8, 10)])
    assert not isinstance(found, str)
    assert found["vertices"].shape == (2, 2, 9, 3) and (found["vertices"][1, 1] == clip().start).all()
    assert found["cpu_ms"].tolist() == [[1.0, 1.0], [1.0, 1.0]]


class Array:
    """Stands for an array of Warp's."""

    def __init__(self, value: np.ndarray) -> None:
        self.value = value

    def numpy(self) -> np.ndarray:
        return self.value.copy()

    def assign(self, value: np.ndarray) -> None:
        assert value.shape == self.value.shape
        self.value = value


def test_newton_takes_our_rest_state():
    made = clip(Held(np.array([3, 5]), np.ones(2), np.ones((2, 2, 3))))
    scene, rest = made.scene([(1, 10)]), made.rest
    ends = scene["hinge_edge"][::-1, ::-1]  # in another order, the other way round, and a border that is none of ours
    edges = np.concatenate([np.zeros_like(ends), ends], axis=1)
    edges = np.concatenate([edges, [(0, -1, 0, 1)]])
    length = np.linalg.norm(rest[edges[:, 3]] - rest[edges[:, 2]], axis=1)
    parts = {
        "tri_indices": made.mesh.faces, "tri_poses": np.zeros((8, 2, 2)), "tri_areas": np.zeros(8),
        "particle_mass": np.zeros(9), "particle_inv_mass": np.zeros(9), "edge_indices": edges,
        "edge_rest_angle": np.ones(9), "edge_rest_length": length,
    }  # fmt: skip
    model = SimpleNamespace(**{name: Array(value) for name, value in parts.items()})
    stiff = take_rest_state(model, scene)
    assert stiff[:-1] * length[:-1] == pytest.approx(scene["hinge_j"][::-1]) and stiff[-1] == 0.0
    assert model.edge_rest_angle.value.tolist() == [0.0] * 8 + [1.0]
    assert np.flatnonzero(model.particle_inv_mass.value == 0.0).tolist() == [3, 5]
    # F = [x1 - x0, x2 - x0] D^-1 of cloth at rest has orthonormal columns.
    corners = rest[made.mesh.faces]
    sides = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=-1)
    f = sides @ model.tri_poses.value
    assert np.swapaxes(f, 1, 2) @ f == pytest.approx(np.broadcast_to(np.eye(2), (8, 2, 2)), abs=1e-6)


@pytest.mark.parametrize(
    ("python", "reason"),
    [(None, "give --newton PYTHON"), ("/nowhere/python", "FileNotFoundError"), (sys.executable, "newton|warp")],
)
def test_what_did_not_run_says_why(python: str | None, reason: str):
    found = newton_runs(python, {"paces": np.ones((1, 2))})
    assert isinstance(found, str) and any(part in found for part in reason.split("|"))
