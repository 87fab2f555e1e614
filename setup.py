"""Make one package of the folders of a clone: `stages/` is `stringcast.stages`."""

from setuptools import find_packages, setup

ROOMS = ("conf", "data", "hardware", "pipeline", "stages")
FOLDERS = {f"stringcast.{room}": room for room in ROOMS}
FOLDERS |= {"stringcast": "pipeline/api", "hydra_plugins": "hydra_plugins"}
INSIDE = [
    f"stringcast.{room}.{inside}"
    for room in ROOMS
    for inside in find_packages(room, exclude=["api"])
]

setup(package_dir=FOLDERS, packages=[*FOLDERS, *INSIDE])
