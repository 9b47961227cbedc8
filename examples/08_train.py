"""Trains a network for some seconds and sets it beside skinning: python examples/08_train.py; no service, but torch.

The shipped model took 95 minutes and some rounds after it: docs/guide/training.md.
"""

import subprocess
import sys
import tempfile

from training.evaluate import main as evaluate

with tempfile.TemporaryDirectory() as folder:
    train = [sys.executable, "-m", "training.run", "--preset", "smoke", "--minutes", "0.05", "--threads", "1"]
    subprocess.run([*train, "--motions", "--out", f"{folder}/run"], check=True)
    evaluate([f"{folder}/run", "--garments", "tshirt", "--frames", "1"])
