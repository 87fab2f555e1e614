"""Real conditions, rendered: each makes a film harder to read in one way, at two or three severities."""

from __future__ import annotations

from collections.abc import Mapping

from stringcast.hardware.virtual.conditions.camera import Closer, Exposure, HotPixels, Jpeg, Noise, Shake, Video
from stringcast.hardware.virtual.conditions.clutter import ArmCable, Cables
from stringcast.hardware.virtual.conditions.condition import Condition, Shot, film, shot_of
from stringcast.hardware.virtual.conditions.light import Blobs, Contrast, Flicker, Gradient, Shadow
from stringcast.hardware.virtual.conditions.pose import Across, Behind, Loop

Severities = tuple[tuple[Condition, ...], ...]
CONDITIONS: Mapping[str, Severities] = {
    "plain": ((),),
    "lamp at one side": ((Gradient(0.5),), (Gradient(0.8),)),
    "flicker": ((Flicker(0.1),), (Flicker(0.3),)),
    "arm's shadow": ((Shadow(0.3),), (Shadow(0.7),)),
    "cluttered wall": ((Cables(40),), (Cables(90),), (Cables(160),)),
    "moving cable": ((ArmCable(110),), (ArmCable(205),)),
    "low contrast": ((Contrast(80),), (Contrast(40),), (Contrast(20),)),
    "drifting dust": ((Blobs(3, 20),), (Blobs(10, 60),)),
    "before the arm": ((Across(0.5),), (Across(0.1),)),
    "behind the arm": ((Behind(0.5),), (Behind(0.1),)),
    "loop": ((Loop(0.20),), (Loop(0.12),), (Loop(0.06),)),
    "tip out of view": ((Closer(0.25),), (Closer(0.6),)),
    "motion blur": ((Exposure(0.25),), (Exposure(0.5),), (Exposure(1.0),)),
    "sensor noise": ((Noise(5),), (Noise(10),), (Noise(20),)),
    "camera shake": ((Shake(0.5),), (Shake(1.0),), (Shake(3.0),)),
    "hot pixels": ((HotPixels(100),), (HotPixels(2000),)),
    "JPEG": ((Jpeg(90),), (Jpeg(60),), (Jpeg(30),)),
    "video": ((Video(),),),
    "several": (
        (Gradient(0.4), Shadow(0.3), Cables(40), Exposure(0.25), Jpeg(90)),
        (Gradient(0.6), Flicker(0.1), Shadow(0.5), Cables(80), Exposure(0.5), Noise(4), Shake(0.5), Jpeg(60)),
    ),
}

__all__ = ["CONDITIONS", "Condition", "Severities", "Shot", "film", "shot_of"]
