"""What pyproject.toml cannot say: the folder conf/ is the package's data, whatever the rooms."""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["trl_explore*"]), "trl_explore.conf"],
    package_dir={"trl_explore.conf": "conf"},
)
