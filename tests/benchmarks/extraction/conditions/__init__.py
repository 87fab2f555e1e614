"""Real conditions, rendered.

Each makes a film harder to read in one way, at two or three severities.
"""

from __future__ import annotations

from collections.abc import Mapping

from tests.benchmarks.extraction.conditions.camera import (
    CameraShake,
    CroppedView,
    HotPixels,
    JpegCoding,
    LongExposure,
    SensorNoise,
    VideoCoding,
)
from tests.benchmarks.extraction.conditions.clutter import ArmCable, Cables
from tests.benchmarks.extraction.conditions.condition import (
    Condition,
    Shot,
    film_shot,
    prepare_shot,
)
from tests.benchmarks.extraction.conditions.light import (
    Blobs,
    Contrast,
    Flicker,
    Gradient,
    Shadow,
)
from tests.benchmarks.extraction.conditions.pose import BeforeArm, BehindArm, StringLoop

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
    "before the arm": ((BeforeArm(0.5),), (BeforeArm(0.1),)),
    "behind the arm": ((BehindArm(0.5),), (BehindArm(0.1),)),
    "loop": ((StringLoop(0.20),), (StringLoop(0.12),), (StringLoop(0.06),)),
    "tip out of view": ((CroppedView(0.25),), (CroppedView(0.6),)),
    "motion blur": ((LongExposure(0.25),), (LongExposure(0.5),), (LongExposure(1.0),)),
    "sensor noise": ((SensorNoise(5),), (SensorNoise(10),), (SensorNoise(20),)),
    "camera shake": ((CameraShake(0.5),), (CameraShake(1.0),), (CameraShake(3.0),)),
    "hot pixels": ((HotPixels(100),), (HotPixels(2000),)),
    "JPEG": ((JpegCoding(90),), (JpegCoding(60),), (JpegCoding(30),)),
    "video": ((VideoCoding(),),),
    "several": (
        (Gradient(0.4), Shadow(0.3), Cables(40), LongExposure(0.25), JpegCoding(90)),
        (
            Gradient(0.6),
            Flicker(0.1),
            Shadow(0.5),
            Cables(80),
            LongExposure(0.5),
            SensorNoise(4),
            CameraShake(0.5),
            JpegCoding(60),
        ),
    ),
}

__all__ = ["CONDITIONS", "Condition", "Severities", "Shot", "film_shot", "prepare_shot"]
