#!/bin/sh
# Any experiment on a Ray cluster, or on this machine as one. Two CPUs to a run; to share a GPU
# between two runs, add +hydra.launcher.ray.remote.num_gpus=0.5
#   launch/ray.sh table2 seed=0,1,2                              a cluster of this machine's own
#   launch/ray.sh table2 +hydra.launcher.ray.init.address=auto   the cluster that runs here
set -e
[ $# -gt 0 ] || { sed -n '2,5p' "$0" >&2; exit 2; }
cd "$(dirname "$0")/.."
experiment=$1
shift
exec .venv/bin/python train.py "+experiment=$experiment" hydra/launcher=ray \
  +hydra.launcher.ray.remote.num_cpus=2 "$@"
