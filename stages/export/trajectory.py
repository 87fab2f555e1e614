"""Export of a motion as `trajectory_msgs/JointTrajectory` of ROS 2."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from stringcast.data.artifacts import JOINTS, SPEEDS
from stringcast.data.lazy_module import LazyModule

mcap_writer = LazyModule("mcap_ros2.writer")

TYPE_NAME = "trajectory_msgs/msg/JointTrajectory"
TOPIC = "/joint_trajectory"
NANOSECONDS_PER_S = 1_000_000_000
SEPARATOR = "=" * 80
DEFINITION = f"""\
std_msgs/Header header
string[] joint_names
trajectory_msgs/JointTrajectoryPoint[] points
{SEPARATOR}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{SEPARATOR}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
{SEPARATOR}
MSG: trajectory_msgs/JointTrajectoryPoint
float64[] positions
float64[] velocities
float64[] accelerations
float64[] effort
builtin_interfaces/Duration time_from_start
{SEPARATOR}
MSG: builtin_interfaces/Duration
int32 sec
uint32 nanosec
"""


def joint_trajectory(
    commands: pd.DataFrame, joint_names: Sequence[str]
) -> dict[str, Any]:
    """Return the commands of a motion as the fields of a JointTrajectory.

    Parameters
    ----------
    commands
        Table COMMANDS: angles [rad] and velocities [rad/s] over time [s].
    joint_names
        Names of the three joints in the robot's description.

    Returns
    -------
    dict
        Fields of the message. Without a time stamp, the motion starts on receipt.
    """
    begin = commands["t"].iloc[0]
    points = []
    for _, row in commands.iterrows():
        nanoseconds = round((row["t"] - begin) * NANOSECONDS_PER_S)
        sec, nanosec = divmod(nanoseconds, NANOSECONDS_PER_S)
        point = {
            "positions": row[list(JOINTS)].tolist(),
            "velocities": row[list(SPEEDS)].tolist(),
            "accelerations": [],
            "effort": [],
            "time_from_start": {"sec": sec, "nanosec": nanosec},
        }
        points.append(point)
    header = {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}
    return {"header": header, "joint_names": list(joint_names), "points": points}


def trajectory_json(trajectory: dict[str, Any]) -> str:
    """Return a trajectory as JSON for `ros2 topic pub`."""
    return json.dumps(trajectory, indent=1) + "\n"


def write_mcap(trajectory: dict[str, Any], file: Path) -> None:
    """Write a trajectory as one message of an MCAP file."""
    with file.open("wb") as stream:
        recording = mcap_writer.Writer(stream)
        schema = recording.register_msgdef(TYPE_NAME, DEFINITION)
        recording.write_message(TOPIC, schema, trajectory, log_time=0, publish_time=0)
        recording.finish()
