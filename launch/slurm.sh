#!/bin/sh
# Any experiment on Slurm, one job per run. The study's folder must be on a shared file system.
#   launch/slurm.sh table2 seed=0,1,2 hydra.launcher.partition=cpu
#   launch/slurm.sh table2 hydra.launcher.partition=gpu hydra.launcher.gpus_per_node=1
set -e
[ $# -gt 0 ] || { sed -n '2,4p' "$0" >&2; exit 2; }
cd "$(dirname "$0")/.."
experiment=$1
shift
exec .venv/bin/python train.py "+experiment=$experiment" hydra/launcher=slurm "$@"
