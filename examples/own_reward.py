"""A reward of your own: a function of the signals to named terms.

``needlehoop tasks task=standard`` prints the signals.

From the command line, the same function:
``python train.py cams=seg_side reward=python reward.function=examples/own_reward.py:reward``
"""

import sys

import torch
from torch import Tensor

import needlehoop


def reward(signals, rate: float = 60.0) -> dict[str, Tensor]:
    """Nearer is better, held better still; terms ``(n,)``, whose rise each step pays."""
    gap = torch.linalg.vector_norm(signals.tool_midpoint - signals.pickup_point, dim=-1)
    return {"near": torch.exp(-rate * gap), "held": 2.0 * signals.grasped}


def main(steps: int = 50) -> Tensor:
    """Random actions; returns what each step paid, ``(num_envs, steps)``."""
    env = needlehoop.make_env(["seg_side"], reward=reward, num_envs=4)
    rollout = env.rollout(steps, break_when_any_done=False)
    for name, term in rollout["next", "terms"].items():
        print(f"{name}: {term.mean():.3f} on average")
    return rollout["next", "reward"].squeeze(-1)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
