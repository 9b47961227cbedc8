"""The fabrics that are trained on."""

from __future__ import annotations

import numpy as np
import pytest

from drape.cloth.fabric_table import FABRICS
from drape.errors import InputError
from training import fabrics
from training.fabrics import APART, COMPARED, FabricBank, fabric_distance, stretch_share


def test_draws_span_the_table_and_leave_out_what_is_held_out(rng):
    bank = FabricBank(("twill",))
    drawn = [bank.draw(rng) for _ in range(400)]
    assert min(fabric_distance(cloth, FABRICS["twill"]) for cloth in drawn) >= APART
    for name in COMPARED:
        known = [getattr(cloth, name) for cloth in bank.known]
        found = np.array([getattr(cloth, name) for cloth in drawn])
        assert found.min() < 1.3 * min(known) and found.max() > max(known) / 1.6, name
    loss = [stretch_share(cloth) for cloth in drawn]
    assert max(loss) / min(loss) > 30.0


def test_the_same_seed_draws_the_same_fabrics():
    bank = FabricBank()
    first, second = ([bank.draw(np.random.default_rng(5)).digest for _ in range(3)] for _ in range(2))
    assert first == second


def test_fabrics_that_there_are_not_or_all_of_them_cannot_be_held_out(rng, monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(InputError, match="held_out_fabrics"):
        FabricBank(("chain mail",))
    monkeypatch.setattr(fabrics, "APART", 100.0)  # everything is like everything
    with pytest.raises(InputError, match="leave others to draw"):
        FabricBank(("twill",)).draw(rng)
