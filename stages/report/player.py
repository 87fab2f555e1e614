"""The animation: small frames and the simulated strings, as data for the page's player."""

from __future__ import annotations

import base64

import cv2
import numpy as np

from stages.report.record import Cast, Record

FRAMES = 60  # at most, spread over the trial
SIZE = 420  # [px] of the longer side


def animation(record: Record, cast: Cast) -> dict[str, object]:
    """Everything the player draws, JSON-able; coordinates in its own pixels."""
    camera = record.camera
    scale = min(SIZE / max(camera.width, camera.height), 1.0)
    chosen = np.unique(np.linspace(0, len(cast.trial.images) - 1, FRAMES).astype(int))
    target = record.target
    half = np.array([target.w, -target.h]) / 2
    corners = np.array([target.x, target.y]) + np.array([[-1], [1]]) * half
    return {
        "width": round(camera.width * scale),
        "height": round(camera.height * scale),
        "t": [round(float(cast.trial.frames["t"].iloc[i]) * 1e3) for i in chosen],
        "frames": [_jpeg(cast.trial.images[int(i)], scale) for i in chosen],
        "before": [_pixels(record, cast.before[i], scale) for i in chosen],
        "after": [_pixels(record, cast.after[i], scale) for i in chosen],
        "target": _pixels(record, corners, scale),
    }


def _jpeg(image: np.ndarray, scale: float) -> str:
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    good, data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, 60])
    assert good
    return base64.b64encode(data.tobytes()).decode()


def _pixels(record: Record, points: np.ndarray, scale: float) -> list[list[float]]:
    """Pixels of the small picture; empty where the simulation was rejected."""
    if not np.isfinite(points).all():
        return []
    return np.round((record.camera.pixels(points) + 0.5) * scale, 1).tolist()
