"""No module imports itself on a way around, not even for the names of types."""

from __future__ import annotations

import grimp
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

ROOMS = ("drape", "service", "clients", "recovery", "training", "model_export", "benchmarks")


def circles(graph: grimp.ImportGraph) -> list[list[str]]:
    """The modules of each circle of imports."""
    modules = sorted(graph.modules)
    number = {name: i for i, name in enumerate(modules)}
    pairs = [(number[one], number[other]) for one in modules for other in graph.find_modules_directly_imported_by(one)]
    rows, columns = np.array(pairs).T
    edges = coo_array((np.ones(len(pairs), bool), (rows, columns)), shape=(len(modules),) * 2)
    _, circle = connected_components(edges, connection="strong")
    return [[modules[i] for i in np.flatnonzero(circle == one)] for one in np.flatnonzero(np.bincount(circle) > 1)]


def test_no_imports_go_around():
    graph = grimp.build_graph(*ROOMS)  # with those under TYPE_CHECKING
    assert "drape.stages.plan" in graph.modules
    assert circles(graph) == []
    graph.add_import(importer="drape.stages.scene", imported="drape.stages.body_stages")
    (found,) = circles(graph)
    assert {"drape.stages.plan", "drape.stages.scene", "drape.stages.stage"} < set(found)
