"""Takes a garment of your own in: python examples/04_upload.py [URL]; a service runs.

The file here is the service's T-shirt, cut off above the waist.
"""

import argparse

import numpy as np

from clients.calls import DEFAULT_URL
from clients.client import DrapeClient

asked = argparse.ArgumentParser(description=__doc__)
asked.add_argument("url", nargs="?", default=DEFAULT_URL, help="the service")

with DrapeClient(asked.parse_args().url) as client:
    mesh = client.mesh("tshirt")
    vertices, faces = np.array(mesh["vertices"]), np.array(mesh["faces"])
    faces = faces[(vertices[faces, 1] > np.quantile(vertices[:, 1], 0.35)).all(axis=1)]
    kept, faces = np.unique(faces, return_inverse=True)
    with open("crop_top.obj", "w") as file:
        file.writelines("v {:.6f} {:.6f} {:.6f}\n".format(*vertex) for vertex in vertices[kept])
        file.writelines("f {} {} {}\n".format(*face) for face in faces.reshape(-1, 3) + 1)

    # "standard": modelled on the service's own body. Other avatars: docs/guide/garments.md.
    told: list[str] = []
    garment = client.upload_garment(
        "crop_top.obj", "standard", progress=lambda job: told.append(job.get("stage") or "")
    )
    print("stages:", *dict.fromkeys(told))
    clip = client.motion("walk").resampled(30.0).window(0, 10)
    print(garment, client.drape(garment, clip).shape, "(frame, vertex, 3) [m]")
