"""Setting and verification of camera controls (exposure, gain, focus, ...)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import AfterValidator

from stringcast.data.lazy_module import LazyModule
from stringcast.stages.execute.interfaces import HardwareError

cv2 = LazyModule("cv2")

RELATIVE_TOLERANCE = 0.01  # of a value read back
# OpenCV's value of a property that a backend cannot report
UNREPORTED_VALUES = (0.0, -1.0)


def _require_known_properties(controls: Mapping[str, float]) -> Mapping[str, float]:
    unknown = [name for name in controls if not hasattr(cv2, f"CAP_PROP_{name}")]
    if unknown:
        raise ValueError(
            f"OpenCV has no property CAP_PROP_{unknown[0]}; such are AUTO_EXPOSURE, "
            "EXPOSURE, GAIN, AUTO_WB"
        )
    return controls


Controls = Annotated[Mapping[str, float], AfterValidator(_require_known_properties)]


def apply_controls(
    capture: Any,
    name: str,
    form: Mapping[str, float],
    controls: Mapping[str, float],
) -> tuple[str, ...]:
    """Set size, rate and controls, and read the controls back once all are set.

    Size and rate are measured later, as drivers only repeat the request.

    Parameters
    ----------
    capture
        The open device.
    name
        Its name for messages.
    form
        Size and rate by OpenCV's names.
    controls
        Controls by OpenCV's names.

    Returns
    -------
    tuple of str
        Remarks on controls that could not be verified.

    Raises
    ------
    HardwareError
        If a control has another value.
    """
    accepted = {
        key: capture.set(_property_number(key), value)
        for key, value in {**form, **controls}.items()
    }
    remarks = []
    for key, value in controls.items():
        reported = float(capture.get(_property_number(key)))
        tolerance = RELATIVE_TOLERANCE * max(abs(value), RELATIVE_TOLERANCE)
        if abs(reported - value) <= tolerance:
            continue
        if accepted[key] or reported not in UNREPORTED_VALUES:
            raise HardwareError(
                name,
                f"source.controls.{key} is {value:g}, the driver reports {reported:g}",
                "Set it to what the driver can do (v4l2-ctl --list-ctrls lists "
                "it), choose another source.backend, or take it out of "
                "source.controls if it does not matter.",
            )
        remarks.append(f"the driver can neither set nor report {key}")
    return tuple(remarks)


def _property_number(key: str) -> int:
    return int(getattr(cv2, f"CAP_PROP_{key}"))
