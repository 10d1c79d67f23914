"""PPO in plain TorchRL, on a page: two cameras, one small network, no file of ours but the task.

For a training that gets there sooner: ``python train.py cams=dep_front,seg_side``.
"""

import sys

import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule, TensorDictSequential
from tensordict.nn.distributions import NormalParamExtractor
from torch import Tensor, nn
from torchrl.collectors import Collector
from torchrl.modules import IndependentNormal, ProbabilisticActor, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

import needlehoop

CAMERAS = ["dep_front", "seg_side"]
PIXELS = [("pixels", name) for name in CAMERAS]


class Eyes(nn.Module):
    """Images ``(..., c, h, w)`` uint8 of all cameras to 256 features."""

    def __init__(self) -> None:
        super().__init__()
        self.convolutions = nn.Sequential(
            *(nn.LazyConv2d(32, 8, 4), nn.ELU(), nn.LazyConv2d(64, 4, 2), nn.ELU()),
            *(nn.LazyConv2d(64, 3), nn.ELU(), nn.Flatten(), nn.LazyLinear(256), nn.ELU()),
        )

    def forward(self, *images: Tensor) -> Tensor:
        side_by_side = torch.cat(images, -3)
        flat = side_by_side.reshape(-1, *side_by_side.shape[-3:]).float() / 127.5 - 1
        return self.convolutions(flat).unflatten(0, side_by_side.shape[:-3])


def main(steps: int = 200_000, num_envs: int = 16, horizon: int = 64) -> float:
    """Train; returns how many of the last buffer's episodes grasped the needle."""
    torch.manual_seed(0)
    env = needlehoop.make_env(CAMERAS, num_envs=num_envs)
    eyes = TensorDictModule(Eyes(), in_keys=PIXELS, out_keys=["hidden"])
    act = nn.Sequential(nn.LazyLinear(2 * env.action_spec.shape[-1]), NormalParamExtractor())
    actor = ProbabilisticActor(
        TensorDictSequential(
            eyes, TensorDictModule(act, in_keys=["hidden"], out_keys=["loc", "scale"])
        ),
        in_keys=["loc", "scale"],
        distribution_class=IndependentNormal,
        return_log_prob=True,
    )
    critic = TensorDictSequential(eyes, ValueOperator(nn.LazyLinear(1), in_keys=["hidden"]))
    critic(actor(env.reset()))  # Lazy layers take their sizes from an observation.

    gae = GAE(gamma=0.99, lmbda=0.95, value_network=critic)
    loss = ClipPPOLoss(actor, critic, entropy_coeff=1e-3, critic_coeff=0.5)
    optimiser = torch.optim.Adam(loss.parameters(), 3e-4)
    buffer = num_envs * horizon
    collector = Collector(
        env,
        actor,
        frames_per_batch=buffer,
        total_frames=steps,
        auto_register_policy_transforms=False,
    )
    grasped = 0.0
    for number, batch in enumerate(collector, 1):
        for _ in range(3):
            with torch.no_grad():
                gae(batch)
            flat = batch.reshape(-1)
            for rows in torch.randperm(buffer).split(256):
                learn(loss, optimiser, flat[rows])
        ended = batch["next", "done"].flatten()
        facts = batch["next", "facts", "has_grasped"].flatten()[ended]
        grasped = float(facts.float().mean()) if len(facts) else 0.0
        print(f"{number * buffer} steps: {len(facts)} episodes ended, {grasped:.0%} had grasped")
    collector.shutdown()
    return grasped


def learn(loss: ClipPPOLoss, optimiser: torch.optim.Optimizer, rows: TensorDict) -> None:
    """One minibatch."""
    losses = loss(rows)
    total = losses["loss_objective"] + losses["loss_critic"] + losses["loss_entropy"]
    optimiser.zero_grad()
    total.backward()
    nn.utils.clip_grad_norm_(loss.parameters(), 1.0)
    optimiser.step()


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
