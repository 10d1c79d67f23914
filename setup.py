"""What pyproject.toml cannot say: a wheel carries ``conf/`` and the shipped agent's run."""

from setuptools import find_packages, setup

PLACES = {
    "needlehoop.conf": "conf",
    "needlehoop.agent": "results/table2/dep_front+seg_side/human/seed0",
}

setup(
    packages=[*find_packages(include=["needlehoop", "needlehoop.*"]), *PLACES],
    package_dir=PLACES,
)
