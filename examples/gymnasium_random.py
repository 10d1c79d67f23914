"""Gymnasium: random actions for a few steps. Needs ``pip install 'needlehoop[gym]'``."""

import sys

import gymnasium

import needlehoop

gymnasium.register_envs(needlehoop)


def main(steps: int = 200) -> float:
    """Returns the mean return of the episodes that ended."""
    env = gymnasium.make("needlehoop/NeedleHoop-v0", cams=["dep_front", "seg_side"])
    env.action_space.seed(0)
    observation, _ = env.reset(seed=0)
    print({name: image.shape for name, image in observation.items()})
    returns = []
    for _ in range(steps):
        observation, _, terminated, truncated, info = env.step(env.action_space.sample())
        if terminated or truncated:
            # An episode's return is its last potential: the sum of the reward's terms.
            returns.append(info["potential"])
            print(f"{info['steps']} steps, return {returns[-1]:.2f}, success {info['success']}")
            observation, _ = env.reset()
    env.close()
    return sum(returns) / max(1, len(returns))


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
