"""The camera: frames from a device, a video or a folder of images, filmed in the background, timed and counted."""

from stringcast.hardware.camera.device import Device
from stringcast.hardware.camera.filming import FilmingCamera
from stringcast.hardware.camera.folder import ImageFolder
from stringcast.hardware.camera.source import Source
from stringcast.hardware.camera.video import VideoFile

__all__ = ["Device", "FilmingCamera", "ImageFolder", "Source", "VideoFile"]
