"""Exposure and white balance of a V4L2 camera: locked where the configuration says so, else left to the camera."""

from __future__ import annotations

from omnibotd.io import camera_v4l2_abi as abi
from omnibotd.io.camera_v4l2_device import Device

_EXPOSURE_UNIT = 1e-4  # s


def lock_exposure(device: Device, seconds: float | None) -> tuple[float | None, str]:
    """Hold the exposure at so many seconds, None: automatic. The seconds it is held at, and why not as was asked.

    An automatic one may not lengthen it beyond the time between frames: a dim room would halve the rate.
    """
    _try(device, abi.CID_EXPOSURE_AUTO_PRIORITY, 0)
    if seconds is None:
        automatic = (abi.EXPOSURE_APERTURE_PRIORITY, abi.EXPOSURE_AUTOMATIC)
        any(_try(device, abi.CID_EXPOSURE_AUTO, mode) for mode in automatic)
        return None, ""
    _try(device, abi.CID_EXPOSURE_AUTO, abi.EXPOSURE_MANUAL)
    held, why_not = _held(device, abi.CID_EXPOSURE_ABSOLUTE, round(seconds / _EXPOSURE_UNIT))
    if held is None:
        return None, f"camera.exposure is not kept: {why_not}"
    kept = held * _EXPOSURE_UNIT
    return kept, "" if not why_not else f"camera.exposure {seconds:g} s: the camera holds {kept:g} s"


def lock_white_balance(device: Device, kelvin: int | None) -> tuple[int | None, str]:
    """Hold the white balance at so many kelvin, None: automatic. What it is held at, and why not as was asked."""
    _try(device, abi.CID_AUTO_WHITE_BALANCE, int(kelvin is None))
    if kelvin is None:
        return None, ""
    held, why_not = _held(device, abi.CID_WHITE_BALANCE_TEMPERATURE, kelvin)
    if held is None:
        return None, f"camera.white_balance is not kept: {why_not}"
    return held, "" if not why_not else f"camera.white_balance {kelvin} K: the camera holds {held} K"


def _held(device: Device, control: int, value: int) -> tuple[int | None, str]:
    """Set the control as near as it goes; what it says then, and what is not as asked."""
    span = device.control(control)
    if span is None:
        return None, "this camera can't"
    try:
        device.set(control, min(max(value, span.minimum), span.maximum))
        held = device.get(control)
    except OSError as error:
        return None, f"this camera refuses ({error.strerror})"
    return held, "" if abs(held - value) <= max(span.step, 1) else "out of its range"


def _try(device: Device, control: int, value: int) -> bool:
    """Whether the camera has the control and took the value."""
    if device.control(control) is None:
        return False
    try:
        device.set(control, value)
    except OSError:
        return False
    return True
