#!/bin/sh
# One camera with depth-shaded segmentation against the paper's best two (its future work).
#   launch/segdep.sh seed=0,1,2
cd "$(dirname "$0")/.." && exec .venv/bin/python train.py +experiment=segdep "$@"
