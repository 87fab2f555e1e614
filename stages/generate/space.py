"""Whether a target lies where the arm and its string can be."""

from __future__ import annotations

from stringcast.data.schema import DataError
from stringcast.stages.model.arm import Arm
from stringcast.stages.model.box import Box


def check_reach(target: Box, arm: Arm, string_length: float) -> None:
    """Refuse a target that the outstretched arm and string cannot touch."""
    reach = arm.reach + string_length
    gap = target.gap(*arm.base)
    if gap > reach:
        raise DataError(
            f"target ({target.x * 1e3:.0f}, {target.y * 1e3:.0f}) mm is out of reach: "
            f"{gap * 1e3:.0f} mm from the arm's base at ({arm.base[0] * 1e3:.0f}, {arm.base[1] * 1e3:.0f}) mm, "
            f"arm and string reach {reach * 1e3:.0f} mm. "
            "Choose target.x and target.y closer, or move arm.base."
        )
