"""Writes a walking T-shirt as an animated GLB: python examples/02_clip_to_glb.py [URL]; a service runs."""

import argparse

from clients.calls import DEFAULT_URL
from clients.client import DrapeClient

asked = argparse.ArgumentParser(description=__doc__)
asked.add_argument("url", nargs="?", default=DEFAULT_URL, help="the service")

with DrapeClient(asked.parse_args().url) as client:
    clip = client.motion("walk").resampled(30.0).window(0, 30)  # or client.placed(read_motion("clip.bvh"))
    glb = client.drape_glb("tshirt", clip, body=True)

with open("walk.glb", "wb") as file:
    file.write(glb)
print(f"walk.glb: {clip.frame_count} frames, {len(glb) / 1e6:.1f} MB; opens in Blender and three.js")
