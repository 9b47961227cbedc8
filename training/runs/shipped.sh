#!/bin/sh
# Trains a model of the shipped kind from nothing and exports it, on two CPU cores: the static drape (95 minutes), then on
# from there with jumps paid for (100), seven tenths of the way between the two, and what motion adds (112). The shipped
# weights went on from such a model with the sewn catalogue and drapes that folds go on from (docs/guide/training.md); the
# manifest's "training" tells the last round.
#
# Poses: DRAPE_DATA/motions holds clips of the CMU Graphics Lab Motion Capture Database as AMASS or BVH
# files (docs/guide/data.md says which and where from). "The data used in this project was obtained from
# mocap.cs.cmu.edu. The database was created with funding from NSF EIA-0196217."
set -eu
export OMP_NUM_THREADS=1
python -m torch.distributed.run --standalone --nproc-per-node 2 -m training.run \
    --preset shipped --bf16 --threads 1 --out runs/shipped "$@"
python -m torch.distributed.run --standalone --nproc-per-node 2 -m training.run \
    --finetune runs/shipped/checkpoint.pt --bf16 --batch 8 --threads 1 --minutes 100 --out runs/longer "$@"
mkdir -p runs/between
python -m training.average runs/shipped/checkpoint.pt runs/longer/checkpoint.pt --share 0.7 --out runs/between/checkpoint.pt
python -m training.run --preset dynamic --from runs/between/checkpoint.pt --threads 1 --minutes 112 --out runs/moving \
    --garment dress skirt dress skirt tshirt longsleeve tank trousers shorts
python -m model_export runs/moving/checkpoint.pt drape/assets/models/onefit
