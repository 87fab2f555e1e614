"""The driver of a camera: a device, a video or a folder of images."""

from stringcast.hardware.camera.device import Device
from stringcast.hardware.camera.filming import FilmingCamera
from stringcast.hardware.camera.playback import ImageFolder, VideoFile
from stringcast.hardware.camera.source import Source

__all__ = ["Device", "FilmingCamera", "ImageFolder", "Source", "VideoFile"]
