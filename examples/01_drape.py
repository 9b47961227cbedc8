"""Drapes one pose: python examples/01_drape.py [URL]; a service runs (make serve)."""

import argparse

import numpy as np

from clients.calls import DEFAULT_URL
from clients.client import DrapeClient

asked = argparse.ArgumentParser(description=__doc__)
asked.add_argument("url", nargs="?", default=DEFAULT_URL, help="the service")

pose = np.zeros((1, 24, 3))  # SMPL's joints as rotation vectors [rad]; zeros are the T-pose
pose[0, 16], pose[0, 17] = (0, 0, -1.1), (0, 0, 1.1)  # both shoulders: arms down

with DrapeClient(asked.parse_args().url) as client:
    print("garments:", [garment["id"] for garment in client.garments()])
    vertices = client.drape("tshirt", pose, advanced={"settle": 16})  # a single pose settles; a clip need not
    faces = np.array(client.mesh("tshirt")["faces"])

with open("tshirt.obj", "w") as file:
    file.writelines("v {:.5f} {:.5f} {:.5f}\n".format(*vertex) for vertex in vertices[0])
    file.writelines("f {} {} {}\n".format(*face) for face in faces + 1)
print(f"tshirt.obj: {len(vertices[0])} vertices [m], hem at {vertices[0, :, 1].min():.2f} m")
