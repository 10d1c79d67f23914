"""TorchRL's usual chain of transforms on images, and what to mind.

Pixels are channels first, ``(n, c, h, w)`` uint8. ``ToTensorImage`` takes them for channels
last and permutes ``(4, 64, 64)`` to ``(64, 4, 64)`` without a word: give it
``shape_tolerant=True``, and it only scales to [0, 1]. Frames are stacked along dim -3, by
``CatFrames`` or, without memory for floats, by the environment itself (``obs.frame_stack=3``).
"""

import sys

from tensordict import TensorDictBase
from torchrl.envs import (
    CatFrames,
    Compose,
    RewardSum,
    StepCounter,
    ToTensorImage,
    TransformedEnv,
)

import needlehoop

CAMERAS = ["dep_front", "seg_side"]


def make(num_envs: int = 4, frames: int = 3) -> TransformedEnv:
    """Float images of three frames, and each episode's steps and return so far."""
    pixels = [("pixels", name) for name in CAMERAS]
    chain = Compose(
        ToTensorImage(in_keys=pixels, shape_tolerant=True),
        CatFrames(frames, dim=-3, in_keys=pixels),
        StepCounter(),
        RewardSum(),
    )
    return TransformedEnv(needlehoop.make_env(CAMERAS, num_envs=num_envs), chain)


def main(steps: int = 20) -> TensorDictBase:
    """A rollout ``(num_envs, steps)`` of random actions."""
    rollout = make().rollout(steps, break_when_any_done=False)
    for name in CAMERAS:
        image = rollout["pixels", name]
        print(name, tuple(image.shape), image.dtype, f"{image.min():.2f} to {image.max():.2f}")
    print("return so far", rollout["next", "episode_reward"][:, -1].flatten().tolist())
    return rollout


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
