"""What pyproject.toml cannot say: a wheel carries ``conf/`` inside the package."""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["needlehoop", "needlehoop.*"]), "needlehoop.conf"],
    package_dir={"needlehoop.conf": "conf"},
)
