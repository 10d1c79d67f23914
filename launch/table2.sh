#!/bin/sh
# The paper's 14 camera combinations with the human reward (its Table II and Figure 6).
#   launch/table2.sh                                        one run after the other
#   launch/table2.sh seed=0,1,2 hydra/launcher=joblib hydra.launcher.n_jobs=2
cd "$(dirname "$0")/.." && exec .venv/bin/python train.py +experiment=table2 "$@"
