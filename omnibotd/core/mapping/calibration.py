"""The camera a map was taught with, and whether another one sees the same."""

from __future__ import annotations

import math

from omnibotd.core.mapping.topo_map import TopoMap
from omnibotd.core.vision.camera_model import CameraModel

# Views are blurred over 5 degrees, and heading and place are good to a tenth of that: what moves a ray by more than
# this (rad) makes other views. A spin calibration corrects less, a bumped or exchanged camera more.
_TOLERANCE = math.radians(2.5)
# Zenith angle (rad) at which lenses are compared: half-way out, where most of a view's cells lie.
_COMPARED_AT = 1.0
# Angle of view (rad) beyond which a view needs nothing.
_ENOUGH = 2.0 * 1.39


def calibration_of(camera: CameraModel) -> dict[str, float]:
    """The numbers by which a map recognises the camera it was taught with."""
    k = camera.distortion
    return {
        "width": float(camera.width),
        "height": float(camera.height),
        "fx": camera.fx,
        "fy": camera.fy,
        "cx": camera.cx,
        "cy": camera.cy,
        **{f"k{i + 1}": k[i] for i in range(4)},
        "fov": camera.fov,
        "mount_yaw": camera.mount_yaw,
        "tilt_x": camera.tilt[0],
        "tilt_y": camera.tilt[1],
    }


def calibration_differs(topo_map: TopoMap, camera: CameraModel) -> str | None:
    """Why the map's views can't be compared with this camera's, naming the number; None where they can.

    Numbers may differ as long as rays move by less than 2.5 degrees; `mount_yaw` may, views being in the base's frame.
    """
    taught, now = dict(topo_map.camera), calibration_of(camera)
    if not taught.keys() >= now.keys():  # nothing is known of how it was taught
        return None
    for name, moved in _ray_changes(taught, now).items():
        if abs(moved) > _TOLERANCE:
            return (
                f"map {topo_map.name!r} was taught with another camera: {name} was {taught[name]:.4g} and is "
                f"{now[name]:.4g} ({math.degrees(abs(moved)):.1f} degrees in the image, "
                f"{math.degrees(_TOLERANCE):.1f} are tolerated); put the calibration right, or teach a new map"
            )
    return None


def _ray_changes(taught: dict[str, float], now: dict[str, float]) -> dict[str, float]:
    """By how much (rad) each number moves rays. Other sizes of the same picture are the same camera."""
    scale = taught["width"] / now["width"]
    changes = {"height": (taught["height"] - scale * now["height"]) / taught["fy"]}
    for focal, centre in (("fx", "cx"), ("fy", "cy")):
        changes[focal] = _COMPARED_AT * (taught[focal] / (scale * now[focal]) - 1.0)
        changes[centre] = (taught[centre] + 0.5 - scale * (now[centre] + 0.5)) / taught[focal]
    changes |= {f"k{i}": (taught[f"k{i}"] - now[f"k{i}"]) * _COMPARED_AT ** (2 * i + 1) for i in range(1, 5)}
    changes["fov"] = min(taught["fov"], _ENOUGH) - min(now["fov"], _ENOUGH)
    return changes | {name: taught[name] - now[name] for name in ("tilt_x", "tilt_y")}
