"""What pyproject.toml cannot say: a wheel carries ``conf/`` and the runs of the shipped agents."""

from runpy import run_path

from setuptools import find_packages, setup

AGENTS = run_path("needlehoop/runs/shipped.py")["AGENTS"]
PLACES = {"needlehoop.conf": "conf"} | {f"needlehoop.{name}": run for name, run in AGENTS.items()}

setup(
    packages=[*find_packages(include=["needlehoop", "needlehoop.*"]), *PLACES],
    package_dir=PLACES,
)
