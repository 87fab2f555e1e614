"""Callables that settings of arms and cameras may name; nothing is imported."""

from __future__ import annotations

PICTURE_SOURCES = (
    "hardware.camera.Device",
    "hardware.camera.ImageFolder",
    "hardware.camera.VideoFile",
)
# These move no real arm.
VIRTUAL_HARDWARE = ("hardware.virtual.open_lab", "hardware.serial.rehearsal.open_lab")
ROLES = {
    "hardware": (
        *VIRTUAL_HARDWARE,
        "hardware.serial.lab.open_lab",
        "hardware.dynamixel.lab.open_lab",
    ),
    "source": PICTURE_SOURCES,  # of pictures
    "plane": PICTURE_SOURCES,
}
