"""Cameras and a task of your own: a folder of YAML, laid out as ``conf/``.

``examples/conf`` has the view ``top``, the rendering ``needle`` and the task ``small``; they
combine with those of the package. Every command and ``train.py`` takes the folder as well:
``python train.py conf_dir=examples/conf cams=needle_top,rgb_top task=small``
"""

from pathlib import Path

from tensordict import TensorDictBase

import needlehoop

FOLDER = Path(__file__).parent / "conf"


def main() -> TensorDictBase:
    """The first images of two environments, by camera."""
    env = needlehoop.make_env(
        ["rgb_top", "needle_top", "needle_side"],
        num_envs=2,
        overrides=["task=small"],
        conf_dir=FOLDER,
    )
    pixels = env.reset()["pixels"]
    for name, image in pixels.items():
        share = (image > 0).any(1).float().mean()
        print(f"{name}: {tuple(image.shape)}, {share:.1%} of the pixels are not black")
    return pixels


if __name__ == "__main__":
    main()
