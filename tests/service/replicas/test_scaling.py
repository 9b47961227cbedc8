"""How many replicas frames need: measured ages and the decision, without Ray."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from service.replicas.scaling import WINDOW_S, FrameAges, Load, wanted
from service.watch.metrics import Metrics

DEADLINE_S = 0.066
loads = st.lists(
    st.builds(Load, age_s=st.floats(0.0, 2.0), streams=st.integers(0, 8)).filter(
        lambda load: load.streams > 0 or load.age_s == 0.0
    ),
    min_size=1,
    max_size=8,
).map(lambda found: {str(place): load for place, load in enumerate(found)})


def test_ages_are_those_of_the_last_seconds():
    metrics = Metrics()
    ages = FrameAges(metrics.frame_age)
    assert ages.p99_s(0.0) == 0.0
    for _ in range(1000):
        metrics.sent(0.02, DEADLINE_S)
    calm = ages.p99_s(1.0)
    assert 0.016 < calm <= 0.033
    for _ in range(20):
        metrics.sent(0.15, DEADLINE_S)
    assert 0.1 < ages.p99_s(2.0) <= 0.2
    assert ages.p99_s(2.0 + WINDOW_S) == 0.0
    metrics.sent(0.02, DEADLINE_S)
    assert 0.016 < ages.p99_s(3.0 + WINDOW_S) <= 0.033
    metrics.sent(100.0, DEADLINE_S)
    assert ages.p99_s(4.0 + WINDOW_S) == 60.0


@pytest.mark.parametrize(
    ("replicas", "expected"),
    [
        ([Load(0.02, 1)], 1),
        ([Load(0.2, 3)], 2),
        ([Load(0.2, 1)], 1),  # nothing that another replica could take
        ([Load(0.2, 3), Load(0.02, 1)], 3),
        ([Load(0.05, 2), Load(0.02, 1)], 2),
        ([Load(0.03, 1), Load(0.0, 0)], 1),
        ([Load(0.03, 1), Load(0.03, 1)], 2),
        ([Load(0.02, 1), Load(0.02, 1)], 1),
        ([Load(0.2, 1), Load(0.0, 0)], 1),
        ([Load(0.0, 0)] * 3, 2),
    ],
)
def test_replicas_that_are_wanted(replicas: list[Load], expected: int):
    assert wanted({str(place): load for place, load in enumerate(replicas)}, DEADLINE_S) == expected


@given(loads)
def test_a_replica_that_went_is_not_wanted_again_at_once(found: dict[str, Load]):
    number = wanted(found, DEADLINE_S)
    assert abs(number - len(found)) <= 1 and number >= 1
    if number >= len(found):
        return
    gone = min(found, key=lambda name: found[name].streams)
    left = {name: load for name, load in found.items() if name != gone}
    spread = Load(sum(load.age_s for load in found.values()) / number, 8)
    after = left if found[gone].streams == 0 else dict.fromkeys(left, spread)
    assert wanted(after, DEADLINE_S) <= number
