#!/bin/sh
# The paper's 20 models: 14 combinations with the human reward, 3 with each of two VLM rewards.
#   launch/full.sh seed=0,1,2
cd "$(dirname "$0")/.." && exec .venv/bin/python train.py +experiment=full "$@"
