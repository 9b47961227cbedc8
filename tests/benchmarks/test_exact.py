"""The benchmark of tier exact in its quick form."""

from __future__ import annotations

import pytest

from benchmarks import exact
from benchmarks.judge import ipc_optimum
from drape.exact import frame


def test_rows_are_of_accurate_exact_and_the_judge():
    with pytest.MonkeyPatch.context() as patch:  # a few steps of one frame, kept nowhere
        patch.setattr(exact, "CACHE_DIR", None)
        patch.setattr(ipc_optimum, "STEPS", 2)
        patch.setattr(frame, "STEPS", 2)
        rows = {row["method"]: row for row in exact.main(["--quick", "--threads", "1"])["rows"]}
    assert list(rows) == ["accurate", "exact", "judge"] and rows["judge"]["gain"] == 1.0
    assert rows["exact"]["energy_j"] < rows["accurate"]["energy_j"] and rows["exact"]["crossings"] == 0
