"""The verbs `calibrate camera`, `spin` and `base`. Pictures in a folder need no daemon: a child process reads them."""

from __future__ import annotations

import argparse
import json
import math
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from omnibotd.cli_verbs import Params, Terminal, UsageError, simple
from omnibotd.control_client import RemoteError
from omnibotd.control_protocol import JOB_FAILED
from omnibotd.core.error_name import ErrorName


def camera(terminal: Terminal, options: argparse.Namespace) -> None:
    """Live by the daemon, or here from a folder."""
    if options.images is not None:
        _from_folder(terminal, options)
        return
    if options.output is not None:
        raise UsageError("calibrate camera: -o goes with --images; live, the daemon keeps the result")
    run = simple("calibrate.camera", "hold a chessboard before the camera", _lens, "board", "square", job=True)
    run(terminal, options)


def spin(terminal: Terminal, options: argparse.Namespace) -> None:
    simple("calibrate.spin", "calibrating by a turn", _axis, job=True)(terminal, options)


def base(terminal: Terminal, options: argparse.Namespace) -> None:
    simple("calibrate.base", "calibrating the wheels", _wheels, "distance", job=True)(terminal, options)


def _from_folder(terminal: Terminal, options: argparse.Namespace) -> None:
    folder, target = Path(options.images), Path(options.output or "camera.yaml")
    if not folder.is_dir():
        raise UsageError(f"calibrate camera: {folder} is no folder")
    with TemporaryDirectory(prefix="omnibot-lens-") as scratch:
        new = Path(scratch) / "camera.yaml"
        info = _fitted(terminal, _command(options, folder, new))
        _replace(target, new)
    told = {"calibration": "camera", "file": str(target), **{key: info[key] for key in _TOLD if key in info}}
    told["message"] = info.get("sentence", "")
    wrote = f"wrote {target}: name it in the configuration under camera.calibration"
    terminal.show(told, f"{told['message'] or _facts(told)}\n{wrote}")


_TOLD = ("rms_px", "edge_sigma_px", "covered_deg", "coverage", "field_of_view_deg")


def _command(options: argparse.Namespace, folder: Path, new: Path) -> list[str]:
    command = [sys.executable, "-m", "omnibotd.lens_calibration", "--images", str(folder), "--out", str(new), "--json"]
    if options.board is not None:
        command += ["--board", options.board]
    return command if options.square is None else [*command, "--square", str(options.square)]


def _fitted(terminal: Terminal, command: list[str]) -> Params:
    """The camera_info that the child wrote; every picture is told on the live line."""
    pictures = found = 0
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        try:
            for message in _messages(child):
                if "error" in message:
                    raise RemoteError(JOB_FAILED, ErrorName.CALIBRATION_FAILED, str(message["error"]))
                if "done" in message:
                    info: Params = message["done"]
                    return info
                pictures, found = pictures + 1, found + bool(message.get("found"))
                terminal.live.show(f"{message.get('image')}: {message.get('message', '')}  {found} of {pictures} found")
        finally:
            terminal.live.clear()
            if child.poll() is None and sys.exc_info()[0] is not None:
                child.kill()
    raise RemoteError(JOB_FAILED, ErrorName.CALIBRATION_FAILED, f"the fit ended with status {child.returncode}")


def _messages(child: subprocess.Popen[str]) -> Iterator[Params]:
    assert child.stdout is not None
    for line in child.stdout:
        with suppress(ValueError):
            message = json.loads(line)
            if isinstance(message, dict):
                yield message


def _replace(target: Path, new: Path) -> None:
    """The file before is kept as FILE.old."""
    try:
        part = target.with_name(f".{target.name}.new")
        part.write_bytes(new.read_bytes())
        if target.exists():
            os.replace(target, target.with_name(f"{target.name}.old"))
        os.replace(part, target)
    except OSError as error:
        raise RemoteError(JOB_FAILED, ErrorName.STORAGE, f"{target}: {error.strerror or error}") from error


def _lens(result: Mapping[str, Any]) -> str:
    return _told(result, _facts(result))


def _facts(result: Mapping[str, Any]) -> str:
    formats = {
        "rms_px": "corners {:.2f} px rms off the lens",
        "covered_deg": "seen out to {:.0f} degrees off axis",
        "edge_sigma_px": "known to {:.2g} px there",
    }
    return ", ".join(form.format(result[key]) for key, form in formats.items() if result.get(key) is not None)


def _axis(result: Mapping[str, Any]) -> str:
    (u, v), (x, y) = result["centre"], result["tilt"]
    centre = f"optical centre {u:.1f}, {v:.1f} px (to {result['centre_sigma_px']:.2f} px)"
    angles = f"{math.degrees(x):.2f}, {math.degrees(y):.2f} degrees (to {result['tilt_sigma_deg']:.2f})"
    return _told(result, f"{centre}, tilt {angles}, residual {result['residual']}")


def _wheels(result: Mapping[str, Any]) -> str:
    radius = f"radius {1000 * result['wheel_radius']:.2f} mm"
    separation = f"separation {1000 * result['wheel_separation']:.1f} mm"
    return _told(result, f"{radius}, left over right {result['wheel_ratio']:.4f}, {separation}")


def _told(result: Mapping[str, Any], facts: str) -> str:
    lines = [facts, result.get("message", ""), f"kept as {result['file']}; {result['effect']}"]
    return "\n".join(line for line in lines if line)
