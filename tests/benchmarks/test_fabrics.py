"""The textile tests: closed forms of their measures, and that the simulator passes them on small meshes."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_bvp

from benchmarks import fabrics
from benchmarks.cloth import fabric_tests
from drape.cloth.fabric_table import fabric
from drape.cloth.material import Material

POPLIN = fabric("poplin").softened(1e3)


def flat(mesh: fabric_tests.Mesh) -> np.ndarray:
    return np.stack([mesh.points[:, 0], np.zeros(len(mesh.points)), -mesh.points[:, 1]], axis=1)


def folded(mesh: fabric_tests.Mesh, *, folds: int, depth_m: float) -> np.ndarray:
    """The flat disc with its rim drawn in by waves of ``depth_m`` on either side of 12 cm."""
    radius, angle = np.linalg.norm(mesh.points, axis=1), np.arctan2(mesh.points[:, 1], mesh.points[:, 0])
    drawn = np.clip((radius - fabric_tests.PEDESTAL_RADIUS_M) / 0.06, 0.0, 1.0)
    found = radius - drawn * (0.03 - depth_m * np.cos(folds * angle))
    return np.stack([found * np.cos(angle), -0.05 * drawn, -found * np.sin(angle)], axis=1)


def elastica_angle(overhang: float) -> float:
    """Angle [rad] below the edge at which the tip of a heavy elastica hangs; ``overhang`` in bending lengths."""

    def slopes(s, y):  # angle, curvature, position
        return np.stack([y[1], overhang**3 * (1.0 - s) * np.cos(y[0]), np.cos(y[0]), np.sin(y[0])])

    start = np.linspace(0.0, 1.0, 200)
    guess = np.stack([-0.8 * start, -0.8 + 0.0 * start, start, -0.4 * start])
    found = solve_bvp(slopes, lambda a, b: np.array([a[0], b[1], a[2], a[3]]), start, guess, tol=1e-6)
    assert found.success
    return float(np.arctan2(-found.y[3, -1], found.y[2, -1]))


@pytest.mark.parametrize("overhang", [1.5, 1.75, 1.96])
def test_peirces_formula_is_within_two_percent_of_the_elastica(overhang: float):
    share = fabric_tests.peirce_share(elastica_angle(overhang))
    assert_allclose(share * overhang, 1.0, rtol=0.02, atol=0.0)


def test_bending_length_of_a_strip_is_peirces():
    expected = (POPLIN.bending_warp_j / (Material.gravity_m_s2 * POPLIN.density_kg_m2)) ** (1.0 / 3.0)
    found = fabric_tests.bending_length(POPLIN, 0.005, angle_rad=0.0, expected_m=expected)
    assert_allclose(found, expected, rtol=0.04, atol=0.0)


def test_strips_stretch_as_the_constants_say_in_every_direction():
    assert fabrics.stretch_error_pct(fabric("jersey"), 0.01) < 1.0


def test_flat_disc_has_a_drape_coefficient_of_100_and_no_nodes():
    mesh = fabric_tests.disc_mesh(0.012)
    assert fabric_tests.drape_coefficient(flat(mesh), mesh.faces) == pytest.approx(100.0, abs=0.7)
    assert fabric_tests.node_count(flat(mesh), mesh) == 0


def test_shadow_and_nodes_of_a_disc_folded_by_hand():
    mesh = fabric_tests.disc_mesh(0.008)
    shape = folded(mesh, folds=6, depth_m=0.008)
    assert fabric_tests.node_count(shape, mesh) == 6
    assert fabric_tests.node_count(folded(mesh, folds=6, depth_m=0.001), mesh) == 0
    # The area inside r = a + b cos(6 t) is pi (a^2 + b^2 / 2).
    expected = 100.0 * (0.12**2 + 0.5 * 0.008**2 - 0.09**2) / (0.15**2 - 0.09**2)
    assert fabric_tests.drape_coefficient(shape, mesh.faces) == pytest.approx(expected, abs=1.0)


def test_a_limper_cloth_drapes_deeper():
    limp, stiff = (fabric_tests.cusick(fabric(name).softened(1e3), 0.02) for name in ("jersey", "denim"))
    assert limp.report.converged
    assert stiff.report.converged
    assert limp.coefficient_pct < stiff.coefficient_pct - 20.0


def test_summary_counts_bands_and_order():
    rows = [
        {"edge_mm": 5.0, "bending_error_pct": error, "inside_range": inside, "nodes": nodes, "range_pct": band}
        | {"drape_coefficient_pct": drape}
        for error, inside, nodes, band, drape in [(1.0, True, 4, [20, 40], 30.0), (-3.0, False, 12, [50, 60], 45.0)]
    ]
    found = fabrics.summary([*rows, rows[0] | {"edge_mm": 10.0, "bending_error_pct": 50.0}])
    assert found == {
        "worst_bending_error_pct": -3.0,
        "inside_range": 1,
        "fabrics": 2,
        "inside_nodes": 1,
        "order": pytest.approx(1.0),
    }


def test_command_gives_its_record(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(fabrics, "QUICK_EDGES_M", (0.02,))
    record = fabrics.main(["--quick", "--fabric", "denim", "--threads", "1"])
    keys = {"fabric", "bending_length_m", "peirce_m", "drape_coefficient_pct", "range_pct", "inside_range", "nodes"}
    assert all(keys <= set(row) for row in record["rows"]) and record["summary"]["fabrics"] == 1
