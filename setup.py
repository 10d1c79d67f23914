"""What pyproject.toml cannot say: a wheel carries ``conf/`` and the runs of the shipped agents."""

from setuptools import find_packages, setup

PLACES = {
    "needlehoop.conf": "conf",
    "needlehoop.agent": "results/agents/dep_front+seg_side/human/seed0",
    "needlehoop.agent_reach": "results/reach/dep_front+seg_side/expert/seed0",
    "needlehoop.agent_peg_transfer": "results/peg_transfer/dep_front+seg_side/expert/seed0",
    "needlehoop.agent_handover": "results/handover/rgb_front+rgb_side/expert/seed0",
}

setup(
    packages=[*find_packages(include=["needlehoop", "needlehoop.*"]), *PLACES],
    package_dir=PLACES,
)
