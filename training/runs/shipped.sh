#!/bin/sh
# Rebuilds the shipped model and exports it: the static drape in about 100 minutes on two CPU cores, then what motion
# adds in 112 on one. The weights shipped saw the same in parts (the manifest's "training"): the static drape was trained
# with 8 anchors a patch first and went on with 12 for 80 minutes on one core (--finetune MODEL), motion for 16 after it;
# they are the mean of before and after (training.average), which moves more smoothly.
#
# Poses: DRAPE_DATA/motions holds clips of the CMU Graphics Lab Motion Capture Database as ASF/AMC or AMASS
# files (docs/data.md says which and where from). "The data used in this project was obtained from
# mocap.cs.cmu.edu. The database was created with funding from NSF EIA-0196217."
set -eu
export OMP_NUM_THREADS=1
python -m torch.distributed.run --standalone --nproc-per-node 2 -m training.run \
    --preset shipped --threads 1 --out runs/shipped "$@"
python -m training.run --preset dynamic --from runs/shipped/checkpoint.pt --threads 1 --minutes 112 --out runs/moving \
    --garment dress skirt dress skirt tshirt longsleeve tank trousers shorts
python -m model_export runs/moving/checkpoint.pt assets/models/onefit
