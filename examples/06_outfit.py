"""A T-shirt over trousers: python examples/06_outfit.py [URL]; a service runs."""

import argparse

from clients.calls import DEFAULT_URL
from clients.client import DrapeClient

asked = argparse.ArgumentParser(description=__doc__)
asked.add_argument("url", nargs="?", default=DEFAULT_URL, help="the service")

with DrapeClient(asked.parse_args().url) as client:
    clip = client.motion("walk").resampled(30.0).window(0, 12)
    worn = ["trousers", "tshirt"]  # the innermost first
    trousers, tshirt = client.drape_outfit(worn, clip)
    print("trousers", trousers.shape, "tshirt", tshirt.shape)
    with open("outfit.glb", "wb") as file:
        file.write(client.drape_glb(worn, clip, body=True))
print("outfit.glb: a mesh for each garment")
