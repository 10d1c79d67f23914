"""Soft actor-critic: what it keeps of a buffer."""

from __future__ import annotations

import torch
from tiny_runs import learner


def test_rewards_of_some_steps_are_summed_up_to_an_episodes_end():
    words = [
        *("algo=sac", "cams=[]", "obs=signals", "num_envs=4", "algo.horizon=8", "steps=32"),
        *("algo.minibatches=1", "algo.memory=32", "episode.max_steps=6", "engine.threads=1"),
        *("algo.minibatch=8", "algo.n_steps=3", "algo.gamma=0.5"),
    ]
    training = learner(*words)
    (buffer,) = [buffer.clone() for buffer, _ in training]
    kept = training.algorithm._kept(buffer)
    reward, done = buffer["next", "reward"], buffer["next", "done"]
    assert done.any()
    for step in range(8):
        total, alive, last = torch.zeros(4, 1), torch.ones(4, 1), torch.full((4,), step)
        for ahead in range(step, min(step + 3, 8)):
            total += 0.5 ** (ahead - step) * alive * reward[:, ahead]
            last = torch.where(alive.squeeze(-1).bool(), ahead, last)
            alive = alive * ~done[:, ahead]
        torch.testing.assert_close(kept["next", "reward"][:, step], total)
        # The critics judge what follows the last of these steps.
        seen = buffer["next", "signals"][torch.arange(4), last]
        assert torch.equal(kept["next", "signals"][:, step], seen)
        for key in ("done", "terminated"):
            ends = buffer["next", key][torch.arange(4), last]
            assert torch.equal(kept["next", key][:, step], ends)
        assert torch.equal(kept["steps_to_next_obs"][:, step].flatten(), last - step + 1)
