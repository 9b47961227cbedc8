"""One garment in three fabrics and three tiers: python examples/05_fabrics_and_tiers.py [URL]; a service runs."""

import argparse
import time

import numpy as np

from clients.calls import DEFAULT_URL
from clients.client import DrapeClient

asked = argparse.ArgumentParser(description=__doc__)
asked.add_argument("url", nargs="?", default=DEFAULT_URL, help="the service")

with DrapeClient(asked.parse_args().url) as client:
    print("fabrics:", *[fabric["id"] for fabric in client.fabrics()])
    clip = client.motion("walk").resampled(30.0).window(0, 12)
    jersey = client.drape("tshirt", clip, fabric="jersey")
    for fabric in ("denim", "satin"):
        vertices = client.drape("tshirt", clip, fabric=fabric)
        apart = np.linalg.norm(vertices[-1] - jersey[-1], axis=-1)
        print(f"{fabric}: vertices lie {1000 * apart.mean():.1f} mm from jersey's on the mean")
    for tier in client.tiers():
        start = time.perf_counter()
        client.drape("tshirt", clip, tier=tier["id"])
        each = 1000 * (time.perf_counter() - start) / clip.frame_count
        print(f"{tier['id']}: {each:.0f} ms a frame here, gain {tier['figures'].get('gain', float('nan')):.2f}")
