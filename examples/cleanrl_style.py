"""PPO in one file, as CleanRL writes it, on ``gymnasium.make_vec``; from the state.

Needs ``pip install 'needlehoop[gym]'``. With ``SAME_STEP`` each of the batch's rows is a step
of an episode; what an episode ended with is in ``infos``, so that time-outs can bootstrap.
"""

import sys

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from torch import Tensor, nn

import needlehoop

gymnasium.register_envs(needlehoop)

GAMMA, LAMBDA, CLIP, EPOCHS, MINIBATCH = 0.99, 0.95, 0.2, 5, 512


def mlp(inputs: int, outputs: int) -> nn.Sequential:
    """Two hidden layers of 128."""
    layers = nn.Linear(inputs, 128), nn.Tanh(), nn.Linear(128, 128), nn.Tanh()
    return nn.Sequential(*layers, nn.Linear(128, outputs))


class Agent(nn.Module):
    """A Gaussian policy and a value function, each with a network of its own."""

    def __init__(self, inputs: int, actions: int):
        super().__init__()
        self.mean, self.critic = mlp(inputs, actions), mlp(inputs, 1)
        self.log_std = nn.Parameter(torch.full((actions,), -0.5))

    def policy(self, seen: Tensor) -> torch.distributions.Independent:
        """Of the whole action."""
        normal = torch.distributions.Normal(self.mean(seen), self.log_std.exp())
        return torch.distributions.Independent(normal, 1)

    def value(self, seen: Tensor) -> Tensor:
        """``(n,)``."""
        return self.critic(seen).squeeze(-1)


def main(steps: int = 300_000, num_envs: int = 32, horizon: int = 128) -> float:
    """Train; returns how many of the last buffer's episodes grasped the needle."""
    torch.manual_seed(0)
    envs = gymnasium.make_vec(
        "needlehoop/NeedleHoop-v0",
        num_envs=num_envs,
        cams=[],
        obs="signals",
        autoreset_mode=AutoresetMode.SAME_STEP,
    )
    size = envs.single_observation_space["signals"].shape[0]
    agent = Agent(size, envs.single_action_space.shape[0])
    optimiser = torch.optim.Adam(agent.parameters(), 3e-4, eps=1e-5)
    seen = torch.from_numpy(envs.reset(seed=0)[0]["signals"])
    shape = (horizon, num_envs)
    grasped = 0.0
    for update in range(steps // (horizon * num_envs)):
        observed, chosen = torch.zeros(*shape, size), torch.zeros(*shape, agent.log_std.numel())
        paid, after, over = (torch.zeros(shape) for _ in range(3))
        ended: list[bool] = []
        for t in range(horizon):
            with torch.no_grad():
                action = agent.policy(seen).sample()
            observed[t], chosen[t] = seen, action
            step, rewards, terminated, truncated, infos = envs.step(action.clamp(-1, 1).numpy())
            seen = torch.from_numpy(step["signals"])
            paid[t], over[t] = torch.from_numpy(rewards), torch.from_numpy(terminated | truncated)
            with torch.no_grad():
                after[t] = agent.value(seen)
                for env in (terminated | truncated).nonzero()[0]:
                    last = torch.from_numpy(infos["final_obs"][env]["signals"])
                    # A time-out is no end: what would have followed still counts.
                    after[t, env] = 0.0 if terminated[env] else agent.value(last)
                    ended.append(infos["final_info"]["facts"]["has_grasped"][env])
        learn(agent, optimiser, observed, chosen, paid, after, over)
        grasped = float(np.mean(ended)) if ended else 0.0
        print(f"{(update + 1) * horizon * num_envs} steps: {grasped:.0%} of {len(ended)} grasped")
    return grasped


def learn(
    agent: Agent,
    optimiser: torch.optim.Optimizer,
    observed: Tensor,
    chosen: Tensor,
    paid: Tensor,
    after: Tensor,
    over: Tensor,
) -> None:
    """PPO on a buffer ``(horizon, num_envs)``."""
    with torch.no_grad():
        values = agent.value(observed)
        before = agent.policy(observed).log_prob(chosen)
    surprise = paid + GAMMA * after - values
    advantage, carried = torch.zeros_like(paid), torch.zeros_like(paid[0])
    for t in reversed(range(len(paid))):
        carried = surprise[t] + GAMMA * LAMBDA * (1 - over[t]) * carried
        advantage[t] = carried
    target = (advantage + values).flatten()
    advantage = ((advantage - advantage.mean()) / (advantage.std() + 1e-8)).flatten()
    observed, chosen, before = observed.flatten(0, 1), chosen.flatten(0, 1), before.flatten()
    for _ in range(EPOCHS):
        for rows in torch.randperm(len(target)).split(MINIBATCH):
            policy = agent.policy(observed[rows])
            ratio = (policy.log_prob(chosen[rows]) - before[rows]).exp()
            gain = torch.min(
                ratio * advantage[rows], ratio.clamp(1 - CLIP, 1 + CLIP) * advantage[rows]
            )
            error = (agent.value(observed[rows]) - target[rows]) ** 2
            loss = 0.5 * error.mean() - gain.mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimiser.step()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
