"""Draws docs/cameras_threaded.png, the README's figure, from results/table2."""

import json
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

ROOT = Path(__file__).parents[1]
IMAGE = {"rgb": "colour", "dep": "colour + depth", "seg": "flat colour per object"}
PLACE = {"default": "front, 45° up", "front": "front", "side": "side"}


def words(cameras: str) -> str:
    """A camera set such as ``dep_front+seg_side`` in words."""
    pairs = [one.split("_") for one in cameras.split("+")]
    return " & ".join(f"{PLACE[view]}: {IMAGE[kind]}" for kind, view in pairs)


def main() -> None:
    found = []
    for path in (ROOT / "results" / "table2").glob("*/human/seed0/evaluation.json"):
        said, name = json.loads(path.read_text()), path.parts[-4]
        low, high = said["success_95"]
        found.append((said["success"], "side" in name, words(name), low, high))
    found.sort()
    figure, axes = plt.subplots(figsize=(8.4, 4.6), layout="constrained")
    for row, (success, both, _, low, high) in enumerate(found):
        axes.barh(row, 100 * success, color="#1b7f79" if both else "#d98032")
        axes.plot([100 * low, 100 * high], [row, row], color="black", linewidth=1)
    axes.set_yticks(range(len(found)), [name for _, _, name, _, _ in found])
    axes.set(xlim=(0, 100), xlabel="episodes of 100 in which the needle goes through the hoop")
    figure.suptitle("Two viewpoints (green) against one (orange)")
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(ROOT / "docs" / "cameras_threaded.png", dpi=110)


if __name__ == "__main__":
    main()
