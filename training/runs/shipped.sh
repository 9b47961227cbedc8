#!/bin/sh
# Rebuilds the shipped model on two CPU cores in about 100 minutes, and exports it.
#
# Poses: DRAPE_DATA/motions holds clips of the CMU Graphics Lab Motion Capture Database as ASF/AMC or AMASS
# files (docs/data.md says which and where from). "The data used in this project was obtained from
# mocap.cs.cmu.edu. The database was created with funding from NSF EIA-0196217."
set -eu
export OMP_NUM_THREADS=1
python -m torch.distributed.run --standalone --nproc-per-node 2 -m training.run \
    --preset shipped --threads 1 --out runs/shipped "$@"
python -m model_export runs/shipped/checkpoint.pt assets/models/onefit
