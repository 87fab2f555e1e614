"""stringcast: cast an unknown string with a robot arm, and find out why the simulation disagrees with the camera.

The rooms are `stringcast.data`, `.stages`, `.hardware` and `.pipeline`; a clone has a folder for each.
"""

from importlib.metadata import version

__version__ = version("stringcast")
