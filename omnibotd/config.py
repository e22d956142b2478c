# ruff: noqa: RUF009 - `option` is dataclasses.field with our metadata
"""The configuration file's options: one table of them, typed, with ranges, defaults and a sentence each.

`python -m omnibotd.config` prints the table as the commented example that is `config/omnibotd.yaml`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from omnibotd.config_reader import ConfigError, option, read, reference

__all__ = [
    "BaseConfig",
    "CameraConfig",
    "Config",
    "ConfigError",
    "ControlConfig",
    "DockingConfig",
    "MappingConfig",
    "NavigationConfig",
    "OdometryConfig",
    "RecordingConfig",
    "StorageConfig",
    "load",
]

BASE_DRIVERS = ("omnibot", "create2", "arduino_bridge")
PRESETS = ("default", "thesis")
HEADINGS = ("wheels", "compass", "fused")
COMPASSES = ("tracker", "registration", "two_point", "image_flow", "labrosse")


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraConfig:
    """The fisheye camera facing the ceiling."""

    source: str = option(
        "Where frames come from: a V4L2 device (best its stable name under /dev/v4l/by-id), an MJPEG stream "
        "(http://...), or to replay a recording: a video file or a folder of images. "
        "A relative path counts from this file.",
        pattern=r"http://[\w\[]|(?!\w+://)",
        words="a device, an http:// address, a video file or a folder of images",
        relative=True,
        example="/dev/video0",
    )
    width: int = option("Width of the image.", 640, unit="px", low=160, high=4096)
    height: int = option("Height of the image.", 480, unit="px", low=120, high=4096)
    fps: float = option("Frames a second to ask of the camera.", 15.0, unit="1/s", low=2.0, high=120.0)
    exposure: float | None = option(
        "Exposure time to hold a V4L2 camera at, against flicker, glare and blur; left out, the camera chooses.",
        None,
        unit="s",
        low=0.0001,
        high=0.5,
        example="0.01",
    )
    white_balance: int | None = option(
        "Colour temperature to hold a V4L2 camera at; left out, the camera chooses.",
        None,
        unit="K",
        low=1000,
        high=20_000,
        example="4600",
    )
    calibration: Path | None = option(
        "Calibration file in the ROS camera_info layout, distortion model equidistant (OpenCV fisheye). "
        "Without it the lens is taken as equidistant, from fov_deg and the image circle. "
        "A relative path counts from this file.",
        None,
        words="the path of a file",
        relative=True,
        example="camera.yaml",
    )
    fov_deg: float = option("Full angle of view of the lens.", 190.0, unit="degrees", low=60.0, high=280.0)
    mount_yaw: float = option(
        "Direction of the image's top in the robot's frame, counter-clockwise from its front.",
        0.0,
        unit="rad",
        low=-math.pi,
        high=math.pi,
    )
    tilt: tuple[float, float] = option(
        "Tilt of the optical axis, a rotation vector: about the direction of the image's top, then about the "
        "one to the left of that.",
        (0.0, 0.0),
        unit="rad",
        low=-0.5,
        high=0.5,
    )
    centre: tuple[float, float] | None = option(
        "Optical centre in the image (column, row), whatever says the lens otherwise; left out, the calibration "
        "file's, or it is found in the frames.",
        None,
        unit="px",
        low=0.0,
        high=4096.0,
        example="[319.5, 239.5]",
    )
    radius: float | None = option(
        "Radius of the image circle; left out, it is found in the frames.",
        None,
        unit="px",
        low=40.0,
        high=8192.0,
        example="240",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class BaseConfig:
    """The two-wheeled base."""

    driver: str = option("Protocol that the base speaks.", choices=BASE_DRIVERS, example="omnibot")
    port: str = option(
        "Where it is: a serial device (best its stable name under /dev/serial/by-id), usb:VID:PID or "
        "usb:VID:PID:SERIAL, or a pyserial URL (socket://127.0.0.1:4000).",
        pattern=r"/|usb:[0-9A-Fa-f]{4}:[0-9A-Fa-f]{4}(:.+)?$|(?!http)\w+://",
        words="a device path, usb:VID:PID[:SERIAL] with four hex digits each, or a pyserial URL",
        example="/dev/ttyUSB0",
    )
    baudrate: int = option(
        "Speed of the serial line.",
        115200,
        unit="bit/s",
        low=1200,
        high=4_000_000,
        by="driver",
        defaults={"arduino_bridge": 57600},
    )
    wheel_radius: float = option(
        "Radius of the driven wheels.",
        0.035,
        unit="m",
        low=0.005,
        high=0.5,
        by="driver",
        defaults={"create2": 0.036},
    )
    wheel_separation: float = option(
        "Distance between the driven wheels.",
        0.23,
        unit="m",
        low=0.03,
        high=2.0,
        by="driver",
        defaults={"create2": 0.235},
    )
    wheel_ratio: float = option(
        "Radius of the left wheel over that of the right one; wheel_radius is their mean.", 1.0, low=0.8, high=1.25
    )
    ticks_per_rev: float | None = option(
        "Encoder counts in a turn of the wheel; left out, what the base says of itself.",
        None,
        low=1.0,
        high=1_000_000.0,
        example="1440",
        by="driver",
        needed_for={"arduino_bridge": "its board can't tell"},
    )
    robot_radius: float = option(
        "Radius of the smallest circle about the wheel axle's middle that holds the robot.",
        0.17,
        unit="m",
        low=0.03,
        high=1.0,
    )
    max_linear_velocity: float = option(
        "Top speed.", 0.3, unit="m/s", low=0.02, high=2.0, by="driver", defaults={"create2": 0.5}
    )
    max_angular_velocity: float = option("Top rate of turn.", 1.0, unit="rad/s", low=0.05, high=6.0)
    max_linear_acceleration: float = option("Greatest change of speed.", 0.5, unit="m/s^2", low=0.05, high=5.0)
    max_angular_acceleration: float = option(
        "Greatest change of rate of turn.", 2.0, unit="rad/s^2", low=0.1, high=20.0
    )
    cmd_vel_timeout: float = option(
        "The robot stops when nobody renewed a driving command for so long.", 0.5, unit="s", low=0.1, high=2.0
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class OdometryConfig:
    """How the robot keeps count of its own motion."""

    heading: str = option(
        "What tells how far it has turned. compass: what is overhead, the wheels only where that shows nothing. "
        "fused: both; with compass tracker the position, too.",
        "wheels",
        choices=HEADINGS,
    )
    compass: str = option(
        "How views of what is overhead are compared, where heading is not wheels. tracker: with key views, learning "
        "how near things are; registration: as for docking; the others are the thesis' methods, frame with frame.",
        "tracker",
        choices=COMPASSES,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class NavigationConfig:
    """How the way is found, and when a place counts as reached."""

    preset: str = option(
        "Method by which the next maps are made; a map is always used by the method that made it. "
        "thesis: Burbridge 2010 to the letter, which needs a red and a blue tile on the ceiling.",
        "default",
        choices=PRESETS,
    )
    xy_goal_tolerance: float = option(
        "Distance from the goal that counts as there.", 0.05, unit="m", low=0.01, high=1.0
    )
    yaw_goal_tolerance: float = option("Heading error that counts as there.", 0.05, unit="rad", low=0.01, high=math.pi)


@dataclass(frozen=True, slots=True, kw_only=True)
class DockingConfig:
    """Docking."""

    max_retries: int = option("Times to back out and approach again before giving up.", 3, low=0, high=20)
    ceiling_height: float | None = option(
        "Height of the ceiling above the camera at the dock; left out, it is measured from the robot's own motion.",
        None,
        unit="m",
        low=0.5,
        high=20.0,
        example="2.2",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingConfig:
    """Recordings, from which maps are made."""

    frame_rate: float = option("Frames a second that are recorded.", 5.0, unit="1/s", low=0.2, high=60.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class MappingConfig:
    """How large a map may grow; beyond that the nodes go that its others explain best."""

    max_nodes: int = option(
        "Most nodes of a map; a room of 4 x 4 m taught in 15 minutes has 2000.", 20_000, low=100, high=200_000
    )
    max_megabytes: float = option("Largest file of a map.", 16.0, unit="MB", low=0.2, high=500.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class StorageConfig:
    """Maps and recordings."""

    directory: Path = option(
        "Folder of maps and recordings.",
        Path("/var/lib/omnibotd"),
        words="the path of a folder",
        relative=True,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlConfig:
    """The socket that omnibotctl talks to."""

    # sun_path holds 108 bytes with its closing zero.
    socket: Path = option(
        "Path of the socket.",
        Path("/run/omnibotd/control.sock"),
        words="a path of at most 107 bytes",
        max_length=107,
        relative=True,
    )
    group: str | None = option(
        "Group whose members may drive the robot; left blank, the group of the process.",
        "omnibot",
        words="the name of a group",
        max_length=32,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """A whole configuration file. SI units."""

    camera: CameraConfig
    base: BaseConfig
    odometry: OdometryConfig = OdometryConfig()
    navigation: NavigationConfig = NavigationConfig()
    docking: DockingConfig = DockingConfig()
    recording: RecordingConfig = RecordingConfig()
    mapping: MappingConfig = MappingConfig()
    storage: StorageConfig = StorageConfig()
    control: ControlConfig = ControlConfig()


def load(path: Path) -> Config:
    """The configuration in the file `path`; raises ConfigError with every fault found."""
    return read(path, Config)


if __name__ == "__main__":
    print(reference(Config), end="")
