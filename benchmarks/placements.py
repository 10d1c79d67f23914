"""Draw the cameras of ``conf/experiment/placements.yaml``, which this prints.

    python benchmarks/placements.py > conf/experiment/placements.yaml

20 single cameras at random over the hemisphere, no two of them closer than 15 degrees, and 20
random pairs of them. All else is that of the shipped views.
"""

from __future__ import annotations

import math
import random
from itertools import combinations

SEED, COUNT, APART = 0, 20, 15.0
LOWEST, HIGHEST = 10.0, 85.0
"""Elevations, degrees: below, the table is seen edge-on; straight down has no azimuth."""


def drawn(seed: int) -> tuple[dict[str, tuple[float, float]], list[tuple[str, str]]]:
    """Azimuth and elevation, degrees, by name; and pairs of names."""
    draw = random.Random(seed)
    low, high = (math.sin(math.radians(end)) for end in (LOWEST, HIGHEST))
    places: list[tuple[float, float]] = []
    while len(places) < COUNT:
        # Uniform over the sphere: the height is.
        elevation = math.degrees(math.asin(draw.uniform(low, high)))
        new = round(draw.uniform(-180.0, 180.0), 0), round(elevation, 0)
        if all(angle(new, old) >= APART for old in places):
            places.append(new)
    names = [f"p{number:02d}" for number in range(1, COUNT + 1)]
    return dict(zip(names, places, strict=True)), draw.sample([*combinations(names, 2)], COUNT)


def angle(a: tuple[float, float], b: tuple[float, float]) -> float:
    """Between two directions, degrees."""
    (az, el), (bz, bl) = (tuple(map(math.radians, direction)) for direction in (a, b))
    cosine = math.sin(el) * math.sin(bl) + math.cos(el) * math.cos(bl) * math.cos(az - bz)
    return math.degrees(math.acos(min(1.0, cosine)))


def text(seed: int) -> str:
    """The experiment's file."""
    views, pairs = drawn(seed)
    singles = ",".join(f"[rgb_{name}]" for name in views)
    both = [f"[rgb_{a},rgb_{b}]" for a, b in pairs]
    lines = [
        "# @package _global_",
        f"# {COUNT} cameras at random over the hemisphere and {COUNT} random pairs of them, for",
        "# imitation and for needlehoop vlm rank. Drawn by benchmarks/placements.py with seed",
        f"# {seed}; no two are closer than {APART:g} degrees. Lengths in m, angles in degrees.",
        "study: placements",
        "views:",
        *(
            f"  {name}: {{target: [0.0, -0.012, 0.023], azimuth: {azimuth}, elevation: {elevation},"
            " distance: 0.40, fovy: 19.6, near: 0.32, far: 0.48}"
            for name, (azimuth, elevation) in views.items()
        ),
        "hydra:",
        "  mode: MULTIRUN",
        "  sweeper:",
        "    params:",
        "      algo: dagger",
        "      cams: >-",
        *(
            f"        {line},"
            for line in (singles, *(",".join(both[i : i + 5]) for i in (0, 5, 10)))
        ),
        f"        {','.join(both[15:])}",
        "      seed: '0'",
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(text(SEED), end="")
