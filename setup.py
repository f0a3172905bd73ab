"""Adds the folder conf/ to the package as data, which pyproject.toml cannot express."""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["trl_explore*"]), "trl_explore.conf"],
    package_dir={"trl_explore.conf": "conf"},
)
