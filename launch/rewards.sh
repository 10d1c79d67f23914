#!/bin/sh
# Camera sets with the rewards that a VLM wrote (the paper's Figure 7).
#   launch/rewards.sh [overrides]                           the paper's top three
#   launch/rewards.sh 'cams=[a,b],[c,d],[e]' [overrides]    your own
set -e
cd "$(dirname "$0")/.."
exec .venv/bin/python train.py +experiment=rewards "$@"
