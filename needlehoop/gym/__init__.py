"""The task for Gymnasium's users: Env, VectorEnv, Stable-Baselines3's VecEnv. Extra ``gym``."""

try:
    # 1.0 is too old: its vector environments know one way of resetting.
    from gymnasium.vector import AutoresetMode as _AutoresetMode  # noqa: F401
except ImportError as error:
    raise ImportError(
        f"needlehoop.gym needs gymnasium 1.1 or newer ({error});"
        " install it with: pip install 'needlehoop[gym]'"
    ) from error
