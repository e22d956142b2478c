"""The camera's lens from a folder of chessboard pictures; run as a command, or as a child process of low priority.

`python -m omnibotd.lens_calibration --images FOLDER [--board 9x6] [--square 0.025] --out camera.yaml [--json]`
prints a line a picture, then the result. With --json each line is an object: {"image": name, "found": bool, "message":
sentence}, then {"done": the camera_info written} or {"error": sentence}. Exit status 0, or 1 with nothing written.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from omnibotd.core.calibration.chessboard import Board, BoardView, agreed, find_grids, view_of
from omnibotd.core.calibration.lens import LensResult, calibrate_lens
from omnibotd.core.errors import CoreError
from omnibotd.core.percept import Verdict
from omnibotd.core.vision import image_circle
from omnibotd.core.vision.frame import Frame, Image

Floats = NDArray[np.float64]
Say = Callable[[Mapping[str, Any]], None]

SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".webp", ".tif", ".tiff", ".pgm", ".ppm")
# Pictures looked at, taken evenly from a larger folder: a video's worth says no more, and takes minutes.
MOST_PICTURES = 200
NICENESS = 15  # the robot may be driving; 19 would starve on a busy single core
_HEADER = "# The camera's lens, measured with a chessboard: name this file under `camera.calibration`.\n"


class LensCalibrationError(CoreError):
    """Pictures from which no lens can be had, and what to do about it."""


@dataclass(frozen=True, slots=True)
class _Seen:
    """What one picture shows: chessboards of any size, the largest first; `size` is (width, height)."""

    name: str
    size: tuple[int, int]
    grids: list[Floats]


class _Brightest:
    """The brightest that each pixel was in pictures of one size: it tells the image circle from dark corners."""

    def __init__(self) -> None:
        self._images: dict[tuple[int, int], Image] = {}

    def add(self, grey: Image) -> None:
        known = self._images.get(_size(grey))
        self._images[_size(grey)] = grey if known is None else np.maximum(known, grey)

    def circle(self, size: tuple[int, int]) -> tuple[float, float, float] | None:
        return image_circle.find([Frame(0.0, self._images[size])])


def calibrate_folder(folder: Path, board: Board | None, square: float, say: Say) -> dict[str, Any]:
    """The camera_info of the lens that took the pictures in `folder`. Raises LensCalibrationError.

    `board` is None where the pictures are to tell its size. `say` is given what each picture shows.
    """
    brightest = _Brightest()
    pictures = list(_looked_at(_pictures_in(folder), brightest, say))
    size = _usual_size(pictures)
    alike = [picture for picture in pictures if picture.size == size]
    board = _board(alike, board, square)
    views = [view for picture in alike if (view := _view(picture, board)) is not None]
    result = calibrate_lens(views, size, brightest.circle(size))
    if result.verdict is not Verdict.ACCEPTED:
        raise LensCalibrationError(f"{result.sentence} ({len(views)} of {len(pictures)} pictures showed the board)")
    others = {p.name: f"is of {p.size[0]}x{p.size[1]} pixels" for p in pictures if p.grids and p.size != size}
    return _facts(result, board, folder, others)


def _pictures_in(folder: Path) -> list[Path]:
    """In the order a person counts, 2 before 10."""
    try:
        paths = [path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES]
    except OSError as error:
        raise LensCalibrationError(f"{folder}: can't be read: {error.strerror}") from error
    if not paths:
        raise LensCalibrationError(f"{folder}: holds no pictures ({', '.join(SUFFIXES)})")
    paths.sort(
        key=lambda path: [(int(part) if part.isdecimal() else 0, part) for part in re.split(r"(\d+)", path.name)]
    )
    chosen = np.unique(np.linspace(0, len(paths) - 1, MOST_PICTURES).astype(int))
    return [paths[i] for i in chosen]


def _looked_at(paths: Sequence[Path], brightest: _Brightest, say: Say) -> Iterator[_Seen]:
    for path in paths:
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if image is None:
            say({"image": path.name, "found": False, "message": "is no picture that OpenCV can read"})
            continue
        grey = np.asarray(image, np.uint8)
        grids = find_grids(grey)
        brightest.add(grey)
        say({"image": path.name, "found": bool(grids), "message": _described(grids)})
        yield _Seen(path.name, _size(grey), grids)


def _size(grey: Image) -> tuple[int, int]:
    return grey.shape[1], grey.shape[0]


def _described(grids: Sequence[Floats]) -> str:
    if not grids:
        return "no chessboard"
    rows, columns = sorted(grids[0].shape[:2])
    corners = int(np.isfinite(grids[0][..., 0]).sum())
    hidden = "" if corners == rows * columns else f", {corners} of them seen"
    return f"a chessboard of {columns}x{rows} inner corners{hidden}"


def _usual_size(pictures: Sequence[_Seen]) -> tuple[int, int]:
    """The size of most of the pictures with a board."""
    sizes = Counter(picture.size for picture in pictures if picture.grids)
    if not sizes:
        raise LensCalibrationError(
            f"No chessboard in any of {len(pictures)} pictures: print one of 9x6 inner corners with a white margin, "
            "and take pictures in focus and in good light, in which its squares are 10 pixels wide or more"
        )
    return sizes.most_common(1)[0][0]


def _board(pictures: Sequence[_Seen], told: Board | None, square: float) -> Board:
    """The board as told, unless the pictures say otherwise; as the pictures say, where none was told."""
    found = agreed((picture.grids for picture in pictures), square)
    if told is None:
        if found is None:
            raise LensCalibrationError("The pictures do not agree on the size of the board: say --board COLUMNSxROWS")
        return found
    if found is not None and {found.columns, found.rows} != {told.columns, told.rows}:
        raise LensCalibrationError(
            f"The board in the pictures has {found} inner corners, not {told}: count where four squares meet, or say "
            f"--board {found}"
        )
    return told


def _view(picture: _Seen, board: Board) -> BoardView | None:
    views = (view_of(grid, board, picture.name) for grid in picture.grids)
    return next((view for view in views if view is not None), None)


def _facts(result: LensResult, board: Board, folder: Path, others: Mapping[str, str]) -> dict[str, Any]:
    """What is written: the lens, then when and from what it was measured. `others` are pictures of another size."""
    info = result.camera_info()
    return {
        **info,
        "dropped": {**info["dropped"], **others},
        "date": datetime.now().astimezone().isoformat(timespec="seconds"),
        "sentence": result.sentence,
        "board": str(board),
        "square_m": board.square,
        "images": str(folder.resolve()),
    }


def write(path: Path, facts: Mapping[str, Any]) -> None:
    """As YAML, whole or not at all. Raises LensCalibrationError."""
    new = path.with_name(f".{path.name}.new")
    try:
        with new.open("w", encoding="utf-8") as file:
            file.write(_HEADER)
            yaml.safe_dump(dict(facts), file, sort_keys=False, allow_unicode=True, default_flow_style=None, width=110)
            file.flush()
            os.fsync(file.fileno())
        os.replace(new, path)
    except OSError as error:
        raise LensCalibrationError(f"{path}: can't be written: {error.strerror or error}") from error


def _tell(message: Mapping[str, Any]) -> None:
    """For people."""
    if "image" in message:
        print(f"{message['image']}: {message['message']}", flush=True)
    elif "error" in message:
        print(message["error"], file=sys.stderr)
    else:
        done = message["done"]
        for name, rms in done["views"].items():
            print(f"{name}: {rms:.2f} px rms")
        for name, why in done["dropped"].items():
            print(f"{name}: dropped, {why}")
        print(done["sentence"])


def _tell_as_json(message: Mapping[str, Any]) -> None:
    print(json.dumps(message), flush=True)


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m omnibotd.lens_calibration", description=__doc__)
    parser.add_argument("--images", type=Path, required=True, metavar="FOLDER", help="pictures of one camera")
    parser.add_argument("--board", metavar="COLSxROWS", help="inner corners; found out where not told")
    parser.add_argument("--square", type=float, default=0.025, metavar="M", help="side of a square; noted, not needed")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE", help="written if the result is good")
    parser.add_argument("--json", action="store_true", help="one JSON object a line")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command's side, and the child's."""
    options = _options(arguments)
    say = _tell_as_json if options.json else _tell
    try:
        board = None if options.board is None else Board.parse(options.board, options.square)
        if not options.out.absolute().parent.is_dir():  # said before the work, not after
            raise LensCalibrationError(f"{options.out}: can't be written: there is no such folder")
        facts = calibrate_folder(options.images, board, options.square, say)
        write(options.out, facts)
    except CoreError as error:
        say({"error": str(error)})
        return 1
    say({"done": facts})
    return 0


if __name__ == "__main__":
    os.nice(NICENESS)
    cv2.setNumThreads(1)  # one core is left to the robot
    sys.exit(main())
