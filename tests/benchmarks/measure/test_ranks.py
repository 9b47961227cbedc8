"""The order of fabrics: closed forms of Spearman's correlation, and the rows of a real garment in three fabrics."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.measure.measures import measure
from benchmarks.measure.ranks import RANKED, rank_correlations
from drape.cloth.fabric_table import fabric
from tests.benchmarks.quality_setup import bench, tube


def rows(network: list[float], physics: list[float], garment: str = "sash") -> list[dict]:
    methods = {"skinning": [0.0] * len(physics), "network": network, "network_push": physics, "physics": physics}
    return [
        {"garment": garment, "fabric": f"cloth {i}", "method": method} | dict.fromkeys(RANKED, value)
        for method, values in methods.items()
        for i, value in enumerate(values)
    ]


@pytest.mark.parametrize(
    ("network", "physics", "expected"),
    [
        ([1.0, 2.0, 3.0, 9.0], [0.1, 0.2, 0.4, 0.5], 1.0),
        ([3.0, 2.0, 1.0], [0.1, 0.2, 0.4], -1.0),
        ([1.0, 3.0, 2.0, 4.0], [1.0, 2.0, 3.0, 4.0], 1.0 - 6.0 * 2.0 / (4.0 * 15.0)),  # 1 - 6 sum d^2 / (n (n^2 - 1))
    ],
)
def test_the_correlation_is_that_of_the_ranks(network, physics, expected):
    alone, pushed = rank_correlations(rows(network, physics))
    assert (alone["garment"], alone["method"], pushed["method"]) == ("sash", "network", "network_push")
    assert alone["fabrics"] == len(network)
    for key in RANKED:
        assert alone[key] == pytest.approx(expected)
        assert pushed[key] == pytest.approx(1.0)


def test_a_network_that_drapes_all_fabrics_alike_has_no_order():
    alone, pushed = rank_correlations(rows([2.0, 2.0, 2.0], [1.0, 2.0, 3.0]))
    assert np.isnan([alone[key] for key in RANKED]).all()
    assert pushed["edge_pct"] == pytest.approx(1.0)


def test_garments_are_ranked_one_by_one_and_only_from_three_fabrics_on():
    many = [
        *rows([1.0, 2.0], [1.0, 2.0], "scarf"),
        *rows([3.0, 2.0, 1.0], [1.0, 2.0, 3.0], "a"),
        *rows([1.0, 2.0, 3.0], [1.0, 2.0, 3.0], "b"),
    ]
    assert [(line["garment"], round(line["edge_pct"])) for line in rank_correlations(many)] == [
        ("a", -1), ("a", 1), ("b", 1), ("b", 1),
    ]  # fmt: skip
    without = [{key: value for key, value in row.items() if key != "fabric"} for row in many]
    assert rank_correlations(without) == []


def test_rows_of_a_real_garment_in_three_fabrics_have_a_rank(tmp_path):
    made = replace(bench(tmp_path, step_limit=120), windows=())
    names = ("jersey", "rib", "denim")
    found = [row for name in names for row in measure(tube(), made.of_fabric(fabric(name)), trained=False)]
    lines = rank_correlations(found)
    assert [line["method"] for line in lines] == ["network", "network_push"]
    for line in lines:
        assert line["fabrics"] == 3
        of = {m: [row["hang_mm"] for row in found if row["method"] == m] for m in (line["method"], "physics")}
        order = [np.argsort(np.argsort(values)) for values in of.values()]
        assert line["hang_mm"] == pytest.approx(1.0 - 6.0 * ((order[0] - order[1]) ** 2).sum() / (3 * 8))
