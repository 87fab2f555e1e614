"""The camera: frames from a device, a video or a folder of images, filmed in the background, timed and counted."""

from hardware.camera.device import Device
from hardware.camera.filming import FilmingCamera
from hardware.camera.folder import ImageFolder
from hardware.camera.source import Source
from hardware.camera.video import VideoFile

__all__ = ["Device", "FilmingCamera", "ImageFolder", "Source", "VideoFile"]
