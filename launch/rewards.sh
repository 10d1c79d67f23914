#!/bin/sh
# A study's top three combinations with the rewards that a VLM wrote (the paper's Figure 7).
#   launch/rewards.sh results/main [overrides]              top three by measured return
#   launch/rewards.sh paper [overrides]                     the paper's top three
set -e
[ $# -gt 0 ] || { sed -n '2,4p' "$0" >&2; exit 2; }
cd "$(dirname "$0")/.."
study=$1
shift
[ "$study" = paper ] && exec .venv/bin/python train.py +experiment=rewards "$@"
cams=$(.venv/bin/needlehoop top "$study")
exec .venv/bin/python train.py -m "cams=$cams" reward=vlm_text,vlm_img \
  "results=$(dirname "$study")" "study=$(basename "$study")" "$@"
